"""`edge-vpr map`: make a reference map of a drive, and learn more drives of the route."""

from __future__ import annotations

import argparse
import itertools
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import EdgeVprWarning, UsageError
from edge_vpr_tools.console import (
    describe_faults,
    describe_removed,
    detail_settings,
    number_of,
    places_text,
    print_facts,
    summary,
    warn_of_few_places,
    warning,
    watched,
)
from edge_vpr_tools.flags import (
    add_gap_flag,
    add_json_flag,
    add_map_flags,
    add_output_flags,
    add_reading_arguments,
    add_track_offset_flag,
    add_window_argument,
    map_flags,
    map_settings,
    match_flags,
    open_source,
)

if TYPE_CHECKING:
    from edge_vpr.descriptors.counting import Removed
    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.evaluation.tracks import Track
    from edge_vpr.recordings import Recording
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.settings import Settings

EXAMPLES = """\
  edge-vpr map monday.raw -o monday.npz
  edge-vpr map monday.raw -o small.npz --preset tiny --counter-bits 2
  edge-vpr map monday.raw -o monday.npz --track monday.nmea
  edge-vpr map monday.raw tuesday.raw wednesday.raw -o route.npz
  edge-vpr map route.npz thursday.raw -o route.npz --overwrite
  edge-vpr map frames/ -o map.npz --frame-period 1/30 --frames-as-windows"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "recording",
        metavar="REFERENCE",
        help="recording of the reference drive, or a map to add the other drives to",
    )
    parser.add_argument(
        "more",
        metavar="DRIVE",
        nargs="*",
        default=[],  # without it, an error calls them required
        help="recordings of further drives of the route, which map averages into the places of "
        "the reference",
    )
    parser.add_argument(
        "--same-route",
        action="store_true",
        help="state that the further drives follow this route: map then learns all windows that "
        "align, even if most windows of a drive do not",
    )
    add_json_flag(
        add_output_flags(parser, "MAP.npz", "file to write"), "info --json and NAME.run.json"
    )
    track = parser.add_argument_group("positions")
    track.add_argument(
        "--track",
        metavar="FILE",
        action="append",
        help="track of the reference drive (NMEA, GPX, poses of TUM, KITTI or EuRoC, or CSV with "
        "time_s or timestamp and metres or degrees), "
        "which gives each match a position and an interval along the route; given once per drive, "
        "the tracks align the further drives, which otherwise matching aligns",
    )
    add_track_offset_flag(track)
    add_gap_flag(track)
    track.add_argument(
        "--odometry",
        metavar="FILE",
        help="odometry of this drive (CSV with time_s, and distance_m, position_m or speed_mps; or "
        "the log of stream --odometry); "
        "with it, match --odometry needs no track",
    )
    parser.add_argument(
        "--pixel-map",
        metavar="FILE",
        help="pixels to use instead of selecting them: a file with a line x, y per pixel, or a map",
    )
    add_window_argument(add_reading_arguments(parser))
    add_map_flags(parser)


def run(args: argparse.Namespace) -> None:
    """Map the recording, or load the map; learn the other drives, and save the map."""
    from edge_vpr.archive import archive_kind
    from edge_vpr.descriptors.counting import Removed
    from edge_vpr.evaluation.facts import Drive, facts
    from edge_vpr.evaluation.track_files import load_track
    from edge_vpr.files import check_new_file, check_new_map
    from edge_vpr.records import json_text, to_json, write_json
    from edge_vpr.reference_map import KIND, ReferenceMap
    from edge_vpr.results import run_record

    output = Path(args.output)
    # a map is read whole before it is written
    learns = archive_kind(args.recording) == KIND
    tracks = args.track or []
    files = (args.odometry, args.pixel_map, args.config, _hot_pixel_file(args))
    named = (*args.more, *tracks, *files)
    inputs = [file for file in (args.recording, *named) if file is not None]
    check_new_map(output, inputs[learns:], args.overwrite)
    run_file = output.with_suffix(".run.json")
    check_new_file(run_file, inputs, args.overwrite)
    if args.track_offset is not None and not tracks:
        raise UsageError("--track-offset corrects the clock of a track: add --track")
    number = len(args.more) + (not learns)
    if len(tracks) > number:
        raise UsageError(f"{len(tracks)} tracks for {number} drives: give one per drive")

    of_drives = [
        load_track(track, max_gap_s=args.longest_gap).shifted(args.track_offset or 0.0)
        for track in tracks
    ]
    removed, seconds = Removed(), None
    drives: dict[str, Drive] = {}
    if learns:
        _check_flags_of_a_map(args)
        reference = ReferenceMap.load(args.recording)
    else:
        settings = map_settings(args)
        recording = open_source(args, args.recording)
        track = of_drives.pop(0) if of_drives else None
        if args.tau == "auto":
            settings = _with_fitting_window(args, settings, recording, track)
        reference, seconds = _mapped(args, settings, recording, track, removed)
        drives["drive"] = Drive.of_map(reference, track)
    for path, its_track in itertools.zip_longest(args.more, of_drives):
        other = open_source(args, path, reference.camera)
        update = reference.update(
            watched(other, "learning"), track=its_track, same_route=args.same_route
        )
        summary(f"{path}: {update}{describe_faults(other)}")
        drives[path] = update.drive
        reference = update.reference
    reference.save(output, overwrite=args.overwrite)
    hot_pixels = int(reference.hot.sum())
    record = run_record(reference.settings.to_dict(), inputs, removed.record(hot_pixels))
    write_json(run_file, record)
    info = reference.info()
    if args.json:
        held = {"path": str(output), "format": "map", **asdict(info)}
        held["facts"] = facts(drives)
        print(json_text({**held, **to_json(record)}))

    places = reference.places
    summary(
        f"{output}: {places_text(reference)} at {len(reference.pixel_map)} pixels of "
        f"{reference.pixel_map.sensor}, {info.lines['size']}, "
        f"{reference.packed_bytes_per_place * len(places) / 1e3:.1f} kB in all"
    )
    if seconds is not None:
        summary(
            f"counted in {seconds:.2f} s; {number_of(hot_pixels, 'hot pixel')} left out"
            f"{describe_removed(removed, reference.settings)}"
            f"{describe_faults(recording)}"
        )
    lines = facts(drives)
    if reference.settings.window == "time":
        lines["window"] = _of_a_window(reference)
    print_facts(lines)
    if reference.route is not None:
        summary(
            f"{info.places_with_position} of {info.places} places have positions, along "
            f"{info.route_m:,.0f} m"
        )
    if reference.odometer_mm is not None:
        summary(f"odometry: {reference.odometer_mm[-1] / 1e3:,.1f} m from first to last place")
        if args.odometry is not None and reference.odometer_mm[-1] == 0:
            warning(
                f"the robot does not move forward by {args.odometry} during this drive: give times "
                "in seconds from the recording's start, and distances that rise"
            )
    warn_of_few_places(output, reference)


def _mapped(
    args: argparse.Namespace,
    settings: Settings,
    recording: Recording | PublishedWindows,
    track: Track | None,
    removed: Removed,
) -> tuple[ReferenceMap, float]:
    """Return the map of the reference drive, and the time that it took in seconds."""
    from edge_vpr.compiling import working_s
    from edge_vpr.reference_map import ReferenceMap

    detail_settings(settings)
    start = working_s()
    reference = ReferenceMap.build(
        watched(recording, "mapping"), settings, pixel_map=args.pixel_map,
        hot=_hot_pixel_file(args), track=track, odometry=args.odometry,
        removed=removed,
    )  # fmt: skip
    seconds = working_s() - start
    selected = len(reference.pixel_map)
    if args.pixel_map is None and selected < settings.pixels:
        warning(
            f"{args.recording} has events at {selected} pixels alone, of {settings.pixels} that "
            "were asked for: the map has only these"
        )
    return reference, seconds


def _with_fitting_window(
    args: argparse.Namespace,
    settings: Settings,
    recording: Recording | PublishedWindows,
    track: Track | None,
) -> Settings:
    """Return settings with the window of --tau auto, from a map with the window that they have."""
    from edge_vpr.descriptors.counting import Removed
    from edge_vpr.map_making import fitting_window

    if settings.window != "time":  # a map of them would be refused, after it was made
        raise UsageError("--tau auto is for windows of fixed time: leave out --window count")
    with warnings.catch_warnings():  # the map that is kept has the same
        warnings.simplefilter("ignore", EdgeVprWarning)
        reference, _ = _mapped(args, settings, recording, track, Removed())
    tau_us = fitting_window(reference).tau_us
    summary(f"--tau auto: windows of {tau_us / 1e6:g} s")
    return settings.replaced({"tau_us": tau_us}, "--tau auto")


def _of_a_window(reference: ReferenceMap) -> str:
    """Return what a window of the map's drive has, and how long --tau auto would make it."""
    from edge_vpr.map_making import fitting_window

    tau_us, fitting = reference.settings.tau_us, fitting_window(reference)
    fact = f"{fitting.events_per_pixel:.2g} events for each selected pixel"
    if fitting.travel_m is not None:
        fact = f"{fitting.travel_m:.1f} m of travel"
    fits = f"; --tau auto makes it {fitting.tau_us / 1e6:g} s" if fitting.tau_us != tau_us else ""
    return f"{tau_us / 1e6:g} s, {fact}{fits}"


def _hot_pixel_file(args: argparse.Namespace) -> str | None:
    """Return the file that lists hot pixels, if one is given."""
    return None if args.hot_pixels in (None, "find", "keep") else str(args.hot_pixels)


def _check_flags_of_a_map(args: argparse.Namespace) -> None:
    """Raise UsageError where a map learns, and a flag is given that only making one takes."""
    flags = map_flags(args) + list(match_flags(args))
    files = {"odometry": args.odometry, "pixel-map": args.pixel_map}
    flags += [f"--{name}" for name, file in files.items() if file is not None]
    if flags:
        raise UsageError(
            f"{flags[0]} is for making a map, and {args.recording} is one, which keeps its "
            "settings: leave it out"
        )
    if not args.more:
        raise UsageError(f"{args.recording} is a map already: name the drives that it is to learn")
