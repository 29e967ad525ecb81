"""Arguments of `edge-vpr demo`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr demo
  edge-vpr demo --seed 3 -o results/street3"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    group = parser.add_argument_group("demo")
    group.add_argument(
        "-o", "--output", metavar="DIR", default="results/demo", help="folder for the report"
    )
    group.add_argument("--overwrite", action="store_true", help="replace the folder if it exists")
    group.add_argument("--seed", type=int, default=0, help="seed of the simulated street")
