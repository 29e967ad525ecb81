"""Windows that slide: the newest microseconds or events, and those of the same length before them.

A sequence of L descriptors at the map's own spacing is L such windows, one behind the other: lag 0
is the newest, and lag i holds what lag 0 held i window lengths ago. An event enters at lag 0, moves
from lag to lag as it ages, and leaves behind the last one; each move takes one from one counter and
adds one to another. At time T, lag i of windows of tau microseconds holds the events with
``T - (i+1) tau <= t < T - i tau``; after an event at time t, T is t + 1. Lag i of windows of N
events holds the i N-th to (i+1) N-th newest event at the selected pixels.

At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
exactly the last L windows of `edge_vpr.windows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.incremental import MAX_STEPS, update_blocks

#: events that the ring holds before it first grows
RING_EVENTS = 4096

# indices into `Sliding.number`
BASE, ARRIVALS, EXPIRIES = range(3)


class Sliding(NamedTuple):
    """What the kernels of a sliding window and of its distances to a map work on.

    Attributes
    ----------
    slot : ndarray of int32, shape (capacity,)
    time : ndarray of int64, shape (capacity,)
        Ring of selected events: event number n is at ``n % capacity``, a power of two.
    bound : ndarray of int64, shape (L + 1,)
        Lag i holds the events numbered from ``bound[i + 1]`` up to ``bound[i]``.
    counts : ndarray of int64, shape (L, J)
        Events in each lag, by slot.
    tau, n : int
        Length of a window in microseconds, or in events; the other is 0.
    code : ndarray of int64
        Code of each count, not decreasing; the last stands for all larger counts. Empty: the count.
    columns : ndarray of uint8 or uint16
        Map, a pixel's places one after another, `stride` apart from pixel to pixel.
    low, high : ndarray of int64, shape (J,)
        Smallest and largest count of each pixel in the map.
    sums : ndarray of uint16 or uint32
        ``sums[m]``: distance of the sequence that ends at place m + L - 1, less `BASE`.
    block_least : ndarray of the same dtype
        See `least_in`.
    offset : ndarray of int64, shape (MAX_STEPS,)
    level : ndarray of the map's dtype, shape (MAX_STEPS,)
        Steps that are not yet in the sums: arrivals from the front, expiries from the back.
    number : ndarray of int64, shape (3,)
        `BASE`, what all places have in common; numbers of `ARRIVALS` and `EXPIRIES`.
    shape : ndarray of int64, shape (2,)
        Stride of `columns`, and number of sums in use.
    """

    slot: npt.NDArray[np.int32]
    time: npt.NDArray[np.int64]
    bound: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int64]
    tau: int
    n: int
    code: npt.NDArray[np.int64]
    columns: npt.NDArray[np.unsignedinteger]
    low: npt.NDArray[np.int64]
    high: npt.NDArray[np.int64]
    sums: npt.NDArray[np.unsignedinteger]
    block_least: npt.NDArray[np.unsignedinteger]
    offset: npt.NDArray[np.int64]
    level: npt.NDArray[np.unsignedinteger]
    number: npt.NDArray[np.int64]
    shape: npt.NDArray[np.int64]


@njit(cache=True, nogil=True)
def apply_steps(s):  # type: ignore[no-untyped-def]
    """Bring the sums up to date with the counters."""
    if s.number[ARRIVALS] + s.number[EXPIRIES] > 0:
        update_blocks(
            s.sums,
            s.block_least,
            s.columns,
            s.offset,
            s.level,
            s.number[ARRIVALS],
            s.number[EXPIRIES],
            s.shape[1],
        )
        s.number[ARRIVALS] = 0
        s.number[EXPIRIES] = 0


@njit(cache=True, nogil=True)
def _code_of(s, count):  # type: ignore[no-untyped-def]
    return count if s.code.size == 0 else s.code[min(count, s.code.size - 1)]


@njit(cache=True, nogil=True)
def _change(s, lag, slot, up):  # type: ignore[no-untyped-def]
    """Count one event more (`up` = 1) or less (-1), and note the steps of its code."""
    before = s.counts[lag, slot]
    s.counts[lag, slot] = before + up
    first = _code_of(s, min(before, before + up))
    last = _code_of(s, max(before, before + up))
    for level in range(first, last):
        # where the whole map lies on one side, every place changes by the same
        if level >= s.high[slot]:
            s.number[BASE] += up
        elif level < s.low[slot]:
            s.number[BASE] -= up
        else:
            if s.number[ARRIVALS] + s.number[EXPIRIES] == MAX_STEPS:
                apply_steps(s)
            if up > 0:
                at = s.number[ARRIVALS]
                s.number[ARRIVALS] += 1
            else:
                s.number[EXPIRIES] += 1
                at = MAX_STEPS - s.number[EXPIRIES]
            s.offset[at] = slot * s.shape[0] + s.counts.shape[0] - 1 - lag
            s.level[at] = level


@njit(cache=True, nogil=True)
def _age(s, lag):  # type: ignore[no-untyped-def]
    """Move the oldest event of a lag to the next, or out of the window."""
    slot = s.slot[s.bound[lag + 1] & (s.slot.size - 1)]
    s.bound[lag + 1] += 1
    _change(s, lag, slot, -1)
    if lag + 1 < s.counts.shape[0]:
        _change(s, lag + 1, slot, 1)


@njit(cache=True, nogil=True)
def advance(s, until):  # type: ignore[no-untyped-def]
    """Let time pass to T = `until`; windows of a number of events do not notice."""
    if s.tau > 0:
        for lag in range(s.counts.shape[0]):
            oldest = until - (lag + 1) * s.tau
            while (
                s.bound[lag + 1] < s.bound[lag]
                and s.time[s.bound[lag + 1] & (s.time.size - 1)] < oldest
            ):
                _age(s, lag)


@njit(cache=True, nogil=True)
def push(s, slot, time):  # type: ignore[no-untyped-def]
    """Take the next selected event; False if the ring is full, and nothing is then changed."""
    advance(s, time + 1)
    if s.n > 0:
        for lag in range(s.counts.shape[0]):
            if s.bound[0] + 1 - s.bound[lag + 1] > (lag + 1) * s.n:
                _age(s, lag)
    if s.bound[0] - s.bound[-1] == s.slot.size:
        return False
    at = s.bound[0] & (s.slot.size - 1)
    s.slot[at] = slot
    s.time[at] = time
    s.bound[0] += 1
    _change(s, 0, slot, 1)
    return True
