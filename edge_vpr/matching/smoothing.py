"""Smoothing: matching of each window of a drive by the later windows too.

The metric of a place and gain is the cost of the cheapest path that ends there. The filter run
backwards gives the cost to go: that of the cheapest path from there to the end of the drive. Their
sum is the cost of the best path of the whole drive through this place, the min-plus form of
forward-backward smoothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.matching.evidence import add
from edge_vpr.matching.place_filter import WindowRows, best
from edge_vpr.matching.prediction import (
    UNUSED,
    FilterTable,
    Narrow,
    Transitions,
    Travelled,
    change_gains,
    move_on,
    subtract_least,
)
from edge_vpr.matching.trust import TRUST_FRACTION_BITS, window_misfit


def add_cost_to_go(
    cost_to_go: Narrow,
    transitions: Transitions,
    rows: WindowRows,
    travelled: Sequence[Travelled],
    unseen: Sequence[int],
) -> None:
    """Add the cost to go to the metrics of n windows, backwards over gaps and driven distances.

    Parameters
    ----------
    cost_to_go, rows
        See `smooth_windows`, which updates them.
    travelled : sequence of int or None
        Driven distance of each window.
    unseen : sequence of int
        See `Descriptors`.
    """
    table, next_cost_to_go = transitions.table, np.empty_like(cost_to_go)
    for first, last in reversed(list(runs(travelled, unseen, len(travelled)))):
        smooth_windows(cost_to_go, next_cost_to_go, table, rows.part(first, last))
        distance = travelled[first]
        if distance is not None:  # every gain leads to every gain
            least = next_cost_to_go[:, : table.gains.size].min(axis=1).astype(np.int32)
            moved = transitions.by_distance(least, distance, back=True)
            cost_to_go[:] = (moved - moved.min())[:, None]
        transitions.spread(cost_to_go, unseen[first], back=True)


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
    cost_to_go : ndarray of int16, shape (K, LANES)
        Cost of the rest of the drive from each place and gain after the last of these windows;
        updated in place to that before the first.
    next_cost_to_go : ndarray of int16, shape (K, LANES)
        Scratch; after the call, the cost to go after the first window plus the evidence of the
        first window.
    rows : WindowRows
        Updated in place: `least` becomes the least cost of the whole paths through each place, and
        `matches` and `best` the matches by it, with the margin as trust, in units of 1/16 of a
        metric, and `window_misfit` as misfit.
    """
    hypotheses = table.gains.size
    for i in range(len(rows.matches) - 1, -1, -1):
        row, sums, metric = rows.matches[i], rows.sums[i], rows.metrics[i]
        whole, to_go = metric.flat, cost_to_go.flat
        for j in range(metric.size):
            whole[j] += to_go[j]
        place, gain, margin = best(metric, table, rows.least[i], row)
        against, factor = rows.evidence[i, sums[gain]], rows.factor[i, sums[gain]]
        rows.best[i, 0], rows.best[i, 1] = place, gain
        row["trust"] = margin << TRUST_FRACTION_BITS
        row["misfit"] = window_misfit(against, place, table.typical, factor, rows.share[i])
        most = np.int64(UNUSED)
        add(cost_to_go, rows.evidence[i], sums, hypotheses, most, next_cost_to_go)
        move_on(next_cost_to_go, table, rows.activity[i], np.bool_(True), cost_to_go)
        subtract_least(cost_to_go)
        change_gains(cost_to_go, hypotheses)


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
