"""Arguments of `edge-vpr profile trace`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr profile --meter -o results/board
  edge-vpr profile trace results/board/profile.json meter.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "profile", metavar="PROFILE.json", help="profile that edge-vpr profile --meter wrote"
    )
    parser.add_argument(
        "trace", metavar="METER.csv",
        help="recording of the meter, with columns time_s and power_w, or voltage and current",
    )  # fmt: skip
    group = parser.add_argument_group("energy")
    group.add_argument(
        "--mission-rate", type=float, default=1.0, metavar="N",
        help="matches per second of the mission that the energy is stated for",
    )  # fmt: skip
    group.add_argument("--no-figures", action="store_true", help="write no report")
