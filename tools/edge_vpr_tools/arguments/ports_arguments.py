"""Arguments of `edge-vpr ports`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr ports
  edge-vpr ports --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON, for programs")
