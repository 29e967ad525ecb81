"""`edge-vpr profile compare`: show two profiles side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.energy.show import compare


def run(args: argparse.Namespace) -> None:
    """Print both profiles, and write them as CSV if asked to."""
    compare(Path(args.first), Path(args.second), None if args.csv is None else Path(args.csv))
