"""Transitions: which places can be reached in one window, and at which cost.

The prediction step of the place filter. Costs come from the activity of the window, from the
settings, from odometry, and from jumps between places that the map names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.route import MOST_MM
from edge_vpr.settings import Settings
from fixedpoint.activity import ACTIVITY_COSTS, PLACE_HIGH, PLACE_LOW, ROW_BITS, SAME_ROW

# Costs of steps from place to place, in the units of the metrics of the place filter.


Metrics = npt.NDArray[np.int32]

#: fraction bits of metrics, evidence and costs
FRACTION_BITS = 2
#: largest metric: 10 bits
METRIC_TOP = (1 << 10) - 1
#: a match follows from the one before over so many places at least, even if no step is so long
LEAST_LAST = 2


@dataclass(frozen=True)
class TransitionCosts:
    """Costs of moves from place to place in one window.

    Parameters
    ----------
    forward : tuple of int, optional
        Cost of a step of 0, 1, 2 ... places. By default `ACTIVITY_COSTS`: by the activity of the
        window against that of the place that is reached.
    back : tuple of int
        Cost of a step of -1, -2 ... places; empty if the route is never driven backwards.
    restart : int
        Cost of getting anywhere else: the robot was carried, or the filter is wrong.

    Raises
    ------
    UsageError
        If a cost does not fit the metric, or there is none.
    """

    forward: tuple[int, ...] | None = None
    back: tuple[int, ...] = ()
    restart: int = 16

    def __post_init__(self) -> None:
        most = (METRIC_TOP >> FRACTION_BITS) - 1
        costs = (*(self.forward or ()), *self.back, self.restart)
        if self.forward == () or min(costs) < 0 or max(costs) > most:
            raise UsageError(
                f"filter costs {self.forward} forward, {self.back} back and {self.restart} for a "
                f"restart: expected 0 to {most}, and at least one step forward"
            )

    @classmethod
    def of(cls, settings: Settings) -> TransitionCosts:
        """Return the costs of the settings; the default depends on the kind of window."""
        forward = settings.filter_steps
        if forward is None and settings.window == "count":  # whose activity is always the same
            forward = (1, 0, 0, 1)
        return cls(forward, settings.filter_back, settings.filter_restart)

    @property
    def first(self) -> int:
        """Smallest step, in places: 0, or below."""
        return -len(self.back)

    @property
    def last(self) -> int:
        """Largest step, in places; a match that is farther away is a jump."""
        forward = ACTIVITY_COSTS[0] if self.forward is None else self.forward
        return max(len(forward) - 1, LEAST_LAST)

    @property
    def scaled(self) -> npt.NDArray[np.int32]:
        """Costs from the smallest to the largest step, with fraction bits.

        A row for each row of `ACTIVITY_COSTS`, or one for all.
        """
        one = np.array([self.forward or ()], dtype=np.int32) << FRACTION_BITS
        forward = np.array(ACTIVITY_COSTS, dtype=np.int32) if self.forward is None else one
        back = np.array(self.back[::-1], dtype=np.int32) << FRACTION_BITS
        return np.hstack([np.tile(back, (len(forward), 1)), forward])


# Kernels for the costs of places one window later: by steps, and by a known distance.


#: fraction bits of the cost of a millimetre
RATE_BITS = 16
#: with odometry, a jump may be taken from this many places before it to as many after it
JUMP_REACH = 8


class StepTable(NamedTuple):
    """The part of `Transitions` that a kernel needs to predict by steps.

    Attributes
    ----------
    costs : ndarray of int32, shape (rows, steps)
        Of a step of ``first``, ``first + 1`` ... places, with fraction bits. Several rows are those
        of `ACTIVITY_COSTS`; one row is for any activity.
    first, last : int
        Smallest step, and the largest after which an answer follows from the one before.
    restart : int
        With fraction bits.
    jumps : ndarray of int32, shape (n, 2)
        Pairs of places, from and to, that follow each other without a step.
    activity : ndarray of int32, shape (K,)
        Of each place, see `place_activity`.
    """

    costs: Metrics
    first: int
    last: int
    restart: int
    jumps: npt.NDArray[np.int32]
    activity: npt.NDArray[np.int32]


@kernel
def leads_to(
    place: int, next_place: int, first: int, last: int, jumps: npt.NDArray[np.int32]
) -> bool:
    """Return whether a step of ``first`` to ``last`` places, or one over a jump, leads there."""
    if first <= next_place - place <= last:
        return True
    for n in range(len(jumps)):
        before, beyond = jumps[n, 0] - place, next_place - jumps[n, 1]
        if before >= 0 and beyond >= 0 and before + beyond < last:
            return True
    return False


@kernel
def predict(
    metric: Metrics, steps: StepTable, activity: int, back: bool, prediction: Metrics
) -> None:
    """Write the cheapest cost of each place one window later, or earlier.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    activity : int
        Of the window, see `activity_of`.
    back : bool
        Whether `metric` is of the window, and the cost of each place in the window before is asked.
    prediction : ndarray of int32, shape (K,)
        Written to: ``min(min_i (M[k - i] + cost[i]), min M + restart) - min M``; over a jump from
        a to b, k = b + o is i places from a - (i - 1 - o). The costs are those of the place
        reached.
    """
    places, number = metric.size, steps.costs.shape[1]
    farthest = max(abs(steps.first), abs(steps.first + number - 1))
    least = metric[0]
    for k in range(places):
        least = min(least, metric[k])
    # as dear as a restart beyond both ends. Loops over new arrays, all from 0 on, compile to vector
    # instructions
    padded = np.full(places + 2 * farthest, least + steps.restart, dtype=np.int32)
    rows = np.zeros(places + 2 * farthest, dtype=np.uint8)
    inside, rows_inside = padded[farthest:], rows[farthest:]
    for k in range(places):
        inside[k] = metric[k]
    last_row = len(steps.costs) - 1
    if last_row > 0:
        for k in range(places):
            row = (activity - steps.activity[k] + (1 << (ROW_BITS - 1))) >> ROW_BITS
            rows_inside[k] = min(max(row + SAME_ROW, 0), last_row)
    found = np.full(places, steps.restart, dtype=np.int32)
    for i in range(number):
        step = steps.first + i
        cost = steps.costs[:, i] - np.int32(least)
        source = padded[farthest + (step if back else -step) :]
        row_of = rows[farthest + (step if back else 0) :]
        if last_row > 0:
            for k in range(places):
                found[k] = min(found[k], source[k] + cost[row_of[k]])
        else:
            for k in range(places):
                found[k] = min(found[k], source[k] + cost[0])
        for j in range(len(steps.jumps)):
            for over in range(step):
                begin, end = steps.jumps[j, 0] - (step - 1 - over), steps.jumps[j, 1] + over
                if begin >= 0 and end < places:
                    to, other = (begin, end) if back else (end, begin)
                    jumped = metric[other] + cost[rows_inside[end]]
                    found[to] = min(found[to], jumped)
    for k in range(places):
        prediction[k] = found[k]


@kernel
def predict_travelled(
    metric: Metrics,
    along: npt.NDArray[np.int64],
    travelled: int,
    rate_and_spacing: tuple[int, int],
    restart: int,
    jumps: npt.NDArray[np.int32],
) -> Metrics:
    """Return the cheapest cost of each place after a known distance driven.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    along : ndarray of int64, shape (K,)
        Millimetres that the reference had driven at each place, not falling.
    travelled : int
        Millimetres since the window before; below 0 backwards.
    rate_and_spacing : tuple of int
        Cost of a millimetre off in units of ``2**-16``, and millimetres between two places.
    jumps : ndarray of int32, shape (n, 2)
        Pairs of places, from and to, that follow each other without a step.

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_j (M[j] + |along[k] - along[j] - travelled| * rate), min M + restart) - min M``,
        rounded down. A jump is a way of one mean spacing.
    """
    rate, spacing = rate_and_spacing
    least, places = np.int64(metric.min()), metric.size
    prediction = np.full(places, np.int64(restart) << RATE_BITS, dtype=np.int64)
    # rounding down is monotone: the lowest exact cost, rounded, is the lowest rounded cost
    best, j = np.int64(1) << 62, 0
    for k in range(places):  # sources from which the distance ends at k or before it
        while j < places and along[j] + travelled <= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) - (along[j] + travelled) * rate
            best, j = min(best, cost), j + 1
        if j > 0:
            prediction[k] = min(prediction[k], best + along[k] * rate)
    best, j = np.int64(1) << 62, places - 1
    for k in range(places - 1, -1, -1):  # sources from which it ends beyond k
        while j >= 0 and along[j] + travelled >= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) + (along[j] + travelled) * rate
            best, j = min(best, cost), j - 1
        if j < places - 1:
            prediction[k] = min(prediction[k], best - along[k] * rate)
    for n in range(len(jumps)):
        begin, end = jumps[n, 0], jumps[n, 1]
        for source in range(max(begin - JUMP_REACH + 1, 0), begin + 1):
            for k in range(end, min(end + JUMP_REACH, places)):
                way = along[begin] - along[source] + spacing + along[k] - along[end]
                cost = ((metric[source] - least) << RATE_BITS) + abs(way - travelled) * rate
                prediction[k] = min(prediction[k], cost)
    return (prediction >> RATE_BITS).astype(np.int32)


# Places that can be reached in one window, and their costs: by steps, odometry and jumps.


#: with odometry, the cost of being one mean spacing away from where the distance leads
OFF_BY_A_PLACE = 2
_NO_JUMPS = np.zeros((0, 2), dtype=np.int32)


class Transitions:
    """Places that can be reached from each place of a map in one window.

    Parameters
    ----------
    places : int
        K.
    place_activity : ndarray of int32, shape (K,), optional
        See `place_activity`; 0 by default.
    jumps : ndarray of int32, shape (n, 2), optional
        Pairs of places: from the first, one step leads to the second too, as where a loop closes
        or two routes meet. Steps of more places may pass the pair.
    along_mm : ndarray of int64, shape (K,), optional
        Millimetres that the reference had driven at each place, not falling: what odometry of a
        query is compared with.

    Raises
    ------
    UsageError
        If there is no place, or a jump or a way is none of this map.

    Examples
    --------
    >>> costs, jumps = TransitionCosts((1, 0, 1), restart=5), np.array([[3, 0]], dtype=np.int32)
    >>> moves = Transitions(4, costs, jumps=jumps)
    >>> moves.by_steps(np.array([9, 9, 9, 0], dtype=np.int32)).tolist()  # back at the start
    [0, 4, 9, 4]
    """

    def __init__(
        self,
        places: int,
        costs: TransitionCosts,
        place_activity: npt.NDArray[np.int32] | None = None,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> None:
        if places < 1:
            raise UsageError(f"a map of {places} places: expected at least 1")
        self.places, self.costs = places, costs
        self.jumps = _NO_JUMPS if jumps is None else np.asarray(jumps, dtype=np.int32)
        check_jumps(self.jumps, places)
        if place_activity is None:
            place_activity = np.zeros(places, dtype=np.int32)
        check_activity(place_activity, places)
        self.by_step = StepTable(
            costs.scaled, costs.first, costs.last, costs.restart << FRACTION_BITS, self.jumps,
            place_activity,
        )  # fmt: skip
        self._along = along_mm
        self._spacing = self._rate = 0
        if along_mm is not None:
            check_along(along_mm, places)
            self._spacing = int(along_mm[-1] - along_mm[0]) // max(places - 1, 1)
            self._rate = (OFF_BY_A_PLACE << FRACTION_BITS << RATE_BITS) // max(self._spacing, 1)

    def check_odometry(self) -> None:
        """Raise UsageError if the map does not hold the distances between its places."""
        self._checked_along()

    def by_steps(self, metric: Metrics, activity: int = 0) -> Metrics:
        """Return the cost of each place after a window of this activity, shape (K,)."""
        prediction = np.empty_like(metric)
        predict(metric, self.by_step, activity, False, prediction)
        return prediction

    def by_distance(self, metric: Metrics, travelled_mm: int, *, back: bool = False) -> Metrics:
        """Return the cost of each place after a distance of `travelled_mm`, shape (K,).

        Parameters
        ----------
        metric : ndarray of int32, shape (K,)
            Of the window before.
        back : bool
            Return the cost of each place before it, from that of the places after it.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        along, jumps = self._checked_along(), self.jumps
        if back:  # the same distance on the route in the opposite direction
            metric, along = np.ascontiguousarray(metric[::-1]), along[-1] - along[::-1]
            jumps = self.places - 1 - jumps[:, ::-1]
        found = predict_travelled(
            metric, along, _limited(travelled_mm), (self._rate, self._spacing),
            self.by_step.restart, jumps,
        )  # fmt: skip
        return np.ascontiguousarray(found[::-1]) if back else found

    def following(self, place: int, travelled_mm: int) -> npt.NDArray[np.bool_]:
        """Return which places can be reached over a distance without a restart, shape (K,)."""
        along, travelled = self._checked_along(), _limited(travelled_mm)
        off = np.abs(along - along[place] - travelled)
        follows = (off * self._rate) >> RATE_BITS < self.by_step.restart
        for begin, end in self.jumps[self._jumps_near(place, JUMP_REACH)].tolist():
            beyond = slice(end, end + JUMP_REACH)
            way = along[begin] - along[place] + self._spacing + along[beyond] - along[end]
            cost = (np.abs(way - travelled) * self._rate) >> RATE_BITS
            follows[beyond] |= cost < self.by_step.restart
        return np.asarray(follows)

    def lead_to(self, place: int, next_place: int, travelled_mm: int | None) -> bool:
        """Return whether `next_place` can be reached from `place` without a restart."""
        steps = self.by_step
        if travelled_mm is None:
            return bool(leads_to(place, next_place, steps.first, steps.last, steps.jumps))
        return bool(self.following(place, travelled_mm)[next_place])

    def _jumps_near(self, place: int, reach: int) -> npt.NDArray[np.bool_]:
        before = self.jumps[:, 0] - place
        return np.asarray((before >= 0) & (before < reach))

    def _checked_along(self) -> npt.NDArray[np.int64]:
        if self._along is None:
            raise UsageError(
                "the map does not say how far its places are from each other: make it with the "
                "reference drive's --odometry or --track"
            )
        if self._spacing < 1:
            raise UsageError(
                "the reference drive of this map did not move by its odometry or track: map a "
                "drive that moves, or match without odometry"
            )
        return self._along


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
            f"way to each of {places} places: expected as many millimetres, which do not fall"
        )
    if not 0 <= along_mm[0] <= along_mm[-1] <= MOST_MM:
        raise UsageError(f"way of {along_mm[0]} to {along_mm[-1]} mm: expected 0 to {MOST_MM}")


def _limited(travelled_mm: int) -> int:
    return min(max(travelled_mm, -MOST_MM), MOST_MM)
