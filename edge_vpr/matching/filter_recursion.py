"""The place filter's recursion over many windows in one call, forwards and backwards."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.pauses import is_pause, is_quiet, usual_after
from edge_vpr.matching.filter_arithmetic import (
    TRUST_BITS,
    evidence_of,
    least_and_second,
    margin_of,
    reciprocal_of_spread,
    trust_after,
)
from edge_vpr.matching.move_kernels import StepTable, leads_to, predict
from edge_vpr.matching.step_prices import METRIC_TOP, Metrics

#: State of a filter between two windows, in addition to its metrics; see `PlaceFilter`.
NUMBERS = np.dtype(
    [("reciprocal", np.int64), ("usual", np.int64), ("place", np.int64), ("trust", np.int64)]
)


class Predictions(NamedTuple):
    """Predictions for the next window from the windows before; see `PlaceFilter`.

    Attributes
    ----------
    moving, quiet : ndarray of int32, shape (K,)
    follows : ndarray of bool, shape (K,)
    """

    moving: Metrics
    quiet: Metrics
    follows: npt.NDArray[np.bool_]


class WindowRows(NamedTuple):
    """Results of n windows, written by `advance_windows`.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 6)
        Of `FilterMatch`.
    metrics : ndarray of int32, shape (n, K)
        After each window.
    evidence : ndarray of uint8, shape (n, K)
        Which each window added.
    quiet : ndarray of bool, shape (n,)
        Which windows are quiet.
    """

    columns: npt.NDArray[np.int64]
    metrics: Metrics
    evidence: npt.NDArray[np.uint8]
    quiet: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, windows: int, places: int) -> WindowRows:
        """Return uninitialised rows."""
        return cls(
            np.empty((windows, 6), dtype=np.int64),
            np.empty((windows, places), dtype=np.int32),
            np.empty((windows, places), dtype=np.uint8),
            np.empty(windows, dtype=np.bool_),
        )

    def part(self, first: int, last: int) -> WindowRows:
        """Return the rows of the windows from `first` to before `last`, in the same memory."""
        return WindowRows(
            self.columns[first:last], self.metrics[first:last], self.evidence[first:last],
            self.quiet[first:last],
        )  # fmt: skip

    def take(self, others: WindowRows) -> None:
        """Copy the rows of as many other windows."""
        self.columns[:], self.metrics[:] = others.columns, others.metrics
        self.evidence[:], self.quiet[:] = others.evidence, others.quiet


@kernel
def advance_windows(
    numbers: Any,
    predicted: Predictions,
    steps: StepTable,
    exclusion: int,
    quiet_shift: int,
    distances: npt.NDArray[np.integer],
    events: npt.NDArray[np.int64],
    rows: WindowRows,
) -> None:
    """Advance the filter by n finished windows, one after the other.

    Parameters
    ----------
    numbers : ndarray of NUMBERS, shape (1,)
        Before the first window; after the call, after the last.
    predicted : Predictions
        Of the first window. Those after it are predicted by steps.
    steps : StepTable
    exclusion, quiet_shift : int
        Of `PlaceFilter`.
    distances : ndarray of int, shape (n, K)
    events : ndarray of int64, shape (n,)
        At the selected pixels in each window.
    rows : WindowRows
        Written to.
    """
    now = numbers[0]
    for i in range(len(distances)):
        metric, evidence = rows.metrics[i], rows.evidence[i]
        quiet = is_quiet(events[i], now.usual)
        rows.quiet[i] = quiet
        if i > 0:
            prices, first = (steps.quiet, 0) if quiet else (steps.prices, steps.first)
            prediction = predict(rows.metrics[i - 1], prices, first, steps.restart, steps.jumps)
        else:
            prediction = predicted.quiet if quiet else predicted.moving
        if is_pause(events[i], now.usual):
            evidence[:] = 0
        else:
            own = reciprocal_of_spread(distances[i])
            evidence_of(distances[i], now.reciprocal if now.reciprocal != 0 else own, evidence)
            now.reciprocal = own
            if quiet:
                evidence >>= np.uint8(quiet_shift)
        for k in range(metric.size):
            metric[k] = min(prediction[k] + np.int32(evidence[k]), METRIC_TOP)
        now.usual = usual_after(now.usual, events[i])
        place, second, ties = least_and_second(metric, exclusion)
        if i > 0:
            follows = leads_to(now.place, place, steps.first, steps.last, steps.jumps)
        else:
            follows = predicted.follows[place]
        margin = write_match(metric, place, second, ties, rows.columns[i])
        kept = int(now.trust) if follows else 0
        now.trust = trust_after(kept, place == now.place, margin)
        now.place = place
        rows.columns[i, 5] = now.trust


@kernel
def write_match(
    metric: Metrics, place: int, second: int, ties: int, row: npt.NDArray[np.int64]
) -> int:
    """Write a match without its trust, and return its margin.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
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
    turned: Metrics,
    back: StepTable,
    exclusion: int,
    quiet: npt.NDArray[np.bool_],
    evidence: npt.NDArray[np.uint8],
    summed: Metrics,
    columns: npt.NDArray[np.int64],
) -> None:
    """Add the prices of the rest of the drive to the metrics of n windows, from the last window.

    Parameters
    ----------
    onward : ndarray of int32, shape (K,)
        Price of going on from each place after the last of these windows; after the call, before
        the first.
    turned : ndarray of int32, shape (K,)
        Written to: the price of going on from the first window, with its own evidence, last place
        first.
    back : StepTable
        Of `Moves.reversed`.
    exclusion : int
    quiet, evidence
        See `WindowRows`.
    summed : ndarray of int32, shape (n, K)
        Metrics; after the call, the price of the best path through each place.
    columns : ndarray of int64, shape (n, 6)
        Of `FilterMatch`, written to; its trust is the margin, in units of 1/16 of a metric.
    """
    for i in range(len(summed) - 1, -1, -1):
        summed[i] += onward
        place, second, ties = least_and_second(summed[i], exclusion)
        columns[i, 5] = write_match(summed[i], place, second, ties, columns[i]) << TRUST_BITS
        for k in range(turned.size):
            turned[k] = onward[turned.size - 1 - k] + evidence[i, turned.size - 1 - k]
        prices, first = (back.quiet, 0) if quiet[i] else (back.prices, back.first)
        onward[:] = predict(turned, prices, first, back.restart, back.jumps)[::-1]
