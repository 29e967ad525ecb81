"""`edge-vpr match`: a query drive is matched against a map."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from edge_vpr.archive import kind_of, write_archive
from edge_vpr.errors import UsageError
from edge_vpr.pipeline import Removed, describe_query, match_query
from edge_vpr.reference_map import KIND as MAP_KIND
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.reading import (
    describe_faults,
    fault_counts,
    open_source,
)
from edge_vpr_tools.arguments.setting_flags import match_flags
from edge_vpr_tools.commands.match_online import match_online
from edge_vpr_tools.output import results
from edge_vpr_tools.output.cleaning import describe_removed, removed_record, warn_if_much
from edge_vpr_tools.output.messages import detail_settings, summary
from edge_vpr_tools.output.progress import tracked
from edge_vpr_tools.output.provenance import run_record, write_json


def run(args: argparse.Namespace) -> None:
    """Match the recording and write the folder of results.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be matched.
    """
    output = Path(args.output)
    results.check_output_folder(output, args.overwrite, [args.map, args.recording])
    if kind_of(args.map) != MAP_KIND and kind_of(args.recording) == MAP_KIND:
        raise UsageError(
            f"{args.recording} is the map and {args.map} is not: the map comes first, then the "
            "recording of the query drive"
        )
    reference = ReferenceMap.load(args.map)
    settings = reference.settings.replaced(match_flags(args), "the command line")
    asked = reference.matched_with(settings)
    _ = asked.judge  # a precision that cannot be promised is refused before the work
    if args.every is not None and not args.online:
        raise UsageError("--every says when to match online: add --online, or leave it out")
    detail_settings(settings.to_dict())
    if args.online:
        match_online(args, asked)
        return
    recording = open_source(args, args.recording)

    removed = Removed()
    start = time.perf_counter()
    queries = describe_query(asked, tracked(recording, "counting"), removed=removed)
    length = settings.windows_per_match
    match_query(asked, queries.first(length))  # compiled before timing
    described = time.perf_counter()
    matches = match_query(asked, queries)
    matched = time.perf_counter()

    metrics = {
        "queries": len(matches),
        "places": len(reference),
        "pixels": len(reference.pixel_map),
        "bytes_per_place": reference.bytes_per_place,
        "packed_bytes_per_place": reference.packed_bytes_per_place,
        "events": int(queries.events.sum()),
        "counting_s": described - start,
        "matching_s": matched - described,
        "tied_queries": int((matches.ties > 0).sum()),
        "faults_dropped": fault_counts(recording),
    }
    with results.results_folder(output, args.overwrite) as folder:
        reference.save(folder / results.MAP)
        matches.save(folder / results.MATCHES)
        matches.save_csv(folder / results.MATCHES_CSV, reference.route)
        write_archive(folder / results.QUERIES, results.QUERIES_KIND, queries.to_arrays(), {})
        left_out = removed_record(removed, int(reference.hot.sum()))
        record = run_record(settings.to_dict(), [args.map, args.recording], left_out)
        write_json(folder / results.RUN, record)
        write_json(folder / results.METRICS, metrics)
        if not args.no_figures:
            from edge_vpr_tools.report.traverse import write_report

            write_report(folder)
    summary(
        f"{output}: {len(matches)} queries matched against {len(reference)} places of "
        f"{reference.bytes_per_place} bytes{describe_removed(removed, settings)}"
        f"{describe_faults(recording)}"
    )
    summary(
        f"counting {queries.events.sum():,} events took {described - start:.2f} s, matching "
        f"{(matched - described) * 1e6 / len(matches):.1f} us a query"
    )
    if not args.no_figures:
        summary(f"see {output / results.REPORT}; is it right? edge-vpr evaluate {output} --help")
    warn_if_much(removed, args.recording, "make the map with --bursts keep")
