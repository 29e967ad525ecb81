"""Prediction: the cost of each place and gain one window later, by steps or by a driven distance.

The cost of a step depends on the events of the window and on the gain, or is fixed, or follows from
odometry. All costs are integers with `FRACTION_BITS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.odometry import MOST_MM, check_distance_driven
from edge_vpr.settings import MOST_COST, Settings
from fixedpoint.activity import (
    BANK_COSTS,
    COST_ROW_SHIFT,
    GAINS,
    PLACE_HIGH,
    PLACE_LOW,
    SAME_ROW,
    WEIGHT_BITS,
)

Metrics = npt.NDArray[np.int32]
#: Metrics and costs in sums: these fit into 16 bits, of which a vector holds twice as many.
Narrow = npt.NDArray[np.int16]
#: Distance driven since the window before, in millimetres; None where it is not known.
Travelled = int | None
#: fraction bits of metrics, evidence and costs
FRACTION_BITS = 2
#: largest metric: 7 bits
METRIC_TOP = (1 << 7) - 1
#: metric of a hypothesis that is not in use
UNUSED = 1 << 12
#: cost of a change of gain by half an octave, with fraction bits
GAIN_STEP = 24
#: eighths of the typical distance of a place that are subtracted from its distances
TYPICAL_EIGHTHS = 4
#: places at half windows around the best, of which the match may be the middle
REACH = {1: 0, 2: 4}
#: hypotheses of the gain in memory, a vector; those of `GAINS` or the first are in use
LANES = 8
SAME_GAIN = GAINS.index(0)
_LOWEST_ROW, _HIGHEST_ROW = -SAME_ROW, len(BANK_COSTS[1]) - 1 - SAME_ROW
# rows that a place's hypotheses span: row r of a place is r + 4 for the gain of two octaves less
_GAIN_ROWS = -GAINS[0] >> COST_ROW_SHIFT
_ROW_LOW, _ROW_HIGH = _LOWEST_ROW - _GAIN_ROWS, _HIGHEST_ROW + LANES - 1 - _GAIN_ROWS
#: costs of steps where windows have a fixed count, by the number of places per window
COUNT_COSTS = {1: (1, 0, 0, 1), 2: (1, 0, 0, 0, 0, 1)}


@dataclass(frozen=True)
class TransitionCosts:
    """Costs of steps from place to place in one window.

    Parameters
    ----------
    restart : int
        Cost of jumping to any place: the robot was carried, or the filter is wrong.
    places_per_window : {1, 2}
        Number of places that start in one window of the reference.
    by_activity : bool
        Whether the costs are those of `BANK_COSTS`, by the activity of the window relative to that
        of the place reached, or `COUNT_COSTS`.
    gains : {1, 7}
        Number of hypotheses of the camera's gain.
    """

    restart: int = 16
    places_per_window: int = 1
    by_activity: bool = True
    gains: int = 1

    def __post_init__(self) -> None:
        most = MOST_COST
        if not 0 <= self.restart <= most:
            raise UsageError(f"cost of {self.restart} for a restart: expected 0 to {most}")

    @classmethod
    def of(cls, settings: Settings) -> TransitionCosts:
        """Return the costs of the settings.

        Windows with a fixed number of events all have the same activity.
        """
        by_activity = settings.window == "time"
        return cls(settings.filter_restart, settings.window_parts, by_activity, settings.hypotheses)

    @property
    def by_step(self) -> npt.NDArray[np.uint8]:
        """Costs of a step of 0, 1, 2 ... places, with fraction bits, shape (steps, columns, LANES).

        A column has the rows of `BANK_COSTS` of the hypotheses of a place, see `first_column`: the
        highest first, and both ends repeated; or all alike.
        """
        columns = np.arange(_ROW_HIGH - _ROW_LOW + LANES)
        if self.by_activity:
            highest = _ROW_HIGH + _GAIN_ROWS * (self.gains > 1)
            rows = np.clip(highest - columns, _LOWEST_ROW, _HIGHEST_ROW) + SAME_ROW
            costs = np.array(BANK_COSTS[self.places_per_window], dtype=np.uint8)[rows].T
        else:
            fixed = np.array(COUNT_COSTS[self.places_per_window], dtype=np.uint8) << FRACTION_BITS
            costs = np.repeat(fixed[:, None], columns.size, axis=1)
        of_lanes = np.lib.stride_tricks.sliding_window_view(costs, LANES, axis=1)
        return np.ascontiguousarray(of_lanes)


# Prediction by steps.


class FilterTable(NamedTuple):
    """Constants of the filter, from a map and its settings.

    Attributes
    ----------
    costs : ndarray of int64, shape (steps, columns)
        See `TransitionCosts.by_step`: the LANES bytes of each column in a word.
    gains : ndarray of int64, shape (hypotheses,)
        Gain of each hypothesis, in 1/16 octave.
    restart_cost : int
        Cost of a restart, with fraction bits; `TransitionCosts.restart` is in whole units.
    activity : ndarray of int32, shape (K,)
        Activity of each place, see `place_activity`.
    typical : ndarray of int64, shape (K,)
        See `distances.typical_distances`.
    bias : ndarray of int64, shape (K,)
        See `bias_of`.
    exclusion : int
        The second-best place is more than this many places from the best.
    reach : int
        Places on each side of the best that the match may be the middle of.
    """

    costs: npt.NDArray[np.int64]
    gains: npt.NDArray[np.int64]
    restart_cost: int
    activity: npt.NDArray[np.int32]
    typical: npt.NDArray[np.int64]
    bias: npt.NDArray[np.int64]
    exclusion: int
    reach: int


#: largest bias: a byte
BIAS_TOP = 255


def bias_of(typical: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return what is added to the distances of each place, so that calm places do not win.

    It is half of the typical distance less that of the place with the largest one, with the sign
    turned, since only differences of distances matter.

    Parameters
    ----------
    typical : ndarray of int64, shape (K,)
        See `distances.typical_distances`.

    Returns
    -------
    ndarray of int64, shape (K,)
        0 to 255.
    """
    part = typical * TYPICAL_EIGHTHS >> 3
    return np.minimum(part.max() - part, BIAS_TOP)


@kernel(inner=True)
def change_gains(metric: Narrow, hypotheses: int) -> None:
    """Lower each metric to that of another gain of the same place plus the cost of the change."""
    places = len(metric)
    of_gain = np.empty((hypotheses, places), dtype=np.int16)  # its long loops compile to vectors
    for h in range(hypotheses):
        for k in range(places):
            of_gain[h, k] = metric[k, h]
    for h in range(1, hypotheses):
        for k in range(places):
            of_gain[h, k] = min(of_gain[h, k], np.int16(of_gain[h - 1, k] + GAIN_STEP))
    for h in range(hypotheses - 1, 0, -1):
        for k in range(places):
            of_gain[h - 1, k] = min(of_gain[h - 1, k], np.int16(of_gain[h, k] + GAIN_STEP))
    for h in range(hypotheses):
        for k in range(places):
            metric[k, h] = of_gain[h, k]


@kernel(inner=True)
def subtract_least(metric: Narrow) -> None:
    """Subtract the least metric of all places and hypotheses; unused ones are never lower."""
    flat, least = metric.flat, metric[0, 0]
    for j in range(metric.size):
        least = min(least, flat[j])
    for j in range(metric.size):
        flat[j] -= least


@kernel(inline="always")
def first_column(activity: int, of_place: int) -> int:
    """Return the column of `FilterTable.costs` of a place."""
    row = (activity - of_place + (1 << (COST_ROW_SHIFT - 1))) >> COST_ROW_SHIFT
    return _ROW_HIGH - min(max(row, _ROW_LOW), _ROW_HIGH)


@kernel(inner=True)
def least_of_lanes(metric: Narrow) -> Narrow:
    """Return the least metric of each hypothesis, shape (LANES,)."""
    copy, places = metric.copy(), len(metric)
    least = copy.flat
    while places > 1:  # of two halves: loops over lanes are no vectors
        half = (places + 1) >> 1
        for j in range((places - half) * LANES):
            least[j] = min(least[j], least[half * LANES + j])
        places = half
    return copy[0]


@kernel(inner=True)
def least_of_places(metric: Narrow, least: Metrics) -> None:
    """Write the least metric of each place, shape (K,)."""
    copy = metric.copy()
    of_lanes = copy.flat
    for lanes in (4, 2):
        for j in range(copy.size - lanes):
            of_lanes[j] = min(of_lanes[j], of_lanes[j + lanes])
    for k in range(least.size):
        least[k] = min(of_lanes[LANES * k], of_lanes[LANES * k + 1])


@kernel(inner=True)
def move_on(metric: Narrow, table: FilterTable, activity: int, back: bool, out: Narrow) -> None:
    """Compute the cheapest cost of each place and hypothesis one window later or earlier.

    All sums fit into 16 bits: a metric, its evidence and a cost add up to less than 5,500.

    Parameters
    ----------
    metric : ndarray of int16, shape (K, LANES)
        Cost of each place and hypothesis.
    activity : int
        Activity of the later of the two windows.
    back : bool
        Whether `metric` belongs to the later window, and the costs in the earlier one are computed.
    out : ndarray of int16, shape (K, LANES)
        ``min(min_i (M[k - i] + cost[i]), min_k M + restart_cost)``, with the costs of the place
        that is reached.
    """
    places, size, steps = len(metric), metric.size, min(len(table.costs), len(metric))
    restarted, column = least_of_lanes(metric), np.empty(places, dtype=np.int64)
    for h in range(LANES):
        restarted[h] += table.restart_cost
    # the lanes of a place are copied as words, and sums are in long loops, which are vectors
    from_any, words = restarted.view(np.int64), out.view(np.int64)
    for k in range(places):
        column[k] = first_column(activity, table.activity[k])
        words[k, 0], words[k, 1] = from_any[0], from_any[1]
    cost = np.empty(places, dtype=np.int64)
    before, reached, costs = metric.flat, out.flat, cost.view(np.uint8)
    for i in range(steps):
        for k in range(places):
            cost[k] = table.costs[i, column[k]]
        far = i * LANES
        to, source = (0, far) if back else (far, 0)
        for j in range(size - far):
            moved = np.int16(before[source + j] + costs[far + j])
            reached[to + j] = min(reached[to + j], moved)


@kernel(inline="always")
def predict(metric: Narrow, table: FilterTable, activity: int, out: Narrow) -> None:
    """Compute the cheapest cost of each place and hypothesis one window later; see `move_on`.

    Parameters
    ----------
    metric : ndarray of int16, shape (K, LANES)
        Cost of each place and hypothesis.
    activity : int
        Activity of the later window; very low if the robot stands.
    out : ndarray of int16, shape (K, LANES)
        Predicted costs.
    """
    before = metric.copy()
    subtract_least(before)
    change_gains(before, table.gains.size)
    # not a constant, for which Numba would compile another version
    move_on(before, table, activity, np.bool_(False), out)


# Prediction by a driven distance.


#: fraction bits of the cost of a millimetre
RATE_BITS = 16


@kernel
def predict_by_distance(
    metric: Metrics,
    along: npt.NDArray[np.int64],
    travelled: int,
    rate: int,
    restart_cost: int,
) -> Metrics:
    """Return the cheapest cost of each place after a known driven distance.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    along : ndarray of int64, shape (K,)
        Millimetres that the reference had driven at each place, never decreasing.
    travelled : int
        Millimetres since the window before; negative when driving backwards.
    rate : int
        Cost per millimetre of deviation, in units of ``2**-16``.

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_j (M[j] + |along[k] - along[j] - travelled| * rate), min M + restart_cost)``, less
        ``min M``, rounded down.
    """
    least, places = np.int64(metric.min()), metric.size
    prediction = np.full(places, np.int64(restart_cost) << RATE_BITS, dtype=np.int64)
    # rounding down is monotone: the lowest exact cost, rounded, is the lowest rounded cost
    best, j = np.int64(1) << 62, 0
    for k in range(places):  # sources from which the distance reaches k or a place before it
        while j < places and along[j] + travelled <= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) - (along[j] + travelled) * rate
            best, j = min(best, cost), j + 1
        if j > 0:
            prediction[k] = min(prediction[k], best + along[k] * rate)
    best, j = np.int64(1) << 62, places - 1
    for k in range(places - 1, -1, -1):  # sources from which it reaches a place beyond k
        while j >= 0 and along[j] + travelled >= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) + (along[j] + travelled) * rate
            best, j = min(best, cost), j - 1
        if j < places - 1:
            prediction[k] = min(prediction[k], best - along[k] * rate)
    return (prediction >> RATE_BITS).astype(np.int32)


# The transitions of a map.


#: with odometry, the cost of a deviation by the mean distance of one window
OFF_BY_A_WINDOW = 2


class Transitions:
    """Costs of the transitions between the places of a map in one window.

    Parameters
    ----------
    places : int
        K.
    place_activity : ndarray of int32, shape (K,), optional
        See `place_activity`; 0 by default.
    along_mm : ndarray of int64, shape (K,), optional
        Millimetres that the reference had driven at each place, never decreasing. Odometry of a
        query is compared with it.
    typical : ndarray of int64, shape (K,), optional
        See `distances.typical_distances`; 0 by default.
    exclusion : int
        See `FilterTable`.

    Examples
    --------
    >>> transitions = Transitions(4, TransitionCosts(restart=5, by_activity=False))
    >>> transitions.reaches(0, 3, None), transitions.reaches(3, 0, None)
    (True, False)
    """

    def __init__(
        self,
        places: int,
        costs: TransitionCosts,
        place_activity: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
        typical: npt.NDArray[np.int64] | None = None,
        exclusion: int = 3,
    ) -> None:
        if places < 1:
            raise UsageError(f"a map of {places} places: expected at least 1")
        self.places, self.costs = places, costs
        if along_mm is not None:
            check_distance_driven(along_mm, places)
        if place_activity is None:
            place_activity = np.zeros(places, dtype=np.int32)
        check_activity(place_activity, places)
        if typical is None:
            typical = np.zeros(places, dtype=np.int64)
        gains = np.array(GAINS if costs.gains > 1 else (0,), dtype=np.int64)
        self.table = FilterTable(
            costs.by_step.view(np.int64)[:, :, 0], gains, costs.restart << FRACTION_BITS,
            place_activity, typical, bias_of(typical), exclusion, REACH[costs.places_per_window],
        )  # fmt: skip
        self._along = along_mm
        #: mean distance between two places; 0 if the map has no distances
        self.spacing_mm = self._rate = 0
        if along_mm is not None:
            self.spacing_mm = int(along_mm[-1] - along_mm[0]) // max(places - 1, 1)
            per_window = max(self.spacing_mm, 1) * costs.places_per_window
            self._rate = (OFF_BY_A_WINDOW << FRACTION_BITS << RATE_BITS) // per_window

    def by_distance(self, metric: Metrics, travelled_mm: int, *, back: bool = False) -> Metrics:
        """Return the cost of each place after a driven distance, shape (K,).

        Parameters
        ----------
        metric : ndarray of int32, shape (K,)
            Cost of each place before it; with `back`, after it.
        back : bool
            Return the cost of each place before the distance instead.
        """
        along = self.check_odometry()
        if back:  # the same distance on the route in the opposite direction
            metric, along = np.ascontiguousarray(metric[::-1]), along[-1] - along[::-1]
        predicted = predict_by_distance(
            metric, along, _limited(travelled_mm), self._rate, self.table.restart_cost
        )
        return np.ascontiguousarray(predicted[::-1]) if back else predicted

    def spread(self, metric: npt.NDArray[Any], windows: int, *, back: bool = False) -> None:
        """Lower the cost of each place to the least from which up to so many windows lead to it.

        Parameters
        ----------
        metric : ndarray of int, shape (K,)
            Cost of each place, updated in place.
        windows : int
            Of the map: as many steps to the next place.
        back : bool
            Take the places to which they lead instead.
        """
        for _ in range(min(windows * self.costs.places_per_window, self.places)):
            before = metric.copy()
            if back:
                np.minimum(before[:-1], before[1:], out=metric[:-1])
            else:
                np.minimum(before[1:], before[:-1], out=metric[1:])
            if np.array_equal(metric, before):
                return

    def weight_by_distance(self, driven_mm: int) -> int:
        """Return the largest weight that the evidence of a window may have, see `weight_of`.

        The weight is the driven distance as a share of the reference's mean distance per window,
        rounded up to units of 1/8. Over a short distance, the view repeats that of the window
        before.
        """
        per_window = self.spacing_mm * self.costs.places_per_window
        eighths = -(-abs(_limited(driven_mm) << WEIGHT_BITS) // per_window)
        return min(eighths, 1 << WEIGHT_BITS)

    def following(self, place: int, travelled_mm: int) -> npt.NDArray[np.bool_]:
        """Return which places are reachable over a distance without a restart, shape (K,)."""
        along, travelled = self.check_odometry(), _limited(travelled_mm)
        off = np.abs(along - along[place] - travelled)
        return np.asarray((off * self._rate) >> RATE_BITS < self.table.restart_cost)

    def reaches(self, place: int, next_place: int, travelled_mm: int | None) -> bool:
        """Return whether `next_place` is reachable from `place` without a restart."""
        if travelled_mm is None:
            return 0 <= next_place - place < len(self.table.costs)
        return bool(self.following(place, travelled_mm)[next_place])

    def check_odometry(self) -> npt.NDArray[np.int64]:
        """Return the distance of each place; raise UsageError if the map has none that differ."""
        if self._along is None:
            raise UsageError(
                "the map does not say how far its places are from each other: make it with the "
                "reference drive's odometry= or track="
            )
        if self.spacing_mm < 1:
            raise UsageError(
                "the reference drive of this map did not move by its odometry or track: map a "
                "drive that moves, or match without odometry"
            )
        return self._along


def odometry_of_sequences() -> UsageError:
    """Return the error of odometry that is given for sequences, which do not use it."""
    return UsageError(
        "odometry is for the place filter, and sequences do not use it: match with "
        "matching='filter'"
    )


def check_activity(place_activity: npt.NDArray[np.integer], places: int) -> None:
    """Check that there is an activity of a byte for each place."""
    low, high = (int(place_activity.min()), int(place_activity.max())) if places else (0, 0)
    if place_activity.shape != (places,) or not PLACE_LOW <= low <= high <= PLACE_HIGH:
        raise UsageError(
            f"activities of {low} to {high}, of shape {place_activity.shape}: expected "
            f"{PLACE_LOW} to {PLACE_HIGH}, one of each of {places} places"
        )


def _limited(travelled_mm: int) -> int:
    return min(max(travelled_mm, -MOST_MM), MOST_MM)
