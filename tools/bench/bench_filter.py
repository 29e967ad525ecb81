"""A recorded drive by the place filter, against sequences of 5 and against NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from table import OURS

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.matching.distances import ReferenceIndex, typical_distances
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.prediction import FRACTION_BITS, METRIC_TOP, bias_of
from edge_vpr.settings import PRESETS, Settings
from fixedpoint.activity import BANK_COSTS, SAME_ROW

PLACES, WINDOWS, J = 641, 724, 150
SMOOTHED = PRESETS["default"]
FILTER = replace(SMOOTHED, smooth=False)
ONE_GAIN = replace(FILTER, gains=1)
SEQUENCES = replace(FILTER, matching="sequence")


def drive(windows, seed):
    """Return windows of codes that change from one to the next, as those of a street."""
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.integers(-1, 2, (windows, J)), axis=0)
    start = np.arange(windows, dtype=np.int64) * 1_000_000
    events = np.full(windows, 1_000, dtype=np.int64)
    codes = (np.abs(steps) % 8).astype(np.uint8)
    # the sums of a robot at the map's speed have much the same codes
    summed = np.stack([codes, codes], axis=1)
    return Descriptors(codes, start, start + 1_000_000, events, events, summed=summed)


def ours(settings: Settings):
    places, queries = drive(PLACES, 1), drive(WINDOWS, 2)
    return lambda: match_descriptors(places, queries, settings).place


def by_numpy():
    """Take the filter's formulas (docs/method.md) as array operations, a window at a time."""
    places, queries = drive(PLACES, 1).counts, drive(WINDOWS, 2).counts
    costs = BANK_COSTS[1][SAME_ROW]  # all windows of these drives have as many events
    bias = bias_of(typical_distances(places))

    def run():
        distances = ReferenceIndex(places).matrix(queries).T + bias
        prediction, reciprocal, best = np.zeros(PLACES, dtype=np.int64), 0, []
        for row in distances:
            own = 2**16 // max(int(np.abs(row - row.sum() // PLACES).sum()) // PLACES, 1)
            scaled = ((row - row.min()) * (reciprocal or own)) >> 14
            metric = np.minimum(prediction + np.minimum(scaled, 255), METRIC_TOP)
            best.append(int(metric.argmin()))
            least, reciprocal = metric.min(), own
            prediction = np.full(PLACES, least + (ONE_GAIN.filter_restart << FRACTION_BITS))
            for step, cost in enumerate(costs):
                moved = prediction[step:]
                np.minimum(moved, metric[: PLACES - step] + cost, out=moved)
            prediction -= least
        return np.array(best)

    return run


def distances_alone():
    places, queries = drive(PLACES, 1).counts, drive(WINDOWS, 2).counts
    return lambda: ReferenceIndex(places).matrix(queries)


@pytest.mark.parametrize(
    ("library", "run", "same_places", "how"),
    [
        (OURS, ours(FILTER), False, {}),
        ("edge-vpr, one gain", ours(ONE_GAIN), True, {}),
        ("NumPy, places alone", by_numpy(), True, {"rounds": 5}),
        ("edge-vpr, smoothed", ours(SMOOTHED), False, {}),
        ("edge-vpr, sequences of 5", ours(SEQUENCES), False, {}),
        ("distances alone", distances_alone(), False, {"limit": True}),
    ],
)
def bench_drive(race, library, run, same_places, how):
    expected = by_numpy()() if same_places else None
    race("a drive of 724 windows by the place filter, 641 places", library, run, expected, **how)
