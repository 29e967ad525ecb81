"""`edge-vpr map`: one drive becomes a reference map."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.reading import add_reading_arguments, add_window_argument
from edge_vpr_tools.setting_flags import add_map_flags

HELP = "make a reference map of one drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="REFERENCE", help="recording of the reference drive")
    parser.add_argument("-o", "--output", metavar="MAP.npz", required=True, help="file to write")
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    add_window_argument(add_reading_arguments(parser))
    add_map_flags(parser)


def run(args: argparse.Namespace) -> None:
    """Map the recording and save the map.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be mapped.
    """
    import time

    from edge_vpr.descriptors.cleaning import load_hot_pixels
    from edge_vpr.errors import UsageError
    from edge_vpr.pipeline import map_traverse
    from edge_vpr_tools.progress import tracked
    from edge_vpr_tools.reading import describe_faults, open_source
    from edge_vpr_tools.results import check_parent
    from edge_vpr_tools.setting_flags import map_settings

    output = Path(args.output)
    if output.suffix != ".npz":
        raise UsageError(f"output {output} does not end in .npz: name the map for example map.npz")
    if output.exists() and not args.overwrite:
        raise UsageError(f"output {output} exists: name another, or replace it with --overwrite")
    check_parent(output)
    settings = map_settings(args)
    recording = open_source(args, args.recording)
    listed = args.hot_pixels not in (None, "find", "keep")
    hot = load_hot_pixels(args.hot_pixels, recording.sensor) if listed else None

    start = time.perf_counter()
    reference = map_traverse(tracked(recording, "mapping"), settings, hot=hot)
    elapsed = time.perf_counter() - start
    reference.save(output)

    places = reference.places
    counts = places.counts
    packed = ""
    if reference.codes is not None:
        packed = f", {reference.packed_bytes_per_place} packed at {reference.counter_bits} bits"
    print(
        f"{output}: {len(reference)} places at {len(reference.pixel_map)} pixels of "
        f"{reference.pixel_map.sensor}, {reference.bytes_per_place} bytes a place "
        f"({counts.dtype}){packed}, {counts.nbytes / 1e3:.1f} kB in all"
    )
    print(
        f"read {places.events.sum():,} events over {places.end_us[-1] / 1e6:.1f} s "
        f"in {elapsed:.2f} s; {reference.hot.sum()} hot pixels left out"
        f"{describe_faults(recording)}"
    )
