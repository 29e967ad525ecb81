"""Arguments of `edge-vpr info`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments

EXAMPLES = """\
  edge-vpr info monday.raw
  edge-vpr info monday.csv --sensor 346x260 --time-unit us --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="FILE", help="recording of any known format")
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    # faults are what this command is asked for: it counts them and goes on
    add_reading_arguments(parser, on_fault=False)
