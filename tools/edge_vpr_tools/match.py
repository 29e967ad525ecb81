"""`edge-vpr match`: a query drive is matched against a map."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr_tools.reading import add_reading_arguments, add_window_argument
from edge_vpr_tools.setting_flags import add_match_flags

HELP = "match a query drive against a map"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("map", metavar="MAP.npz", help="reference map from edge-vpr map")
    parser.add_argument("recording", metavar="QUERY", help="recording of the query drive")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="folder to write")
    parser.add_argument("--overwrite", action="store_true", help="replace the output if it exists")
    parser.add_argument("--no-figures", action="store_true", help="write no figures and no report")
    parser.add_argument(
        "--online", action="store_true", help="match event by event, as on the board"
    )
    parser.add_argument(
        "--every",
        metavar="WHEN",
        help="with --online, when to give a match: event (at a selected pixel; the default), N "
        "events, a time such as 10ms, window, or change (of the best place)",
    )
    add_window_argument(add_reading_arguments(parser))
    add_match_flags(parser.add_argument_group("settings (over the map's)"))


def run(args: argparse.Namespace) -> None:
    """Match the recording and write the folder of results.

    Raises
    ------
    EdgeVprError
        If an argument is wrong or the recording cannot be matched.
    """
    import dataclasses
    import time

    from edge_vpr.archive import write_archive
    from edge_vpr.errors import UsageError
    from edge_vpr.matching.matches import match_descriptors
    from edge_vpr.pipeline import describe
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools import results
    from edge_vpr_tools.online import match_online
    from edge_vpr_tools.progress import tracked
    from edge_vpr_tools.provenance import run_record, write_json
    from edge_vpr_tools.reading import describe_faults, fault_counts, open_source
    from edge_vpr_tools.setting_flags import match_flags

    output = Path(args.output)
    results.check_output_folder(output, args.overwrite)
    reference = ReferenceMap.load(args.map)
    given = {name: value for name, value in match_flags(args).items() if value is not None}
    settings = reference.settings.replaced(given, "the command line")
    if args.every is not None and not args.online:
        raise UsageError("--every says when to match online: add --online, or leave it out")
    if args.online:
        match_online(args, dataclasses.replace(reference, settings=settings))
        return
    recording = open_source(args, args.recording)

    start = time.perf_counter()
    queries = describe(
        tracked(recording, "counting"), reference.pixel_map, settings, reference.full_scale
    )
    length = settings.sequence_length
    match_descriptors(reference.places, queries.first(length), settings)  # compiled before timing
    described = time.perf_counter()
    matches = match_descriptors(reference.places, queries, settings)
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
        matches.save_csv(folder / results.MATCHES_CSV)
        write_archive(folder / results.QUERIES, results.QUERIES_KIND, queries.to_arrays(), {})
        write_json(folder / results.RUN, run_record(settings.to_dict(), [args.map, args.recording]))
        write_json(folder / results.METRICS, metrics)
        if not args.no_figures:
            from edge_vpr_tools.report.traverse import write_report

            write_report(folder)
    print(
        f"{output}: {len(matches)} queries matched against {len(reference)} places of "
        f"{reference.bytes_per_place} bytes{describe_faults(recording)}"
    )
    print(
        f"counting {queries.events.sum():,} events took {described - start:.2f} s, matching "
        f"{(matched - described) * 1e6 / len(matches):.1f} us a query"
    )
    if not args.no_figures:
        print(f"see {output / results.REPORT}; is it right? edge-vpr evaluate {output} --help")
