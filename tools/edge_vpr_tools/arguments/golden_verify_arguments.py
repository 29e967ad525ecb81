"""Arguments of `edge-vpr golden verify`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr golden verify vectors
  edge-vpr golden verify vectors --results device.jsonl --only match"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("vectors", metavar="VECTORS", help="folder that edge-vpr golden wrote")
    group = parser.add_argument_group("results of a device")
    group.add_argument(
        "--results", metavar="FILE",
        help="file with the results of the device (default: check the vectors only)",
    )  # fmt: skip
    group.add_argument(
        "--case", metavar="SUITE/NAME", help="case to which results without a case belong"
    )
    group.add_argument(
        "--only", metavar="KINDS", default="event,window,match",
        help="kinds of result that the device returns, separated by commas",
    )  # fmt: skip
