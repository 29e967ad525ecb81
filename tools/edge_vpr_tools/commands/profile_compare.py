"""`edge-vpr profile compare`: show two profiles side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """\
  edge-vpr profile compare results/board results/laptop --csv both.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("first", metavar="A", help="a profile, by its folder or file")
    parser.add_argument("second", metavar="B", help="another profile")
    output = parser.add_argument_group("output")
    output.add_argument("--csv", metavar="FILE", help="also write the table as CSV")


def run(args: argparse.Namespace) -> None:
    """Print both profiles, and write them as CSV if asked to."""
    from edge_vpr_tools.profile.show import compare

    compare(Path(args.first), Path(args.second), None if args.csv is None else Path(args.csv))
