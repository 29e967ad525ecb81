"""Arguments of `edge-vpr compare`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.figure_flags import FIGURES_HELP

EXAMPLES = """\
  edge-vpr compare sweeps/pixels
  edge-vpr compare sweeps/pixels results/tuesday -o compared --figures pdf,svg"""

#: the names in `sweep.comparison.MEASURES`, repeated here so that --help imports nothing heavy
MEASURES = (
    "precision_at_100_recall",
    "recall_at_99_precision",
    "average_precision",
    "recall_at_1",
    "packed_bytes_per_place",
    "operations_per_match",
    "microseconds_per_match",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "runs", metavar="RUN", nargs="+",
        help="folder that edge-vpr sweep wrote, or folder of matches that were evaluated",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o", "--output", metavar="DIR",
        help="folder to write compare.csv, compare.json, compare.md and the figure to",
    )  # fmt: skip
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    output.add_argument("--figures", metavar="FORMATS", default="png", help=FIGURES_HELP)
    output.add_argument(
        "--measure", choices=MEASURES, default=MEASURES[0], help="measure that the figure shows"
    )
