"""The report of a matched drive: its figures as files, and one page with all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import REPORT, RunRecord, run_record
from edge_vpr.route import Route
from edge_vpr_tools.console import places_text
from edge_vpr_tools.report.figures import (
    RouteView,
    Window,
    along_route,
    distance_matrix,
    over_time,
    precision_recall,
    reliability_diagram,
    selected_pixels,
    total_counts,
    windows_side_by_side,
)
from edge_vpr_tools.report.page import Page, add_run
from edge_vpr_tools.report.spreadsheets import write_spreadsheet
from edge_vpr_tools.report.style import save
from edge_vpr_tools.report.verdict import Outcome

#: file with the points of the precision-recall curve
CURVE = "precision_recall.csv"
#: wrong matches whose windows are shown
MOST_WINDOWS = 5
#: when recall counts a query as missed, by the name of the denominator
MISSED: dict[str, str] = {
    "rejected-correct": "rejected although its best match was correct",
    "all-with-place": "in the map but not found",
}


def write_report(
    folder: Path,
    result: MatchResult,
    run: RunRecord,
    outcome: Outcome,
    formats: Sequence[str],
    facts: Mapping[str, str],
    *,
    route: Route | None = None,
    warnings: Sequence[str] = (),
    tolerances: Mapping[str, Evaluation] = MappingProxyType({}),
    remarks: Sequence[str] = (),
) -> None:
    """Draw the figures of a results folder, which has its matches, and then write its page.

    Parameters
    ----------
    run : RunRecord
        Of the matching.
    formats : sequence of str
        Of `report.FORMATS`: each figure is also written in each.
    facts : mapping of str to str
        Of the result, see `MatchResult.facts`.
    route : Route, optional
        Positions of the places; without it, those that the map holds.
    warnings : sequence of str
        Of the evaluation; those of matching are in the run's record.
    tolerances : mapping of str to Evaluation
        Evaluations by their tolerance, where there are several.
    remarks : sequence of str
        Sentences about the inputs, shown below the verdict.
    """
    truth = outcome.truth
    route = result.reference.route if route is None else route
    page = Page("edge-vpr: matches of a drive")
    page.verdict(outcome.sentence)
    for text in (*(run.warnings or ()), *warnings):
        page.warning(text)
    for text in remarks:
        page.text(f"{text[0].upper()}{text[1:]}.")
    if truth is None:
        page.text("edge-vpr evaluate adds which matches are correct, given a ground truth.")
    else:
        page.text(f"Ground truth: {truth.description}.")
    page.text(_described(result.reference, outcome.matches))
    page.table(("drive", "facts"), facts.items())
    _add_figures(page, folder, formats, result, outcome, route, tolerances)
    add_run(page, run)
    page.write(folder / REPORT)


def evaluated(
    result: MatchResult,
    outcome: Outcome,
    evaluation: Evaluation,
    facts: Mapping[str, str],
    inputs: Sequence[str],
) -> dict[str, Any]:
    """Return what an evaluation, with these files, adds to ``metrics.json``."""
    return {
        "ground_truth": evaluation.truth.description,
        "facts": facts,
        "evaluation": evaluation.to_dict(),
        "evaluated_by": run_record(result.matches.settings.to_dict(), inputs),
        "verdict": outcome.sentence,
    }


def _add_figures(
    page: Page,
    folder: Path,
    formats: Sequence[str],
    result: MatchResult,
    outcome: Outcome,
    route: Route | None,
    tolerances: Mapping[str, Evaluation],
) -> None:
    """Draw all figures, write them in each format, and add them to the page in their sections."""
    reference, evaluation, matches = result.reference, outcome.evaluation, outcome.matches

    def add(name: str, drawing: Figure, caption: str) -> None:
        page.picture(save(drawing, *(folder / f"{name}.{kind}" for kind in formats)), caption)

    view = RouteView.of(reference, outcome, route)
    if view is not None:
        add("route", view.figure(outcome), view.caption)
    over = over_time(outcome, along_route(reference, route))
    upper = "How far each match is from the true place" if outcome.truth else "The place"
    add("matches", over, f"{upper}, and how probable it is to be correct.")
    windows, at = result.queries, matches.query
    if windows is None:  # of a drive that was matched event by event: the last before each match
        windows = result.windows
        if windows is not None:
            before = np.searchsorted(windows.end_us, matches.time_us, side="right") - 1
            at = np.maximum(before, 0)
    if windows is not None and outcome.wrong.any():
        page.heading("The worst matches")
        page.text(
            "What the selected pixels counted: in the query, at the place that was matched, and at "
            "the correct place. Larger dots: more events."
        )
        for drawing, caption in _wrong_windows(reference, windows, at, outcome):
            page.picture(save(drawing), caption)
    if evaluation is not None:
        page.heading("Metrics")
        page.table(("figure", "value", "what it says"), _figures_of(evaluation))
        if len(tolerances) > 1:
            page.table(*tolerance_table(tolerances))
        name = f"{len(reference.pixel_map)} pixels, {reference.settings.strategy}"
        text = f"Precision against recall, one step for each threshold; {CURVE} has the points."
        add("precision_recall", precision_recall(evaluation, name), text)
        columns = evaluation.curve_columns()
        points = zip(*(column.tolist() for column in columns.values()), strict=True)
        cells = [[value if np.isfinite(value) else None for value in row] for row in points]
        write_spreadsheet(folder / CURVE, list(columns), cells)
        if outcome.wrong.any() and evaluation.reliability is not None:  # otherwise a straight line
            text = (
                "Above the line, matches are correct more often than their probability says; "
                "below, less often."
            )
            add("reliability", reliability_diagram(evaluation.reliability), text)
    if result.queries is not None:
        page.heading("Distances")
        matrix = distance_matrix(reference, result.queries, outcome, route)
        add("distance_matrix", matrix, "Dark is near.")
    page.heading("Pixels")
    text = "Where the sensor sees change that differs from place to place."
    add("pixels", selected_pixels(reference), text)


def _described(reference: ReferenceMap, matches: Matches) -> str:
    by = "by the place filter"
    if matches.settings.matching != "filter":
        by = f"by sequences of {matches.settings.sequence_length} windows"
    return (
        f"{len(matches):,} matches with {places_text(reference)} {by}, at "
        f"{len(reference.pixel_map)} of {reference.pixel_map.sensor.pixels:,} pixels; "
        f"{reference.size_text}."
    )


def _wrong_windows(
    reference: ReferenceMap, queries: Descriptors, at: npt.NDArray[np.integer], outcome: Outcome
) -> Iterator[tuple[Figure, str]]:
    """Draw the windows of the worst matches, with captions: first one of each part of the drive.

    `at` says which of the queries belongs to each match.
    """
    errors, truth = outcome.errors, outcome.truth
    assert errors is not None and truth is not None  # else no match is known to be wrong
    size = np.where(outcome.wrong, np.nan_to_num(errors, nan=np.inf), -1.0)
    worst = [int(run[np.argmax(size[run])]) for run in outcome.wrong_runs()]
    others = [int(i) for i in np.argsort(-size, kind="stable") if outcome.wrong[i]]
    chosen = sorted(worst, key=lambda i: -size[i])[:MOST_WINDOWS]
    chosen += [i for i in others if i not in chosen][: MOST_WINDOWS - len(chosen)]
    chosen.sort(key=lambda i: -size[i])

    def shown(title: str, drive: Descriptors, window: int) -> Window:
        return Window(title, total_counts(reference, drive.take(np.array([window])))[0])

    unit, matches = truth.error_unit, outcome.matches
    every_place = np.arange(len(reference))
    for number, i in enumerate(chosen, 1):
        j, k = int(matches.query[i]), int(matches.place[i])
        windows = [
            shown("query", queries, int(at[i])),
            shown(f"matched: place {k}", reference.places, k),
        ]
        correct = np.flatnonzero(truth.correct[:, j])
        if correct.size:
            off = truth.errors(every_place[correct], np.full(correct.size, j))
            best = int(correct[np.argmin(np.nan_to_num(off, nan=np.inf))])
            windows.append(shown(f"correct: place {best}", reference.places, best))
        caption = f"{number}. At {outcome.time_s[i]:.1f} s"
        if np.isfinite(errors[i]):
            caption += f", {errors[i]:,.0f} {unit} off"
        if np.isfinite(matches.probability[i]):
            caption += f", with probability {matches.probability[i]:.2f}"
        if outcome.precision is not None:
            caption += f" ({'' if outcome.accepted[i] else 'not '}accepted"
            caption += f" at {outcome.precision:g})"
        if not correct.size:
            caption += "; no place of the map is correct"
        yield windows_side_by_side(reference, windows), f"{caption}."


def tolerance_table(evaluations: Mapping[str, Evaluation]) -> tuple[list[str], list[list[str]]]:
    """Return heading and cells of a table of evaluations by their tolerance."""
    number = next(iter(evaluations.values())).recall_at
    head = ["tolerance", "P@100R", "R@99P", *(f"Recall@{n}" for n in number)]
    return head, [
        [name]
        + [f"{one.precision_at_100_recall:.3f}", f"{one.recall_at_99_precision:.3f}"]
        + [f"{share:.3f}" for share in one.recall_at.values()]
        for name, one in evaluations.items()
    ]


def _figures_of(evaluation: Evaluation) -> list[tuple[str, str, str]]:
    matches = evaluation.matches
    ranked = "nearest"
    if matches.settings.matching == "filter" and matches.candidates.shape[1] > 1:
        ranked = "with the filter's least metrics; a match is the middle of those near the least"
    return [
        ("P@100R", f"{evaluation.precision_at_100_recall:.3f}",
         "share of correct matches when every query is matched"),
        ("R@99P", f"{evaluation.recall_at_99_precision:.3f}",
         "largest recall at 99 % precision, with a threshold chosen by this truth; missed queries: "
         f"{MISSED[evaluation.recall_denominator]}"),
        ("average precision", f"{evaluation.average_precision:.3f}",
         "area under the precision-recall curve, as a sum of steps"),
        *((f"Recall@{n}", f"{recall:.3f}", f"a correct place is among the {n} {ranked}")
          for n, recall in evaluation.recall_at.items()),
        *other_figures(evaluation),
    ]  # fmt: skip


def other_figures(evaluation: Evaluation) -> list[tuple[str, str, str]]:
    """Return figures on probabilities, and on which queries were judged."""
    return [
        *_trust_figures(evaluation),
        ("queries", f"{evaluation.queries}", "number of queries evaluated"),
        ("unknown", f"{evaluation.queries_unknown}",
         "matches left out: the window has no position, or the place has none and may be near"),
        ("without a place", f"{evaluation.queries_without_place}",
         "queries evaluated, although no place in the map is correct"),
        ("tied", f"{evaluation.queries_tied}",
         "queries with several places at the least distance; the lowest place counts"),
    ]  # fmt: skip


def _trust_figures(evaluation: Evaluation) -> list[tuple[str, str, str]]:
    """Return figures on probabilities, and on queries that are not on the map."""
    # fmt: off
    rejection, reliability = evaluation.rejection, evaluation.reliability
    named: list[tuple[str, float | int | None, str]] = [
        ("calibration error", reliability.expected_calibration_error if reliability else None,
         "expected: mean gap between probabilities and shares of correct matches"),
    ]
    if rejection.off_map:
        named += [
            ("correct on the map", rejection.right_on_map,
             "share of correct matches among the queries that are on the map"),
            ("found at 99 % precision", rejection.found_at_99_precision,
             "correct matches above the best threshold, as a share of the queries on the map"),
            ("AUROC off the map", rejection.off_map_auroc,
             "how well trust tells queries off the map from those on it; 0.5 is chance"),
        ]
    if rejection.accepted is not None:
        named += [
            ("accepted", rejection.accepted, "matches that are not marked lost"),
            ("precision of the accepted", rejection.precision, "share of correct ones among them"),
            ("recall of the accepted", rejection.recall,
             "correct ones among them, as a share of the queries on the map"),
        ]
    # fmt: on
    return [
        (name, f"{value}" if isinstance(value, int) else f"{value:.3f}", text)
        for name, value, text in named
        if value is not None
    ]
