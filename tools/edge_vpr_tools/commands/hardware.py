"""`edge-vpr hardware`: write the hardware core of a design as a project for a board."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import note, status, summary
from edge_vpr_tools.flags import add_design_flags

if TYPE_CHECKING:
    from firmware_model import Design, Memories


EXAMPLES = """\
  edge-vpr hardware --map monday.npz -o core
  edge-vpr hardware --design design.toml -o core"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_design_flags(parser, "; the core then has random pixels, for tests only")
    parser.add_argument(
        "--vectors", metavar="SIZE", default="20MB",
        help="size of the golden vectors, about: hardware leaves out the cases with most events; "
        "all writes every case, 0 none",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True, help="folder to write: new, or empty"
    )


def run(args: argparse.Namespace) -> None:
    """Write the project."""
    from edge_vpr.files import check_output, check_parent, replacing_folder
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools.estimate.of_map import design_of, memories_of
    from edge_vpr_tools.golden_vectors import vectors_size
    from firmware_model import Design
    from firmware_model.hardware.project import write_project

    output = Path(args.output)
    check_output(output, (args.design, args.map))
    check_parent(output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise UsageError(f"{output} is not an empty folder: name a new one")
    if args.map is None:
        design = Design.load(args.design)
        memories = _test_memories(design)
        note(
            "a design file has no pixels, so that those of the tables are for tests only; use --map"
        )
    else:
        reference = ReferenceMap.load(args.map)
        design = design_of(reference, args.lanes)
        memories = memories_of(reference, design)
    with replacing_folder(output, overwrite=False) as folder, status("golden vectors") as show_case:
        write_project(folder, memories, 0, most_bytes=vectors_size(args.vectors), on_case=show_case)
    summary(
        f"{args.output}: core of {design.pixels} pixels and {design.places} places; make builds it "
        "for an iCEBreaker or a ULX3S, make test holds it to its vectors"
    )


def _test_memories(design: Design) -> Memories:
    """Return tables with pixels for tests, and places without events."""
    from firmware_model import Memories
    from firmware_model.vectors.case import choose_pixels

    places = [[0] * design.slots] * design.places
    return Memories(design, choose_pixels(design), places)
