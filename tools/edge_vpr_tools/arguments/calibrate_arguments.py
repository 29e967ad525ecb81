"""Arguments of `edge-vpr calibrate`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.truth_flags import add_truth_flags

EXAMPLES = """\
  edge-vpr calibrate results/tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 70
  edge-vpr calibrate results/tuesday --ground-truth pairs.csv --tolerance 3 -o monday_sure.npz"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    output = parser.add_argument_group("output")
    output.add_argument(
        "-o",
        "--output",
        metavar="MAP.npz",
        help="map to write, which holds the learnt table of probabilities (default: the map in "
        "RESULTS)",
    )
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_truth_flags(parser.add_argument_group("ground truth"))
