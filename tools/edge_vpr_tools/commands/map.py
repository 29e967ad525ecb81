"""`edge-vpr map`: make a reference map of a drive."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import detail_settings, summary, warning
from edge_vpr_tools.flags import (
    add_map_flags,
    add_reading_arguments,
    add_window_argument,
    map_settings,
)

EXAMPLES = """\
  edge-vpr map monday.raw -o monday.npz
  edge-vpr map monday.raw -o small.npz --preset tiny --counter-code log --counter-bits 3
  edge-vpr map monday.raw -o monday.npz --track monday.nmea
  edge-vpr map frames/ -o map.npz --frame-period 1/30 --frames-as-windows"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="REFERENCE", help="recording of the reference drive")
    output = parser.add_argument_group("output")
    output.add_argument("-o", "--output", metavar="MAP.npz", required=True, help="file to write")
    output.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    track = parser.add_argument_group("positions")
    track.add_argument(
        "--track",
        metavar="FILE",
        help="track of this drive (NMEA, GPX, or CSV with time_s and metres or degrees), from "
        "which each match gets a position and an interval along the route",
    )
    track.add_argument(
        "--track-offset",
        type=float,
        metavar="S",
        help="time in the recording at which the track has its time 0, in seconds; negative if the "
        "track began earlier (default: 0)",
    )
    track.add_argument(
        "--odometry",
        metavar="FILE",
        help="odometry of this drive (CSV with time_s and distance_m or speed_mps); with it, match "
        "--odometry needs no track",
    )
    track.add_argument(
        "--jumps",
        metavar="FILE",
        help="pairs of places (CSV with from,to) between which a vehicle can go in one step, for "
        "example where a loop closes",
    )
    add_window_argument(add_reading_arguments(parser))
    add_map_flags(parser)


def run(args: argparse.Namespace) -> None:
    """Map the recording and save the map."""
    import numpy as np

    from edge_vpr.descriptors.cleaning import load_hot_pixels
    from edge_vpr.evaluation.tracks import load_odometry, load_track
    from edge_vpr.files import check_output
    from edge_vpr.pipeline import WindowSource
    from edge_vpr.reference_map import removed_record
    from edge_vpr.results import check_parent, run_record, write_json
    from edge_vpr.warm_up import mapping_steps
    from edge_vpr_tools.inputs import describe_faults, open_source
    from edge_vpr_tools.progress import describe_removed, tracked, warmed_up, warn_if_much
    from edge_vpr_tools.runs.mapping import map_recording

    output = Path(args.output)
    listed = args.hot_pixels not in (None, "find", "keep")
    named = (args.recording, args.track, args.odometry, args.jumps, args.config)
    inputs = [file for file in (*named, args.hot_pixels if listed else None) if file is not None]
    check_output(output, inputs)
    if output.suffix != ".npz":
        raise UsageError(f"output {output} does not end in .npz: name the map for example map.npz")
    run_file = output.with_suffix(".run.json")
    for file in (output, run_file):
        if file.exists() and not args.overwrite:
            raise UsageError(f"output {file} exists: name another, or replace it with --overwrite")
    check_parent(output)
    settings = map_settings(args)
    recording = open_source(args, args.recording)
    hot = load_hot_pixels(args.hot_pixels, recording.sensor) if listed else None

    if args.track_offset is not None and args.track is None:
        raise UsageError("--track-offset sets the clock of a track right: add --track")
    track = None if args.track is None else load_track(args.track).shifted(args.track_offset or 0.0)

    odometry = None if args.odometry is None else load_odometry(args.odometry)
    detail_settings(settings.to_dict())
    if not isinstance(recording, WindowSource):
        warmed_up(mapping_steps(settings))
    reference, removed, elapsed = map_recording(
        tracked(recording, "mapping"),
        settings,
        hot=hot,
        track=track,
        odometry=odometry,
        jumps=args.jumps,
    )
    reference.save(output)
    hot_pixels = int(reference.hot.sum())
    left_out = removed_record(removed, hot_pixels)
    write_json(run_file, run_record(reference.settings.to_dict(), inputs, left_out))

    places = reference.places
    summary(
        f"{output}: {len(reference)} places at {len(reference.pixel_map)} pixels of "
        f"{reference.pixel_map.sensor}, {reference.bytes_text}, "
        f"{reference.packed_bytes_per_place * len(places) / 1e3:.1f} kB in all"
    )
    summary(
        f"counted {places.events.sum():,} events over {places.end_us[-1] / 1e6:.1f} s "
        f"in {elapsed:.2f} s; {hot_pixels} hot pixels left out"
        f"{describe_removed(removed, settings)}"
        f"{describe_faults(recording)}"
    )
    if reference.route is not None:
        along = reference.route.along_m
        known = along[~np.isnan(along)]
        summary(f"{known.size} of {len(reference)} places have positions, along {known[-1]:,.0f} m")
    if reference.odometer_mm is not None:
        summary(f"odometry: {reference.odometer_mm[-1] / 1e3:,.1f} m from first to last place")
    if len(reference.pixel_map) < settings.pixels:
        warning(
            f"{args.recording} has events at {len(reference.pixel_map)} pixels alone, of "
            f"{settings.pixels} that were asked for: all of them are taken"
        )
    warn_if_much(removed, args.recording, "keep them with --bursts keep")
