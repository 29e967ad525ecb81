"""Flags of the settings, shared by the commands that map and match."""

from __future__ import annotations

import argparse
import re
from fractions import Fraction
from typing import Any, get_args

from edge_vpr.errors import UsageError
from edge_vpr.settings import (
    PRESETS,
    STRATEGIES,
    Anchor,
    CounterCodeName,
    CounterScaling,
    Matching,
    QueryMean,
    Settings,
    WindowKind,
    resolve_settings,
)

# flags of a map that are named as their settings are, and the others
_PLAIN = (
    "pixels",
    "strategy",
    "sigma",
    "seed",
    "window",
    "events_per_pixel",
    "polarity",
    "clip",
    "counter_code",
    "counter_bits",
    "counter_full_scale",
    "counter_scaling",
    "keep_incomplete",
)
_MATCHING = (
    "matching",
    "filter_steps",
    "filter_back",
    "filter_restart",
    "query_mean",
    "sequence_length",
    "anchor",
    "exclusion",
    "precision",
)
_OTHER = ("config", "tau", "hot_pixels", "bursts")
DEFAULT_PRESET = "default"
_MICROSECONDS = {"us": 1, "ms": 1_000, "s": 1_000_000, "": 1_000_000}


def duration_us(text: str) -> int:
    """Read ``1s``, ``250ms``, ``500us`` or ``0.5`` (seconds) as whole microseconds.

    Raises
    ------
    UsageError
        If it is none of these, or no whole positive number of microseconds.
    """
    form = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(us|ms|s|)\s*", text)
    if form:
        microseconds = Fraction(form[1]) * _MICROSECONDS[form[2]]
        if microseconds.denominator == 1 and microseconds >= 1:
            return int(microseconds)
    raise UsageError(f"duration {text!r}: expected a time such as 1s, 250ms or 500us")


def _default(name: str) -> str:
    """Show the default of a setting, which is the preset's."""
    value = getattr(PRESETS[DEFAULT_PRESET], name)
    return f"(default: {value:g})" if isinstance(value, float) else f"(default: {value})"


def _switch(name: str, on: str, off: str) -> str:
    return f"(default: {on if getattr(PRESETS[DEFAULT_PRESET], name) else off})"


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
    _add_pixel_flags(parser.add_argument_group("pixels"))
    _add_window_flags(parser.add_argument_group("windows"))
    _add_counter_flags(parser.add_argument_group("counters"))
    _add_cleaning_flags(parser.add_argument_group("cleaning"))
    add_match_flags(parser.add_argument_group("matching"))


def _add_pixel_flags(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--pixels", type=int, metavar="J", help=f"number of selected pixels {_default('pixels')}"
    )
    group.add_argument(
        "--strategy", choices=STRATEGIES, help=f"how they are selected {_default('strategy')}"
    )
    group.add_argument(
        "--sigma",
        type=float,
        metavar="PX",
        help=f"surround suppression, in pixels {_default('sigma')}",
    )
    group.add_argument("--seed", type=int, help=f"seed of the draw of pixels {_default('seed')}")


def _add_window_flags(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--window",
        choices=get_args(WindowKind),
        help=f"of fixed time, or of a fixed count of events {_default('window')}",
    )
    tau_s = PRESETS[DEFAULT_PRESET].tau_us / 1e6
    group.add_argument(
        "--tau",
        metavar="TIME",
        help=f"length of a fixed-time window: 1s, 250ms (default: {tau_s:g}s)",
    )
    group.add_argument(
        "--events-per-pixel",
        type=float,
        metavar="R",
        help="a fixed-count window closes after R x J events at the selected pixels; 0: as many as "
        f"a window of tau holds in the reference on average {_default('events_per_pixel')}",
    )
    group.add_argument(
        "--keep-incomplete",
        action=argparse.BooleanOptionalAction,
        help="keep the last, incomplete window " + _switch("keep_incomplete", "keep it", "drop it"),
    )


def _add_counter_flags(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--polarity",
        action=argparse.BooleanOptionalAction,
        help="count ON and OFF apart " + _switch("polarity", "apart", "together"),
    )
    group.add_argument(
        "--clip", type=int, metavar="N", help=f"largest count; 0 = no limit {_default('clip')}"
    )
    group.add_argument(
        "--counter-code",
        choices=get_args(CounterCodeName),
        help=f"what is compared in place of a count {_default('counter_code')}",
    )
    group.add_argument(
        "--counter-bits",
        type=int,
        metavar="B",
        help=f"bits of a code, 1 to 16 {_default('counter_bits')}",
    )
    group.add_argument(
        "--counter-full-scale",
        type=int,
        metavar="N",
        help="largest count that the code tells apart; 0 = the code's own "
        + _default("counter_full_scale"),
    )
    group.add_argument(
        "--counter-scaling",
        choices=get_args(CounterScaling),
        help="one full scale for all; or one for each pixel, learned from the reference; or the "
        "logarithm less its mean over the drive, which other light does not move "
        + _default("counter_scaling"),
    )


def _add_cleaning_flags(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--hot-pixels",
        metavar="find|keep|FILE",
        help="find and leave out, keep, or leave out those listed in FILE (x, y a line) "
        + _switch("remove_hot_pixels", "find", "keep"),
    )
    group.add_argument(
        "--bursts",
        choices=("remove", "keep"),
        help="events of moments when most pixels fire "
        + _switch("remove_bursts", "remove", "keep"),
    )


def add_match_flags(parser: argparse._ActionsContainer, default: str = "") -> None:
    """Add the flags of the settings that decide how a map is matched.

    Parameters
    ----------
    parser : parser or group
    default : str, optional
        Whose value holds where a flag is not given; empty for the preset's.
    """

    def shown(name: str) -> str:
        return f"(default: {default})" if default else _default(name)

    parser.add_argument(
        "--matching",
        choices=get_args(Matching),
        help=f"by sequences of windows (the paper), or the place filter {shown('matching')}",
    )
    parser.add_argument(
        "--filter-steps",
        type=_prices,
        metavar="P,P,...",
        help="place filter: price of a step of 0, 1, 2 ... places in a window "
        "(default: 1,0,1 for windows of fixed time, 1,0,0,1 for a number of events)",
    )
    parser.add_argument(
        "--filter-back",
        type=_prices,
        metavar="P,P,...",
        help="place filter: price of a step of 1, 2 ... places backwards (default: never)",
    )
    parser.add_argument(
        "--filter-restart",
        type=int,
        metavar="P",
        help=f"place filter: price of a step to any place {shown('filter_restart')}",
    )
    parser.add_argument(
        "--query-mean",
        choices=get_args(QueryMean),
        help="of own-mean codes, a query's mean: over the whole drive, or running, as on the robot "
        + shown("query_mean"),
    )
    parser.add_argument(
        "--sequence-length",
        "-L",
        type=int,
        metavar="L",
        help=f"windows in a sequence {shown('sequence_length')}",
    )
    parser.add_argument(
        "--anchor",
        choices=get_args(Anchor),
        help="window that a sequence's match belongs to: middle (offline) or end "
        + shown("anchor"),
    )
    parser.add_argument(
        "--exclusion",
        type=int,
        metavar="R",
        help=f"second best is over R places from the best {shown('exclusion')}",
    )
    parser.add_argument(
        "--precision",
        type=float,
        metavar="P",
        help="mark matches as lost so that of the others a share of P is right, for example 0.99; "
        f"0 marks none {shown('precision')}",
    )


def map_settings(args: argparse.Namespace) -> Settings:
    """Resolve the settings that the flags of `add_map_flags` ask for.

    Raises
    ------
    UsageError
        If a value is wrong.
    """
    flags: dict[str, Any] = {name: getattr(args, name) for name in _PLAIN}
    flags["tau_us"] = None if args.tau is None else duration_us(args.tau)
    flags["remove_hot_pixels"] = None if args.hot_pixels is None else args.hot_pixels != "keep"
    flags["remove_bursts"] = None if args.bursts is None else args.bursts == "remove"
    return resolve_settings(args.preset, args.config, flags | match_flags(args))


def given_map_flags(args: argparse.Namespace) -> list[str]:
    """List the flags given that decide a map, and not how it is matched; not ``--preset``."""
    return [
        "--" + name.replace("_", "-")
        for name in (*_OTHER, *_PLAIN)
        if getattr(args, name) is not None
    ]


def match_flags(args: argparse.Namespace) -> dict[str, Any]:
    """Collect the flags of `add_match_flags` by setting; None where not given."""
    return {name: getattr(args, name) for name in _MATCHING}


def _prices(text: str) -> tuple[int, ...]:
    """Read prices such as ``1,0,1``."""
    try:
        return tuple(int(price) for price in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected prices such as 1,0,1") from None
