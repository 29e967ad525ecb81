"""`edge-vpr convert`: convert a recording to another format."""

from __future__ import annotations

import argparse

from edge_vpr.recordings import write_recording
from edge_vpr.whole_files import check_output
from edge_vpr_tools.arguments.reading import describe_faults, open_from
from edge_vpr_tools.output.messages import summary
from edge_vpr_tools.output.progress import tracked


def run(args: argparse.Namespace) -> None:
    """Read the input and write the output, whole or not at all.

    Raises
    ------
    EdgeVprError
        If the input cannot be read, holds faults, or does not fit the output's format.
    """
    check_output(args.output, [args.input])
    recording = open_from(args, args.input)
    n = write_recording(args.output, tracked(recording, "converting"), overwrite=args.overwrite)
    summary(f"{args.output}: {n:,} events of {recording.sensor}{describe_faults(recording)}")
