"""`edge-vpr compare`: show several runs in one table and one figure."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.report.formats import read_formats
from edge_vpr_tools.sweep.comparison import rows_of
from edge_vpr_tools.sweep.comparison_files import markdown, write_comparison


def run(args: argparse.Namespace) -> None:
    """Print the table, and write it with the figure if asked."""
    runs, formats = [Path(run) for run in args.runs], read_formats(args.figures)
    output = None if args.output is None else Path(args.output)
    if output is not None:
        results.check_output_folder(output, args.overwrite, runs)
    rows = rows_of(runs)
    print(markdown(rows), end="")
    if output is not None:
        with results.results_folder(output, args.overwrite) as folder:
            write_comparison(folder, rows, formats, args.measure)
        summary(f"{output}: {len(rows)} rows of {len(runs)} runs")
