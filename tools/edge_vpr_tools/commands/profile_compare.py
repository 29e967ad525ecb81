"""`edge-vpr profile compare`: show two profiles side by side."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edge_vpr_tools.profile.profiling import Number

EXAMPLES = """\
  edge-vpr profile compare results/board results/laptop --csv both.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("first", metavar="A", help="a profile, by its folder or file")
    parser.add_argument("second", metavar="B", help="another profile")
    output = parser.add_argument_group("output")
    output.add_argument("--csv", metavar="FILE", help="also write all figures as CSV")


#: verdicts of a comparison of two intervals
OVERLAP, APART = "overlap", "apart"


def run(args: argparse.Namespace) -> None:
    """Print both profiles, with the ratio of what both have, and write them as CSV if asked to."""
    from edge_vpr_tools.console import say, table
    from edge_vpr_tools.profile.profiling import NOT_MEASURED, Number, Profile, numbers
    from edge_vpr_tools.profile.show import COMPARED, WIDTH, cell, check_shown, notes
    from edge_vpr_tools.report.tables import write_spreadsheet

    paths = [Path(args.first), Path(args.second)]
    found = [Profile.load_file(path) for path in paths]
    for path, one in zip(paths, found, strict=True):
        check_shown(one, path)
    sides = [{number.name: number for number in numbers(one)} for one in found]
    lines: dict[str, tuple[str, ...]] = {}
    cells = []
    for name in dict.fromkeys(name for side in sides for name in side):
        a, b = (side.get(name, Number(name, None, why=NOT_MEASURED)) for side in sides)
        ratio = b.value / a.value if a.value and b.value is not None else None
        overlap = _overlap(a, b)
        cells.append((name, *a[1:4], *b[1:4], ratio, overlap))
        if name in COMPARED:
            times = "-" if ratio is None else f"{ratio:.3g}"
            lines[name] = (COMPARED[name][0], cell(a), cell(b), times, overlap or "-")
    first, second = map(str, paths)
    ordered = [lines[name] for name in COMPARED if name in lines]
    table(("", first, second, "times", "intervals"), ordered, width=WIDTH)
    if any(cell[-1] == OVERLAP for cell in cells):
        say(
            "intervals are of 95 %; where they overlap, the two profiles show no difference",
            width=WIDTH,
        )
    for path, one in zip(paths, found, strict=True):
        for line in notes(one):
            say(f"{path}: {line}", width=WIDTH)
    if args.csv is not None:
        header = (
            "quantity", first, f"{first} low", f"{first} high",
            second, f"{second} low", f"{second} high", "times", "intervals",
        )  # fmt: skip
        write_spreadsheet(Path(args.csv), header, cells)


def _overlap(a: Number, b: Number) -> str | None:
    """Return whether two intervals overlap; None unless both figures have one."""
    if a.low is None or a.high is None or b.low is None or b.high is None:
        return None
    return OVERLAP if a.low <= b.high and b.low <= a.high else APART
