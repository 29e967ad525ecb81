"""`edge-vpr doctor`: show what this machine has."""

from __future__ import annotations

import argparse

from edge_vpr_tools.console import print_facts

EXAMPLES = """\
  edge-vpr doctor
  edge-vpr doctor --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON, for programs")


def run(args: argparse.Namespace) -> None:
    """Print the facts."""
    from edge_vpr.records import json_text
    from edge_vpr_tools.doctor import facts

    if args.json:
        print(json_text(facts(), indent=2))
    else:
        print_facts(facts())
