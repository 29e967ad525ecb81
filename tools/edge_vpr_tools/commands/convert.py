"""`edge-vpr convert`: convert a recording to another format."""

from __future__ import annotations

import argparse

from edge_vpr_tools.console import summary
from edge_vpr_tools.flags import add_reading_arguments

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
        "(EVT 2.0), .dat, .h5, .hdf5 or .es",
    )
    output = parser.add_argument_group("output")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Read the input and write the output, whole or not at all."""
    from edge_vpr.files import check_output
    from edge_vpr.recordings import write_recording
    from edge_vpr_tools.inputs import describe_faults, open_from, tracked

    check_output(args.output, [args.input])
    recording = open_from(args, args.input)
    n = write_recording(args.output, tracked(recording, "converting"), overwrite=args.overwrite)
    summary(f"{args.output}: {n:,} events of {recording.sensor}{describe_faults(recording)}")
