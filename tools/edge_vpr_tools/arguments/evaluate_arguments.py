"""Arguments of `edge-vpr evaluate`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.figure_flags import FIGURES_HELP
from edge_vpr_tools.arguments.truth_flags import add_truth_flags

EXAMPLES = """\
  edge-vpr evaluate results/tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 70
  edge-vpr evaluate results/tuesday --ground-truth matrix.npz --rows reference
  edge-vpr evaluate results/tuesday --ground-truth pairs.csv --tolerance 3 --score ratio"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    add_truth_flags(parser.add_argument_group("ground truth"))
    output = parser.add_argument_group("output")
    output.add_argument("--figures", metavar="FORMATS", default="png", help=FIGURES_HELP)
    metrics = parser.add_argument_group("metrics")
    metrics.add_argument(
        "--score", choices=("distance", "ratio", "margin", "trust"),
        help="what the threshold of the precision-recall curve is on (default: trust of the place "
        "filter, distance of sequences)",
    )  # fmt: skip
    metrics.add_argument(
        "--recall-denominator",
        choices=("rejected-correct", "all-with-place"),
        default="rejected-correct",
        help="what counts as missed: rejected queries whose best match was right (the released "
        "code), or every query with a true place that did not get it",
    )
    metrics.add_argument(
        "--thresholds", type=int, metavar="N", help="N even thresholds (default: all)"
    )
