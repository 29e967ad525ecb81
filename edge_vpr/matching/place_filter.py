"""The place filter: Viterbi's algorithm over the places of a route, in fixed-width integers.

It is the min-plus form of a discrete Bayes filter. Each place has one metric: the cost of the
cheapest path that ends there in the current window. In each window, the prediction adds the cost of
the step from place to place, and the update adds the evidence of the distances. The cost of a step
depends on the activity of the window, or is fixed, or follows from odometry; jumps of the map
connect places like steps. Smoothing adds the costs of a backward pass from later windows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, plain
from edge_vpr.confidence import TRUST_TOP
from edge_vpr.descriptors.windows import (
    Descriptors,
    activity_of,
    activity_of_drive,
    is_pause,
    mean_activity_after,
    place_activity,
)
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import typical_distances
from edge_vpr.route import MOST_MM
from edge_vpr.settings import Settings
from fixedpoint.activity import (
    COSTS_BY_ACTIVITY,
    LOG_TOP,
    PLACE_HIGH,
    PLACE_LOW,
    ROW_BITS,
    SAME_ROW,
    WEIGHT_BITS,
    WEIGHT_FROM,
)

Metrics = npt.NDArray[np.int32]
#: Metrics and costs in sums: these fit into 16 bits, of which a vector holds twice as many.
Narrow = npt.NDArray[np.int16]

#: fraction bits of metrics, evidence and costs
FRACTION_BITS = 2
#: largest metric: 10 bits
METRIC_TOP = (1 << 10) - 1
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
        Whether the costs are those of `COSTS_BY_ACTIVITY`, by the activity of the window relative
        to that of the place reached, or `COUNT_COSTS`.
    """

    restart: int = 16
    places_per_window: int = 1
    by_activity: bool = True

    def __post_init__(self) -> None:
        most = (METRIC_TOP >> FRACTION_BITS) - 1
        if not 0 <= self.restart <= most:
            raise UsageError(f"cost of {self.restart} for a restart: expected 0 to {most}")

    @classmethod
    def of(cls, settings: Settings) -> TransitionCosts:
        """Return the costs of the settings.

        Windows with a fixed number of events all have the same activity.
        """
        return cls(settings.filter_restart, settings.window_parts, settings.window == "time")

    @property
    def rows(self) -> npt.NDArray[np.int32]:
        """Costs of a step of 0, 1, 2 ... places, with fraction bits.

        One row for each row of `COSTS_BY_ACTIVITY`, or a single row for any activity.
        """
        if self.by_activity:
            return np.array(COSTS_BY_ACTIVITY[self.places_per_window], dtype=np.int32)
        fixed = [COUNT_COSTS[self.places_per_window]]
        return np.array(fixed, dtype=np.int32) << FRACTION_BITS


# Prediction: the cost of each place one window later, by steps or by a known distance.


#: fraction bits of the cost of a millimetre
RATE_BITS = 16
#: with odometry, a step over a jump may start and end up to this many places from it
JUMP_REACH = 8


class FilterTable(NamedTuple):
    """Constants of the filter, from a map and its settings.

    Attributes
    ----------
    costs : ndarray of int32, shape (rows, steps)
        See `TransitionCosts.rows`.
    restart : int
        Cost of a restart, with fraction bits.
    jumps : ndarray of int32, shape (n, 2)
        Pairs of places, from and to, that follow each other without a step.
    activity : ndarray of int32, shape (K,)
        Activity of each place, see `place_activity`.
    typical : ndarray of int64, shape (K,)
        See `distances.typical_distances`.
    exclusion : int
        The second-best place is more than this many places from the best.
    """

    costs: Metrics
    restart: int
    jumps: npt.NDArray[np.int32]
    activity: npt.NDArray[np.int32]
    typical: npt.NDArray[np.int64]
    exclusion: int


@kernel(inner=True)
def is_reachable(place: int, next_place: int, last: int, jumps: npt.NDArray[np.int32]) -> bool:
    """Return whether a step of at most `last` places, possibly over a jump, reaches a place."""
    if 0 <= next_place - place <= last:
        return True
    for n in range(len(jumps)):
        before, beyond = jumps[n, 0] - place, next_place - jumps[n, 1]
        if before >= 0 and beyond >= 0 and before + beyond < last:
            return True
    return False


@kernel(inner=True)
def write_costs(table: FilterTable, activity: int, out: Narrow) -> None:
    """Compute the cost of each step to each place in a window.

    Parameters
    ----------
    activity : int
        Activity of the window, see `activity_of`.
    out : ndarray of int16, shape (steps, K)
        Costs, by the length of the step and the place reached.
    """
    places, last_row = out.shape[1], len(table.costs) - 1
    rows = np.empty(places if last_row > 0 else 0, dtype=np.int16)
    for k in range(rows.size):
        row = (activity - table.activity[k] + (1 << (ROW_BITS - 1))) >> ROW_BITS
        rows[k] = min(max(row + SAME_ROW, 0), last_row)
    for i in range(out.shape[0]):
        of_row, of_step = table.costs[:, i], out[i]
        if last_row > 0:
            for k in range(places):
                of_step[k] = of_row[rows[k]]
        else:
            cost = np.int16(of_row[0])
            for k in range(places):
                of_step[k] = cost


@kernel(inner=True)
def move(metric: Narrow, table: FilterTable, costs: Narrow, back: bool, out: Narrow) -> None:
    """Compute the cheapest cost of each place one window later or earlier.

    All sums fit into 16 bits: a metric, its evidence and a cost add up to less than 2,500.

    Parameters
    ----------
    metric : ndarray of int16, shape (K,)
        Cost of each place.
    costs : ndarray of int16, shape (steps, K)
        Result of `write_costs` for the later of the two windows.
    back : bool
        Whether `metric` belongs to the later window, and the costs in the earlier one are computed.
    out : ndarray of int16, shape (K,)
        ``min(min_i (M[k - i] + cost[i]), min M + restart) - min M``. Over a jump from a to b, place
        k = b + o is i places from a - (i - 1 - o). The costs are those of the place reached.
    """
    places = metric.size
    least = metric[0]
    for k in range(places):
        least = min(least, metric[k])
    restarted = np.int16(least + table.restart)
    for k in range(places):
        out[k] = restarted
    for i in range(costs.shape[0]):
        number, reached = max(places - i, 0), min(i, places)
        found, source = (0, reached) if back else (reached, 0)
        # loops from 0 over slices compile to vector instructions
        cost = costs[i, reached : reached + number]
        reached_by, start = out[found : found + number], metric[source : source + number]
        for k in range(number):
            reached_by[k] = min(reached_by[k], np.int16(start[k] + cost[k]))
        for j in range(len(table.jumps)):
            for over in range(i):
                begin, end = table.jumps[j, 0] - (i - 1 - over), table.jumps[j, 1] + over
                if begin >= 0 and end < places:
                    to, other = (begin, end) if back else (end, begin)
                    jumped = np.int16(metric[other] + costs[i, end])
                    out[to] = min(out[to], jumped)
    for k in range(places):
        out[k] -= least


@kernel(inline="always")
def predict(metric: Metrics, table: FilterTable, activity: int, out: Narrow) -> None:
    """Compute the cheapest cost of each place one window later; see `move`.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    activity : int
        Activity of the later window, see `activity_of`.
    out : ndarray of int16, shape (K,)
        Predicted costs.
    """
    before = np.empty(metric.size, dtype=np.int16)
    for k in range(metric.size):
        before[k] = metric[k]
    costs = np.empty((table.costs.shape[1], metric.size), dtype=np.int16)
    write_costs(table, activity, costs)
    # not a constant, for which Numba would compile another version
    move(before, table, costs, np.bool_(False), out)


@kernel
def predict_by_distance(
    metric: Metrics,
    along: npt.NDArray[np.int64],
    travelled: int,
    rate_and_spacing: tuple[int, int],
    restart: int,
    jumps: npt.NDArray[np.int32],
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
    rate_and_spacing : tuple of int
        Cost per millimetre of deviation in units of ``2**-16``, and millimetres between two places.
    jumps : ndarray of int32, shape (n, 2)
        Pairs of places, from and to, that follow each other without a step.

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_j (M[j] + |along[k] - along[j] - travelled| * rate), min M + restart) - min M``,
        rounded down. A jump has the length of one mean spacing.
    """
    rate, spacing = rate_and_spacing
    least, places = np.int64(metric.min()), metric.size
    prediction = np.full(places, np.int64(restart) << RATE_BITS, dtype=np.int64)
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
    for n in range(len(jumps)):
        begin, end = jumps[n, 0], jumps[n, 1]
        for source in range(max(begin - JUMP_REACH + 1, 0), begin + 1):
            for k in range(end, min(end + JUMP_REACH, places)):
                length = along[begin] - along[source] + spacing + along[k] - along[end]
                cost = ((metric[source] - least) << RATE_BITS) + abs(length - travelled) * rate
                prediction[k] = min(prediction[k], cost)
    return (prediction >> RATE_BITS).astype(np.int32)


#: with odometry, the cost of a deviation by the mean distance of one window
OFF_BY_A_WINDOW = 2
_NO_JUMPS = np.zeros((0, 2), dtype=np.int32)


class Transitions:
    """Costs of the transitions between the places of a map in one window.

    Parameters
    ----------
    places : int
        K.
    place_activity : ndarray of int32, shape (K,), optional
        See `place_activity`; 0 by default.
    jumps : ndarray of int32, shape (n, 2), optional
        Pairs of places: one step also leads from the first to the second, for example where a loop
        closes or two routes meet. Longer steps may cross the pair.
    along_mm : ndarray of int64, shape (K,), optional
        Millimetres that the reference had driven at each place, never decreasing. Odometry of a
        query is compared with it.
    typical : ndarray of int64, shape (K,), optional
        See `distances.typical_distances`; 0 by default.
    exclusion : int
        See `FilterTable`.

    Examples
    --------
    >>> costs = TransitionCosts(restart=5, by_activity=False)
    >>> jumps = np.array([[3, 0]], dtype=np.int32)
    >>> transitions, prediction = Transitions(4, costs, jumps=jumps), np.empty(4, dtype=np.int16)
    >>> metric = np.array([9, 9, 9, 0], dtype=np.int32)  # at the end, with a jump to the start
    >>> predict(metric, transitions.table, 0, prediction)
    >>> prediction.tolist()
    [0, 0, 4, 4]
    """

    def __init__(
        self,
        places: int,
        costs: TransitionCosts,
        place_activity: npt.NDArray[np.int32] | None = None,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
        typical: npt.NDArray[np.int64] | None = None,
        exclusion: int = 3,
    ) -> None:
        if places < 1:
            raise UsageError(f"a map of {places} places: expected at least 1")
        self.places, self.costs = places, costs
        self.jumps = _NO_JUMPS if jumps is None else np.asarray(jumps, dtype=np.int32)
        check_jumps(self.jumps, places)
        if place_activity is None:
            place_activity = np.zeros(places, dtype=np.int32)
        check_activity(place_activity, places)
        if typical is None:
            typical = np.zeros(places, dtype=np.int64)
        self.table = FilterTable(
            costs.rows, costs.restart << FRACTION_BITS, self.jumps, place_activity, typical,
            exclusion,
        )  # fmt: skip
        self._along = along_mm
        #: mean distance between two places; 0 if the map has no distances
        self.spacing_mm = self._rate = 0
        if along_mm is not None:
            check_along(along_mm, places)
            self.spacing_mm = int(along_mm[-1] - along_mm[0]) // max(places - 1, 1)
            per_window = max(self.spacing_mm, 1) * costs.places_per_window
            self._rate = (OFF_BY_A_WINDOW << FRACTION_BITS << RATE_BITS) // per_window

    def check_odometry(self) -> None:
        """Raise UsageError if the map has no distances between its places."""
        self._checked_along()

    def by_distance(self, metric: Metrics, travelled_mm: int, *, back: bool = False) -> Metrics:
        """Return the cost of each place after a driven distance, shape (K,).

        Parameters
        ----------
        metric : ndarray of int32, shape (K,)
            Cost of each place before it; with `back`, after it.
        back : bool
            Return the cost of each place before the distance instead.
        """
        along, jumps = self._checked_along(), self.jumps
        if back:  # the same distance on the route in the opposite direction
            metric, along = np.ascontiguousarray(metric[::-1]), along[-1] - along[::-1]
            jumps = self.places - 1 - jumps[:, ::-1]
        found = predict_by_distance(
            metric, along, _limited(travelled_mm), (self._rate, self.spacing_mm),
            self.table.restart, jumps,
        )  # fmt: skip
        return np.ascontiguousarray(found[::-1]) if back else found

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
        along, travelled = self._checked_along(), _limited(travelled_mm)
        off = np.abs(along - along[place] - travelled)
        follows = (off * self._rate) >> RATE_BITS < self.table.restart
        before = self.jumps[:, 0] - place
        for begin, end in self.jumps[(before >= 0) & (before < JUMP_REACH)].tolist():
            beyond = slice(end, end + JUMP_REACH)
            length = along[begin] - along[place] + self.spacing_mm + along[beyond] - along[end]
            cost = (np.abs(length - travelled) * self._rate) >> RATE_BITS
            follows[beyond] |= cost < self.table.restart
        return np.asarray(follows)

    def reaches(self, place: int, next_place: int, travelled_mm: int | None) -> bool:
        """Return whether `next_place` is reachable from `place` without a restart."""
        table = self.table
        if travelled_mm is None:
            last = table.costs.shape[1] - 1
            return bool(plain(is_reachable)(place, next_place, last, table.jumps))
        return bool(self.following(place, travelled_mm)[next_place])

    def _checked_along(self) -> npt.NDArray[np.int64]:
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


def check_no_transitions(jumps: npt.NDArray[np.int32] | None, odometry: bool) -> None:
    """Raise UsageError if jumps or odometry are given, which sequences do not use.

    Parameters
    ----------
    jumps : ndarray of int32, shape (n, 2), optional
        None if there are none.
    odometry : bool
        Whether it is given.
    """
    given = "odometry" if odometry else "a map with jumps"
    if odometry or (jumps is not None and len(jumps)):
        raise UsageError(
            f"{given} is for the place filter, and sequences follow neither: match with "
            "matching='filter'"
        )


def check_jumps(jumps: npt.NDArray[np.integer], places: int) -> None:
    """Check that every jump leads from a place of the map to another one."""
    for begin, end in jumps.tolist():
        if not (0 <= begin < places and 0 <= end < places) or begin == end:
            raise UsageError(
                f"jump from place {begin} to {end}: expected two places from 0 to {places - 1}"
            )


def check_activity(place_activity: npt.NDArray[np.integer], places: int) -> None:
    """Check that there is an activity of a byte for each place."""
    low, high = (int(place_activity.min()), int(place_activity.max())) if places else (0, 0)
    if place_activity.shape != (places,) or not PLACE_LOW <= low <= high <= PLACE_HIGH:
        raise UsageError(
            f"activities of {low} to {high}, of shape {place_activity.shape}: expected "
            f"{PLACE_LOW} to {PLACE_HIGH}, one of each of {places} places"
        )


def check_along(along_mm: npt.NDArray[np.int64], places: int) -> None:
    """Check that there is a distance driven for each place, which never decreases."""
    if along_mm.shape != (places,) or (np.diff(along_mm) < 0).any():
        raise UsageError(
            f"distances to {along_mm.shape} places: expected one for each of {places} places, in "
            "millimetres, that never decrease"
        )
    if not 0 <= along_mm[0] <= along_mm[-1] <= MOST_MM:
        raise UsageError(
            f"distances of {along_mm[0]} to {along_mm[-1]} mm: expected 0 to {MOST_MM}"
        )


def _limited(travelled_mm: int) -> int:
    return min(max(travelled_mm, -MOST_MM), MOST_MM)


# Update: the evidence of a window, the best places, and the trust in the match.


#: largest evidence: 8 bits
EVIDENCE_TOP = (1 << 8) - 1
#: fraction bits of the reciprocal of the spread
RECIPROCAL_BITS = 16
#: shift of the product of this reciprocal and a weight that leaves the fraction bits of evidence
FACTOR_SHIFT = RECIPROCAL_BITS - FRACTION_BITS + WEIGHT_BITS
#: support, in units of 1/16 of a margin, moves by 1/4 of the difference in each window
TRUST_SHIFT, TRUST_BITS = 2, 4
#: while the place stays the same, support falls by 1/16 in each window
STANDING_SHIFT = 4
#: margins and residuals are capped at 23, which bounds the influence of one window
MARGIN_TOP = RESIDUAL_TOP = TRUST_TOP >> TRUST_BITS


@kernel(inline="always")
def support_after(kept: int, stands: bool, margin: int) -> int:
    """Return the support of a match after a window: a running mean of the margins.

    At a standstill, further windows of the same view add no information: the support decays by 1/16
    in each window.

    Parameters
    ----------
    kept : int
        Support of the window before; 0 if this place is not reachable from that of the window
        before.
    stands : bool
        Whether the place is the same as in the window before.
    margin : int
        Second metric less the least.

    Returns
    -------
    int
        0 to `TRUST_TOP`, in units of 1/16 of a metric.
    """
    before, capped = np.int64(kept), np.int64(min(margin, MARGIN_TOP))
    raised = before + (((capped << TRUST_BITS) - before) >> TRUST_SHIFT)
    if stands:
        raised = min(raised, before - (before >> STANDING_SHIFT))
    return int(raised)


@kernel(inline="always")
def trust_of(support: int, residual: int) -> int:
    """Return the trust in a match: its support less the residual of the matched place.

    A path that has become wrong keeps the support of earlier windows for a while, but its places no
    longer fit the view.

    Parameters
    ----------
    support : int
        See `support_after`.
    residual : int
        Largest `residual_of` of this window and the two before it.

    Returns
    -------
    int
        0 to `TRUST_TOP`.
    """
    return max(int(support) - (int(residual) << TRUST_BITS), 0)


@kernel(inline="always")
def residual_of(evidence: int) -> int:
    """Return the residual of a window: the evidence against the matched place, up to 23."""
    return min(int(evidence), RESIDUAL_TOP)


#: the running misfit moves by 1/16 of the difference in each window, and has 4 more fraction bits
RUNNING_SHIFT, MISFIT_BITS = 4, 4
#: Initial running misfit, which is reported as 0. Windows of drives along the map in the same light
#: are lower on average.
MISFIT_ZERO = -80
#: number of windows before and after a match over which smoothing averages the misfit
MISFIT_NEIGHBOURS = 16


@kernel
def window_misfit(
    evidence: npt.NDArray[np.uint8],
    place: int,
    typical: npt.NDArray[np.int64],
    factor: int,
    share: int,
) -> int:
    """Return how badly a window fits the matched place, relative to all places.

    Some place of the map is nearest to any view, even off the map or in another light. The path
    cannot follow these nearest places, and so the matched place is then as far from the view as
    any other.

    Parameters
    ----------
    evidence : ndarray of uint8, shape (K,)
        Evidence of the window.
    typical : ndarray of int64, shape (K,)
        Subtracted, since places without contrast are nearer to any view.
    factor, share : int
        See `WindowRows`. The result is divided by the share, because a short driven distance lowers
        the weight of the evidence but not how well the view fits.

    Returns
    -------
    int
        Evidence against the place less its advantage over the mean of all places, each divided by
        the share and limited to 23: -23 to 46.
    """
    total = np.int64(0)
    for k in range(evidence.size):
        total += np.int64(evidence[k])
    nearer = (np.int64(typical[place]) * factor) >> FACTOR_SHIFT
    against, whole = np.int64(evidence[place]), max(share, 1)
    advantage = int((total // evidence.size - against + nearer) << WEIGHT_BITS) // whole
    residual = residual_of((against << WEIGHT_BITS) // whole)
    return residual - min(max(advantage, -RESIDUAL_TOP), RESIDUAL_TOP)


@kernel(inline="always")
def update_misfit(before: int, misfit: int, factor: int) -> int:
    """Return the running mean of `window_misfit` after a window, in units of 1/256 of a metric."""
    if factor == 0:
        return before
    return before + (((misfit << (TRUST_BITS + MISFIT_BITS)) - before) >> RUNNING_SHIFT)


@kernel(inline="always")
def reported_misfit(running: int) -> int:
    """Return the misfit that is reported with a match, in units of 1/16 of a metric like trust."""
    return max((running >> MISFIT_BITS) - MISFIT_ZERO, 0)


@kernel
def reciprocal_of_spread(distances: npt.NDArray[np.integer]) -> int:
    """Return ``floor(2**16 / s)``, with s the mean absolute deviation of the distances.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        From a window to each place.

    Returns
    -------
    int
        The mean of the distances is rounded down; s is rounded down and at least 1.
    """
    total = np.int64(0)
    for distance in distances:
        total += np.int64(distance)
    mean = total // distances.size
    spread = np.int64(0)
    for distance in distances:
        spread += abs(np.int64(distance) - mean)
    return (1 << RECIPROCAL_BITS) // max(int(spread) // distances.size, 1)


@kernel(inline="always")
def weight_of(activity: int) -> int:
    """Return the weight of the evidence of a window, in units of 1/8.

    A camera that hardly moves repeats its view, with fewer events.
    """
    return min(max((activity - WEIGHT_FROM) >> 1, 0), 1 << WEIGHT_BITS)


@kernel
def evidence_of(
    distances: npt.NDArray[np.integer],
    reciprocal: int,
    weight: int,
    out: npt.NDArray[np.uint8],
) -> None:
    """Compute the evidence ``min((D - min D) / s, 255) * weight``, with fraction bits.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        D. Only differences matter: adding a constant changes nothing.
    reciprocal : int
        Reciprocal of s, see `reciprocal_of_spread`. It is 0 for a spread above 2**16, and so is all
        evidence then.
    weight : int
        See `weight_of`.
    out : ndarray of uint8, shape (K,)
        Evidence against each place.
    """
    shift = RECIPROCAL_BITS - FRACTION_BITS
    # larger differences saturate the evidence, and products up to this one fit into 32 bits
    most = np.int64((EVIDENCE_TOP << shift) // max(reciprocal, 1) + 1)
    least = np.int64(distances[0])
    for distance in distances:
        least = min(least, np.int64(distance))
    factor = np.int32(reciprocal)
    for k in range(out.size):
        difference = np.int32(min(np.int64(distances[k]) - least, most))
        unweighted = (difference * factor) >> shift
        out[k] = (min(unweighted, np.int32(EVIDENCE_TOP)) * weight) >> WEIGHT_BITS


@kernel
def least_and_second(metric: Metrics, exclusion: int) -> tuple[int, int, int]:
    """Return the place of the least metric, the best one outside the exclusion zone, and ties.

    The second is -1 if no place lies outside the zone.
    """
    best, ties = _first_least(metric, np.int64(0), metric.size), -1
    for k in range(metric.size):
        ties += metric[k] == metric[best]
    before = _first_least(metric, np.int64(0), best - exclusion)
    second = _first_least(metric, best + exclusion + 1, metric.size)
    if before >= 0 and (second < 0 or metric[before] <= metric[second]):
        second = before
    return best, second, ties


@kernel(inline="always")
def margin_of(metric: Metrics, place: int, second: int) -> int:
    """Return the second-best metric less the best; the largest metric if there is no second."""
    if second < 0:
        return METRIC_TOP
    return int(metric[second]) - int(metric[place])


@kernel(inner=True)
def _first_least(metric: Metrics, begin: int, end: int) -> int:
    """Return the first place of the least metric in a range; -1 if the range is empty."""
    if begin >= end:
        return -1
    # two loops: the first compiles to vector instructions, the second stops early
    least = metric[begin]
    for k in range(begin, end):
        least = min(least, metric[k])
    k = begin
    while metric[k] != least:
        k += 1
    return k


# The recursion: many windows in one call, forwards and backwards.


#: State of a filter between two windows, in addition to its metrics; see `PlaceFilter`.
NUMBER_NAMES = (
    "reciprocal", "mean_activity", "place", "support", "residual", "residual_before",
    "running_misfit",
)  # fmt: skip
#: `NUMBER_NAMES`, and the activity for which the prediction holds or one of the two values below
NUMBERS = np.dtype([(name, np.int64) for name in (*NUMBER_NAMES, "predicted_for")])
#: Values of `predicted_for`: no prediction yet; from `BY_DISTANCE` on, a prediction by odometry,
#: which holds for any activity, plus the largest weight of the evidence.
NOT_PREDICTED, BY_DISTANCE = -2 * LOG_TOP, 2 * LOG_TOP


class FilterState(NamedTuple):
    """State of a `PlaceFilter`, which its kernels update in place.

    Attributes
    ----------
    numbers : ndarray of NUMBERS, shape (1,)
        See `PlaceFilter`, and `predicted_for`.
    metric : ndarray of int32, shape (K,)
        Metrics after the window before.
    prediction : ndarray of int16, shape (K,)
        Cost of each place in this window, without its evidence.
    follows : ndarray of bool, shape (K,)
        Which places are reachable from the latest match, if the prediction is by odometry.
    """

    numbers: Any
    metric: Metrics
    prediction: Narrow
    follows: npt.NDArray[np.bool_]


class WindowRows(NamedTuple):
    """Results of n windows, written by `update_windows`.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 7)
        Fields of `FilterMatch`.
    metrics : ndarray of int32, shape (n, K)
        Metrics after each window.
    evidence : ndarray of uint8, shape (n, K)
        Evidence of each window.
    activity : ndarray of int32, shape (n,)
        Activity of each window, see `activity_of`.
    factor : ndarray of int64, shape (n,)
        Evidence per unit of distance, in units of 2**-17; 0 in a pause.
    share : ndarray of int32, shape (n,)
        Weight of the evidence that odometry leaves, in units of 1/8; 8 without odometry.
    """

    columns: npt.NDArray[np.int64]
    metrics: Metrics
    evidence: npt.NDArray[np.uint8]
    activity: npt.NDArray[np.int32]
    factor: npt.NDArray[np.int64]
    share: npt.NDArray[np.int32]

    @classmethod
    def empty(cls, windows: int, places: int) -> WindowRows:
        """Return uninitialised rows."""
        return cls(
            np.empty((windows, 7), dtype=np.int64),
            np.empty((windows, places), dtype=np.int32),
            np.empty((windows, places), dtype=np.uint8),
            np.empty(windows, dtype=np.int32),
            np.empty(windows, dtype=np.int64),
            np.empty(windows, dtype=np.int32),
        )

    def part(self, first: int, last: int) -> WindowRows:
        """Return the rows of the windows from `first` to before `last`, in the same memory."""
        return WindowRows(
            self.columns[first:last], self.metrics[first:last], self.evidence[first:last],
            self.activity[first:last], self.factor[first:last], self.share[first:last],
        )  # fmt: skip

    def take(self, others: WindowRows) -> None:
        """Copy the rows of as many other windows."""
        self.columns[:], self.metrics[:] = others.columns, others.metrics
        self.evidence[:], self.activity[:] = others.evidence, others.activity
        self.factor[:], self.share[:] = others.factor, others.share


@kernel
def update_windows(
    state: FilterState,
    table: FilterTable,
    distances: npt.NDArray[np.integer],
    events: npt.NDArray[np.int64],
    out: WindowRows,
) -> None:
    """Advance the filter by n finished windows, one after the other.

    Parameters
    ----------
    state : FilterState
        State before the first window; updated in place.
    distances : ndarray of int, shape (n, K)
        From each window to each place.
    events : ndarray of int64, shape (n,)
        Number of events at the selected pixels in each window.
    out : WindowRows
        Results of the n windows.
    """
    for i in range(len(distances)):
        found = match_window(state, table, distances[i], events[i], out, i)
        end_window(state, distances[i], events[i], out.metrics[i], found)


@kernel(inline="always")
def end_window(
    state: FilterState,
    distances: npt.NDArray[np.integer],
    events: int,
    metric: Metrics,
    found: tuple[int, int, int, int],
) -> None:
    """Advance the filter to the next window.

    Parameters
    ----------
    distances, events, metric
        Arguments and metrics of `match_window` for this window.
    found : tuple of int
        Result of `match_window`.
    """
    now = state.numbers[0]
    if not is_pause(events, now.mean_activity):
        now.reciprocal = reciprocal_of_spread(distances)
    now.mean_activity = mean_activity_after(now.mean_activity, events)
    now.residual_before = now.residual
    now.place, now.support, now.residual, now.running_misfit = found
    now.predicted_for = NOT_PREDICTED
    for k in range(metric.size):
        state.metric[k] = metric[k]


@kernel(inline="always")
def match_window(
    state: FilterState,
    table: FilterTable,
    distances: npt.NDArray[np.integer],
    events: int,
    out: WindowRows,
    i: int,
) -> tuple[int, int, int, int]:
    """Match a window, finished or not, without advancing the filter.

    Parameters
    ----------
    state : FilterState
        Only its prediction is updated, for the next call for the same window.
    distances : ndarray of int, shape (K,)
        Only differences matter: adding a constant changes nothing.
    events : int
        Number of events at the selected pixels in the window.
    out : WindowRows
        The result is written to row `i`.

    Returns
    -------
    place, support, residual, misfit : int
        See `write_trust`.
    """
    now, row = state.numbers[0], out.columns[i]
    metric, evidence = out.metrics[i], out.evidence[i]
    activity = activity_of(events, now.mean_activity)
    if now.predicted_for != activity and now.predicted_for < BY_DISTANCE:
        if now.place >= 0:
            predict(state.metric, table, activity, state.prediction)
        now.predicted_for = activity
    scale, weight, share = now.reciprocal, 0, 1 << WEIGHT_BITS
    if not is_pause(events, now.mean_activity):
        weight = weight_of(activity)
        if now.predicted_for >= BY_DISTANCE:
            whole = weight
            weight = min(whole, now.predicted_for - BY_DISTANCE)
            share = (weight << WEIGHT_BITS) // max(whole, 1)
        if scale == 0:
            scale = reciprocal_of_spread(distances)
    evidence_of(distances, scale, weight, evidence)
    for k in range(metric.size):
        metric[k] = min(state.prediction[k] + np.int32(evidence[k]), METRIC_TOP)
    place, second, ties = least_and_second(metric, table.exclusion)
    margin = write_match(metric, place, second, ties, row)
    factor_and_share = (scale * weight, share)
    by_distance = now.predicted_for >= BY_DISTANCE
    kept = write_trust(
        now, table, by_distance, state.follows, margin, evidence, factor_and_share, row
    )
    out.activity[i], (out.factor[i], out.share[i]) = activity, factor_and_share
    return kept


@kernel(inline="always")
def write_trust(
    now: Any,
    table: FilterTable,
    by_distance: bool,
    follows: npt.NDArray[np.bool_],
    margin: int,
    evidence: npt.NDArray[np.uint8],
    factor_and_share: tuple[int, int],
    out: npt.NDArray[np.int64],
) -> tuple[int, int, int, int]:
    """Compute the trust in a match and its misfit.

    Parameters
    ----------
    now : record of NUMBERS or HELD
        State after the match before.
    by_distance : bool
        Whether `follows` holds the places reachable from that match, by odometry; else places are
        reached by steps.
    margin : int
        Result of `write_match`.
    evidence : ndarray of uint8, shape (K,)
        Evidence of the window.
    factor_and_share : tuple of int
        Of the window, see `WindowRows`.
    out : ndarray of int64, shape (7,)
        Fields of `FilterMatch`: the place is read, trust and misfit are written.

    Returns
    -------
    place, support, residual, misfit : int
        State for the next match, see `PlaceFilter`.
    """
    place, before = out[0], now.place
    factor, share = factor_and_share
    if by_distance:
        reachable = follows[place]
    else:
        last = table.costs.shape[1] - 1
        reachable = before >= 0 and is_reachable(before, place, last, table.jumps)
    support = support_after(now.support if reachable else 0, place == before, margin)
    residual = residual_of(evidence[place])
    out[5] = trust_of(support, max(residual, now.residual, now.residual_before))
    of_window = window_misfit(evidence, place, table.typical, factor, share)
    misfit = update_misfit(now.running_misfit, of_window, factor)
    out[6] = reported_misfit(misfit)
    return place, support, residual, misfit


@kernel(inline="always")
def write_match(
    metric: Metrics, place: int, second: int, ties: int, out: npt.NDArray[np.int64]
) -> int:
    """Write a match without its trust and misfit, and return its margin.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    place, second, ties : int
        Result of `least_and_second`.
    out : ndarray of int64, shape (7,)
        Fields of `FilterMatch`.
    """
    out[0], out[1], out[2], out[3], out[4] = place, metric[place], second, -1, ties
    if second >= 0:
        out[3] = metric[second]
    return margin_of(metric, place, second)


@kernel
def smooth_windows(
    cost_to_go: Narrow,
    next_cost_to_go: Narrow,
    table: FilterTable,
    rows: WindowRows,
) -> None:
    """Add the cost to go to the metrics of n windows, backwards from the last window.

    Parameters
    ----------
    cost_to_go : ndarray of int16, shape (K,)
        Cost of the rest of the drive from each place after the last of these windows; updated in
        place to that before the first.
    next_cost_to_go : ndarray of int16, shape (K,)
        Scratch; after the call, the cost to go after the first window plus the evidence of the
        first window.
    rows : WindowRows
        Updated in place: the metrics become the costs of the best path through each place, and the
        columns the matches by these, with the margin as trust, in units of 1/16 of a metric, and
        `window_misfit` as misfit.
    """
    costs = np.empty((table.costs.shape[1], cost_to_go.size), dtype=np.int16)
    for i in range(len(rows.metrics) - 1, -1, -1):
        row, evidence = rows.columns[i], rows.evidence[i]
        row[5] = match_summed(rows.metrics[i], cost_to_go, table.exclusion, row) << TRUST_BITS
        row[6] = window_misfit(evidence, row[0], table.typical, rows.factor[i], rows.share[i])
        write_costs(table, np.int64(rows.activity[i]), costs)
        backward_step(cost_to_go, next_cost_to_go, table, costs, evidence)


@kernel(inline="always")
def match_summed(
    metric: Metrics, cost_to_go: Narrow, exclusion: int, out: npt.NDArray[np.int64]
) -> int:
    """Add the cost to go to the metric of a window, match by the sum, and return the margin.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Updated in place to the cost of the best path through each place.
    cost_to_go : ndarray of int16, shape (K,)
        Cost of the rest of the drive from each place.
    out : ndarray of int64, shape (7,)
        Fields of `FilterMatch`, all but trust and misfit.
    """
    for k in range(metric.size):
        metric[k] += np.int32(cost_to_go[k])
    place, second, ties = least_and_second(metric, exclusion)
    return write_match(metric, place, second, ties, out)


@kernel(inline="always")
def backward_step(
    cost_to_go: Narrow,
    next_cost_to_go: Narrow,
    table: FilterTable,
    costs: Narrow,
    evidence: npt.NDArray[np.uint8],
) -> None:
    """Advance the cost to go backwards by one window.

    Parameters
    ----------
    cost_to_go : ndarray of int16, shape (K,)
        Cost of the rest of the drive from each place after this window; updated in place to that
        after the window before.
    next_cost_to_go : ndarray of int16, shape (K,)
        Scratch; after the call, the cost to go after this window plus its evidence.
    costs : ndarray of int16, shape (steps, K)
        Result of `write_costs` for this window.
    evidence : ndarray of uint8, shape (K,)
        Evidence of this window.
    """
    for k in range(next_cost_to_go.size):
        next_cost_to_go[k] = np.int16(cost_to_go[k] + np.int16(evidence[k]))
    move(next_cost_to_go, table, costs, np.bool_(True), cost_to_go)


#: State of `HeldWindows`: the number of the first held window, how many are held, and the
#: `NUMBER_NAMES` of the match before them.
HELD = np.dtype([(name, np.int64) for name in ("first", "windows", *NUMBER_NAMES[2:])])


class HeldWindows(NamedTuple):
    """Windows to be matched after N later ones, in rings of N + 1 windows.

    Attributes
    ----------
    numbers : ndarray of HELD, shape (1,)
        Window i is element ``i % (N + 1)`` of each ring.
    metrics, evidence, factor, share : ndarray
        See `WindowRows`; N + 1 rows each.
    costs : ndarray of int16, shape (N + 1, steps, K)
        Result of `write_costs` for each window, which all backward passes over it use.
    cost_to_go, next_cost_to_go : ndarray of int16, shape (K,)
        See `backward_step`.
    follows : ndarray of bool, shape (K,)
        Which places are reachable from the match before, if known by odometry.
    """

    numbers: Any
    metrics: Metrics
    evidence: npt.NDArray[np.uint8]
    factor: npt.NDArray[np.int64]
    share: npt.NDArray[np.int32]
    costs: Narrow
    cost_to_go: Narrow
    next_cost_to_go: Narrow
    follows: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, delay: int, transitions: Transitions) -> HeldWindows:
        """Return empty rings for a delay of `delay` windows."""
        room, places = delay + 1, transitions.places
        numbers = np.array([(0, 0, -1, 0, 0, 0, MISFIT_ZERO << MISFIT_BITS)], dtype=HELD)
        steps = transitions.table.costs.shape[1]
        return cls(
            numbers.view(np.recarray),
            np.empty((room, places), dtype=np.int32),
            np.empty((room, places), dtype=np.uint8),
            np.empty(room, dtype=np.int64),
            np.empty(room, dtype=np.int32),
            np.empty((room, steps, places), dtype=np.int16),
            np.empty(places, dtype=np.int16),
            np.empty(places, dtype=np.int16),
            np.empty(places, dtype=np.bool_),
        )


@kernel
def match_late(
    held: HeldWindows,
    table: FilterTable,
    rows: WindowRows,
    delay: int,
    backward: bool,
    by_distance: bool,
    columns: npt.NDArray[np.int64],
    metrics: Metrics,
) -> int:
    """Hold n more windows, and match all held windows but the newest `delay` ones.

    Parameters
    ----------
    rows : WindowRows
        Results of the place filter for the n windows.
    delay : int
        N; 0 at the end of a drive.
    backward : bool
        Whether to compute `cost_to_go` here, by steps. Otherwise there is one window to match, and
        the caller has computed it.
    by_distance : bool
        Whether `held.follows` is valid.
    columns : ndarray of int64, shape (n + N, 7)
        Output: fields of `FilterMatch`.
    metrics : ndarray of int32, shape (n + N, K)
        Output: cost of the best path through each place.

    Returns
    -------
    int
        Number of matches.
    """
    now, cost_to_go, room, places = (
        held.numbers[0],
        held.cost_to_go,
        len(held.metrics),
        held.cost_to_go.size,
    )
    added = matched = 0
    while added < len(rows.metrics) or now.windows > delay:
        if added < len(rows.metrics):
            at = (now.first + now.windows) % room
            for k in range(places):
                held.metrics[at, k] = rows.metrics[added, k]
                held.evidence[at, k] = rows.evidence[added, k]
            held.factor[at], held.share[at] = rows.factor[added], rows.share[added]
            write_costs(table, np.int64(rows.activity[added]), held.costs[at])
            now.windows += 1
            added += 1
        if now.windows <= delay:
            continue
        if backward:
            for k in range(places):
                cost_to_go[k] = 0
            for later in range(now.first + now.windows - 1, now.first, -1):
                at = later % room
                backward_step(
                    cost_to_go, held.next_cost_to_go, table, held.costs[at], held.evidence[at]
                )
        at = now.first % room
        row, metric = columns[matched], metrics[matched]
        for k in range(places):
            metric[k] = held.metrics[at, k]
        margin = match_summed(metric, cost_to_go, table.exclusion, row)
        kept = write_trust(
            now, table, by_distance, held.follows, margin,
            held.evidence[at], (held.factor[at], held.share[at]), row,
        )  # fmt: skip
        now.residual_before = now.residual
        now.place, now.support, now.residual, now.running_misfit = kept
        now.first += 1
        now.windows -= 1
        matched += 1
    return matched


class FilterMatch(NamedTuple):
    """Match of the place filter in a window.

    Attributes
    ----------
    place : int
        Place of the least metric; the first one in a tie.
    metric : int
        Its metric.
    second, second_metric : int
        Place of the least metric outside the exclusion zone and its metric; -1 if there is none.
    ties : int
        Number of other places with the least metric.
    trust : int
        Confidence in the match, 0 to 368; higher means more confident. It is the support, a running
        mean of the margins (second metric less the least) up to this window, less the largest
        residual (evidence against the matched place) of this window and the two before. See
        `support_after` and `trust_of`.
    misfit : int
        How much worse than in a drive along the map in the same light, which is 0, about the last
        sixteen windows fit the matched places. See `window_misfit`.
    """

    place: int
    metric: int
    second: int
    second_metric: int
    ties: int
    trust: int
    misfit: int


class PlaceFilter:
    """Place filter of a map, advanced window by window.

    Parameters
    ----------
    transitions : Transitions
        Transitions of the map.
    mean_activity : int
        Initial mean number of events per window at the selected pixels, in units of 1/256 event;
        0 if only windows without events are pauses.

    Attributes
    ----------
    state : FilterState
        The numbers are: `reciprocal`, ``floor(2**16 / spread)`` of the window before, which scales
        the evidence (0 before the first window and after a spread above 2**16: the reciprocal of
        the window itself is then used); `mean_activity`, the running mean number of events per
        window; `place` (-1 before the first match), `support` and `residual` of the latest match
        and `residual_before` of the match before it, see `trust_of`; and `running_misfit`, see
        `update_misfit`.
    """

    def __init__(self, transitions: Transitions, mean_activity: int = 0) -> None:
        self.transitions, places = transitions, transitions.places
        begin = (0, mean_activity, -1, 0, 0, 0, MISFIT_ZERO << MISFIT_BITS, NOT_PREDICTED)
        numbers = np.array([begin], dtype=NUMBERS)
        metric, prediction = np.zeros(places, dtype=np.int32), np.zeros(places, dtype=np.int16)
        self.state = FilterState(
            numbers.view(np.recarray), metric, prediction, np.zeros(places, dtype=np.bool_)
        )

    @classmethod
    def of(
        cls,
        places: Descriptors,
        settings: Settings,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> PlaceFilter:
        """Return the place filter of a map, before its first window.

        Parameters
        ----------
        places : Descriptors
            Descriptors of the map, in its codes.
        jumps, along_mm : ndarray, optional
            See `Transitions`.
        """
        events, number = places.selected_events, settings.window_parts
        transitions = Transitions(
            len(places), TransitionCosts.of(settings), place_activity(events, number), jumps,
            along_mm, typical_distances(places.counts), settings.exclusion_places,
        )  # fmt: skip
        return cls(transitions, activity_of_drive(events[::number]))

    def __len__(self) -> int:
        return len(self.state.metric)

    def match(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Return the match of an unfinished window, without advancing.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            From the window to each place.
        events : int
            Number of events at the selected pixels in the window.
        """
        distances, state = self._checked(distances[np.newaxis]), self.state
        rows = WindowRows.empty(1, len(self))
        match_window(state, self.transitions.table, distances[0], events, rows, 0)
        return FilterMatch(*rows.columns[0].tolist())

    def update(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Advance by a finished window, and return its match.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            From the window to each place.
        events : int
            Number of events at the selected pixels in the window.
        """
        rows = self.update_windows(distances[np.newaxis], np.array([events], dtype=np.int64))
        return FilterMatch(*rows.columns[0].tolist())

    def update_windows(
        self, distances: npt.NDArray[np.integer], events: npt.NDArray[np.int64]
    ) -> WindowRows:
        """Advance by n finished windows, n at least 1, one after the other.

        Parameters
        ----------
        distances : ndarray of int, shape (n, K)
            From each window to each place.
        events : ndarray of int64, shape (n,)
            Number of events at the selected pixels in each window.
        """
        distances = self._checked(distances)
        rows = WindowRows.empty(*distances.shape)
        update_windows(self.state, self.transitions.table, distances, events, rows)
        return rows

    @property
    def place(self) -> int:
        """Place of the latest match; -1 before the first."""
        return int(self.state.numbers[0].place)

    @property
    def numbers(self) -> tuple[int, ...]:
        """State without the arrays, in the order of `NUMBER_NAMES`."""
        return tuple(self.state.numbers[0].tolist()[: len(NUMBER_NAMES)])

    def resume(self, metric: Metrics, numbers: Sequence[int]) -> None:
        """Continue from the state of another filter with the same map and costs.

        Parameters
        ----------
        metric : ndarray of int32, shape (K,)
            Metrics of that filter.
        numbers : sequence of int
            `numbers` of that filter.
        """
        self.state.metric[:] = metric
        self.state.prediction[:] = 0  # as before the first window
        self.state.numbers[0] = (*numbers, NOT_PREDICTED)

    def spread(self, places: int) -> None:
        """Let the robot be up to so many places further on, and nothing speak for any of them."""
        metric = self.state.metric
        for _ in range(min(places, len(metric))):
            np.minimum(metric[1:], metric[:-1], out=metric[1:])
        self.state.numbers[0].support = 0
        self.state.numbers[0].predicted_for = NOT_PREDICTED

    def predict_travelled(self, travelled_mm: int, driven_mm: int) -> None:
        """Predict by odometry instead of steps until the window ends.

        Parameters
        ----------
        travelled_mm : int
            Distance that `Odometer` counts from the end of the window before to now or to the end
            of this window, in millimetres; negative when driving backwards.
        driven_mm : int
            The whole driven distance.
        """
        prediction = self.transitions.by_distance(self.state.metric, travelled_mm)
        if self.place >= 0:
            self.state.prediction[:] = prediction
            self.state.follows[:] = self.transitions.following(self.place, travelled_mm)
            self.state.numbers[0].predicted_for = BY_DISTANCE + self.transitions.weight_by_distance(
                driven_mm
            )

    def _checked(self, distances: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
        if distances.shape[1:] != (len(self),):
            raise UsageError(
                f"{distances.shape[1]} distances to {len(self)} places: give one of each place"
            )
        if distances.dtype.kind not in "iu":
            raise UsageError(
                f"distances are {distances.dtype}: give whole numbers, for example multiplied by "
                "1,000 and rounded"
            )
        # the kernel is compiled for the types of recorded drives and streams, and for int64
        known = distances.dtype in (np.int32, np.uint16, np.uint32)
        return np.ascontiguousarray(distances, dtype=distances.dtype if known else np.int64)


# Smoothing of the place filter with later windows.
#
# The metric of a place is the cost of the cheapest path that ends there. The filter run backwards
# gives the cost to go: that of the cheapest path from there to the end of the drive. Their sum is
# the cost of the best path of the whole drive through this place, the min-plus form of
# forward-backward smoothing. Fixed-lag smoothing does this for each window and the N after it: each
# match then comes N windows late.


#: Distance driven since the window before, in millimetres; None where it is not known.
Travelled = int | None
#: Fields of `FilterMatch`, shape (m, 7), and costs of the best path through each place, (m, K).
Late = tuple[npt.NDArray[np.int64], Metrics]


class BackwardPass:
    """Cost to go from each place, computed from the last window of a drive back to the first."""

    def __init__(self, transitions: Transitions) -> None:
        self._transitions = transitions
        self._cost_to_go = np.zeros(transitions.places, dtype=np.int16)
        self._next_cost_to_go = np.empty(transitions.places, dtype=np.int16)

    def add_to(self, rows: WindowRows, travelled: Sequence[Travelled]) -> None:
        """Add the cost to go to the metrics of the n windows before those added so far.

        Parameters
        ----------
        rows : WindowRows
            Results of n windows, updated in place as by `smooth_windows`.
        travelled : sequence of int or None
            Driven distance of each window.
        """
        for first, last in reversed(list(runs(travelled, len(travelled)))):
            smooth_windows(
                self._cost_to_go, self._next_cost_to_go, self._transitions.table,
                rows.part(first, last),
            )  # fmt: skip
            distance = travelled[first]
            if distance is not None:
                _travel_back(self._transitions, self._next_cost_to_go, distance, self._cost_to_go)


def _travel_back(
    transitions: Transitions,
    next_cost_to_go: npt.NDArray[np.int16],
    distance: int,
    cost_to_go: npt.NDArray[np.int16],
) -> None:
    """Compute the cost to go by odometry instead of steps; see `backward_step`."""
    cost_to_go[:] = transitions.by_distance(next_cost_to_go.astype(np.int32), distance, back=True)


class FixedLag:
    """Matching of each window by the windows before it and the N after it.

    Parameters
    ----------
    delay : int
        N.
    """

    def __init__(self, transitions: Transitions, delay: int) -> None:
        self._transitions, self._delay = transitions, delay
        self._held = HeldWindows.empty(delay, transitions)
        self._travelled: deque[Travelled] = deque()  # of the windows that are held

    def add(self, rows: WindowRows, travelled: Sequence[Travelled]) -> Late:
        """Add the next n windows, and match those that have N after them.

        Parameters
        ----------
        rows : WindowRows
            Results of the place filter for these windows.
        travelled : sequence of int or None
            Driven distance of each window.

        Returns
        -------
        columns : ndarray of int64, shape (m, 7)
            Fields of `FilterMatch`.
        metrics : ndarray of int32, shape (m, K)
            Cost of the best path through each place.
        """
        return self._match(rows, travelled, self._delay)

    def finish(self) -> Late:
        """Match the last windows, which fewer than N windows follow; return the same as `add`."""
        return self._match(WindowRows.empty(0, self._transitions.places), [], 0)

    def _match(self, rows: WindowRows, travelled: Sequence[Travelled], delay: int) -> Late:
        self._travelled.extend(travelled)
        number = max(len(self._travelled) - delay, 0)
        columns = np.empty((number, 7), dtype=np.int64)
        metrics = np.empty((number, self._transitions.places), dtype=np.int32)
        if all(distance is None for distance in self._travelled):
            match_late(
                self._held, self._transitions.table, rows, delay, True, False,
                columns, metrics,
            )  # fmt: skip
            for _ in range(number):
                self._travelled.popleft()
            return columns, metrics
        for i in range(len(travelled)):
            match_late(
                self._held, self._transitions.table, rows.part(i, i + 1),
                self._delay + 1, False, False, columns[:0], metrics[:0],
            )  # fmt: skip
            j = number - (len(travelled) - i)
            if j >= 0:
                self._match_first(columns[j : j + 1], metrics[j : j + 1])
        if not travelled:
            for j in range(number):
                self._match_first(columns[j : j + 1], metrics[j : j + 1])
        return columns, metrics

    def _match_first(self, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Match the first held window, with the distances driven in those after it."""
        held, transitions = self._held, self._transitions
        first, windows, place = held.numbers[0].tolist()[:3]
        held.cost_to_go[:] = 0
        for i in range(windows - 1, 0, -1):
            at, distance = (first + i) % len(held.metrics), self._travelled[i]
            backward_step(
                held.cost_to_go,
                held.next_cost_to_go,
                transitions.table,
                held.costs[at],
                held.evidence[at],
            )
            if distance is not None:
                _travel_back(transitions, held.next_cost_to_go, distance, held.cost_to_go)
        distance = self._travelled.popleft()
        by_distance = distance is not None and place >= 0
        if distance is not None and place >= 0:
            held.follows[:] = transitions.following(place, distance)
        match_late(
            held, transitions.table, WindowRows.empty(0, transitions.places),
            windows - 1, False, by_distance, columns, metrics,
        )  # fmt: skip


def runs(travelled: Sequence[Travelled], most: int) -> Iterator[tuple[int, int]]:
    """Yield the start and end of runs of windows of which only the first may have a known distance.

    Parameters
    ----------
    most : int
        Largest number of windows in a run.
    """
    begin = 0
    while begin < len(travelled):
        end = begin + 1
        while end < len(travelled) and end - begin < most and travelled[end] is None:
            end += 1
        yield begin, end
        begin = end
