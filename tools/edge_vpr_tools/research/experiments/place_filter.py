"""What the place filter, its code and its measure of trust bring, each on its own.

Parameters were chosen on the real drives and on simulated streets of the seeds 0 to 4 and 30 to 49.
The streets here have other seeds, and light that was not tried before. All rows are evaluated on
the windows that sequences of 10 match.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.descriptors.counting import count_windows
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.map_record import coded_map
from edge_vpr.matching.drive import match_query
from edge_vpr.matching.matches import Matches
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import PRESETS, Score, Settings
from edge_vpr.simulation import QUERY, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr.simulation.drive import wheel_odometry
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments.drives import Pair, recorded_drives
from edge_vpr_tools.research.experiments.experiment import (
    CHOSEN_ON,
    DRIVES,
    Draw,
    Drives,
    Experiment,
    Row,
    Rows,
)
from edge_vpr_tools.research.experiments.nulls import BY_AUTHORS, BY_US, null_rows
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.simulated import truth_of_pair
from edge_vpr_tools.research.experiments.trial import inner_windows

# Settings that the place filter is compared by, and drives of simulated streets.


_FILTER = {"matching": "filter", "anchor": "end", "score": None}
_SMOOTH = {"smooth": True}
_LOG = {"counter_code": "log", "score": None}
_OWN = {**_LOG, "counter_scaling": "own-mean"}
_CONTRAST = {**_LOG, "counter_scaling": "contrast"}
_DRIVE_MEAN = {"query_mean": "own"}
_ROBOT = {**_FILTER, **_CONTRAST, "query_mean": "running"}
PAPER = "sequences of 5, counts (the paper)"
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    PAPER: {"sequence_length": 5},
    "sequences of 5, 3-bit log": {**_LOG, "sequence_length": 5},
    "sequences of 10, 3-bit log": {**_LOG, "sequence_length": 10},
    "sequences of 10, own mean": {**_OWN, "sequence_length": 10},
    "place filter, counts": _FILTER,
    "place filter, 3-bit log": {**_FILTER, **_LOG},
    "place filter, own mean": {**_FILTER, **_OWN, **_DRIVE_MEAN},
    "place filter, contrast": {**_FILTER, **_CONTRAST, **_DRIVE_MEAN},
    "place filter, contrast, steps 1,0,1": {
        **_FILTER,
        **_CONTRAST,
        **_DRIVE_MEAN,
        "filter_steps": (1, 0, 1),
    },
    "place filter, running mean (robot)": _ROBOT,
    "place filter, running mean (robot), 4 windows late": {**_ROBOT, "delay": 4},
    "place filter, contrast, smoothed (default)": {**_FILTER, **_CONTRAST, **_SMOOTH},
}
BEST = "place filter, contrast, smoothed (default)"
ROBOT = "place filter, running mean (robot)"
SCORES: tuple[Score, ...] = ("distance", "ratio", "margin", "trust")
#: windows of the longest sequences
LONGEST = 10


class Second(NamedTuple):
    """A second drive along the street, and the contrast thresholds of its camera as a multiple."""

    drive: Drive
    contrast: float = 1.0


#: as in the demo, in two other lights, with stops, and with a camera that fires sooner or later
STREETS: Mapping[str, Second] = {
    "street": Second(QUERY),
    "street, low sun": Second(
        replace(
            QUERY,
            light=Light(sun=0.2, ambient=0.15, azimuth_deg=110.0, elevation_deg=15.0, glare=0.06),
        )
    ),
    "street, noon": Second(
        replace(
            QUERY,
            light=Light(sun=0.9, ambient=0.2, azimuth_deg=-160.0, elevation_deg=70.0, glare=0.0),
        )
    ),
    "street, 3 stops": Second(replace(QUERY, stops=3, stop_s=10.0)),
    "street, thresholds x 1.3": Second(QUERY, 1.3),
    "street, thresholds x 0.75": Second(QUERY, 0.75),
}


def second_drive(query: SimulatedRecording, name: str, offset: int = 0) -> SimulatedRecording:
    """Simulate the drive of `STREETS` on the street of a query; an offset makes another traffic."""
    drive, contrast = STREETS[name]
    camera = replace(
        query.camera,
        contrast_on=contrast * query.camera.contrast_on,
        contrast_off=contrast * query.camera.contrast_off,
    )
    seed = query.seed + offset
    return SimulatedRecording(query.world, camera, drive, seed=seed, device=query.device).keep()


FIRST_SEED = 10
PIXELS = (25, 150)
_WHEELS = 9  # random stream of the odometers


@dataclass(frozen=True, eq=False)
class Counted:
    """One draw of pixels on one pair of drives: a map of counts, and counts of the query."""

    name: str
    settings: Settings
    reference: ReferenceMap
    queries: Descriptors
    truth: GroundTruth
    odometry: Odometry | None = None

    def coded(self, changes: Mapping[str, Any]) -> ReferenceMap:
        """Return the map with these changes of the pair's settings."""
        return coded_map(self.reference, self.settings.replaced(changes, "variant"))

    def matched(self, changes: Mapping[str, Any], odometry: Odometry | None = None) -> Matches:
        """Match with these changes of the pair's settings."""
        coded = self.coded(changes)
        return match_query(coded, coded.coded(self.queries), odometry)


def counted_pair(pair: Pair, seed: int) -> Counted:
    """Count a recorded pair at one draw of pixels."""
    settings = pair.settings.replaced({"seed": seed}, "seed")
    reference = ReferenceMap.build(pair.reference, settings)
    queries = count_windows(pair.query, reference.pixel_map, settings)
    truth = pair.truth_of(reference.places.centre_us, queries.centre_us)
    return Counted(pair.name, settings, reference, queries, truth)


def counted_street(seed: int, kinds: Sequence[str] = tuple(STREETS)) -> Iterator[Counted]:
    """Simulate one street with some of its drives, and count each at some numbers of pixels."""
    reference, query = simulate_pair(seed)
    reference.keep()
    rng = np.random.default_rng((seed, _WHEELS))
    meter = wheel_odometry(reference.track, rng)
    for name in kinds:
        other = second_drive(query, name)
        wheel = wheel_odometry(other.track, rng)
        for pixels in PIXELS:
            settings = PRESETS["paper"].replaced({"pixels": pixels, "seed": seed}, "street")
            mapped = ReferenceMap.build(reference, settings)
            queries = count_windows(other, mapped.pixel_map, settings)
            truth = truth_of_pair(reference, other)(mapped.places.centre_us, queries.centre_us)
            mapped = replace(mapped, odometer_mm=meter.along(mapped.places.centre_us))
            yield Counted(f"{name}, {pixels} px", settings, mapped, queries, truth, wheel)


def measure(draw: Draw) -> Iterator[Row]:
    """Match with every variant, and with the filter on what shows nothing of the route."""
    counted = [counted_pair(draw.pair, draw.seed)] if isinstance(draw.pair, Pair) else draw.pair
    for each in counted:
        for row in rows_of_variants(each, draw.seed):
            yield {DRIVES: each.name, **row}


def rows_of_variants(counted: Counted, seed: int) -> Iterator[Row]:
    """Yield the rows of one pair of drives."""
    truth = inner_windows(counted.truth, LONGEST)
    tried: list[tuple[str, str, Odometry | None]] = [(name, name, None) for name in VARIANTS]
    if counted.odometry is not None:
        tried += [(f"{name}, odometry", name, counted.odometry) for name in (ROBOT, BEST)]
    for name, variant, odometry in tried:
        matches = counted.matched(VARIANTS[variant], odometry)
        found = evaluate(matches, truth)
        yield {
            "method": name,
            CHOSEN_ON: BY_AUTHORS if variant == PAPER else BY_US,
            "P@100R": found.precision_at_100_recall,
            "R@99P": found.recall_at_99_precision,
            **{
                f"R@99P by {score}": evaluate(matches, truth, score=score).recall_at_99_precision
                for score in SCORES
            },
        }
    for variant, ending in ((ROBOT, ""), (BEST, ", smoothed")):
        rng = np.random.default_rng(seed)
        coded = counted.coded(VARIANTS[variant])
        yield from null_rows(coded, counted.queries, truth, rng, "method", ending)


def drives(data: Path | None) -> list[Drives]:
    """Return the recorded pairs of a folder, and streets that chose no parameter."""
    streets = Drives("streets", lambda seed: counted_street(FIRST_SEED + seed), varied=True)
    return [*recorded_drives(data), streets]


#: pairs of drives in the figure
SHOWN = (
    "Speck indoor, 150 px", "Speck walks, 25 px", "Brisbane, 49 px", "street, 150 px",
    "street, low sun, 150 px", "street, 3 stops, 150 px",
)  # fmt: skip


def figure(rows: Rows) -> Figure:
    """Draw correct matches of every method, on some pairs of drives where there are these."""
    shown = [row for row in rows if row[DRIVES] in SHOWN] or rows
    return dots(shown, measures=("P@100R",), row="method")


EXPERIMENT = Experiment(
    drives=drives,
    names=("method", CHOSEN_ON),
    measure=measure,
    figure=figure,
    view=TableView({}, ("method", "P@100R", "R@99P")),
)
