"""Flags of the settings, shared by the commands that map and match; made from the settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.settings import (
    PRESETS,
    SETTING_FIELDS,
    SettingField,
    Settings,
    resolve_settings,
)
from edge_vpr_tools.output.messages import warning

DEFAULT_PRESET = "default"
#: the group of those that can be changed after a map is made
_MATCHING = "matching"


def add_map_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of every setting that decides a map, and how it is matched."""
    group = parser.add_argument_group(
        "settings",
        f"flags go over --config, which goes over --preset; defaults are those of {DEFAULT_PRESET}",
    )
    group.add_argument(
        "--preset", choices=tuple(PRESETS), default=DEFAULT_PRESET, help="a set of settings"
    )
    group.add_argument("--config", metavar="FILE", help="TOML file with settings")
    for title in ("pixels", "windows", "counters", "cleaning"):
        _add_flags(parser.add_argument_group(title), title)
    add_match_flags(parser.add_argument_group(_MATCHING))


def add_match_flags(parser: argparse._ActionsContainer, default: str = "") -> None:
    """Add the flags of the settings that decide how a map is matched.

    Parameters
    ----------
    parser : parser or group
    default : str, optional
        Whose value holds where a flag is not given; empty for the preset's.
    """
    _add_flags(parser, _MATCHING, default)


def map_settings(args: argparse.Namespace) -> Settings:
    """Resolve the settings that the flags of `add_map_flags` ask for.

    Raises
    ------
    UsageError
        If a value is wrong.
    """
    flags = {field.key: getattr(args, field.key) for field in SETTING_FIELDS.values()}
    if flags["hot_pixels"] not in (None, "find", "keep"):  # a file: those listed are left out
        flags["hot_pixels"] = "find"
    settings = resolve_settings(args.preset, args.config, flags)
    _warn_of_no_effect(args, settings, SETTING_FIELDS.values())
    return settings


def given_map_flags(args: argparse.Namespace) -> list[str]:
    """List the flags given that decide a map, and not how it is matched; not ``--preset``."""
    decide = [field for field in SETTING_FIELDS.values() if field.group != _MATCHING]
    given = ["--config"] if args.config is not None else []
    return given + [field.flag for field in decide if getattr(args, field.key) is not None]


def match_flags(args: argparse.Namespace) -> dict[str, Any]:
    """Collect the flags of `add_match_flags` that are given, by the key of the setting."""
    values = {field.key: getattr(args, field.key) for field in _of_group(_MATCHING)}
    return {key: value for key, value in values.items() if value is not None}


def with_match_flags(args: argparse.Namespace, settings: Settings) -> Settings:
    """Return the settings of a map with those that the flags of `add_match_flags` give.

    Raises
    ------
    UsageError
        If a value is wrong.
    """
    changed = settings.replaced(match_flags(args), "the command line")
    _warn_of_no_effect(args, changed, _of_group(_MATCHING))
    return changed


def _warn_of_no_effect(
    args: argparse.Namespace, settings: Settings, known: Iterable[SettingField]
) -> None:
    """Warn of each flag given that the other settings make void; ``--no-...`` asks for nothing."""
    for field in known:
        if getattr(args, field.key) in (None, False) or field.needs is None:
            continue
        name, values = field.needs
        other, now = SETTING_FIELDS[name].flag, getattr(settings, name)
        if now not in values:
            warning(
                f"{field.flag} has no effect with {other} {now}: it is for {other} "
                f"{' or '.join(values)}"
            )


def check_not_smooth(asked: bool | None) -> None:
    """Raise UsageError if ``--smooth`` was given to a run that knows no later windows."""
    if asked:
        raise UsageError(
            "--smooth takes the windows after each one, which are not known online: leave it out"
        )


def _of_group(group: str) -> Iterable[SettingField]:
    return (field for field in SETTING_FIELDS.values() if field.group == group)


def _add_flags(parser: argparse._ActionsContainer, group: str, default: str = "") -> None:
    for field in _of_group(group):
        preset = field.word(getattr(PRESETS[DEFAULT_PRESET], field.name))
        names = [field.flag] if field.short is None else [field.flag, field.short]
        text = f"{field.help} (default: {default or preset})"
        parser.add_argument(*names, dest=field.key, help=text, **_form(field))


def _form(field: SettingField) -> dict[str, Any]:
    """Return how the parser reads a flag: a switch, one of a few words, or a value."""
    if field.kind is bool and not field.words:
        return {"action": argparse.BooleanOptionalAction}
    if field.choices:
        return {"choices": (*field.choices, *field.words)}
    if field.kind is bool and field.metavar is None:
        return {"choices": tuple(field.words)}
    if field.kind is bool:  # its words, or a file
        return {"metavar": field.metavar}
    has_words = field.words or field.read is not None
    return {"metavar": field.metavar, "type": _checked(field) if has_words else field.kind}


def _checked(field: SettingField) -> Callable[[str], str]:
    """Return a function that refuses words that the setting does not take, and returns others."""

    def word(given: str) -> str:
        try:
            field.value_of(given)
        except UsageError:
            raise argparse.ArgumentTypeError(f"{given!r}: expected {field.accepted}") from None
        return given

    return word
