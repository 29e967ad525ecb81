"""Arguments of `edge-vpr profile trace`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr profile --meter -o results/board
  edge-vpr profile trace results/board/profile.json meter.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("profile", metavar="PROFILE.json", help="of edge-vpr profile --meter")
    parser.add_argument(
        "trace", metavar="METER.csv", help="with time_s and power_w, or voltage and current"
    )
    group = parser.add_argument_group("energy")
    group.add_argument(
        "--mission-rate", type=float, default=1.0, metavar="N", help="matches a second of a mission"
    )
    group.add_argument("--no-figures", action="store_true", help="write no report")
