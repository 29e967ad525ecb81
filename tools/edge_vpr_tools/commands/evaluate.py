"""`edge-vpr evaluate`: are the matches right? Compares them with a ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.archive import read_archive
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.arguments.truth import load_truth
from edge_vpr_tools.output import results
from edge_vpr_tools.output.messages import note
from edge_vpr_tools.output.provenance import read_json, run_record, write_json
from edge_vpr_tools.report.traverse import write_report

#: places times queries of the ground truth: 64 MB
_MOST_CELLS = 1 << 26


def run(args: argparse.Namespace) -> None:
    """Evaluate, print the figures, and add them to the folder.

    Raises
    ------
    EdgeVprError
        If the folder or the ground truth cannot be used.
    """
    folder = Path(args.results)
    if not folder.is_dir():
        raise MapError(f"{folder} is not a folder of results: run edge-vpr match first")
    reference = ReferenceMap.load(folder / results.MAP)
    matches = Matches.load(folder / results.MATCHES)
    if (folder / results.QUERIES).is_file():
        arrays, _ = read_archive(folder / results.QUERIES, results.QUERIES_KIND)
        queries_us = Descriptors.from_arrays(arrays).centre_us
    else:  # matched event by event: each match is a query of its own
        matches = matches.every(1 + len(matches) * len(reference) // _MOST_CELLS)
        queries_us = matches.time_us
    truth = load_truth(
        args.ground_truth,
        reference.places.centre_us,
        queries_us,
        tolerance=args.tolerance,
        rows=args.rows,
        frame_period=args.frame_period,
        offset_s=args.offset,
    )
    for line in truth.notes:
        note(line)
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
