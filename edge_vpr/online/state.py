"""State of sliding windows: the newest time or events, and windows of the same length before.

A sequence consists of L such windows, one directly after the other. They are numbered by their lag:
lag 0 is the newest window, and lag i holds what lag 0 held i window lengths ago. An event enters at
lag 0, moves from lag to lag as it ages, and leaves after the last one. Each move subtracts one from
a counter and adds one to another. At time T, lag i of windows of tau microseconds holds the events
with ``T - (i+1) tau <= t < T - i tau``; after an event at time t, T is t + 1. Lag i of windows of N
events holds the i N-th to (i+1) N-th newest event at the selected pixels.

At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
exactly the last L windows of `edge_vpr.descriptors.windows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import FixedTime, Window
from edge_vpr.online.vector_kernels import MAX_STEPS

#: initial size of the ring buffer of events
RING_EVENTS = 4096
#: largest number of moves that are noted before the counters are updated
MAX_MOVES = 256

#: A move of an event: its slot, and the lag that it left (-1: it is new).
MOVE = np.dtype([("slot", "<i4"), ("left", "<i4")])
#: For each counter: its table, and its smallest and largest count in the map.
COUNTER = np.dtype([("table", "<i8"), ("low", "<i8"), ("high", "<i8")])
#: Common part of all distances, number of noted moves that the counters do not include yet, stride
#: of `Sliding.columns`, and number of sums in use.
TOTALS = np.dtype([("common", "<i8"), ("moves", "<i8"), ("stride", "<i8"), ("sums", "<i8")])


class Sliding(NamedTuple):
    """State of the kernels of sliding windows and of their distances to a map.

    Attributes
    ----------
    slot : ndarray of int32, shape (capacity,)
    time : ndarray of int64, shape (capacity,)
        Ring of selected events: event number i is at ``i % capacity``, a power of two.
    bound : ndarray of int64, shape (L + 1,)
        Lag i holds the events numbered from ``bound[i + 1]`` up to ``bound[i]``.
    moves : ndarray of MOVE, shape (MAX_MOVES,)
        Events that have moved since the counters were last brought up to date.
    counts : ndarray of int64, shape (L, J)
        Events in each lag, by slot.
    tau, n : int
        Length of a window in microseconds, or in events; the other is 0.
    code : ndarray of uint16, shape (codes, size)
        Tables, a row each: code of each count, not decreasing; the last stands for all larger
        counts. Of size 0: the count itself.
    counters : ndarray of COUNTER, shape (J,)
    columns : ndarray of uint8 or uint16
        Map, a pixel's places one after another, `stride` apart from pixel to pixel.
    sums : ndarray of uint16 or uint32
        ``sums[m]``: distance of the sequence that ends at place m + L - 1, less the common base.
        After LANES spare ones, the smallest of each block, see `vector_kernels.least_in`.
    steps : ndarray of int64, shape (2, MAX_STEPS)
        Scratch for the steps of `update_blocks`.
    totals : ndarray of TOTALS, shape (1,)
    """

    slot: npt.NDArray[np.int32]
    time: npt.NDArray[np.int64]
    bound: npt.NDArray[np.int64]
    moves: npt.NDArray[np.void]
    counts: npt.NDArray[np.int64]
    tau: int
    n: int
    code: npt.NDArray[np.uint16]
    counters: npt.NDArray[np.void]
    columns: npt.NDArray[np.unsignedinteger]
    sums: npt.NDArray[np.unsignedinteger]
    steps: npt.NDArray[np.int64]
    totals: npt.NDArray[np.void]


def empty_windows(window: Window, length: int, counters: int) -> Sliding:
    """Build the state before the first event, without a map.

    Parameters
    ----------
    window : FixedTime or FixedCount
    length, counters : int
        L, and J (or 2 J).
    """
    return Sliding(
        slot=np.zeros(RING_EVENTS, dtype=np.int32),
        time=np.zeros(RING_EVENTS, dtype=np.int64),
        bound=np.zeros(length + 1, dtype=np.int64),
        moves=np.zeros(MAX_MOVES, dtype=MOVE).view(np.recarray),
        counts=np.zeros((length, counters), dtype=np.int64),
        tau=window.tau_us if isinstance(window, FixedTime) else 0,
        n=0 if isinstance(window, FixedTime) else window.events,
        code=np.empty((1, 0), dtype=np.uint16),
        counters=np.zeros(counters, dtype=COUNTER).view(np.recarray),
        columns=np.empty(0, dtype=np.uint8),
        sums=np.empty(0, dtype=np.uint16),
        steps=np.zeros((2, MAX_STEPS), dtype=np.int64),
        totals=np.zeros(1, dtype=TOTALS).view(np.recarray),
    )


def recount(s: Sliding) -> npt.NDArray[np.int64]:
    """Count all events in the ring again, shape (L, J)."""
    counts = np.zeros_like(s.counts)
    for lag in range(len(counts)):
        numbers = np.arange(s.bound[lag + 1], s.bound[lag])
        slots = s.slot[numbers & (s.slot.size - 1)]
        counts[lag] = np.bincount(slots, minlength=counts.shape[1])
    return counts


def grown(s: Sliding) -> Sliding:
    """Return the state with a ring of twice the size."""
    numbers = np.arange(s.bound[-1], s.bound[0])
    old, size = numbers & (s.slot.size - 1), 2 * s.slot.size
    slot, time = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int64)
    slot[numbers & (size - 1)] = s.slot[old]
    time[numbers & (size - 1)] = s.time[old]
    return s._replace(slot=slot, time=time)
