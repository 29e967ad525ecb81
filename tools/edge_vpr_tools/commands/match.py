"""`edge-vpr match`: match a query drive with a map."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from edge_vpr.errors import MapError, UsageError
from edge_vpr_tools.console import (
    describe_faults,
    describe_removed,
    detail_settings,
    places_text,
    print_facts,
    summary,
    warn_of_few_places,
    warning,
    watched,
)
from edge_vpr_tools.flags import (
    add_figures_flag,
    add_json_flag,
    add_output_flags,
    add_reading_arguments,
    add_setting_flags,
    add_window_argument,
    match_flags,
    open_source,
    warn_of_no_effect,
)

if TYPE_CHECKING:
    from edge_vpr.descriptors.published import PublishedWindows
    from edge_vpr.matching.matches import Matches
    from edge_vpr.recordings import Recording
    from edge_vpr.reference_map import ReferenceMap


EXAMPLES = """\
  edge-vpr match monday.npz tuesday.raw -o tuesday
  edge-vpr match monday.npz tuesday.raw -o online --online --every 50ms --precision 0.99
  edge-vpr match monday.npz tuesday.raw -o robot --no-smooth --precision 0.99 --overwrite"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("map", metavar="MAP.npz", help="reference map from edge-vpr map")
    parser.add_argument("recording", metavar="QUERY", help="recording of the query drive")
    output = add_output_flags(parser)
    output.add_argument("--no-figures", action="store_true", help="write no figures and no report")
    add_figures_flag(output, "svg")
    add_json_flag(output, "metrics.json")
    output.add_argument(
        "--matrix", metavar="FILE.npy",
        help="also write the distance of every place (row) to every query window (column)",
    )  # fmt: skip
    output.add_argument(
        "--export",
        metavar="FILE",
        action="append",
        help="also write the matched positions as a track: .gpx or .geojson if the map has a GPS "
        "log, .tum (as evo reads) if it has positions; may be repeated",
    )
    online = parser.add_argument_group("online matching")
    online.add_argument(
        "--online", action="store_true",
        help="match as the events come, like a device, without using later events",
    )  # fmt: skip
    online.add_argument(
        "--every",
        metavar="WHEN",
        help="when --online gives a match: event (after each event at a selected pixel), N (after "
        "N of them), a time such as 10ms, window (at the end of each window), or change (when the "
        "place changes) (default: event); by events, matches come more often where the camera "
        "sees more",
    )
    parser.add_argument_group("odometry").add_argument(
        "--odometry",
        metavar="FILE",
        help="odometry of the query drive (CSV with time_s, and distance_m, position_m or "
        "speed_mps; or the log of stream --odometry), for a map made with --odometry or --track",
    )
    matching = parser.add_argument_group("matching (over the map's settings)")
    add_setting_flags(matching, "matching", "the map's")
    add_window_argument(add_reading_arguments(parser))


def run(args: argparse.Namespace) -> None:
    """Match the recording and write the folder of results."""
    from edge_vpr import results
    from edge_vpr.archive import archive_kind, write_npy
    from edge_vpr.evaluation.match_tracks import check_track_file
    from edge_vpr.evaluation.tables import load_odometry
    from edge_vpr.files import check_new_file
    from edge_vpr.match_result import OnlineMetrics
    from edge_vpr.matching.drive import query_distances
    from edge_vpr.records import json_text
    from edge_vpr.reference_map import KIND as MAP_KIND
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr.route import length_m
    from edge_vpr_tools.report.verdict import outcome_of

    output = Path(args.output)
    inputs = list(filter(None, (args.map, args.recording, args.odometry)))
    results.check_output_folder(output, args.overwrite, inputs)
    matrix = None if args.matrix is None else Path(args.matrix)
    if matrix is not None:
        _check_matrix(matrix, inputs, args)
    try:
        reference = ReferenceMap.load(args.map)
    except MapError:
        if archive_kind(args.recording) != MAP_KIND or archive_kind(args.map) == MAP_KIND:
            raise
        raise UsageError(
            f"{args.recording} is the map and {args.map} is not: the map comes first, then the "
            "recording of the query drive"
        ) from None
    for path in args.export or ():
        check_track_file(path, reference)
        check_new_file(Path(path), inputs, args.overwrite)
    if args.every is not None and not args.online:
        raise UsageError("--every says when to match online: add --online, or leave it out")
    odometry = None if args.odometry is None else load_odometry(args.odometry)
    changed = reference.causal_with if args.online else reference.with_settings
    settings = changed(None, match_flags(args), "the command line").settings
    detail_settings(settings)
    warn_of_no_effect(args, settings)
    if args.stays_on_map and settings.matching == "filter" and settings.smooth:
        warning("--stays-on-map is for live matches: add --no-smooth")
    warn_of_few_places(args.map, reference)
    recording = open_source(args, args.recording, reference.camera)
    result = reference.match(
        watched(recording, "localising" if args.online else "counting"),
        every=(args.every or "event") if args.online else None,
        settings=settings,
        odometry=odometry,
    )
    queries, matches, metrics = result.queries, result.matches, result.metrics
    remarks = []
    if odometry is not None:
        odometry = odometry.since(result.start_us)
        along_mm = reference.along_mm
        assert along_mm is not None  # else matching refuses odometry
        route_m = length_m(along_mm / 1e3, reference.settings.window_parts)
        remarks.append(odometry.beside(matches.time_us, route_m))
    outcome, facts = outcome_of(reference, matches), result.facts()
    with results.results_folder(output, args.overwrite) as folder:
        run = result.write(folder, inputs)
        if not args.no_figures:
            from edge_vpr_tools.report.traverse import write_report

            write_report(folder, result, run, outcome, args.figures, facts, remarks=remarks)
    if args.json:
        print(json_text({} if metrics is None else metrics))
    summary(f"{output}: {outcome.sentence}")
    for remark in remarks:
        summary(remark)
    print_facts(facts)
    left_out = describe_removed(result.removed, settings) + describe_faults(recording)
    if isinstance(metrics, OnlineMetrics):
        duration_s = metrics.times_real_time * metrics.localising_s
        summary(f"{metrics.events:,} events over {duration_s:.1f} s{left_out}")
        summary(
            f"localising took {metrics.localising_s:.2f} s, {metrics.times_real_time:,.0f} times "
            "real time"
        )
        _export_tracks(args.export, reference, matches, recording)
        return
    assert queries is not None and metrics is not None
    summary(f"{places_text(reference)}, {reference.size_text}{left_out}")
    _export_tracks(args.export, reference, matches, recording)
    if matrix is not None:
        distances = query_distances(reference.matched_with(settings), queries, odometry)
        write_npy(matrix, distances)
        summary(f"{matrix}: distances, {distances.shape[0]} places x {distances.shape[1]} queries")
    summary(
        f"counting {queries.events.sum():,} events took {metrics.counting_s:.2f} s, matching "
        f"{metrics.matching_s * 1e6 / len(matches):.1f} µs per query"
    )
    if not args.no_figures:
        summary(
            f"see {output / results.REPORT}; next, compare with the truth: "
            f"edge-vpr evaluate {quote(str(output))} --ground-truth MAP_TRACK QUERY_TRACK "
            "--tolerance METRES"
        )


def _check_matrix(matrix: Path, inputs: list[str], args: argparse.Namespace) -> None:
    """Check that a matrix can be written, before any work is done."""
    from edge_vpr.files import check_new_file

    if args.online:
        raise UsageError(
            "--matrix needs whole windows, and --online matches single events: leave one out"
        )
    if matrix.suffix != ".npy":
        raise UsageError(f"matrix {matrix} does not end in .npy: name it for example distances.npy")
    check_new_file(matrix, inputs, args.overwrite)


def _export_tracks(
    paths: Iterable[str] | None,
    reference: ReferenceMap,
    matches: Matches,
    recording: Recording | PublishedWindows,
) -> None:
    """Write the matched positions to files, and report how many points each has."""
    from edge_vpr.evaluation.match_tracks import save_match_track

    for path in paths or ():
        points = save_match_track(path, reference, matches, start_us=recording.start_us)
        summary(f"{path}: a track of {points:,} of the {len(matches):,} matches")
