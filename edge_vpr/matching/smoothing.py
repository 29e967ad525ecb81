"""Smoothing: matching of each window of a drive by the later windows too.

The metric of a place is the cost of the cheapest path that ends there. The filter run backwards
gives the cost to go: that of the cheapest path from there to the end of the drive. Their sum is the
cost of the best path of the whole drive through this place, the min-plus form of forward-backward
smoothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.matching.filter_match import MISFIT, PLACE, TRUST
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
from edge_vpr.matching.trust import TRUST_FRACTION_BITS, window_misfit


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

    def add_to(
        self, rows: WindowRows, travelled: Sequence[Travelled], unseen: Sequence[int]
    ) -> None:
        """Add the cost to go to the metrics of the n windows before those added so far.

        Parameters
        ----------
        rows : WindowRows
            Results of n windows, updated in place as by `smooth_windows`.
        travelled : sequence of int or None
            Driven distance of each window.
        unseen : sequence of int
            See `Descriptors`.
        """
        for first, last in reversed(list(runs(travelled, unseen, len(travelled)))):
            smooth_windows(
                self._cost_to_go, self._next_cost_to_go, self._transitions.table,
                rows.part(first, last),
            )  # fmt: skip
            distance = travelled[first]
            if distance is not None:
                _travel_back(self._transitions, self._next_cost_to_go, distance, self._cost_to_go)
            self._transitions.spread(self._cost_to_go, unseen[first], back=True)


def runs(
    travelled: Sequence[Travelled], unseen: Sequence[int], most: int
) -> Iterator[tuple[int, int]]:
    """Yield the start and end of runs of windows.

    Only the first window of each may have a known distance, or unseen time.

    Parameters
    ----------
    most : int
        Largest number of windows in a run.
    """
    begin = 0
    while begin < len(travelled):
        end = begin + 1
        while (
            end < len(travelled)
            and end - begin < most
            and travelled[end] is None
            and not unseen[end]
        ):
            end += 1
        yield begin, end
        begin = end
