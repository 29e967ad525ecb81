"""`edge-vpr match`: match a query drive with a map."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.archive import kind_of, write_npy
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.odometry_files import load_odometry
from edge_vpr.pipeline import query_distances
from edge_vpr.reference_map import KIND as MAP_KIND
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.whole_files import check_output
from edge_vpr_tools.arguments.reading import describe_faults, open_source
from edge_vpr_tools.arguments.setting_flags import match_flags, with_match_flags
from edge_vpr_tools.commands.match_online import match_online
from edge_vpr_tools.output import results
from edge_vpr_tools.output.cleaning import describe_removed, warn_if_much
from edge_vpr_tools.output.messages import detail_settings, summary
from edge_vpr_tools.output.progress import tracked
from edge_vpr_tools.report.formats import read_formats
from edge_vpr_tools.runs.match_folder import write_match_folder
from edge_vpr_tools.runs.matching import match_recording
from edge_vpr_tools.runs.registration import registered


def run(args: argparse.Namespace) -> None:
    """Match the recording and write the folder of results."""
    output = Path(args.output)
    inputs = list(filter(None, (args.map, args.recording, args.odometry)))
    results.check_output_folder(output, args.overwrite, inputs)
    if kind_of(args.map) != MAP_KIND and kind_of(args.recording) == MAP_KIND:
        raise UsageError(
            f"{args.recording} is the map and {args.map} is not: the map comes first, then the "
            "recording of the query drive"
        )
    formats = read_formats(args.figures)
    matrix = None if args.matrix is None else Path(args.matrix)
    if matrix is not None:
        _check_matrix(matrix, inputs, args)
    reference = ReferenceMap.load(args.map)
    settings = with_match_flags(args, reference.settings, online=args.online)
    asked = reference.matched_with(settings)
    _ = asked.judge  # a precision that the table cannot reach is an error before any work is done
    if args.every is not None and not args.online:
        raise UsageError("--every says when to match online: add --online, or leave it out")
    odometry = None if args.odometry is None else load_odometry(args.odometry)
    detail_settings(settings.to_dict())
    if args.online:
        match_online(args, asked, odometry)
        return
    recording = open_source(args, args.recording)
    reference, shift = registered(reference, recording, args.register)
    asked = reference.matched_with(
        reference.settings.replaced(match_flags(args), "the command line")
    )
    found = match_recording(asked, tracked(recording, "counting"), odometry)
    queries, matches = found.queries, found.matches
    metrics = found.metrics(reference, recording.faults, shift)
    with results.results_folder(output, args.overwrite) as folder:
        write_match_folder(folder, reference, matches, found.removed, metrics, inputs, queries)
        if not args.no_figures:
            from edge_vpr_tools.report.traverse import write_report

            write_report(folder, formats=formats)
    summary(
        f"{output}: {len(matches)} queries matched against {len(reference)} places of "
        f"{reference.bytes_per_place} bytes{describe_removed(found.removed, settings)}"
        f"{describe_faults(recording)}"
    )
    if matrix is not None:
        distances = query_distances(asked, queries, odometry)
        write_npy(matrix, distances)
        summary(f"{matrix}: distances, {distances.shape[0]} places x {distances.shape[1]} queries")
    summary(
        f"counting {queries.events.sum():,} events took {found.counting_s:.2f} s, matching "
        f"{found.matching_s * 1e6 / len(matches):.1f} us a query"
    )
    if not args.no_figures:
        summary(f"see {output / results.REPORT}; is it right? edge-vpr evaluate {output} --help")
    warn_if_much(found.removed, args.recording, "make the map with --bursts keep")


def _check_matrix(matrix: Path, inputs: list[str], args: argparse.Namespace) -> None:
    """Check that a matrix can be written, before any work is done."""
    if args.online:
        raise UsageError(
            "--matrix needs whole windows, and --online matches single events: leave one out"
        )
    if matrix.suffix != ".npy":
        raise UsageError(f"matrix {matrix} does not end in .npy: name it for example distances.npy")
    check_output(matrix, inputs)
    results.check_parent(matrix)
    if matrix.exists() and not args.overwrite:
        raise UsageError(f"{matrix} exists: name another file, or replace it with --overwrite")
