"""Places at half windows against places at whole ones: what twice the memory is worth.

The costs of half steps were chosen on simulated streets of the seeds 20 to 26 (with the small
sensor). Nothing was chosen on the streets and the walks here. Maps of published windows, as of the
other recorded drives, cannot have places at half windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.evaluation.ground_truth import GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import EventSource, count_windows, match_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import SimulatedRecording, simulate_pair
from edge_vpr.simulation.drive import wheel_odometry
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments import speck_walks
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row, Rows
from edge_vpr_tools.research.experiments.place_filter import STREETS
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.trial import Times

LENGTH_M, TOLERANCES_M = 450.0, (10.0, 20.0)
FIRST_SEED = 70
PIXELS = (25, 150)
PRECISION = 0.99
_NUMBER = "places per window"
_WHEELS = 9  # random stream of the odometers
LIGHTS: Mapping[str, str] = {
    "in other light": "street",
    "with 3 stops": "street, 3 stops",
    "in low sun": "street, low sun",
    "at noon": "street, noon",
}
MATCHED: Mapping[str, Mapping[str, Any]] = {
    "live": {"smooth": False, "query_mean": "running"},
    "4 windows late": {"smooth": False, "query_mean": "running", "delay": 4},
    "recorded": {},
}


class Query(NamedTuple):
    """One drive to match: its truths from the nearest tolerance on, and its odometry, if any."""

    name: str
    recording: EventSource
    truths: Mapping[str, Any]
    odometry: Odometry | None = None


class Route(NamedTuple):
    """The drive that a map is made of, and the drives that are matched with it."""

    reference: EventSource
    queries: tuple[Query, ...]
    odometry: Odometry | None = None


def open_street(seed: int) -> Route:
    """Simulate the drives of one street, with odometers on their wheels."""
    reference, query = simulate_pair(FIRST_SEED + seed, length_m=LENGTH_M)
    rng = np.random.default_rng((FIRST_SEED + seed, _WHEELS))
    meter = wheel_odometry(reference.track, rng)
    queries = []
    for light, name in LIGHTS.items():
        driven = SimulatedRecording(
            query.world, query.camera, STREETS[name].drive, seed=query.seed, device=query.device
        ).keep()
        truths = {
            f"{metres:g} m": partial(from_tracks, reference.track, driven.track, tolerance_m=metres)
            for metres in TOLERANCES_M
        }
        queries.append(Query(light, driven, truths, wheel_odometry(driven.track, rng)))
    return Route(reference.keep(), tuple(queries), meter)


def open_walks(folder: Path, seed: int) -> Route:
    """Read the walks; their truth is known to a second, so that one tolerance serves for both."""
    reference, query, truth_of = speck_walks.open_pair(folder, seed)
    return Route(reference, (Query("as recorded", query, {"2 s": truth_of}),))


def measure(draw: Draw) -> Iterator[Row]:
    """Match in every way with both maps."""
    route: Route = draw.pair
    for pixels in PIXELS:
        settings = PRESETS["default"].replaced({"pixels": pixels, "seed": draw.seed}, "half")
        whole = ReferenceMap.build(route.reference, settings)
        half = ReferenceMap.build(
            route.reference, settings, pixel_map=whole.pixel_map, places_per_window=2
        )
        for query in route.queries:
            counted = count_windows(query.recording, whole.pixel_map, settings)
            for number, mapped in ((1, whole), (2, half)):
                truths = _truths(query, mapped.places.centre_us, counted.centre_us)
                metred = mapped
                if route.odometry is not None:
                    way = route.odometry.along(mapped.places.centre_us)
                    metred = replace(mapped, odometer_mm=way)
                for odometry in (None, query.odometry)[: 1 + (query.odometry is not None)]:
                    for matched, changes in MATCHED.items():
                        asked = metred.matched_with(settings.replaced(
                            {**changes, "places_per_window": number}, matched
                        ))  # fmt: skip
                        found = match_query(asked, asked.coded(counted), odometry)
                        yield {
                            "pixels": pixels,
                            "query": query.name,
                            "odometry": "wheels" if odometry is not None else "none",
                            "matched": matched,
                            _NUMBER: number,
                            **_judged(asked, found, truths),
                        }


def _truths(query: Query, places_us: Times, queries_us: Times) -> dict[str, GroundTruth]:
    return {name: truth_of(places_us, queries_us) for name, truth_of in query.truths.items()}


def _judged(asked: ReferenceMap, found: Matches, truths: Mapping[str, GroundTruth]) -> Row:
    """Return the figures of one drive; those of probabilities, and "wide", at the last truth."""
    judged = [evaluate(found, truth) for truth in truths.values()]
    near, far = judged[0], judged[-1]
    confidence = asked.acceptance.confidence
    assert confidence is not None and far.reliability is not None
    known = far.evaluated
    accepted = known & (found.trust >= confidence.least_trust(PRECISION))
    return {
        "P@100R": near.precision_at_100_recall,
        "P@100R (wide)": far.precision_at_100_recall,
        "R@99P (wide)": far.recall_at_99_precision,
        "mean probability": float(found.probability[known].mean()),
        "calibration error": far.reliability.expected_calibration_error,
        "windows": int(known.sum()),
        "accepted at 0.99": int(accepted.sum()),
        "accepted and correct": int((accepted & far.correct).sum()),
        "places": len(asked),
        "bytes of the places": len(asked) * (asked.packed_bytes_per_place + 1),
        "differences per window": asked.places.counts.size,
    }


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the walks of a folder."""
    found = [Drives(f"streets of {LENGTH_M:g} m", open_street, varied=True)]
    if data is not None and (data / speck_walks.FOLDER).is_dir():
        folder = data / speck_walks.FOLDER
        found.append(Drives("Speck walks", partial(open_walks, folder), [folder]))
    return found


def figure(rows: Rows) -> Figure:
    """Draw correct matches without odometry."""
    shown = [
        {**row, "drives": f"{row['drives']}, {row['pixels']} px", _NUMBER: f"{row[_NUMBER]}"}
        for row in rows
        if row["odometry"] == "none"
    ]
    return dots(shown, measures=("P@100R", "R@99P (wide)"), row="matched", series=_NUMBER)


EXPERIMENT = Experiment(
    drives=drives,
    names=("pixels", "query", "odometry", "matched", _NUMBER),
    measure=measure,
    figure=figure,
    view=TableView({"matched": "live", "odometry": "none"}, ("pixels", "query", "P@100R"), _NUMBER),
)
