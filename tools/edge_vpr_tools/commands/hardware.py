"""`edge-vpr hardware`: write the hardware core of a design as a project for a board."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.whole_files import check_output, replacing_folder
from edge_vpr_tools.device.design_errors import design_errors
from edge_vpr_tools.device.tables import blank_memories
from edge_vpr_tools.estimate.of_map import design_of, memories_of
from edge_vpr_tools.output.messages import note, summary
from edge_vpr_tools.output.results import check_parent
from firmware_model import Design
from firmware_model.hardware.project import write_project


@design_errors()
def run(args: argparse.Namespace) -> None:
    """Write the project."""
    if (args.design is None) == (args.map is None):
        raise UsageError("hardware needs either --design or --map: give one of them")
    output = Path(args.output)
    check_output(output, (args.design, args.map))
    check_parent(output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise UsageError(f"{output} is not an empty folder: name a new one")
    if args.map is None:
        design = Design.load(args.design)
        memories = blank_memories(design)
        note(
            "a design file has no pixels, so that those of the tables are for tests only; use --map"
        )
    else:
        reference = ReferenceMap.load(args.map)
        design = design_of(reference, args.lanes)
        memories = memories_of(reference, design)
    with replacing_folder(output) as folder:
        write_project(folder, memories, args.seed)
    summary(
        f"{args.output}: core of {design.pixels} pixels and {design.places} places; make builds it "
        "for an iCEBreaker or a ULX3S, make test holds it to its vectors"
    )
