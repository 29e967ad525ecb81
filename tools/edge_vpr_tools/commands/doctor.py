"""`edge-vpr doctor`: show what this machine has, what is missing, and how to install it."""

from __future__ import annotations

import argparse

from edge_vpr.errors import EdgeVprError
from edge_vpr_tools.console import summary

EXAMPLES = """\
  edge-vpr doctor
  edge-vpr doctor --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print JSON, for programs")


def run(args: argparse.Namespace) -> None:
    """Print what was found."""
    from edge_vpr.results import json_text
    from edge_vpr_tools.doctor import as_text, examine

    findings = examine()
    if args.json:
        print(json_text(findings, indent=2))
    else:
        for line in as_text(findings).splitlines():
            summary(line)
    wrong = sum(finding.state == "wrong" for finding in findings)
    if wrong:
        raise EdgeVprError(f"{wrong} of {len(findings)} findings are wrong: they are marked !!")
