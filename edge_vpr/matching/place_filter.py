"""The place filter: Viterbi's algorithm over places and camera gains, in fixed-width integers.

It is the min-plus form of a discrete Bayes filter. A window has more events if the robot drives
faster, and also if light, lens or thresholds of the camera give more of them. The filter therefore
follows seven hypotheses of this gain side by side. Each place has a metric for each of them: the
cost of the cheapest path that ends there in the current window with this gain. `match_window` is
the algorithm: see, predict, evidence, best, trust, by the names of the specification, of `filter.h`
and of the core's units. `smoothing` adds the costs of a backward pass from later windows.

With one gain, the number of events is compared with its running mean instead of the reference's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.compiling import kernel
from edge_vpr.descriptors.activity import (
    activity_of,
    activity_of_drive,
    is_pause,
    log_activity,
    log_of_mean,
    mean_activity_after,
    place_activity,
)
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import typical_distances
from edge_vpr.matching.evidence import (
    FEW,
    SPEED_SHIFT,
    add,
    evidence_of_sum,
    speed_after,
    sum_by_distance,
    sum_of,
    weight_of,
)
from edge_vpr.matching.match import MATCH_DTYPE, Match, write_distances
from edge_vpr.matching.prediction import (
    GAIN_STEP,
    LANES,
    METRIC_TOP,
    SAME_GAIN,
    FilterTable,
    Metrics,
    Narrow,
    TransitionCosts,
    Transitions,
    least_of_places,
    predict,
)
from edge_vpr.matching.search import least_and_second
from edge_vpr.matching.trust import (
    FIRST_MISFIT,
    WHOLE_AGE,
    margin_of,
    reported_misfit,
    residual_of,
    support_after,
    trust_of,
    update_misfit,
    window_misfit,
)
from edge_vpr.settings import Settings
from fixedpoint.activity import EVENTS_TOP, LOG_TOP, SUMS, WEIGHT_BITS

# State, and the results of windows.


#: after more windows with few events in a row, the robot stands: live, and in a smoothed drive
PATIENCE, PATIENCE_SMOOTHED = 2, 8
#: the match is the middle of the places whose metric is at most so much above the best
NEAR = 8
#: activity of a window in which the robot stands: it has the costs of the lowest row at any place
STANDS = -4 * LOG_TOP
#: `predicted_for` before there is a prediction, and weights by distance where it is by steps
NOT_PREDICTED, BY_STEPS = 4 * LOG_TOP, -1
#: Numbers of a filter between two windows, and their values before the first; see `PlaceFilter`.
BEFORE_FIRST = {
    "place": -1, "gain": 0, "few": 0, "speed": 0, "moved": 0, "support": 0, "age": 0,
    "residual": 0, "residual_before": 0, "running_misfit": FIRST_MISFIT,
    "predicted_for": NOT_PREDICTED, "weight_by_distance": BY_STEPS, "weight_before": BY_STEPS,
}  # fmt: skip
NUMBERS = np.dtype(
    [(name, np.int64) for name in ("mean_activity", "mean_log", "patience", *BEFORE_FIRST)]
)


class FilterState(NamedTuple):
    """State of a `PlaceFilter`, which its kernels update in place.

    Row 0 is the state after the last finished window, row 1 that after the current one.

    Attributes
    ----------
    numbers : ndarray of NUMBERS, shape (2,)
        See `PlaceFilter`.
    reciprocal : ndarray of int64, shape (2, sums)
        ``floor(2**16 / spread)`` of the distances of each sum of windows, which scales the evidence
        of the next window; 0 if it was not needed.
    metric : ndarray of int16, shape (K, LANES)
        Metrics after the window before, for each hypothesis.
    prediction : ndarray of int16, shape (K, LANES)
        Cost of each place and hypothesis in this window, without its evidence.
    follows : ndarray of bool, shape (K,)
        Which places are reachable from the latest match, if the prediction is by odometry.
    """

    numbers: Any
    reciprocal: npt.NDArray[np.int64]
    metric: Narrow
    prediction: Narrow
    follows: npt.NDArray[np.bool_]


class WindowRows(NamedTuple):
    """Results of n windows, written by `match_windows`.

    Attributes
    ----------
    matches : ndarray of MATCH_DTYPE, shape (n,)
        Without times, number of events, and probability.
    least : ndarray of int32, shape (n, K)
        Least metric of each place after each window.
    metrics : ndarray of int16, shape (n, K, LANES)
        Metrics after each window.
    evidence : ndarray of uint8, shape (n, sums, K)
        Evidence of each sum of windows.
    sums : ndarray of int64, shape (n, LANES)
        Sum that each hypothesis looks at.
    activity : ndarray of int64, shape (n,)
        Activity of each window, or `STANDS`.
    factor : ndarray of int64, shape (n, sums)
        Evidence per unit of distance, in units of 2**-17; 0 in a pause.
    share : ndarray of int64, shape (n,)
        Weight of the evidence that odometry leaves, in units of 1/8; 8 without odometry.
    best : ndarray of int64, shape (n, 2)
        Best place and its hypothesis.
    """

    matches: npt.NDArray[np.void]
    least: Metrics
    metrics: Narrow
    evidence: npt.NDArray[np.uint8]
    sums: npt.NDArray[np.int64]
    activity: npt.NDArray[np.int64]
    factor: npt.NDArray[np.int64]
    share: npt.NDArray[np.int64]
    best: npt.NDArray[np.int64]

    @classmethod
    def empty(cls, windows: int, sums: int, places: int) -> WindowRows:
        """Return rows to be written."""
        return cls(
            np.zeros(windows, dtype=MATCH_DTYPE),
            np.empty((windows, places), dtype=np.int32),
            np.empty((windows, places, LANES), dtype=np.int16),
            np.empty((windows, sums, places), dtype=np.uint8),
            np.empty((windows, LANES), dtype=np.int64),
            np.empty(windows, dtype=np.int64),
            np.empty((windows, sums), dtype=np.int64),
            np.empty(windows, dtype=np.int64),
            np.empty((windows, 2), dtype=np.int64),
        )

    def part(self, first: int, last: int) -> WindowRows:
        """Return the rows of the windows from `first` to before `last`, in the same memory."""
        return WindowRows(*(column[first:last] for column in self))  # type: ignore[arg-type]


# The algorithm: five steps a window, which the specification and the device name alike.


@kernel(inline="always")  # or it would be compiled apart from the loop that calls it, too
def match_window(
    state: FilterState,
    table: FilterTable,
    distances: npt.NDArray[np.integer],
    events: int,
    rows: WindowRows,
    i: int,
) -> None:
    """Match a window, finished or not; `end_window` then advances the filter.

    Parameters
    ----------
    state : FilterState
        Row 1 becomes the state after this window. The prediction is kept for the next call for the
        same window.
    distances : ndarray of int, shape (sums, K)
        Of the sums of the newest windows. Only differences matter: adding a constant to a row
        changes nothing.
    events : int
        Counted events of the window, see `codes.counted_events`.
    rows : WindowRows
        The result is written to row `i`.
    """
    hypotheses, before = table.gains.size, state.numbers[0]
    seen = see(state.numbers, table, events)
    rows.activity[i] = seen.activity
    if seen.by_steps and before.predicted_for != seen.activity:
        predict(state.metric, table, seen.activity, state.prediction)
        before.predicted_for = seen.activity
    evidence(state, table, distances, seen, rows, i)
    # not a constant, for which Numba would compile another version
    most, metrics = np.int64(METRIC_TOP), rows.metrics[i]
    add(state.prediction, rows.evidence[i], rows.sums[i], hypotheses, most, metrics)
    nearest = best(metrics, table, rows.least[i], rows.matches[i])
    rows.best[i, 0], rows.best[i, 1] = nearest.place, nearest.gain
    trust(state, table, nearest, rows, i)


@kernel(inner=True)
def end_window(state: FilterState, metrics: Narrow) -> None:
    """Advance the filter to the next window, with the metrics that `match_window` wrote."""
    state.numbers[0] = state.numbers[1]
    for s in range(state.reciprocal.shape[1]):
        state.reciprocal[0, s] = state.reciprocal[1, s]
    after, metric = state.metric.flat, metrics.flat
    for j in range(metrics.size):
        after[j] = metric[j]


@kernel
def match_windows(
    state: FilterState,
    table: FilterTable,
    distances: npt.NDArray[np.integer],
    events: npt.NDArray[np.int64],
    rows: WindowRows,
) -> None:
    """Match n finished windows, one after the other.

    Parameters
    ----------
    state : FilterState
        State before the first window; updated in place.
    distances : ndarray of int, shape (n, sums, K)
        From the sums of the newest windows to each place.
    events : ndarray of int64, shape (n,)
        Counted events of each window.
    rows : WindowRows
        Results of the n windows.
    """
    for i in range(len(distances)):
        match_window(state, table, distances[i], events[i], rows, i)
        end_window(state, rows.metrics[i])


# 1. See: what the number of events says. The prediction, step 2, has a module of its own.


class Seen(NamedTuple):
    """What the number of events of a window says."""

    paused: bool  #: Whether the window has too few events for any evidence.
    weight: int  #: Of the evidence, in units of 1/8.
    activity: int  #: Of the window, or `STANDS`.
    by_steps: bool  #: Whether places are predicted by steps: not at first, nor with odometry.


@kernel(inner=True)
def see(numbers: Any, table: FilterTable, events: int) -> Seen:
    """Return what the number of events says; begin row 1 of the numbers with it.

    Parameters
    ----------
    numbers : ndarray of NUMBERS, shape (2,)
        See `FilterState`.
    events : int
        Counted events of the window.
    """
    before, now = numbers[0], numbers[1]
    numbers[1] = before
    if before.mean_log < 0:
        activity = activity_of(events, before.mean_activity)
    elif events == 0:
        activity = np.int64(-LOG_TOP)
    else:
        activity = log_activity(min(events, EVENTS_TOP)) - before.mean_log
    paused, weight, few = is_pause(events, before.mean_activity), 1 << WEIGHT_BITS, False
    if before.place >= 0:
        surplus = activity - table.activity[before.place] - min(table.gains[before.gain], 0)
        weight, few = weight_of(surplus), surplus < -FEW
    few = few or paused
    now.few = min(before.few + 1, before.patience + 1) if few else 0
    if not few:
        now.speed = speed_after(before.speed, before.moved, activity)
        now.moved = min(before.moved + 1, (1 << SPEED_SHIFT) - 1)
    now.mean_activity = mean_activity_after(before.mean_activity, events)
    now.predicted_for, now.weight_by_distance = NOT_PREDICTED, BY_STEPS
    now.weight_before = before.weight_by_distance
    by_steps = before.place >= 0 and before.weight_by_distance == BY_STEPS
    return Seen(paused, weight, STANDS if now.few > before.patience else activity, by_steps)


# 3. Evidence of each sum of windows.


@kernel(inner=True)
def evidence(
    state: FilterState,
    table: FilterTable,
    distances: npt.NDArray[np.integer],
    seen: Seen,
    rows: WindowRows,
    i: int,
) -> None:
    """Write the evidence of each sum that a hypothesis looks at."""
    weight, most = seen.weight, state.numbers[0].weight_by_distance
    rows.share[i] = 1 << WEIGHT_BITS
    if most != BY_STEPS:
        weight = min(seen.weight, most)
        rows.share[i] = (weight << WEIGHT_BITS) // max(seen.weight, 1)
    farthest = max(most, state.numbers[0].weight_before)  # this window may have only begun
    for h in range(LANES):
        rows.sums[i, h] = 0
    if len(distances) > 1:
        for h in range(table.gains.size):
            by_speed = sum_of(state.numbers[1].speed, table.gains[h])
            rows.sums[i, h] = by_speed if most == BY_STEPS else sum_by_distance(farthest)
    for s in range(len(distances)):
        used, against = False, rows.evidence[i, s]
        for h in range(table.gains.size):
            used = used or rows.sums[i, h] == s
        rows.factor[i, s] = 0
        state.reciprocal[1, s] = state.reciprocal[0, s] if seen.paused else 0
        if used and not seen.paused:
            scale, own = evidence_of_sum(
                distances[s], table.bias, state.reciprocal[0, s], weight, against
            )
            rows.factor[i, s], state.reciprocal[1, s] = scale * weight, own
        else:
            for k in range(against.size):
                against[k] = 0


# 4. Best: the place and gain of the least metric, and the middle of the places near it.


class Best(NamedTuple):
    """Place and hypothesis of the least metric, and how much the second-best place has above it."""

    place: int
    gain: int
    margin: int


@kernel(inner=True)
def best(metric: Narrow, table: FilterTable, least: Metrics, row: Any) -> Best:
    """Write a match without its trust and misfit.

    Parameters
    ----------
    metric : ndarray of int16, shape (K, LANES)
        Cost of each place and hypothesis.
    least : ndarray of int32, shape (K,)
        Output: the least metric of each place.
    row : record of MATCH_DTYPE
        Output.
    """
    least_of_places(metric, least)
    place, second, ties = least_and_second(least, table.exclusion)
    first, last, most = place, place, least[place] + NEAR
    while first > max(place - table.reach, 0) and least[first - 1] <= most:
        first -= 1
    while last < min(place + table.reach, least.size - 1) and least[last + 1] <= most:
        last += 1
    row["place"], row["second"], row["ties"] = (first + last + 1) >> 1, second, ties
    write_distances(row, least[place], least[second] if second >= 0 else np.int32(-1), 1)
    gain = 0
    while metric[place, gain] > least[place]:
        gain += 1
    return Best(place, gain, margin_of(least, place, second))


# 5. Trust: how sure the match is, and how well its view fits.


@kernel(inner=True)
def trust(state: FilterState, table: FilterTable, nearest: Best, rows: WindowRows, i: int) -> None:
    """Write the trust in a match and its misfit, and the state after it."""
    before, now, row = state.numbers[0], state.numbers[1], rows.matches[i]
    place, of_sum = nearest.place, rows.sums[i, nearest.gain]
    if before.weight_by_distance != BY_STEPS:
        follows = state.follows[place]
    else:
        follows = before.place >= 0 and 0 <= place - before.place < len(table.costs)
    against, factor = rows.evidence[i, of_sum], rows.factor[i, of_sum]
    kept, residual = before.support if follows else 0, residual_of(against[place])
    now.support = support_after(kept, place == before.place, nearest.margin)
    now.age = min(before.age + 1, WHOLE_AGE) if follows else 0
    worst = max(residual, before.residual, before.residual_before)
    row["trust"] = trust_of(now.support, worst, now.age)
    of_window = window_misfit(against, place, table.typical, factor, rows.share[i])
    now.running_misfit = update_misfit(before.running_misfit, of_window, factor)
    row["misfit"] = reported_misfit(now.running_misfit)
    now.place, now.gain = place, nearest.gain
    now.residual, now.residual_before = residual, before.residual


# The filter of a map.


class PlaceFilter:
    """Place filter of a map, advanced window by window.

    Parameters
    ----------
    transitions : Transitions
        Transitions of the map.
    mean_activity : int
        Mean number of counted events per window of the reference, in units of 1/256 event; 0 if
        only windows without events are pauses.
    patience : int
        See `PATIENCE`.

    Attributes
    ----------
    state : FilterState
        The numbers are: `mean_activity`, the running mean of the counted events, by which a window
        is a pause; `mean_log`, the logarithm of the reference's mean, or -1 with one gain; `place`
        and `gain` of the best path (-1 before the first match); `few`, the windows with few events
        in a row; `speed`, the mean activity of the drive, and `moved`, the windows that moved it,
        see `speed_after`; `support`, `age`, `residual` and `residual_before`, see `trust_of`;
        `running_misfit`, see `update_misfit`; `predicted_for`, the activity that the prediction is
        for; `weight_by_distance`, that of the present window, and `weight_before`, that of the
        window before, or `BY_STEPS` without odometry; and `patience`.
    """

    def __init__(
        self, transitions: Transitions, mean_activity: int = 0, patience: int = PATIENCE
    ) -> None:
        self.transitions, places = transitions, transitions.places
        several = transitions.costs.gains > 1
        #: number of sums of windows whose distances the filter takes
        self.sums = len(SUMS) if several else 1
        numbers = np.zeros(2, dtype=NUMBERS)
        set_numbers(
            numbers,
            BEFORE_FIRST
            | {
                "mean_activity": mean_activity,
                "mean_log": log_of_mean(mean_activity) if several else -1,
                "patience": patience,
                "gain": SAME_GAIN if several else 0,
            },
        )
        self.state = FilterState(
            numbers.view(np.recarray),
            np.zeros((2, self.sums), dtype=np.int64),
            np.zeros((places, LANES), dtype=np.int16),
            np.zeros((places, LANES), dtype=np.int16),
            np.zeros(places, dtype=np.bool_),
        )

    @classmethod
    def of(
        cls,
        places: Descriptors,
        settings: Settings,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> PlaceFilter:
        """Return the place filter of a map, before its first window.

        Parameters
        ----------
        places : Descriptors
            Descriptors of the map, in its codes.
        along_mm : ndarray of int64, shape (K,), optional
            See `Transitions`.
        """
        events, number = places.counted_events, settings.window_parts
        transitions = Transitions(
            len(places), TransitionCosts.of(settings), place_activity(events, number),
            along_mm, typical_distances(places.counts), settings.exclusion_places,
        )  # fmt: skip
        patience = PATIENCE_SMOOTHED if settings.smooth else PATIENCE
        return cls(transitions, activity_of_drive(events[::number]), patience)

    def __len__(self) -> int:
        return len(self.state.metric)

    def update(self, distances: npt.NDArray[np.integer], events: int) -> Match:
        """Advance by a finished window, and return its match, of no time.

        Parameters
        ----------
        distances : ndarray of int, shape (sums, K), or (K,) with one gain
            From the sums of the newest windows to each place.
        events : int
            Counted events of the window.
        """
        rows = self.update_windows(
            np.atleast_2d(distances)[np.newaxis], np.array([events], dtype=np.int64)
        )
        match = Match(*rows.matches[0].tolist())
        return match._replace(events=events, probability=np.nan)

    def update_windows(
        self,
        distances: npt.NDArray[np.integer],
        events: npt.NDArray[np.int64],
        rows: WindowRows | None = None,
    ) -> WindowRows:
        """Advance by n finished windows, n at least 1, one after the other.

        Parameters
        ----------
        distances : ndarray of int, shape (n, sums, K)
            From the sums of the newest windows to each place.
        events : ndarray of int64, shape (n,)
            Counted events of each window.
        rows : WindowRows, optional
            Where the results are written; by default in new memory.
        """
        distances = self._checked(distances)
        rows = WindowRows.empty(*distances.shape) if rows is None else rows
        match_windows(self.state, self.transitions.table, distances, events, rows)
        return rows

    @property
    def place(self) -> int:
        """Best place of the latest window; -1 before the first."""
        return int(self.state.numbers[0].place)

    def to_arrays(self) -> Arrays:
        """Return the state between two windows by name, for an archive or `resume`."""
        return {
            "filter_numbers": np.array(self.state.numbers[0].tolist(), dtype=np.int64),
            "filter_reciprocal": self.state.reciprocal[0].copy(),
            "filter_metric": self.state.metric.astype(np.uint8),
        }

    def resume(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Continue from the arrays of `to_arrays` of another filter with the same map and costs."""
        names = NUMBERS.names or ()
        numbers = arrays["filter_numbers"].tolist()
        set_numbers(self.state.numbers, dict(zip(names, numbers, strict=True)) | _UNPREDICTED)
        self.state.reciprocal[:] = arrays["filter_reciprocal"]
        self.state.metric[:] = arrays["filter_metric"]
        self.state.prediction[:] = 0  # as before the first window

    def unseen(self, halves: int) -> None:
        """Allow the robot to be anywhere that unseen time allows, with no evidence for any place.

        Parameters
        ----------
        halves : int
            Of a window, see `UnseenTime`; in each, the robot may have driven on by a window of the
            map, which is twice its speed.
        """
        self.transitions.spread(self.state.metric, halves)
        set_numbers(self.state.numbers, {"support": 0, "age": 0} | _UNPREDICTED)

    def predict_travelled(self, travelled_mm: int, driven_mm: int) -> None:
        """Predict by odometry instead of steps until the window ends, from every gain to its own.

        Parameters
        ----------
        travelled_mm : int
            Distance that `Odometer` counts from the end of the window before to now or to the end
            of this window, in millimetres; negative when driving backwards.
        driven_mm : int
            The whole driven distance.
        """
        state, transitions = self.state, self.transitions
        hypotheses = transitions.table.gains.size
        least = state.metric[:, :hypotheses].min(axis=1).astype(np.int32)
        prediction = transitions.by_distance(least, travelled_mm)
        if self.place >= 0:
            state.prediction[:] = prediction[:, None] + GAIN_STEP
            state.prediction[:, int(state.numbers[0].gain)] = prediction
            state.follows[:] = transitions.following(self.place, travelled_mm)
            weight = transitions.weight_by_distance(driven_mm)
            state.numbers[0].weight_by_distance = weight

    def _checked(self, distances: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
        if distances.shape[1:] != (self.sums, len(self)):
            raise UsageError(
                f"distances of shape {distances.shape[1:]} a window: expected {self.sums} sums of "
                f"windows to {len(self)} places"
            )
        if distances.dtype.kind not in "iu":
            raise UsageError(
                f"distances are {distances.dtype}: give whole numbers, for example multiplied by "
                "1,000 and rounded"
            )
        # the kernel is compiled for the types of recorded drives and streams, and for int64
        taken = distances.dtype in (np.int32, np.uint16, np.uint32)
        return np.ascontiguousarray(distances, dtype=distances.dtype if taken else np.int64)


_UNPREDICTED = {"predicted_for": NOT_PREDICTED, "weight_by_distance": BY_STEPS}


def set_numbers(numbers: npt.NDArray[Any], values: Mapping[str, int]) -> None:
    """Set fields of records by their names."""
    for name, value in values.items():
        numbers[name] = value
