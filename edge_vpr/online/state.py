"""Windows that slide: the newest microseconds or events, and those of the same length before them.

A sequence of L descriptors at the map's own spacing is L such windows, one behind the other: lag 0
is the newest, and lag i holds what lag 0 held i window lengths ago. An event enters at lag 0, moves
from lag to lag as it ages, and leaves behind the last one; each move takes one from one counter and
adds one to another. At time T, lag i of windows of tau microseconds holds the events with
``T - (i+1) tau <= t < T - i tau``; after an event at time t, T is t + 1. Lag i of windows of N
events holds the i N-th to (i+1) N-th newest event at the selected pixels.

At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
exactly the last L windows of `edge_vpr.descriptors.windows`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.descriptors.codes import PixelCodes
from edge_vpr.descriptors.windows import FixedTime, Window
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.online.vector_kernels import BLOCK, LANES, MAX_STEPS, update_blocks

_CACHE_LINE = 64
#: events that the ring holds before it first grows
RING_EVENTS = 4096
#: moves that are noted before the counters must take them
MAX_MOVES = 256

# indices into `Sliding.number`: what all distances have in common, and moves not yet taken
BASE, MOVES = range(2)


class Sliding(NamedTuple):
    """What the kernels of a sliding window and of its distances to a map work on.

    Attributes
    ----------
    slot : ndarray of int32, shape (capacity,)
    time : ndarray of int64, shape (capacity,)
        Ring of selected events: event number i is at ``i % capacity``, a power of two.
    bound : ndarray of int64, shape (L + 1,)
        Lag i holds the events numbered from ``bound[i + 1]`` up to ``bound[i]``.
    moves : ndarray of int32, shape (MAX_MOVES, 2)
        Events that have moved since the counters were last brought up to date: slot, and the lag
        that it left (-1: it is new).
    counts : ndarray of int64, shape (L, J)
        Events in each lag, by slot.
    tau, n : int
        Length of a window in microseconds, or in events; the other is 0.
    code : ndarray of uint16, shape (codes, size)
        Tables, a row each: code of each count, not decreasing; the last stands for all larger
        counts. Of size 0: the count itself.
    row : ndarray of uint16, shape (J,)
        Which table a counter uses.
    columns : ndarray of uint8 or uint16
        Map, a pixel's places one after another, `stride` apart from pixel to pixel.
    low, high : ndarray of int64, shape (J,)
        Smallest and largest count of each pixel in the map.
    sums : ndarray of uint16 or uint32
        ``sums[m]``: distance of the sequence that ends at place m + L - 1, less the common base.
    block_least : ndarray of the same dtype
        See `least_in`.
    offset : ndarray of int64, shape (MAX_STEPS,)
    level : ndarray of the map's dtype, shape (MAX_STEPS,)
        Scratch for the steps of `update_blocks`.
    number : ndarray of int64, shape (2,)
        See `BASE` and `MOVES`.
    shape : ndarray of int64, shape (2,)
        Stride of `columns`, and number of sums in use.
    """

    slot: npt.NDArray[np.int32]
    time: npt.NDArray[np.int64]
    bound: npt.NDArray[np.int64]
    moves: npt.NDArray[np.int32]
    counts: npt.NDArray[np.int64]
    tau: int
    n: int
    code: npt.NDArray[np.uint16]
    row: npt.NDArray[np.uint16]
    columns: npt.NDArray[np.unsignedinteger]
    low: npt.NDArray[np.int64]
    high: npt.NDArray[np.int64]
    sums: npt.NDArray[np.unsignedinteger]
    block_least: npt.NDArray[np.unsignedinteger]
    offset: npt.NDArray[np.int64]
    level: npt.NDArray[np.unsignedinteger]
    number: npt.NDArray[np.int64]
    shape: npt.NDArray[np.int64]


# The kernels take arrays one by one: reading one out of a tuple counts a reference, and an event
# would spend more time on that than on its distances. Those that are called for every event are
# inlined, since handing a dozen arrays over costs as much as updating a hundred places.


@njit(cache=True, nogil=True, inline="always")
def age(time, slot, bound, moves, number, tau, n, until):
    """Note the moves of events that grow too old for their lag by T = `until`.

    Windows of a number of events make room for one more instead.

    Returns
    -------
    bool
        False if there is no room for more moves: take them, and call again.
    """
    mask = time.size - 1
    for lag in range(bound.size - 1):
        oldest = until - (lag + 1) * tau
        while (
            tau > 0 and bound[lag + 1] < bound[lag] and time[bound[lag + 1] & mask] < oldest
        ) or (n > 0 and bound[0] - bound[lag + 1] >= (lag + 1) * n):
            if number[MOVES] == len(moves):
                return False
            moves[number[MOVES], 0] = slot[bound[lag + 1] & mask]
            moves[number[MOVES], 1] = lag
            number[MOVES] += 1
            bound[lag + 1] += 1
    return True


@njit(cache=True, nogil=True)
def take_moves(
    moves, counts, code, row, low, high, columns, sums, block_least, offset, level, number, shape
):
    """Bring counters and distances up to date with the moves noted."""
    lags = counts.shape[0]
    arrivals = expiries = 0
    for m in range(number[MOVES]):
        slot, left = moves[m, 0], moves[m, 1]
        for lag in range(max(left, 0), min(left + 2, lags)):
            up = -1 if lag == left else 1
            less = counts[lag, slot] + min(up, 0)
            counts[lag, slot] += up
            first, last = less, less + 1
            if code.size > 0:
                table = row[slot]
                first = np.int64(code[table, min(first, code.shape[1] - 1)])
                last = np.int64(code[table, min(last, code.shape[1] - 1)])
            for step in range(first, last):
                # where the whole map lies on one side, every place changes by the same
                if step >= high[slot]:
                    number[BASE] += up
                    continue
                if step < low[slot]:
                    number[BASE] -= up
                    continue
                if arrivals + expiries == MAX_STEPS:
                    update_blocks(
                        sums, block_least, columns, offset, level, arrivals, expiries, shape[1]
                    )
                    arrivals = expiries = 0
                if up > 0:
                    at = arrivals
                    arrivals += 1
                else:
                    expiries += 1
                    at = MAX_STEPS - expiries
                offset[at] = slot * shape[0] + lags - 1 - lag
                level[at] = step
    number[MOVES] = 0
    if arrivals + expiries > 0:
        update_blocks(sums, block_least, columns, offset, level, arrivals, expiries, shape[1])


@njit(cache=True, nogil=True)
def settle(s):
    """Bring counters and distances up to date, as `take_moves` does."""
    take_moves(
        s.moves,
        s.counts,
        s.code,
        s.row,
        s.low,
        s.high,
        s.columns,
        s.sums,
        s.block_least,
        s.offset,
        s.level,
        s.number,
        s.shape,
    )


@njit(cache=True, nogil=True)
def advance(s, until):
    """Let time pass to T = `until`; windows of a number of events do not notice."""
    if s.tau > 0:
        while not age(s.time, s.slot, s.bound, s.moves, s.number, s.tau, 0, until):
            settle(s)


@njit(cache=True, nogil=True)
def push(s, slot, time):
    """Take the next selected event; False if the ring is full: let it grow, and call again."""
    while not (
        age(s.time, s.slot, s.bound, s.moves, s.number, s.tau, s.n, time + 1)
        and s.number[MOVES] < len(s.moves)
    ):
        settle(s)
    mask = s.slot.size - 1
    if s.bound[0] - s.bound[-1] > mask:
        return False
    s.slot[s.bound[0] & mask] = slot
    s.time[s.bound[0] & mask] = time
    s.bound[0] += 1
    s.moves[s.number[MOVES], 0] = slot
    s.moves[s.number[MOVES], 1] = -1
    s.number[MOVES] += 1
    return True


def start(
    places: npt.NDArray[np.unsignedinteger], window: Window, length: int, codes: PixelCodes | None
) -> Sliding:
    """Build the state before the first event.

    Parameters
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Map, in codes if there are any.
    window : FixedTime or FixedCount
    length : int
        L.
    codes : PixelCodes, optional
        What the counts of a window become before they are compared.
    """
    counters = places.shape[1]
    tables, row = np.empty((1, 0), dtype=np.uint16), np.zeros(counters, dtype=np.uint16)
    if codes is not None:
        tables, row = codes.tables, codes.row.astype(np.uint16)
    no_sums, none = np.empty(0, dtype=np.uint16), np.empty(0, dtype=np.int64)
    bare = Sliding(
        slot=np.zeros(RING_EVENTS, dtype=np.int32),
        time=np.zeros(RING_EVENTS, dtype=np.int64),
        bound=np.zeros(length + 1, dtype=np.int64),
        moves=np.zeros((MAX_MOVES, 2), dtype=np.int32),
        counts=np.zeros((length, counters), dtype=np.int64),
        tau=window.tau_us if isinstance(window, FixedTime) else 0,
        n=0 if isinstance(window, FixedTime) else window.events,
        code=tables,
        row=row,
        columns=np.empty(0, dtype=np.uint8),
        low=none,
        high=none,
        sums=no_sums,
        block_least=no_sums,
        offset=np.zeros(MAX_STEPS, dtype=np.int64),
        level=np.empty(0, dtype=np.uint8),
        number=np.zeros(2, dtype=np.int64),
        shape=np.zeros(2, dtype=np.int64),
    )
    return with_distances(bare, places)


def with_distances(s: Sliding, places: npt.NDArray[np.unsignedinteger]) -> Sliding:
    """Lay a map out by pixel and compute every distance of the present counters anew."""
    length = len(s.counts)
    # whole vectors, and an odd number of them: a power of two would make all columns of a place
    # fall on the same lines of the cache
    count, stride = len(places) - length + 1, (len(places) // LANES + 2 | 1) * LANES
    columns = _aligned(places.shape[1] * stride + LANES, places.dtype)
    columns[: places.shape[1] * stride].reshape(-1, stride)[:, : len(places)] = places.T
    low, high = places.min(axis=0).astype(np.int64), places.max(axis=0).astype(np.int64)

    coded = _coded(s)
    # spare places of the smallest counts fill the last vector
    spare = np.broadcast_to(low.astype(places.dtype), (LANES, len(low)))
    index = ReferenceIndex(np.concatenate([places, spare]))
    distances = np.zeros(count + LANES, dtype=np.int64)
    for lag in range(length):
        end = length - 1 - lag
        distances += index.distances(coded[lag])[end : end + count + LANES]
    base = int(np.abs(coded - np.clip(coded, low, high)).sum())
    # without the base no distance is larger than this; spare ones always are, so that a search may
    # run over them
    largest = length * int((high - low).sum())
    if 2 * largest + 1 > np.iinfo(np.uint32).max:
        raise UsageError(
            f"distances of up to {largest} do not fit 32 bits: take fewer pixels, a shorter "
            "sequence, or a counter code"
        )
    distances[count:] += largest + 1
    dtype = np.uint16 if 2 * largest + 1 <= np.iinfo(np.uint16).max else np.uint32
    sums = _aligned(count + LANES, dtype)
    sums[:] = distances - base
    block_least = np.minimum.reduceat(sums[:count], np.arange(0, count, BLOCK))
    return s._replace(
        columns=columns,
        low=low,
        high=high,
        sums=sums,
        block_least=block_least,
        level=np.zeros(MAX_STEPS, dtype=places.dtype),
        number=np.array([base, 0], dtype=np.int64),
        shape=np.array([stride, count], dtype=np.int64),
    )


def compared(s: Sliding, index: ReferenceIndex) -> Sliding:
    """Compute every distance anew after the codes of the counters have changed.

    Parameters
    ----------
    s : Sliding
        Of one window, with all moves taken.
    index : ReferenceIndex
        The map.
    """
    coded, count = _coded(s)[0], index.places
    base = int(np.abs(coded - np.clip(coded, s.low, s.high)).sum())
    s.sums[:count] = index.distances(coded) - base
    s.number[BASE] = base
    s.block_least[:] = np.minimum.reduceat(s.sums[:count], np.arange(0, count, BLOCK))
    return s


def _coded(s: Sliding) -> npt.NDArray[np.int64]:
    """Return the counters of each lag as they are compared, shape (L, J)."""
    if s.code.size == 0:
        return s.counts
    return s.code[s.row, np.minimum(s.counts, s.code.shape[1] - 1)].astype(np.int64)


def _aligned(size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Make zeros that start at a cache line: a vector across two lines costs twice."""
    itemsize = np.dtype(dtype).itemsize
    spacious = np.zeros(size + _CACHE_LINE // itemsize, dtype=dtype)
    first = -spacious.ctypes.data % _CACHE_LINE // itemsize
    return spacious[first : first + size]


def recount(s: Sliding) -> npt.NDArray[np.int64]:
    """Count the events in the ring anew, shape (L, J)."""
    counts = np.zeros_like(s.counts)
    for lag in range(len(counts)):
        numbers = np.arange(s.bound[lag + 1], s.bound[lag])
        slots = s.slot[numbers & (s.slot.size - 1)]
        counts[lag] = np.bincount(slots, minlength=counts.shape[1])
    return counts


def grown(s: Sliding) -> Sliding:
    """Double the ring."""
    numbers = np.arange(s.bound[-1], s.bound[0])
    old, size = numbers & (s.slot.size - 1), 2 * s.slot.size
    slot, time = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int64)
    slot[numbers & (size - 1)] = s.slot[old]
    time[numbers & (size - 1)] = s.time[old]
    return s._replace(slot=slot, time=time)
