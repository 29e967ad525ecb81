"""Arguments of `edge-vpr demo`."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "-o", "--output", metavar="DIR", default="results/demo", help="folder for the report"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the folder if it exists")
    parser.add_argument("--seed", type=int, default=0, help="another seed, another street")
