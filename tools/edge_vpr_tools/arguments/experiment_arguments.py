"""Arguments of `edge-vpr experiment`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.experiments import EXPERIMENTS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("name", choices=EXPERIMENTS, help="which experiment")
    parser.add_argument(
        "--data", metavar="DIR", help="folder of the real recordings (not needed for simulated)"
    )
    parser.add_argument("--figure", metavar="PNG", help="also draw the figure (codes only)")
    parser.add_argument(
        "--seeds", type=int, default=5, metavar="N", help="trials with different seeds (5)"
    )
