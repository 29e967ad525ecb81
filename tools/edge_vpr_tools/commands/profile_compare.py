"""`edge-vpr profile compare`: show two profiles side by side."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edge_vpr_tools.flags import add_json_flag

if TYPE_CHECKING:
    from edge_vpr_tools.profile.profiling import Number

EXAMPLES = """\
  edge-vpr profile compare results/board results/laptop
  edge-vpr profile compare results/board results/laptop --json > both.json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("first", metavar="A", help="a profile, by its folder or file")
    parser.add_argument("second", metavar="B", help="another profile")
    add_json_flag(parser.add_argument_group("output"), "both profiles, with low and high")


#: verdicts of a comparison of two intervals
OVERLAP, APART = "overlap", "apart"


class Compared(NamedTuple):
    """A figure of two profiles."""

    first: Number
    second: Number
    times: float | None  #: The second over the first; None unless both have the figure.
    intervals: str | None  #: Whether they overlap; None unless both figures have one.


def run(args: argparse.Namespace) -> None:
    """Print the figures of both profiles, and the ratio of what both have."""
    from edge_vpr.records import json_text
    from edge_vpr_tools.console import say, table
    from edge_vpr_tools.profile.profiling import Profile, numbers
    from edge_vpr_tools.profile.show import COMPARED, WIDTH, cell, check_shown, notes

    paths = [Path(args.first), Path(args.second)]
    profiles = [Profile.load_file(path) for path in paths]
    for path, one in zip(paths, profiles, strict=True):
        check_shown(one, path)
    figures = {
        a.name: Compared(a, b, b.value / a.value if a.value and b.value is not None else None,
                         _overlap(a, b))
        for a, b in zip(*map(numbers, profiles), strict=True)
    }  # fmt: skip
    if args.json:
        print(json_text({"first": args.first, "second": args.second, "figures": figures}))
    rows = []
    for name, (title, _) in COMPARED.items():
        a, b, ratio, overlap = figures[name]
        times = "-" if ratio is None else f"{ratio:.3g}"
        rows.append((title, cell(a), cell(b), times, overlap or "-"))
    table(("", args.first, args.second, "times", "intervals"), rows, width=WIDTH)
    if any(one.intervals == OVERLAP for one in figures.values()):
        say(
            "intervals are of 95 %; where they overlap, the two profiles show no difference",
            width=WIDTH,
        )
    for path, one in zip(paths, profiles, strict=True):
        for line in notes(one):
            say(f"{path}: {line}", width=WIDTH)


def _overlap(a: Number, b: Number) -> str | None:
    if a.low is None or a.high is None or b.low is None or b.high is None:
        return None
    return OVERLAP if a.low <= b.high and b.low <= a.high else APART
