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
        help="figure of a match to which the thresholds of the precision-recall curve apply "
        "(default: that of the map's settings; if they leave it to auto, trust with the place "
        "filter and ratio with sequences)",
    )  # fmt: skip
    metrics.add_argument(
        "--recall-denominator",
        choices=("rejected-correct", "all-with-place"),
        default="rejected-correct",
        help="which queries count as missed: those rejected although their match was right "
        "(rejected-correct, as in the authors' released code), or all that have a true place in "
        "the map and did not get it (all-with-place)",
    )
    metrics.add_argument(
        "--thresholds", type=int, metavar="N",
        help="use N evenly spaced thresholds (default: every value that occurs)",
    )  # fmt: skip
