"""The kernel of the place filter event by event: from one end of a window to the next."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.descriptors.pauses import ACTIVITY_BITS, PAUSE_SHIFT
from edge_vpr.matching.filter_arithmetic import (
    add_evidence,
    least_and_second,
    reciprocal_of_spread,
    trust_after,
)
from edge_vpr.matching.step_prices import METRIC_TOP
from edge_vpr.online.kernel import DONE, MATCHES_FULL, RING_FULL
from edge_vpr.online.state_kernels import advance, push, settle

#: What the kernel knows besides the window and the metrics: when a match is asked for (every so
#: many events, at ticks of an interval, only if the place changes); the filter's numbers.
CONTROL = np.dtype(
    [
        ("every", np.int64),
        ("interval", np.int64),
        ("change", np.int64),
        ("next_tick", np.int64),
        ("place_told", np.int64),
        ("exclusion", np.int64),
        ("usual", np.int64),
        ("reciprocal", np.int64),
        ("place", np.int64),
        ("trust", np.int64),
    ]
)


class Predicted(NamedTuple):
    """Metrics that the kernel adds evidence to.

    Attributes
    ----------
    moving, paused : ndarray of int32, shape (K,)
        `PlaceFilter.prediction` and `PlaceFilter.paused`.
    follows : ndarray of bool, shape (K,)
        `PlaceFilter.follows`.
    metric : ndarray of int32, shape (K,)
        Scratch.
    """

    moving: npt.NDArray[np.int32]
    paused: npt.NDArray[np.int32]
    follows: npt.NDArray[np.bool_]
    metric: npt.NDArray[np.int32]


@njit(cache=True, nogil=True)
def follow_filtered(
    s: Any, predicted: Any, control: Any, slots: Any, times: Any, until: int, out: Any
) -> tuple[int, int, int]:
    """Feed selected events, then let time pass to `until`; stop where a buffer is full.

    Parameters
    ----------
    s : Sliding
        Of one window.
    predicted : Predicted
    control : ndarray of CONTROL, shape (1,)
        Changed in place: the next tick, and the place told last.
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)
        Events at selected pixels, in time order, none after the end of the filter's window.
    until : int
        Time of the last event, selected or not, or the window's end, in microseconds.
    out : ndarray of int64, shape (n, 8)
        Matches are written here: the integers of MATCH_DTYPE, in its order.

    Returns
    -------
    read, given, why : int
        Events taken, matches written, and `DONE`, `MATCHES_FULL` or `RING_FULL`.
    """
    c = control[0]
    mask = s.slot.size - 1
    given, i = 0, 0
    left = c.every - s.bound[0] % c.every if c.every > 0 else np.int64(-1)
    while True:
        now = times[i] if i < slots.size else until
        tick = c.interval > 0 and c.next_tick <= now
        if not tick and i == slots.size:
            return i, given, DONE
        if given == len(out):
            return i, given, MATCHES_FULL
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        if tick:
            advance(s, seen_until)
            c.next_tick += c.interval
        elif not push(s, slots[i], now):
            return i, given, RING_FULL
        else:
            i += 1
            left -= 1
            if left != 0:
                continue
            left = c.every
        complete = seen_until >= s.tau if s.tau > 0 else s.bound[0] >= s.n
        if not complete:
            continue
        settle(s)
        # of a window of a number of events, the time of the oldest
        begin = seen_until - s.tau if s.tau > 0 else s.time[s.bound[1] & mask]
        given += _answer(s, predicted, c, (now, begin), out[given])


@njit(cache=True, nogil=True)
def _answer(s, predicted, c, span, row):  # type: ignore[no-untyped-def]
    """Write the match of the present window; 0 if only changes are asked for and there is none."""
    events = s.bound[0] - s.bound[1]
    metric = predicted.metric
    if events == 0 or events << (ACTIVITY_BITS + PAUSE_SHIFT) < c.usual:
        for k in range(metric.size):
            metric[k] = min(predicted.paused[k], METRIC_TOP)
    else:
        sums = s.sums[: metric.size]
        reciprocal = c.reciprocal
        if reciprocal == 0:
            reciprocal = reciprocal_of_spread(sums)
        add_evidence(predicted.moving, sums, reciprocal, metric)
    best, second, _ = least_and_second(metric, c.exclusion)
    if c.change and best == c.place_told:
        return 0
    c.place_told = best
    second_metric = np.int64(metric[second]) if second >= 0 else np.int64(-1)
    margin = second_metric - metric[best] if second >= 0 else np.int64(METRIC_TOP)
    kept = c.trust if predicted.follows[best] else np.int64(0)
    row[0], row[1], row[2], row[3], row[4] = span[0], best, metric[best], second, second_metric
    row[5], row[6] = events, span[1]
    row[7] = trust_after(int(kept), bool(best == c.place), int(margin))
    return 1
