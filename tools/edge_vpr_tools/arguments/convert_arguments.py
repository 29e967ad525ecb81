"""Arguments of `edge-vpr convert`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("input", metavar="IN", help="recording of any known format")
    parser.add_argument(
        "output",
        metavar="OUT",
        help=".npz, .npy, .csv, .txt, .parquet, .raw (EVT 2.0), .dat, .h5 or .es",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_reading_arguments(parser)
