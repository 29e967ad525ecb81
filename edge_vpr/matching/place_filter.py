"""The place filter: predicts from the places of the window before, updates with the distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.windows import activity_of, is_pause, mean_activity_after
from edge_vpr.errors import UsageError
from edge_vpr.matching.transitions import (
    FRACTION_BITS,
    METRIC_TOP,
    Metrics,
    StepTable,
    TransitionCosts,
    Transitions,
    leads_to,
    predict,
)
from fixedpoint.activity import LOG_TOP, WEIGHT_BITS, WEIGHT_FROM

# Integer arithmetic of one window of the place filter: spread, evidence, best places, trust.


#: largest evidence: 8 bits
EVIDENCE_TOP = (1 << 8) - 1
#: fraction bits of the reciprocal of the spread
RECIPROCAL_BITS = 16
#: support, in units of 1/16 of a margin, moves by 1/4 of the difference in each window
TRUST_SHIFT, TRUST_BITS = 2, 4
#: while the place stays the same, support falls by 1/16 in each window
STANDING_SHIFT = 4
#: larger margins and misfits count as this, so that one window is not remembered for long: 5 bits
MARGIN_TOP = MISFIT_TOP = 23
#: largest support and largest trust: 9 bits
TRUST_TOP = MARGIN_TOP << TRUST_BITS


@kernel
def support_after(kept: int, stands: bool, margin: int) -> int:
    """Return the support of a match after a window: a running mean of its margins.

    While the robot stands, it sees the same view again and learns nothing new. The support then
    falls by 1/16 in each window.

    Parameters
    ----------
    kept : int
        Support of the window before; 0 where this match does not follow from that one.
    stands : bool
        Whether the place is that of the window before.
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


@kernel
def trust_of(support: int, misfit: int) -> int:
    """Return the trust in a match: its support less the misfit of the matched place.

    A path that has become wrong still has the support of earlier windows, but the places along it
    no longer fit what is seen.

    Parameters
    ----------
    support : int
        See `support_after`.
    misfit : int
        Largest `misfit_of` of this window and the two before it.

    Returns
    -------
    int
        0 to `TRUST_TOP`.
    """
    return max(int(support) - (int(misfit) << TRUST_BITS), 0)


@kernel
def misfit_of(evidence: int) -> int:
    """Return the evidence against the matched place, limited to `MISFIT_TOP`."""
    return min(int(evidence), MISFIT_TOP)


@kernel
def reciprocal_of_spread(distances: npt.NDArray[np.integer]) -> int:
    """Return ``floor(2**16 / s)``, with s the mean absolute deviation of the distances.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        Of a window to each place.

    Returns
    -------
    int
        s is rounded down, as is the mean that it is taken from, and at least 1.
    """
    total = np.int64(0)
    for distance in distances:
        total += np.int64(distance)
    mean = total // distances.size
    spread = np.int64(0)
    for distance in distances:
        spread += abs(np.int64(distance) - mean)
    return (1 << RECIPROCAL_BITS) // max(int(spread) // distances.size, 1)


@kernel
def weight_of(activity: int) -> int:
    """Return the weight of the evidence of a window, in units of 1/8.

    A camera that hardly moves sees the same view again, by fewer events.
    """
    return min(max((activity - WEIGHT_FROM) >> 1, 0), 1 << WEIGHT_BITS)


@kernel
def evidence_of(
    distances: npt.NDArray[np.integer],
    reciprocal: int,
    weight: int,
    evidence: npt.NDArray[np.uint8],
) -> None:
    """Write ``E = min((D - min D) / s, 255) * weight``, in fraction bits.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        What all of them have in common does not matter.
    reciprocal : int
        Of s, see `reciprocal_of_spread`; 0 of a spread above 2**16: nothing is evidence then.
    weight : int
        See `weight_of`.
    evidence : ndarray of uint8, shape (K,)
        Written to.
    """
    shift = RECIPROCAL_BITS - FRACTION_BITS
    # a larger difference gives the largest evidence anyway, and this product fits into 32 bits
    most = np.int64((EVIDENCE_TOP << shift) // max(reciprocal, 1) + 1)
    least = np.int64(distances[0])
    for distance in distances:
        least = min(least, np.int64(distance))
    factor = np.int32(reciprocal)
    for k in range(evidence.size):
        difference = np.int32(min(np.int64(distances[k]) - least, most))
        unweighted = (difference * factor) >> shift
        evidence[k] = (min(unweighted, np.int32(EVIDENCE_TOP)) * weight) >> WEIGHT_BITS


@kernel
def least_and_second(metric: Metrics, exclusion: int) -> tuple[int, int, int]:
    """Return the place of the lowest metric, the best one outside its zone or -1, and ties."""
    best, ties = _first_least(metric, 0, metric.size), -1
    for k in range(metric.size):
        ties += metric[k] == metric[best]
    before = _first_least(metric, 0, best - exclusion)
    second = _first_least(metric, best + exclusion + 1, metric.size)
    if before >= 0 and (second < 0 or metric[before] <= metric[second]):
        second = before
    return best, second, ties


@kernel
def margin_of(metric: Metrics, place: int, second: int) -> int:
    """Return the second-best less the best metric; the largest value if there is no second."""
    if second < 0:
        return METRIC_TOP
    return int(metric[second]) - int(metric[place])


@kernel
def _first_least(metric: Metrics, begin: int, end: int) -> int:
    """Return the first place of the lowest metric in a range; -1 if the range is empty."""
    if begin >= end:
        return -1
    # two loops: the first compiles to vector instructions, the second ends early
    least = metric[begin]
    for k in range(begin, end):
        least = min(least, metric[k])
    k = begin
    while metric[k] != least:
        k += 1
    return k


# The place filter's recursion over many windows in one call, forwards and backwards.


#: State of a filter between two windows, in addition to its metrics; see `PlaceFilter`.
NUMBER_NAMES = ("reciprocal", "mean_activity", "place", "support", "misfit", "misfit_before")
#: with the activity for which the prediction holds, or one of the two below
NUMBERS = np.dtype([(name, np.int64) for name in (*NUMBER_NAMES, "predicted_for")])
#: there is no prediction yet; it is by odometry, and holds for any activity
NOT_PREDICTED, BY_DISTANCE = -2 * LOG_TOP, 2 * LOG_TOP


class FilterState(NamedTuple):
    """Arrays of a `PlaceFilter`, which its kernels update in place.

    Attributes
    ----------
    numbers : ndarray of NUMBERS, shape (1,)
        Of `NUMBER_NAMES`, and the activity that the prediction holds for.
    metric : ndarray of int32, shape (K,)
        After the window before.
    prediction : ndarray of int32, shape (K,)
        Cost of being at each place in this window, without its evidence.
    follows : ndarray of bool, shape (K,)
        Which places follow from the latest match, if the prediction is by odometry.
    """

    numbers: Any
    metric: Metrics
    prediction: Metrics
    follows: npt.NDArray[np.bool_]


class WindowRows(NamedTuple):
    """Results of n windows, written by `update_windows`.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 6)
        Of `FilterMatch`.
    metrics : ndarray of int32, shape (n, K)
        After each window.
    evidence : ndarray of uint8, shape (n, K)
        Which each window added.
    activity : ndarray of int32, shape (n,)
        Of each window, see `activity_of`.
    """

    columns: npt.NDArray[np.int64]
    metrics: Metrics
    evidence: npt.NDArray[np.uint8]
    activity: npt.NDArray[np.int32]

    @classmethod
    def empty(cls, windows: int, places: int) -> WindowRows:
        """Return uninitialised rows."""
        return cls(
            np.empty((windows, 6), dtype=np.int64),
            np.empty((windows, places), dtype=np.int32),
            np.empty((windows, places), dtype=np.uint8),
            np.empty(windows, dtype=np.int32),
        )

    def part(self, first: int, last: int) -> WindowRows:
        """Return the rows of the windows from `first` to before `last`, in the same memory."""
        return WindowRows(
            self.columns[first:last], self.metrics[first:last], self.evidence[first:last],
            self.activity[first:last],
        )  # fmt: skip

    def take(self, others: WindowRows) -> None:
        """Copy the rows of as many other windows."""
        self.columns[:], self.metrics[:] = others.columns, others.metrics
        self.evidence[:], self.activity[:] = others.evidence, others.activity


@kernel
def update_windows(
    state: FilterState,
    steps: StepTable,
    exclusion: int,
    distances: npt.NDArray[np.integer],
    events: npt.NDArray[np.int64],
    rows: WindowRows,
) -> None:
    """Advance the filter by n finished windows, one after the other.

    Parameters
    ----------
    state : FilterState
        Before the first window; after the call, after the last.
    exclusion : int
        Of `PlaceFilter`.
    distances : ndarray of int, shape (n, K)
        Of each window to each place.
    events : ndarray of int64, shape (n,)
        At the selected pixels in each window.
    rows : WindowRows
        Written to.
    """
    now = state.numbers[0]
    for i in range(len(distances)):
        row = rows.columns[i]
        rows.activity[i] = activity_of(events[i], now.mean_activity)
        support, misfit = match_window(
            state, steps, exclusion, distances[i], events[i], rows.evidence[i], rows.metrics[i], row
        )
        if not is_pause(events[i], now.mean_activity):
            now.reciprocal = reciprocal_of_spread(distances[i])
        now.mean_activity = mean_activity_after(now.mean_activity, events[i])
        now.place, now.support = row[0], support
        now.misfit_before = now.misfit
        now.misfit = misfit
        now.predicted_for = NOT_PREDICTED
        for k in range(state.metric.size):
            state.metric[k] = rows.metrics[i, k]


@kernel
def match_window(
    state: FilterState,
    steps: StepTable,
    exclusion: int,
    distances: npt.NDArray[np.integer],
    events: int,
    evidence: npt.NDArray[np.uint8],
    metric: Metrics,
    row: npt.NDArray[np.int64],
) -> tuple[int, int]:
    """Match a window, finished or not, without advancing the filter.

    Parameters
    ----------
    state : FilterState
        Only its prediction is changed, which the next call for this window may use again.
    distances : ndarray of int, shape (K,)
        What all of them have in common does not matter.
    events : int
        At the selected pixels in the window.
    evidence : ndarray of uint8, shape (K,)
        Written to: what the window adds at each place.
    metric : ndarray of int32, shape (K,)
        Written to: the metric of each place.
    row : ndarray of int64, shape (6,)
        Of `FilterMatch`; all three are written to.

    Returns
    -------
    support, misfit : int
        Of the match.
    """
    now = state.numbers[0]
    activity = activity_of(events, now.mean_activity)
    if now.predicted_for != activity and now.predicted_for != BY_DISTANCE:
        if now.place >= 0:
            predict(state.metric, steps, activity, False, state.prediction)
        now.predicted_for = activity
    scale, weight = now.reciprocal, 0
    if not is_pause(events, now.mean_activity):
        weight = weight_of(activity)
        if scale == 0:
            scale = reciprocal_of_spread(distances)
    evidence_of(distances, scale, weight, evidence)
    for k in range(metric.size):
        metric[k] = min(state.prediction[k] + np.int32(evidence[k]), METRIC_TOP)
    place, second, ties = least_and_second(metric, exclusion)
    if now.predicted_for == BY_DISTANCE:
        follows = state.follows[place]
    else:
        follows = now.place >= 0 and leads_to(
            now.place, place, steps.first, steps.last, steps.jumps
        )
    margin = write_match(metric, place, second, ties, row)
    support = support_after(now.support if follows else 0, place == now.place, margin)
    misfit = misfit_of(evidence[place])
    row[5] = trust_of(support, max(misfit, now.misfit, now.misfit_before))
    return support, misfit


@kernel
def write_match(
    metric: Metrics, place: int, second: int, ties: int, row: npt.NDArray[np.int64]
) -> int:
    """Write a match without its trust, and return its margin.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        Cost of each place.
    place, second, ties : int
        Of `least_and_second`.
    row : ndarray of int64, shape (6,)
        Of `FilterMatch`; written to.
    """
    row[0], row[1], row[2], row[3], row[4] = place, metric[place], second, -1, ties
    if second >= 0:
        row[3] = metric[second]
    return margin_of(metric, place, second)


@kernel
def smooth_windows(
    onward: Metrics,
    ahead: Metrics,
    steps: StepTable,
    exclusion: int,
    activity: npt.NDArray[np.int32],
    evidence: npt.NDArray[np.uint8],
    summed: Metrics,
    columns: npt.NDArray[np.int64],
) -> None:
    """Add the costs of the rest of the drive to the metrics of n windows, from the last window.

    Parameters
    ----------
    onward : ndarray of int32, shape (K,)
        Cost of going on from each place after the last of these windows; after the call, before
        the first.
    ahead : ndarray of int32, shape (K,)
        Written to: the cost of going on from the first window, with its own evidence.
    activity, evidence
        See `WindowRows`.
    summed : ndarray of int32, shape (n, K)
        Metrics; after the call, the cost of the best path through each place.
    columns : ndarray of int64, shape (n, 6)
        Of `FilterMatch`, written to; its trust is the margin, in units of 1/16 of a metric.
    """
    for i in range(len(summed) - 1, -1, -1):
        columns[i, 5] = match_summed(summed[i], onward, exclusion, columns[i])
        go_back(onward, ahead, steps, activity[i], evidence[i])


@kernel
def match_summed(
    metric: Metrics, onward: Metrics, exclusion: int, row: npt.NDArray[np.int64]
) -> int:
    """Add the cost of the rest of the drive to the metric of a window, and match it by the sum.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
        After the call, the cost of the best path through each place.
    onward : ndarray of int32, shape (K,)
        Cost of going on from each place.
    row : ndarray of int64, shape (6,)
        Of `FilterMatch`, written to but for its trust.

    Returns
    -------
    int
        The margin, in units of 1/16 of a metric.
    """
    for k in range(metric.size):
        metric[k] += onward[k]
    place, second, ties = least_and_second(metric, exclusion)
    return write_match(metric, place, second, ties, row) << TRUST_BITS


@kernel
def go_back(
    onward: Metrics,
    ahead: Metrics,
    steps: StepTable,
    activity: int,
    evidence: npt.NDArray[np.uint8],
) -> None:
    """Change the cost of going on from each place, from after a window to before it.

    Parameters
    ----------
    onward : ndarray of int32, shape (K,)
        Cost of going on from each place.
    ahead : ndarray of int32, shape (K,)
        Written to: the cost after the window before, with the evidence of this window.
    evidence : ndarray of uint8, shape (K,)
        Of this window, see `WindowRows`.
    """
    for k in range(ahead.size):
        ahead[k] = onward[k] + np.int32(evidence[k])
    predict(ahead, steps, activity, True, onward)


# The place filter: finds the place from the newest window and the possible moves before it.
#
# This is Viterbi's algorithm over the places of a route (the min-plus form of a discrete Bayes
# filter), in unsigned integers of fixed widths. Each place has one metric: the cost of the
# cheapest way to be there now. Each window adds the cost of a move from the place before, and
# evidence.


class FilterMatch(NamedTuple):
    """Match of the filter after a window.

    Attributes
    ----------
    place : int
        Place of the least metric; the lowest of equals.
    second, second_metric : int
        Least metric outside the exclusion zone; -1 if nothing lies outside.
    ties : int
        Other places of the same least metric.
    trust : int
        How far to trust the match, 0 to 368: its support, which is a running mean of the margins
        (second metric less the least) of this window and those before, less its misfit, which is
        the largest evidence against the matched places of this window and the two before. See
        `support_after` and `trust_of`.
    """

    place: int
    metric: int
    second: int
    second_metric: int
    ties: int
    trust: int


class PlaceFilter:
    """Metrics of all places, advanced window by window.

    Parameters
    ----------
    places : int
        K.
    exclusion : int
        The second best is searched more than this many places from the best.
    mean_activity : int
        Events that a window of the reference has at the selected pixels on average, in units of
        1/256 event; 0 if only windows without events are pauses.
    place_activity, jumps, along_mm : ndarray, optional
        Of the map, see `Transitions`.

    Attributes
    ----------
    state : FilterState
        Its numbers: `reciprocal` is ``floor(2**16 / spread)`` of the window before and scales the
        evidence (0 before the first, and after a spread above 2**16: then the window's own does);
        `mean_activity`, how many events a window usually has; `place` and `support` of the latest
        match (the place is -1 before the first); `misfit` of the latest match and `misfit_before`
        of the one before it, see `trust_of`.
    """

    def __init__(
        self,
        places: int,
        costs: TransitionCosts,
        exclusion: int = 3,
        mean_activity: int = 0,
        *,
        place_activity: npt.NDArray[np.int32] | None = None,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> None:
        self.transitions = Transitions(places, costs, place_activity, jumps, along_mm)
        self.exclusion = exclusion
        numbers = np.array([(0, mean_activity, -1, 0, 0, 0, NOT_PREDICTED)], dtype=NUMBERS)
        metric, prediction = np.zeros((2, places), dtype=np.int32)
        self.state = FilterState(
            numbers.view(np.recarray), metric, prediction, np.zeros(places, dtype=np.bool_)
        )

    def __len__(self) -> int:
        return len(self.state.metric)

    def answer(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Return the match for an unfinished window, without advancing.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            Of the window to every place.
        events : int
            At the selected pixels in the window.

        Raises
        ------
        UsageError
            If there is not one distance of each place, or they are not integers.
        """
        distances, state = self._checked(distances[np.newaxis]), self.state
        rows = WindowRows.empty(1, len(self))
        match_window(
            state, self.transitions.by_step, self.exclusion, distances[0], events,
            rows.evidence[0], rows.metrics[0], rows.columns[0],
        )  # fmt: skip
        return FilterMatch(*rows.columns[0].tolist())

    def update(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Advance by a finished window, and return its match.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            Of the window to each place.
        events : int
            At the selected pixels in the window.
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
            Of each window to each place.
        events : ndarray of int64, shape (n,)
            At the selected pixels in each window.
        """
        distances = self._checked(distances)
        rows = WindowRows.empty(*distances.shape)
        update_windows(
            self.state, self.transitions.by_step, self.exclusion, distances, events, rows
        )
        return rows

    @property
    def place(self) -> int:
        """Place of the latest match; -1 before the first."""
        return self.numbers[NUMBER_NAMES.index("place")]

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the state other than the metrics, in the order of `NUMBER_NAMES`."""
        return tuple(self.state.numbers[0].tolist()[: len(NUMBER_NAMES)])

    def resume(self, metric: Metrics, numbers: Sequence[int]) -> None:
        """Continue from the state of another filter with the same map and costs.

        Parameters
        ----------
        metric : ndarray of int32, shape (K,)
            Cost of each place.
        numbers : sequence of int
            Of that filter.
        """
        self.state.metric[:] = metric
        self.state.prediction[:] = 0  # as before the first window
        self.state.numbers[0] = (*numbers, NOT_PREDICTED)

    def pauses(self, events: int) -> bool:
        """Return whether a window with `events` selected events is a pause."""
        return bool(is_pause(events, int(self.state.numbers[0].mean_activity)))

    def predict_travelled(self, travelled_mm: int) -> None:
        """Predict by odometry instead of steps until the window ends.

        Parameters
        ----------
        travelled_mm : int
            Millimetres from the end of the window before to now, or to the end of this one; below
            0 backwards.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        prediction = self.transitions.by_distance(self.state.metric, travelled_mm)
        if self.place >= 0:
            self.state.prediction[:] = prediction
            self.state.follows[:] = self.transitions.following(self.place, travelled_mm)
            self.state.numbers[0].predicted_for = BY_DISTANCE

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
        # the kernel is compiled for the distances of recorded drives, of streams, and any other
        known = distances.dtype in (np.int32, np.uint16, np.uint32)
        return np.ascontiguousarray(distances, dtype=distances.dtype if known else np.int64)
