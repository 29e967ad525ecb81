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
        "--results", metavar="FILE", help="what the device returned (default: check the files only)"
    )
    group.add_argument("--case", metavar="SUITE/NAME", help="the case of results that name none")
    group.add_argument(
        "--only",
        metavar="KINDS",
        default="event,window,match",
        help="what the device returns, separated by commas",
    )
