"""`edge-vpr evaluate`: compare matches with a ground truth."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from edge_vpr.errors import UsageError
from edge_vpr.run_log import warnings_so_far
from edge_vpr_tools.console import print_facts, summary, table
from edge_vpr_tools.flags import add_figures_flag, add_gap_flag, add_json_flag

if TYPE_CHECKING:
    from edge_vpr.evaluation.ground_truth import GroundTruth
    from edge_vpr.evaluation.metrics import Evaluation


EXAMPLES = """\
  edge-vpr evaluate tuesday --ground-truth monday.nmea tuesday.nmea --tolerance 25
  edge-vpr evaluate tuesday --ground-truth monday.gpx tuesday.gpx --tolerance 10 25
  edge-vpr evaluate tuesday --ground-truth matrix.npz --rows reference
  edge-vpr evaluate tuesday --ground-truth pairs.csv --tolerance 3 --score ratio"""
#: width of a table in a file, in characters
_WIDTH = 80


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("results", metavar="RESULTS", help="folder that edge-vpr match wrote")
    _add_truth_flags(parser.add_argument_group("ground truth"))
    output = parser.add_argument_group("output")
    add_figures_flag(output, "svg")
    add_json_flag(output, "metrics.json")
    metrics = parser.add_argument_group("metrics")
    metrics.add_argument(
        "--score", choices=("distance", "ratio", "margin", "trust"),
        help="score of a match to which the thresholds of the precision-recall curve apply "
        "(default: trust with the place filter; with sequences, ratio for contrast codes and "
        "distance for others)",
    )  # fmt: skip
    metrics.add_argument(
        "--recall-denominator",
        choices=("rejected-correct", "all-with-place"),
        default="rejected-correct",
        help="which queries count as missed: those rejected although their match was correct "
        "(rejected-correct, as in the authors' released code), or all that have a true place in "
        "the map and did not get it (all-with-place)",
    )


def _add_truth_flags(group: argparse._ActionsContainer) -> None:
    """Add the flags that a `truth_files.TruthFiles` is made of."""
    group.add_argument(
        "--ground-truth",
        nargs="+",
        required=True,
        metavar="FILE",
        help="two tracks, first that of the reference (NMEA, GPX, poses of TUM, KITTI or EuRoC, or "
        "CSV with time_s or timestamp and position_m, x_m[,y_m[,z_m]] or latitude,longitude); or "
        "one alignment (CSV with query_s,reference_s or query_frame,reference_frame); or one "
        "matrix of 0 and 1 (.npz, .npy, .csv)",
    )
    group.add_argument(
        "--tolerance",
        default=[],
        metavar="T",
        nargs="+",
        help="largest error of a correct match: in metres for tracks, in the unit of the file for "
        "an alignment, or in seconds, as 2s; needed for both; of several, the report "
        "and the verdict are of the first",
    )
    group.add_argument(
        "--rows", choices=("reference", "query"),
        help="whether the rows of a matrix are reference places or queries; needed for a matrix",
    )  # fmt: skip
    group.add_argument(
        "--offset",
        nargs=2,
        type=float,
        metavar=("REF_S", "QUERY_S"),
        help="time in each recording at which its track has its time 0, in seconds; negative if "
        "the track began earlier (default: 0 0)",
    )
    add_gap_flag(group)
    group.add_argument(
        "--frame-period", metavar="S",
        help="duration of a frame in seconds, for an alignment in frames, for example 1/30",
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Evaluate, print the figures, and add them to the folder."""
    from edge_vpr import results
    from edge_vpr.evaluation.metrics import evaluate
    from edge_vpr.evaluation.tracks import with_positions
    from edge_vpr.records import json_text, read_json, write_json
    from edge_vpr_tools.report.traverse import (
        MISSED,
        evaluated,
        other_figures,
        tolerance_table,
        write_report,
    )
    from edge_vpr_tools.report.verdict import outcome_of
    from edge_vpr_tools.truth_files import TruthFiles, load_evaluated, parse_tolerances, truth_of

    folder = Path(args.results)
    tolerances, in_seconds = parse_tolerances(args.tolerance)
    first, *others = tolerances or (None,)
    files = TruthFiles(
        tuple(args.ground_truth), first, args.rows, args.frame_period,
        None if args.offset is None else tuple(args.offset), args.longest_gap, in_seconds,
    )  # fmt: skip
    result, truth, files = load_evaluated(args.results, files)
    reference, matches = result.reference, result.matches

    def judged(truth: GroundTruth) -> Evaluation:
        return evaluate(
            matches, truth, score=args.score, recall_denominator=args.recall_denominator
        )

    evaluation = judged(truth)
    if others and truth.positions is None:
        raise UsageError(
            f"{args.ground_truth[0]} itself says which matches are correct: leave --tolerance out"
        )
    evaluations = {} if first is None or truth.positions is None else {first: evaluation}
    for tolerance in others:
        evaluations[tolerance] = judged(truth_of(result, replace(files, tolerance=tolerance)))
    by_tolerance = {one.truth.tolerance_text: one for one in evaluations.values()}
    metrics = read_json(folder / results.METRICS, "metrics", "match again")
    outcome = outcome_of(reference, matches, evaluation)
    facts = result.facts(evaluation.truth)
    metrics |= evaluated(result, outcome, evaluation, facts, args.ground_truth)
    metrics["truth"] = files
    metrics["tolerances"] = [
        {"tolerance": each, "unit": truth.error_unit, **one.shares()}
        for each, one in evaluations.items()
    ]
    route = reference.route
    if route is None and truth.tracks is not None:
        route = with_positions(reference, truth.tracks[0]).route
    write_report(
        folder, result, results.read_run(folder), outcome, args.figures, facts,
        route=route, warnings=warnings_so_far(), tolerances=by_tolerance,
    )  # fmt: skip
    write_json(folder / results.METRICS, metrics)
    if args.json:
        print(json_text(metrics))

    summary(outcome.sentence)
    summary(
        f"P@100R {evaluation.precision_at_100_recall:.3f}   "
        f"R@99P {evaluation.recall_at_99_precision:.3f}   "
        f"average precision {evaluation.average_precision:.3f}   "
        + "   ".join(f"Recall@{n} {recall:.3f}" for n, recall in evaluation.recall_at.items())
    )
    if others:
        table(*tolerance_table(by_tolerance), width=_WIDTH)
    figures = [(name, value) for name, value, _ in other_figures(evaluation)]
    table(("figure", "value"), figures, width=_WIDTH)
    summary(f"judged by {truth.description}")
    print_facts(facts)
    summary(
        'R@99P takes its threshold from this truth, "accepted" does not; recall counts a query as '
        f"missed if {MISSED[args.recall_denominator]}; see {folder / results.REPORT}"
    )
