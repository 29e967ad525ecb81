"""`edge-vpr convert`: one recording into another format."""

from __future__ import annotations

import argparse

from edge_vpr_tools.reading import add_reading_arguments

HELP = "convert a recording; the suffix of the output names its format"


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


def run(args: argparse.Namespace) -> None:
    """Read the input and write the output, whole or not at all.

    Raises
    ------
    EdgeVprError
        If the input cannot be read, holds faults, or does not fit the output's format.
    """
    from edge_vpr.recordings import write_recording
    from edge_vpr.whole_files import check_output
    from edge_vpr_tools.progress import tracked
    from edge_vpr_tools.reading import describe_faults, open_from

    check_output(args.output, [args.input])
    recording = open_from(args, args.input)
    n = write_recording(args.output, tracked(recording, "converting"), overwrite=args.overwrite)
    print(f"{args.output}: {n:,} events of {recording.sensor}{describe_faults(recording)}")
