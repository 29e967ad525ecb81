"""`edge-vpr evaluate`: are the matches right? Compares them with a ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "compare matches with a ground truth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    parser.add_argument(
        "--ground-truth",
        nargs="+",
        required=True,
        metavar="FILE",
        help="two tracks, reference then query (NMEA, GPX, or CSV with time_s and metres or "
        "degrees); or one alignment (CSV with the columns query_s,reference_s or "
        "query_frame,reference_frame); or one 0/1 matrix (.npz, .npy)",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        metavar="T",
        help="largest error of a right match: metres for tracks, the unit of an alignment",
    )
    parser.add_argument(
        "--rows", choices=("reference", "query"), help="what a row of the matrix stands for"
    )
    parser.add_argument(
        "--offset",
        nargs=2,
        type=float,
        metavar=("REF_S", "QUERY_S"),
        help="where time 0 of each track is in its recording, in seconds; negative if the log "
        "began earlier (default: 0 0)",
    )
    parser.add_argument(
        "--frame-period", metavar="S", help="of an alignment in frames, in seconds: 1/30"
    )
    parser.add_argument(
        "--score", choices=("distance", "ratio"), default="distance",
        help="what the threshold of the precision-recall curve is on",
    )  # fmt: skip
    parser.add_argument(
        "--recall-denominator",
        choices=("rejected-correct", "all-with-place"),
        default="rejected-correct",
        help="what counts as missed: rejected queries whose best match was right (the released "
        "code), or every query with a true place that did not get it",
    )
    parser.add_argument(
        "--thresholds", type=int, metavar="N", help="N even thresholds instead of all"
    )


def run(args: argparse.Namespace) -> None:
    """Evaluate, print the figures, and add them to the folder.

    Raises
    ------
    EdgeVprError
        If the folder or the ground truth cannot be used.
    """
    import sys

    from edge_vpr.archive import read_archive
    from edge_vpr.descriptors.windows import Descriptors
    from edge_vpr.errors import MapError, printable
    from edge_vpr.evaluation.metrics import evaluate
    from edge_vpr.matching.matches import Matches
    from edge_vpr.reference_map import ReferenceMap
    from edge_vpr_tools import results
    from edge_vpr_tools.online import ONLINE
    from edge_vpr_tools.provenance import read_json, run_record, write_json
    from edge_vpr_tools.report.traverse import write_report
    from edge_vpr_tools.truth import load_truth

    folder = Path(args.results)
    if not folder.is_dir():
        raise MapError(f"{folder} is not a folder of results: run edge-vpr match first")
    if (folder / ONLINE).is_file():
        raise MapError(f"{folder} holds online matches: evaluate those of edge-vpr match alone")
    reference = ReferenceMap.load(folder / results.MAP)
    matches = Matches.load(folder / results.MATCHES)
    arrays, _ = read_archive(folder / results.QUERIES, results.QUERIES_KIND)
    queries = Descriptors.from_arrays(arrays)
    truth = load_truth(
        args.ground_truth,
        reference.places.centre_us,
        queries.centre_us,
        tolerance=args.tolerance,
        rows=args.rows,
        frame_period=args.frame_period,
        offset_s=args.offset,
    )
    for note in truth.notes:
        print(f"edge-vpr: note: {printable(note)}", file=sys.stderr)
    found = evaluate(
        matches,
        truth,
        score=args.score,
        recall_denominator=args.recall_denominator,
        thresholds=args.thresholds,
    )
    metrics = read_json(folder / results.METRICS, "match again")
    metrics["ground_truth"] = truth.description
    metrics["evaluation"] = found.to_dict()
    metrics["evaluated_by"] = run_record(matches.settings.to_dict(), args.ground_truth)
    write_report(folder, truth, found)
    write_json(folder / results.METRICS, metrics)

    print(
        f"P@100R {found.precision_at_100_recall:.3f}   R@99P {found.recall_at_99_precision:.3f}   "
        f"average precision {found.curve.average_precision:.3f}   "
        + "   ".join(f"Recall@{n} {recall:.3f}" for n, recall in found.recall_at.items())
    )
    print(
        f"{found.queries} queries evaluated by {truth.description}; {found.queries_unknown} of "
        f"unknown truth left out, {found.queries_without_place} without a true place in the map, "
        f"{found.queries_tied} tied"
    )
    print(f"recall: {args.recall_denominator} queries are missed; see {folder / results.REPORT}")
