"""Smoothing: matching of a window by later windows too, of the whole drive or of the next N.

The metric of a place is the cost of the cheapest path that ends there. The filter run backwards
gives the cost to go: that of the cheapest path from there to the end of the drive. Their sum is the
cost of the best path of the whole drive through this place, the min-plus form of forward-backward
smoothing. Fixed-lag smoothing does this for each window and the N after it: each match then comes N
windows late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.matching.filter_match import MISFIT, PLACE, TRUST, FilterMatch
from edge_vpr.matching.place_filter import WindowRows, write_match
from edge_vpr.matching.prediction import (
    FilterTable,
    Metrics,
    Narrow,
    Transitions,
    Travelled,
    move,
    write_costs,
)
from edge_vpr.matching.search import least_and_second
from edge_vpr.matching.trust import (
    BEFORE_FIRST,
    TRUST_FRACTION_BITS,
    set_numbers,
    window_misfit,
    write_trust,
)

#: Fields of `FilterMatch`, shape (m, 7), and costs of the best path through each place, (m, K).
Late = tuple[npt.NDArray[np.int64], Metrics]


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


def _travel_back(
    transitions: Transitions,
    next_cost_to_go: npt.NDArray[np.int16],
    distance: int,
    cost_to_go: npt.NDArray[np.int16],
) -> None:
    """Compute the cost to go by odometry instead of steps; see `backward_step`."""
    cost_to_go[:] = transitions.by_distance(next_cost_to_go.astype(np.int32), distance, back=True)


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


# The whole drive.


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
    costs = np.empty((len(table.costs), cost_to_go.size), dtype=np.int16)
    for i in range(len(rows.metrics) - 1, -1, -1):
        row, evidence = rows.columns[i], rows.evidence[i]
        margin = match_summed(rows.metrics[i], cost_to_go, table.exclusion, row)
        row[TRUST] = margin << TRUST_FRACTION_BITS
        row[MISFIT] = window_misfit(
            evidence, row[PLACE], table.typical, rows.factor[i], rows.share[i]
        )
        write_costs(table, np.int64(rows.activity[i]), costs)
        backward_step(cost_to_go, next_cost_to_go, table, costs, evidence)


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


# The next N windows.


#: State of `HeldWindows`: the number of the first held window, how many are held, and the state
#: after the match before them.
HELD = np.dtype([(name, np.int64) for name in ("first", "windows", *BEFORE_FIRST)])


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
        numbers = np.zeros(1, dtype=HELD)
        set_numbers(numbers, BEFORE_FIRST)
        steps = len(transitions.table.costs)
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
) -> None:
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
    """
    now, cost_to_go, room = held.numbers[0], held.cost_to_go, len(held.metrics)
    places = cost_to_go.size
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
        columns = np.empty((number, len(FilterMatch._fields)), dtype=np.int64)
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
        now = held.numbers[0]
        first, windows, place = int(now.first), int(now.windows), int(now.place)
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
