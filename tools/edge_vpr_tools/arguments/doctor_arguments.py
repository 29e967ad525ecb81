"""Arguments of `edge-vpr doctor`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr doctor
  edge-vpr doctor --json
  edge-vpr doctor --compile"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    group = parser.add_argument_group("checks")
    group.add_argument(
        "--compile", action="store_true",
        help="compile the functions that a live run needs now, so that it starts at once later",
    )  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON, for programs")
