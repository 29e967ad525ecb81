"""Arguments of `edge-vpr profile compare`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr profile compare results/board/profile.json results/laptop/profile.json --csv both.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("first", metavar="A.json", help="a profile")
    parser.add_argument("second", metavar="B.json", help="another profile")
    output = parser.add_argument_group("output")
    output.add_argument("--csv", metavar="FILE", help="also write the table as CSV")
