"""Flags that several commands share, and what they give: recordings, settings, output, figures."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.settings import (
    PRESETS,
    SETTING_FIELDS,
    Preset,
    SettingField,
    Settings,
    resolve_settings,
)
from edge_vpr_tools.console import warning
from edge_vpr_tools.report import FORMATS

if TYPE_CHECKING:
    from pathlib import Path

    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.recordings import Recording
    from edge_vpr.recordings.reading import Camera

# Flags by which every command opens a recording.


def add_reading_arguments(
    parser: argparse.ArgumentParser, *, on_fault: bool = True
) -> argparse._ArgumentGroup:
    """Add a group with the flags that `open_from` reads, and return the group.

    Parameters
    ----------
    on_fault : bool
        Without this flag, faulty events are left out and counted.
    """
    group = parser.add_argument_group(
        "reading", "needed where a file does not hold this information"
    )
    group.add_argument(
        "--sensor",
        metavar="WxH",
        help="size of the sensor, such as 346x260 (default: the file's or the map's)",
    )
    if on_fault:
        group.add_argument(
            "--on-fault", choices=("error", "drop"), default="error",
            help="stop at the first faulty event, or leave faulty events out and count them",
        )  # fmt: skip
    else:
        parser.set_defaults(on_fault="drop")
    group.add_argument(
        "--frame-period", metavar="S",
        help="duration of a frame of counts in seconds, for example 1/30",
    )  # fmt: skip
    group.add_argument(
        "--format", metavar="NAME",
        help="format of the file (default: by its first bytes, else by its suffix)",
    )  # fmt: skip
    group.add_argument(
        "--topic", metavar="NAME",
        help="topic or stream to read, if the file has several (default: the only one)",
    )  # fmt: skip
    group.add_argument(
        "--time-unit", choices=("s", "ms", "us", "ns"),
        help="unit of the times in a table (default: that of its header, else us for whole "
        "numbers; times with decimals need a unit)",
    )  # fmt: skip
    group.add_argument(
        "--columns",
        metavar="ORDER",
        help="order of the columns in a table without names, or with unknown ones, for example "
        "xytp, or -txyp to leave out the first (default: txyp)",
    )
    crop = parser.add_argument_group("part of the recording")
    crop.add_argument(
        "--start", metavar="S", help="first second to read, which becomes time 0 (default: 0)"
    )
    crop.add_argument("--end", metavar="S", help="second to read up to (default: the end)")
    crop.add_argument(
        "--start-offset",
        metavar="S",
        help="time on the clock of the file from which --start and --end count, in seconds, for "
        "example 1587452582.35 (default: the start of the recording)",
    )
    return group


def open_from(
    args: argparse.Namespace, path: str | Path, default: Camera | None = None
) -> Recording:
    """Open a recording with the flags of `add_reading_arguments`; see `open_recording`."""
    from edge_vpr.recordings import open_recording
    from edge_vpr.recordings.reading import NO_CAMERA, crop_of

    crop = crop_of(args.start, args.end, args.start_offset)
    recording = open_recording(
        path,
        format=args.format,
        sensor=args.sensor,
        on_fault=args.on_fault,
        frame_period=args.frame_period,
        default=default or NO_CAMERA,
        topic=args.topic,
        time_unit=args.time_unit,
        columns=args.columns,
    )
    return recording if crop is None else recording.cropped(crop)


def add_window_argument(group: argparse._ArgumentGroup) -> None:
    """Add the further flag that `open_source` reads."""
    group.add_argument(
        "--frames-as-windows", action="store_true",
        help="take each frame of counts as one window, instead of turning it into events",
    )  # fmt: skip


def open_source(
    args: argparse.Namespace, path: str | Path, default: Camera | None = None
) -> Recording | PublishedWindows:
    """Open events as `open_from`, or with ``--frames-as-windows`` windows of counts."""
    if not args.frames_as_windows:
        return open_from(args, path, default)
    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.recordings.reading import NO_CAMERA, crop_of

    default = default or NO_CAMERA
    return PublishedWindows(
        path,
        frame_period=args.frame_period or default.frame_period,
        sensor=args.sensor or default.sensor,
        crop=crop_of(args.start, args.end, args.start_offset),
    )


def add_protocol_flag(group: argparse._ArgumentGroup, text: str, *, required: bool = False) -> None:
    """Add the flag that names a protocol, whose names a shell completes."""
    default = None if required else "evpr"
    flag = group.add_argument(
        "--protocol", required=required, default=default, metavar="P", help=text
    )
    flag.completer = _protocols  # type: ignore[attr-defined]  # as argcomplete has it


def _protocols(**_: object) -> list[str]:
    from edge_vpr.live.protocols import protocol_names  # when a shell asks

    return protocol_names()


def add_design_flags(parser: argparse.ArgumentParser, of_file: str = "") -> None:
    """Add the flags that name the design of a device.

    Parameters
    ----------
    of_file : str
        What the help adds about a design that is read from a file.
    """
    group = parser.add_argument_group("design", "--design or --map is needed")
    one = group.add_mutually_exclusive_group(required=True)
    one.add_argument("--design", metavar="FILE.toml", help=f"read the design from a file{of_file}")
    one.add_argument(
        "--map", metavar="MAP.npz", help="take the design, the pixels and the places of a map"
    )
    group.add_argument(
        "--lanes", type=int, default=8, metavar="P", help="with --map, number of parallel lanes"
    )


# Flags of the settings, made from their descriptions; shared by the commands map and match.


DEFAULT_PRESET: Preset = "default"
#: the group of settings that can be changed after a map is made
_MATCHING_GROUP = "matching"


def add_map_flags(parser: argparse.ArgumentParser, *, live: bool = False) -> None:
    """Add the flags of all settings.

    Parameters
    ----------
    live : bool
        Matching begins with the settings of a map, if the command is given one; otherwise,
        ``--tau auto`` is taken too, which stays the word.
    """
    group = parser.add_argument_group(
        "settings",
        "a flag overrides the file of --config, and the file overrides --preset; the defaults "
        f"shown are those of the preset {DEFAULT_PRESET!r}",
    )
    group.add_argument(
        "--preset", choices=tuple(PRESETS), default=DEFAULT_PRESET, help="named set of settings"
    )
    group.add_argument("--config", metavar="FILE", help="TOML file with settings")
    for title in ("pixels", "windows", "counters", "cleaning"):
        add_setting_flags(parser.add_argument_group(title), title, auto="" if live else "tau")
    default = "the map's, or for a new one {}" if live else ""
    add_setting_flags(parser.add_argument_group(_MATCHING_GROUP), _MATCHING_GROUP, default)


def map_settings(args: argparse.Namespace) -> Settings:
    """Return the settings that result from the flags of `add_map_flags`."""
    flags = {field.key: getattr(args, field.key) for field in SETTING_FIELDS.values()}
    if flags["hot_pixels"] not in (None, "find", "keep"):  # a file, which is read elsewhere
        flags["hot_pixels"] = "find"
    if flags["tau"] == "auto":  # which is fitted to the map of these settings
        flags["tau"] = None
    settings = resolve_settings(args.preset, args.config, flags, "the command line")
    warn_of_no_effect(args, settings, SETTING_FIELDS.values())
    return settings


def map_flags(args: argparse.Namespace) -> list[str]:
    """Return the given flags that belong to making a map and not to matching; no ``--preset``."""
    decide = [field for field in SETTING_FIELDS.values() if field.group != _MATCHING_GROUP]
    flags = ["--config"] if args.config is not None else []
    return flags + [field.flag for field in decide if getattr(args, field.key) is not None]


def match_flags(args: argparse.Namespace) -> dict[str, Any]:
    """Return the given flags of the settings of matching, by the key of the setting."""
    values = {field.key: getattr(args, field.key) for field in _of_group(_MATCHING_GROUP)}
    return {key: value for key, value in values.items() if value is not None}


def warn_of_no_effect(
    args: argparse.Namespace, settings: Settings, offered: Iterable[SettingField] | None = None
) -> None:
    """Warn of each given flag that has no effect with the other settings; not of ``--no-...``.

    Parameters
    ----------
    settings : Settings
        That result from the flags.
    offered : iterable of SettingField
        Whose flags they are; by default those of matching.
    """
    for field in _of_group(_MATCHING_GROUP) if offered is None else offered:
        if getattr(args, field.key) in (None, False) or field.needs is None:
            continue
        name, values = field.needs
        other, now = SETTING_FIELDS[name].flag, getattr(settings, name)
        if now not in values:
            warning(
                f"{field.flag} has no effect with {other} {now}: it is for {other} "
                f"{' or '.join(values)}"
            )


def _of_group(group: str) -> Iterable[SettingField]:
    return (field for field in SETTING_FIELDS.values() if field.group == group)


def add_setting_flags(
    parser: argparse._ActionsContainer, group: str, default: str = "", *, auto: str = ""
) -> None:
    """Add the flags of a group of settings.

    Parameters
    ----------
    group : str
        Such as ``matching``: settings that can be changed after a map is made.
    default : str, optional
        Text that the help shows as the default, ``{}`` in it for the value of the preset; empty
        for that value.
    auto : str
        Key of the setting that takes the word ``auto`` too, if any does.
    """
    for field in _of_group(group):
        preset = field.word(getattr(PRESETS[DEFAULT_PRESET], field.name))
        names = [field.flag] if field.short is None else [field.flag, field.short]
        text = f"{field.help} (default: {(default or '{}').format(preset)})"
        form = _form(field)
        if field.key == auto:
            text = (
                f"{text}; auto: that length, or for a slow robot a longer one, of 2.5 m of travel "
                "by --track or --odometry, or without them of 3 events per selected pixel"
            )
            form["type"] = partial(_auto_or, form["type"])
        parser.add_argument(*names, dest=field.key, help=text, **form)


def _auto_or(read: Callable[[str], object], text: str) -> object:
    return text if text == "auto" else read(text)


def _form(field: SettingField) -> dict[str, Any]:
    """Return the arguments by which argparse reads a flag: a switch, a choice, or a value."""
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
    """Return a function that checks a given value, raises if it is wrong, and returns it."""

    def word(typed: str) -> str:
        try:
            field.value_of(typed)
        except UsageError:
            raise argparse.ArgumentTypeError(f"{typed!r}: expected {field.accepted}") from None
        return typed

    return word


# The flag for gaps of tracks, which maps and ground truth are made of.


def add_track_offset_flag(group: argparse._ActionsContainer) -> None:
    """Add the flag for the clock of a track."""
    group.add_argument(
        "--track-offset",
        type=float,
        metavar="S",
        help="time in the recording at which the track has its time 0, in seconds; negative if the "
        "track began earlier (default: 0)",
    )


def add_gap_flag(group: argparse._ActionsContainer) -> None:
    """Add the flag for gaps of tracks."""
    group.add_argument(
        "--longest-gap",
        type=float,
        default=5.0,
        metavar="S",
        help="longest time between two points of a track over which positions are interpolated, in "
        "seconds (default: %(default)g)",
    )


# Flags of the output: where it goes, and the formats of figures.


def add_output_flags(
    parser: argparse.ArgumentParser,
    metavar: str = "DIR",
    help: str = "folder to write",
    *,
    required: bool = True,
    default: str | None = None,
) -> argparse._ArgumentGroup:
    """Add a group with ``--output`` and ``--overwrite``, and return the group."""
    group = parser.add_argument_group("output")
    group.add_argument(
        "-o", "--output", metavar=metavar, help=help, required=required, default=default
    )
    group.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    return group


def add_json_flag(group: argparse._ActionsContainer, what: str) -> None:
    """Add ``--json``, with which standard output is one JSON object and nothing else.

    Parameters
    ----------
    what : str
        What the object has the keys of.
    """
    group.add_argument("--json", action="store_true", help=f"print JSON with the keys of {what}")


def add_figures_flag(group: argparse._ActionsContainer, default: str) -> None:
    """Add the flag of the formats of figures."""
    group.add_argument(
        "--figures", metavar="FORMATS", type=_formats, default=default,
        help="formats of the figures: png, pdf, svg, or several separated by commas",
    )  # fmt: skip


def _formats(text: str) -> tuple[str, ...]:
    """Read names of formats that are separated by commas, each once."""
    names = tuple(dict.fromkeys(name.strip().lower() for name in text.split(",")))
    for name in names:
        if name not in FORMATS:
            raise UsageError(
                f"--figures {text!r}: {name!r} is no format of figures"
                f"{did_you_mean(name, FORMATS)}: choose from {', '.join(FORMATS)}"
            )
    return names
