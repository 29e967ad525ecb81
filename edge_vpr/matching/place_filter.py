"""The place filter: Viterbi's algorithm over the places of a route, in fixed-width integers.

It is the min-plus form of a discrete Bayes filter. Each place has one metric: the cost of the
cheapest path that ends there in the current window. In each window, the prediction adds the cost of
the step from place to place, and the update adds the evidence of the distances. `smoothing` adds
the costs of a backward pass from later windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
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
from edge_vpr.matching.evidence import evidence_of, reciprocal_of_spread, weight_of
from edge_vpr.matching.filter_match import (
    METRIC,
    PLACE,
    SECOND,
    SECOND_METRIC,
    TIES,
    FilterMatch,
)
from edge_vpr.matching.prediction import (
    METRIC_TOP,
    FilterTable,
    Metrics,
    Narrow,
    TransitionCosts,
    Transitions,
    predict,
)
from edge_vpr.matching.search import least_and_second
from edge_vpr.matching.trust import BEFORE_FIRST, margin_of, set_numbers, write_trust
from edge_vpr.settings import Settings
from fixedpoint.activity import LOG_TOP, WEIGHT_BITS

# State, and the results of windows.


#: State of a filter between two windows, in addition to its metrics; see `PlaceFilter`.
NUMBER_NAMES = ("reciprocal", "mean_activity", *BEFORE_FIRST)
#: `predicted_for` before there is a prediction, and `weight_by_distance` where it is by steps.
NOT_PREDICTED, BY_STEPS = -2 * LOG_TOP, -1
#: How the places of a window are predicted, with the values at its beginning: by steps, for the
#: activity `predicted_for`; or by odometry, for any activity, with a largest weight of evidence.
_UNPREDICTED = {"predicted_for": NOT_PREDICTED, "weight_by_distance": BY_STEPS}
NUMBERS = np.dtype([(name, np.int64) for name in (*NUMBER_NAMES, *_UNPREDICTED)])


class FilterState(NamedTuple):
    """State of a `PlaceFilter`, which its kernels update in place.

    Attributes
    ----------
    numbers : ndarray of NUMBERS, shape (1,)
        See `PlaceFilter`, and `_UNPREDICTED`.
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
        Fields of `FilterMatch`, see `filter_match`.
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
            np.empty((windows, len(FilterMatch._fields)), dtype=np.int64),
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


# One window: predict, update, match.


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
    by_distance = now.weight_by_distance != BY_STEPS
    if not by_distance and now.predicted_for != activity:
        if now.place >= 0:
            predict(state.metric, table, activity, state.prediction)
        now.predicted_for = activity
    scale, weight, share = now.reciprocal, 0, 1 << WEIGHT_BITS
    if not is_pause(events, now.mean_activity):
        weight = weight_of(activity)
        if by_distance:
            whole = weight
            weight = min(whole, now.weight_by_distance)
            share = (weight << WEIGHT_BITS) // max(whole, 1)
        if scale == 0:
            scale = reciprocal_of_spread(distances)
    evidence_of(distances, scale, weight, evidence)
    for k in range(metric.size):
        metric[k] = min(state.prediction[k] + np.int32(evidence[k]), METRIC_TOP)
    place, second, ties = least_and_second(metric, table.exclusion)
    margin = write_match(metric, place, second, ties, row)
    factor_and_share = (scale * weight, share)
    kept = write_trust(
        now, table, by_distance, state.follows, margin, evidence, factor_and_share, row
    )
    out.activity[i], (out.factor[i], out.share[i]) = activity, factor_and_share
    return kept


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
    out[PLACE], out[METRIC], out[TIES] = place, metric[place], ties
    out[SECOND], out[SECOND_METRIC] = second, -1
    if second >= 0:
        out[SECOND_METRIC] = metric[second]
    return margin_of(metric, place, second)


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
    now.predicted_for, now.weight_by_distance = NOT_PREDICTED, BY_STEPS
    for k in range(metric.size):
        state.metric[k] = metric[k]


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


# The filter of a map.


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
        numbers = np.zeros(1, dtype=NUMBERS)
        set_numbers(numbers, {"mean_activity": mean_activity} | BEFORE_FIRST | _UNPREDICTED)
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
        found = dict(zip(NUMBERS.names or (), self.state.numbers[0].tolist(), strict=True))
        return tuple(found[name] for name in NUMBER_NAMES)

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
        set_numbers(self.state.numbers, dict(zip(NUMBER_NAMES, numbers, strict=True)))
        set_numbers(self.state.numbers, _UNPREDICTED)

    def unseen(self, halves: int) -> None:
        """Let the robot be anywhere that unseen time allows, and nothing speak for any place.

        Parameters
        ----------
        halves : int
            Of a window, see `UnseenTime`; in each, the robot may have driven on by a window of the
            map, which is twice its speed.
        """
        self.transitions.spread(self.state.metric, halves)
        set_numbers(self.state.numbers, {"support": 0} | _UNPREDICTED)

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
            weight = self.transitions.weight_by_distance(driven_mm)
            self.state.numbers[0].weight_by_distance = weight

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
