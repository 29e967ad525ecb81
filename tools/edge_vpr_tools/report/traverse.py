"""The report of a matched drive: its figures as files, and one page with all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr import results
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import Evaluation
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.sequences import sequence_sums
from edge_vpr.reference_map import ReferenceMap, read_queries
from edge_vpr.results import read_json
from edge_vpr.route import Route
from edge_vpr_tools.report import figures
from edge_vpr_tools.report.page import MISSED, Page, add_run
from edge_vpr_tools.report.style import Scale, along_route, drawn, save, seconds

#: a picture shows no more cells than this on a side
_SIDE = 1500
ONLINE_FIGURE = "online"


def write_report(
    folder: Path,
    truth: GroundTruth | None = None,
    found: Evaluation | None = None,
    formats: Sequence[str] = ("png",),
    route: Route | None = None,
) -> None:
    """Draw the figures of a results folder and write its page.

    Parameters
    ----------
    folder : path
        With a map, queries, matches and the run's record.
    truth, found : GroundTruth and Evaluation, optional
        After an evaluation: matches are shown right or wrong.
    formats : sequence of str
        Of `report.formats.FORMATS`: each figure is written in each. The page has its own.
    route : Route, optional
        Positions of the places, for an axis in metres; without it, those that the map holds.
    """
    reference = ReferenceMap.load(folder / results.MAP)
    matches = Matches.load(folder / results.MATCHES)
    queries = read_queries(folder)
    route = reference.route if route is None else route
    page = Page("edge-vpr: matches of a drive")

    def add(name: str, drawing: Figure, caption: str) -> None:
        saved = save(drawing, *(folder / f"{name}.{kind}" for kind in formats))
        page.picture(saved.get("png") or drawn(drawing, "png"), caption)

    settings = matches.settings
    page.text(
        f"{len(matches)} query windows matched against {len(reference)} places, "
        f"{len(reference.pixel_map)} of {reference.pixel_map.sensor.pixels:,} pixels, "
        f"{reference.bytes_per_place} bytes a place ({reference.packed_bytes_per_place} packed), "
        + (
            "by the place filter."
            if settings.matching == "filter"
            else f"sequences of {settings.sequence_length}."
        )
    )
    if found is not None and truth is not None:
        page.heading("How many are right")
        page.text(f"Ground truth: {truth.description}.")
        page.table(("figure", "value", "what it says"), _figures_of(found))
        add("precision_recall", figures.precision_recall(
            {f"{len(reference.pixel_map)} pixels, {settings.strategy}": found}
        ), "Precision against recall, one step for each threshold.")  # fmt: skip
        certain = found.reliability
        if certain is not None:
            add("reliability", figures.reliability_diagram({"": certain}),
                 "Above the line, matches are right more often than their probability; below, less."
                 )  # fmt: skip
    page.heading("Matches")
    if queries is None:
        add(ONLINE_FIGURE, figures.online_places(matches, along_route(reference, route)),
             "A drive that is recognised makes a line; trusted matches are dark.")  # fmt: skip
    else:
        scales = seconds(queries.centre_us, "query"), along_route(reference, route)
        _add_queries(page, add, reference, queries, matches, truth, found, scales)
    add_run(page, read_json(folder / results.RUN, "match again"))
    page.write(folder / results.REPORT)


def write_online_figure(
    folder: Path, reference: ReferenceMap, matches: Matches, formats: Sequence[str]
) -> None:
    """Draw the matches that a localiser gave, as ``online.png`` or in other formats.

    Parameters
    ----------
    folder : path
    reference : ReferenceMap
    matches : Matches
    formats : sequence of str
        Of `report.formats.FORMATS`.
    """
    drawing = figures.online_places(matches, along_route(reference, reference.route))
    save(drawing, *(folder / f"{ONLINE_FIGURE}.{kind}" for kind in formats))


def _add_queries(
    page: Page,
    add: Callable[[str, Figure, str], None],
    reference: ReferenceMap,
    queries: Descriptors,
    matches: Matches,
    truth: GroundTruth | None,
    found: Evaluation | None,
    scales: tuple[Scale, Scale],
) -> None:
    """Draw the figures that need the query's descriptors; `scales` are of queries and places."""
    drives = [
        (name, reference.decoded(drive))
        for name, drive in (("reference", reference.places), ("query", queries))
    ]
    distances, stride = shown_distances(reference.places, queries, matches)
    add("distance_matrix", figures.distance_matrix(
        distances, stride, matches, truth, found, *scales
    ), "Dark is near. A drive that is recognised makes a dark line.")  # fmt: skip
    page.heading("Pixels")
    add("pixels", figures.selected_pixels(reference),
         "Where the sensor sees change that differs from place to place.")  # fmt: skip
    page.heading("Events and windows")
    add("event_rate", figures.event_rate(drives),
         "The selected pixels follow the whole sensor, at a fraction of the events."
         + (" Their events are estimated from codes." if reference.is_coded else ""))  # fmt: skip
    lengths = (
        "A window of a fixed number of events is short where much moves."
        if reference.settings.window == "count"
        else "Windows of a fixed time are equally long."
    )
    add("window_lengths", figures.window_lengths(drives), lengths)


def _figures_of(found: Evaluation) -> list[tuple[str, str, str]]:
    return [
        ("P@100R", f"{found.precision_at_100_recall:.3f}",
         "share of right matches when every query is matched"),
        ("R@99P", f"{found.recall_at_99_precision:.3f}",
         f"largest recall at 99 % precision; missed queries: {MISSED[found.recall_denominator]}"),
        ("average precision", f"{found.curve.average_precision:.3f}",
         "area under the precision-recall curve, as a sum of steps"),
        *((f"Recall@{n}", f"{recall:.3f}", f"a right place is among the {n} nearest")
          for n, recall in found.recall_at.items()),
        *_trust_figures(found),
        ("queries", f"{found.queries}", "number of queries evaluated"),
        ("unknown", f"{found.queries_unknown}", "queries left out, since their truth is not known"),
        ("without a place", f"{found.queries_without_place}",
         "queries evaluated, although no place in the map is right"),
        ("tied", f"{found.queries_tied}",
         "queries with several places at the least distance; the lowest place counts"),
    ]  # fmt: skip


def _trust_figures(found: Evaluation) -> list[tuple[str, str, str]]:
    """Return figures on probabilities, and on queries that are not on the map."""
    rejection = found.rejection
    named: list[tuple[str, float | int | None, str]] = []
    if found.reliability is not None:
        named.append(
            (
                "calibration error",
                found.reliability.expected_calibration_error,
                "expected: mean gap between probabilities and shares of right matches",
            )
        )
    if rejection.off_map:
        named += [
            (
                "right on the map",
                rejection.right_on_map,
                "share of right matches among the queries that are on the map",
            ),
            (
                "found at 99 % precision",
                rejection.found_at_99_precision,
                "right matches above the best threshold, as a share of the queries on the map",
            ),
            (
                "AUROC off the map",
                rejection.off_map_auroc,
                "how surely a query off the map has less trust than one on it; 0.5 is chance",
            ),
        ]
    if rejection.accepted is not None:
        named += [
            ("accepted", rejection.accepted, "matches that are not marked lost"),
            ("precision of the accepted", rejection.precision, "share of right ones among them"),
            (
                "recall of the accepted",
                rejection.recall,
                "right ones among them, as a share of the queries on the map",
            ),
        ]
    return [
        (name, f"{value}" if isinstance(value, int) else f"{value:.3f}", text)
        for name, value, text in named
        if value is not None
    ]  # fmt: skip


def shown_distances(
    places: Descriptors, queries: Descriptors, matches: Matches
) -> tuple[npt.NDArray[np.float64], int]:
    """Compute D_seq at every stride-th place and query, so that a long drive fits a picture.

    Returns
    -------
    distances : ndarray of float64, shape (rows, columns)
    stride : int
    """
    length = matches.settings.windows_per_match
    stride = 1 + max(len(places), len(queries)) // _SIDE
    index = ReferenceIndex(places.counts)
    columns = [
        sequence_sums(index.matrix(queries.counts[j : j + length]), length)[::stride]
        for j in range(0, len(matches), stride)
    ]
    return np.concatenate(columns, axis=1) / length, stride
