"""Arguments of `edge-vpr hardware`."""

from __future__ import annotations

import argparse

EXAMPLES = """\
  edge-vpr hardware --map monday.npz -o core
  edge-vpr hardware --design design.toml -o core"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    design = parser.add_argument_group("design", "--design or --map is needed")
    design.add_argument(
        "--design", metavar="FILE.toml",
        help="read the design from a file; the core then has random pixels, for tests only",
    )  # fmt: skip
    design.add_argument(
        "--map", metavar="MAP.npz", help="take the design, the pixels and the places of a map"
    )
    design.add_argument(
        "--lanes", type=int, default=8, metavar="P", help="with --map, number of parallel lanes"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the random vectors")
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True, help="folder to write: new, or empty"
    )
