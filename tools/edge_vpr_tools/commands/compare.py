"""`edge-vpr compare`: show sweeps in one table and one figure."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.console import note, number_of, summary
from edge_vpr_tools.flags import add_figures_flag, add_output_flags
from edge_vpr_tools.sweep import MEASURES

EXAMPLES = """\
  edge-vpr compare pixels.csv
  edge-vpr compare pixels.csv codes.csv -o compared --figures pdf,svg
  edge-vpr compare pixels.csv -o compared --measure R@99P"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("runs", metavar="RUN.csv", nargs="+", help="file that edge-vpr sweep wrote")
    output = add_output_flags(
        parser, help="folder for the table of means over drives, and for the figure", required=False
    )
    add_figures_flag(output, "png")
    output.add_argument(
        "--measure", choices=tuple(MEASURES.values()),
        default=next(iter(MEASURES.values())),
        help="measure of the figure, and of the differences from the first variant",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Print the table, and write it with the figure if asked."""
    from edge_vpr import results
    from edge_vpr_tools.sweep.comparison import (
        LEAST,
        lacks_intervals,
        rows_of,
        show,
        write_comparison,
    )

    runs = [Path(run) for run in args.runs]
    output = None if args.output is None else Path(args.output)
    if output is not None:
        results.check_output_folder(output, args.overwrite, runs)
    rows = rows_of(runs)
    measure = next(name for name, heading in MEASURES.items() if heading == args.measure)
    show(rows)
    if output is not None:
        with results.results_folder(output, args.overwrite) as folder:
            means = write_comparison(folder, rows, args.figures, measure)
        if lacks_intervals(means):
            note(
                f"means have no intervals: these need {LEAST} pairs of drives, or {LEAST} seeds of "
                "a single one"
            )
        summary(f"{output}: {number_of(len(rows), 'row')} of {number_of(len(runs), 'run')}")
