"""Flags of the settings, shared by the commands that map and match."""

from __future__ import annotations

import argparse
import re
from fractions import Fraction
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.settings import Settings, resolve_settings

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
_OTHER = ("config", "tau", "hot_pixels", "bursts")
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


def add_map_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of every setting that decides a map."""
    group = parser.add_argument_group("settings (flags over --config over --preset)")
    group.add_argument("--preset", default="paper", help="paper, seed-code or tiny")
    group.add_argument("--config", metavar="FILE", help="TOML file with settings")
    group.add_argument("--pixels", type=int, metavar="J", help="number of selected pixels")
    group.add_argument("--strategy", help="variance, seed-code, random, random-upper or top")
    group.add_argument("--sigma", type=float, metavar="PX", help="surround suppression, in pixels")
    group.add_argument("--seed", type=int, help="seed of the draw of pixels")
    group.add_argument("--window", help="time or count")
    group.add_argument("--tau", metavar="TIME", help="length of a fixed-time window: 1s, 250ms")
    group.add_argument(
        "--events-per-pixel",
        type=float,
        metavar="R",
        help="a fixed-count window closes after R x J events at the selected pixels; 0: as many as "
        "a window of tau holds in the reference on average",
    )
    group.add_argument(
        "--polarity", action=argparse.BooleanOptionalAction, help="count ON and OFF apart"
    )
    group.add_argument("--clip", type=int, metavar="N", help="largest count; 0 = no limit")
    group.add_argument(
        "--counter-code",
        metavar="KIND",
        help="what is compared in place of a count: none, linear, sqrt or log",
    )
    group.add_argument("--counter-bits", type=int, metavar="B", help="bits of a code, 1 to 16")
    group.add_argument(
        "--counter-full-scale",
        type=int,
        metavar="N",
        help="largest count that the code tells apart; 0 = the code's own",
    )
    group.add_argument(
        "--counter-scaling",
        metavar="SCALING",
        help="shared, or per-pixel: a full scale for each pixel, learned from the reference",
    )
    group.add_argument(
        "--hot-pixels",
        metavar="find|keep|FILE",
        help="find and leave out, keep, or leave out those listed in FILE (x, y a line)",
    )
    group.add_argument(
        "--bursts", choices=("remove", "keep"), help="events of moments when most pixels fire"
    )
    group.add_argument(
        "--keep-incomplete",
        action=argparse.BooleanOptionalAction,
        help="keep the last, incomplete window",
    )
    add_match_flags(group)


def add_match_flags(parser: argparse._ActionsContainer) -> None:
    """Add the flags of the settings that decide how a map is matched."""
    parser.add_argument(
        "--sequence-length", "-L", type=int, metavar="L", help="windows in a sequence"
    )
    parser.add_argument(
        "--anchor", help="window that a sequence's match belongs to: middle (offline) or end"
    )
    parser.add_argument(
        "--exclusion", type=int, metavar="R", help="second best is over R places from the best"
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
    return {name: getattr(args, name) for name in ("sequence_length", "anchor", "exclusion")}
