"""Arguments of `edge-vpr convert`."""

from __future__ import annotations

import argparse

from edge_vpr_tools.arguments.reading_flags import add_reading_arguments

EXAMPLES = """\
  edge-vpr convert drive.aedat4 drive.npz
  edge-vpr convert drive.csv drive.raw --sensor 346x260 --columns txyp"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("input", metavar="IN", help="recording of any known format")
    parser.add_argument(
        "output",
        metavar="OUT",
        help="file to write; its suffix names the format: .npz, .npy, .csv, .txt, .parquet, .raw "
        "(EVT 2.0), .dat, .h5 or .es",
    )
    output = parser.add_argument_group("output")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_reading_arguments(parser)
