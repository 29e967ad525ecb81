"""Sliding windows: the newest time or events, earlier windows, and their distances to a map.

A sequence consists of L consecutive windows, which are numbered by their lag: lag 0 is the newest
window, and lag i has the content that lag 0 had i window lengths ago. An event enters at lag 0,
moves from lag to lag as it ages, and leaves after the last one. Each move subtracts one from a
counter and adds one to another. At time T, lag i of windows of tau microseconds holds the events
with ``T - (i+1) tau <= t < T - i tau``; after an event at time t, T is t + 1. Lag i of windows of N
events holds the i N-th to (i+1) N-th newest event at the selected pixels.

At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
exactly the last L windows of `edge_vpr.descriptors.windows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, plain
from edge_vpr.descriptors.windows import FixedTime, Window
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import aligned_zeros
from edge_vpr.online.sums import BLOCK, LANES, MAX_CHANGES, update_blocks
from fixedpoint.activity import SUMS
from fixedpoint.own_mean import LEVEL_FRACTION_BITS, ContrastCode

# The state.


#: without a limit, counts do not saturate
UNLIMITED = np.iinfo(np.int64).max
#: initial size of the ring buffer of events
RING_EVENTS = 4096
#: largest number of pending moves before the counters are updated
MAX_MOVES = 256

#: A move of an event: its slot, and the lag that it left (-1 for a new event).
MOVE = np.dtype([("slot", "<i4"), ("left", "<i4")])
#: For each counter: its smallest and largest count in the map.
COUNTER = np.dtype([("low", "<i8"), ("high", "<i8")])
#: Common part of all distances, number of pending moves, stride of `SlidingWindows.columns`, and
#: number of places that a match may be at.
TOTALS = np.dtype([("common", "<i8"), ("moves", "<i8"), ("stride", "<i8"), ("places", "<i8")])


class ContrastCodes(NamedTuple):
    """Parameters and state of contrast codes, each of which depends on the whole window.

    Attributes
    ----------
    levels : ndarray of int32, shape (size,)
        Logarithm of each count, see `ContrastCode`; empty where the windows hold counts.
    means : ndarray of int32, shape (sums, J)
        Mean logarithm of each counter in the newest window, and in sums of the newest windows, in
        units of 1/256 octave.
    codes : ndarray of int64, shape (sums, 2, J)
        Codes that the distances include, and scratch.
    bits : int
        See `ContrastCode`.
    """

    levels: npt.NDArray[np.int32]
    means: npt.NDArray[np.int32]
    codes: npt.NDArray[np.int64]
    bits: int


class SlidingWindows(NamedTuple):
    """State of the kernels of sliding windows and of their distances to a map.

    Attributes
    ----------
    slot : ndarray of int32, shape (capacity,)
        Ring of the slots of selected events, parallel to `time`.
    time : ndarray of int64, shape (capacity,)
        Ring of the times of selected events: event number i is element ``i % capacity``. The
        capacity is a power of two.
    bound : ndarray of int64, shape (L + 1,)
        Lag i holds the events numbered from ``bound[i + 1]`` up to ``bound[i]``.
    moves : ndarray of MOVE, shape (MAX_MOVES,)
        Pending moves, which the counters do not include yet.
    counts : ndarray of int64, shape (L, J)
        Events in each lag, by slot.
    tau, n : int
        Length of a window in microseconds, or in events; the other is 0.
    saturation : int
        Largest count of a counter, or `UNLIMITED`; 0 with contrast codes.
    contrast : ContrastCodes
        Of the place filter.
    counters : ndarray of COUNTER, shape (J,)
        State of each counter.
    columns : ndarray of uint8 or uint16
        Map, the places of one pixel after another, with a distance of `stride` between pixels.
    sums : ndarray of uint16 or uint32, shape (sums, places + LANES + blocks or more)
        Distances to all places, less the common part: of the newest window and each sum of the
        newest windows with contrast codes; else of the sequence that ends at place m + L - 1, in
        ``sums[0, m]``. After LANES padding elements, the smallest sum of each block, see
        `least_in`.
    changes : ndarray of int64, shape (2, MAX_CHANGES)
        Scratch for the changes of `update_blocks`.
    totals : ndarray of TOTALS, shape (sums,)
        Numbers shared by all counters; the first has the pending moves.
    """

    slot: npt.NDArray[np.int32]
    time: npt.NDArray[np.int64]
    bound: npt.NDArray[np.int64]
    moves: npt.NDArray[np.void]
    counts: npt.NDArray[np.int64]
    tau: int
    n: int
    saturation: int
    contrast: ContrastCodes
    counters: npt.NDArray[np.void]
    columns: npt.NDArray[np.unsignedinteger]
    sums: npt.NDArray[np.unsignedinteger]
    changes: npt.NDArray[np.int64]
    totals: npt.NDArray[np.void]


def recount(s: SlidingWindows) -> npt.NDArray[np.int64]:
    """Return the counters recomputed from the events in the ring, shape (L, J)."""
    counts = np.zeros_like(s.counts)
    for lag in range(len(counts)):
        numbers = np.arange(s.bound[lag + 1], s.bound[lag])
        slots = s.slot[numbers & (s.slot.size - 1)]
        counts[lag] = np.bincount(slots, minlength=counts.shape[1])
    return counts


def grown(s: SlidingWindows) -> SlidingWindows:
    """Return the state with a ring of twice the capacity."""
    numbers = np.arange(s.bound[-1], s.bound[0])
    old, size = numbers & (s.slot.size - 1), 2 * s.slot.size
    slot, time = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int64)
    slot[numbers & (size - 1)] = s.slot[old]
    time[numbers & (size - 1)] = s.time[old]
    return s._replace(slot=slot, time=time)


# Computation of all distances from the windows to the places, and the map's layout by pixel.


def start(
    places: npt.NDArray[np.unsignedinteger],
    window: Window,
    length: int,
    code: ContrastCode | int,
    mean: npt.NDArray[np.int32] | None = None,
    sums: int = 1,
) -> SlidingWindows:
    """Build the state before the first event.

    Parameters
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Map, in its codes.
    length : int
        L; with contrast codes, which compare sums of the newest windows, the longest of them.
    code : ContrastCode or int
        Contrast code of the counts; or the count at which they saturate, or `UNLIMITED`.
    mean : ndarray of int32, shape (J,), optional
        Initial means of contrast codes.
    sums : int
        Number of sums of windows that have contrast codes.
    """
    counters = places.shape[1]
    levels, means, bits = np.empty(0, dtype=np.int32), np.zeros((1, counters), dtype=np.int32), 0
    if isinstance(code, ContrastCode) and mean is not None:
        # copies, because Numba gives read-only arrays another type
        levels, means, bits = code.levels.copy(), np.tile(mean, (sums, 1)), code.bits
    state = SlidingWindows(
        slot=np.zeros(RING_EVENTS, dtype=np.int32),
        time=np.zeros(RING_EVENTS, dtype=np.int64),
        bound=np.zeros(length + 1, dtype=np.int64),
        moves=np.zeros(MAX_MOVES, dtype=MOVE).view(np.recarray),
        counts=np.zeros((length, counters), dtype=np.int64),
        tau=window.tau_us if isinstance(window, FixedTime) else 0,
        n=0 if isinstance(window, FixedTime) else window.events,
        saturation=code if isinstance(code, int) else 0,
        contrast=ContrastCodes(levels, means, np.zeros((sums, 2, counters), dtype=np.int64), bits),
        counters=np.zeros(counters, dtype=COUNTER).view(np.recarray),
        columns=np.empty(0, dtype=np.uint8),
        sums=np.empty((0, 0), dtype=np.uint16),
        changes=np.zeros((2, MAX_CHANGES), dtype=np.int64),
        totals=np.zeros(1, dtype=TOTALS).view(np.recarray),
    )
    return with_distances(state, places)


def with_distances(s: SlidingWindows, places: npt.NDArray[np.unsignedinteger]) -> SlidingWindows:
    """Return the state with a map laid out by pixel, and all distances of the current counters."""
    length = 1 if s.contrast.levels.size else len(s.counts)
    # an odd number of whole vectors: with a power of two, all columns of a place would compete for
    # the same cache lines
    count, stride = len(places) - length + 1, (len(places) // LANES + 2 | 1) * LANES
    columns = aligned_zeros(places.shape[1] * stride + LANES, places.dtype)
    columns[: places.shape[1] * stride].reshape(-1, stride)[:, : len(places)] = places.T
    low, high = places.min(axis=0).astype(np.int64), places.max(axis=0).astype(np.int64)

    s = s._replace(contrast=s.contrast._replace(codes=np.zeros_like(s.contrast.codes)))
    coded = _coded(s)
    # places with the smallest counts fill the last vector
    spare = np.broadcast_to(low.astype(places.dtype), (LANES, len(low)))
    by_pixel = np.ascontiguousarray(np.concatenate([places, spare]).T)
    distances = np.zeros((len(coded), count + LANES), dtype=np.int64)
    for of_sum, windows in zip(distances, coded, strict=True):
        for end, codes in zip(range(length - 1, -1, -1), windows.tolist(), strict=True):
            # `ReferenceIndex` is faster, but its compilation would take longer than this
            for column, code in zip(by_pixel, codes, strict=True):
                of_sum += np.abs(column[end : end + count + LANES].astype(np.int64) - code)
    base = np.abs(coded - np.clip(coded, low, high)).sum(axis=(1, 2))
    # upper bound of the distances less the base; padding exceeds it, and a search may include it
    largest = length * int((high - low).sum())
    if 2 * largest + 1 > np.iinfo(np.uint32).max:
        raise UsageError(
            f"distances of up to {largest} do not fit 32 bits: take fewer pixels, a shorter "
            "sequence, or a counter code"
        )
    distances[:, count:] += largest + 1
    dtype = np.uint16 if 2 * largest + 1 <= np.iinfo(np.uint16).max else np.uint32
    width = -(-(count + LANES + -(-count // BLOCK)) // LANES) * LANES
    sums = aligned_zeros(len(coded) * width, dtype).reshape(-1, width)
    sums[:, : count + LANES] = distances - base[:, None]
    _find_least(sums, count)
    counters = s.counters.copy()
    counters["low"], counters["high"] = low, high
    totals = [(common, 0, stride, count) for common in base.tolist()]
    return s._replace(
        columns=columns,
        counters=counters,
        sums=sums,
        totals=np.array(totals, dtype=TOTALS).view(np.recarray),
    )


def _find_least(sums: npt.NDArray[np.unsignedinteger], count: int) -> None:
    """Write the smallest sum of each block behind the sums, see `least_in`."""
    starts = np.arange(0, count, BLOCK)
    least = np.minimum.reduceat(sums[:, :count], starts, axis=1)
    sums[:, count + LANES : count + LANES + starts.size] = least


def _coded(s: SlidingWindows) -> npt.NDArray[np.int64]:
    """Return the codes of the windows that each row of distances compares, shape (sums, L, J).

    Contrast codes are stored too.
    """
    if not s.contrast.levels.size:
        return np.minimum(s.counts, s.saturation)[np.newaxis]
    for i, codes in enumerate(s.contrast.codes):
        plain(write_codes)(s.counts[: SUMS[i]].sum(axis=0), s.contrast, i, codes[0])
    return s.contrast.codes[:, :1].copy()


# Kernels of the sliding windows: add events, move them from lag to lag, update distances.
#
# Functions that are called for every event take separate arrays, or are inlined: reading an array
# from the state changes a reference count, which takes longer than processing the event.


@kernel(inline="always")
def note(moves, totals, slot, left):
    """Append a pending move: an event at `slot` has left the lag `left` (-1 for a new event)."""
    at = totals[0].moves
    moves[at].slot = slot
    moves[at].left = left
    totals[0].moves = at + 1


@kernel(inline="always")
def age(time, slot, bound, moves, totals, tau, n, until):
    """Append the moves of events that are too old for their lag at T = `until`.

    With windows of a fixed number of events, make room for one more event instead.

    Returns
    -------
    bool
        False if there is no room for more moves: apply them, and call again.
    """
    mask = time.size - 1
    for lag in range(bound.size - 1):
        oldest = until - (lag + 1) * tau
        while (
            tau > 0 and bound[lag + 1] < bound[lag] and time[bound[lag + 1] & mask] < oldest
        ) or (n > 0 and bound[0] - bound[lag + 1] >= (lag + 1) * n):
            if totals[0].moves == len(moves):
                return False
            note(moves, totals, slot[bound[lag + 1] & mask], lag)
            bound[lag + 1] += 1
    return True


@kernel(inline="always")
def note_changes(slot, column, before, now, noted, total, counters, arrays):
    """Append the changes from one code of a counter to another.

    Parameters
    ----------
    column : int
        Index of the lag, counted from the oldest.
    noted : tuple of int
        Numbers of pending changes up and down.
    total : record of TOTALS
        Of the row of distances; its common part is updated.
    arrays : tuple
        `columns`, a row of `sums`, and `changes` of `SlidingWindows`.

    Returns
    -------
    tuple of int
        The new `noted`.
    """
    (columns, sums, changes), (arrivals, expiries) = arrays, noted
    up = 1 if now > before else -1
    for step in range(min(before, now), max(before, now)):
        # if all counts of the map are on one side, all distances change equally
        if step >= counters[slot].high:
            total.common += up
            continue
        if step < counters[slot].low:
            total.common -= up
            continue
        if arrivals + expiries == MAX_CHANGES:
            update_blocks(sums, columns, changes, arrivals, expiries, total.places)
            arrivals = expiries = 0
        if up > 0:
            at = arrivals
            arrivals += 1
        else:
            expiries += 1
            at = MAX_CHANGES - expiries
        changes[0, at] = slot * total.stride + column
        changes[1, at] = step
    return arrivals, expiries


@kernel(inner=True)
def take_moves(moves, totals, counts, saturation, counters, columns, sums, changes):
    """Apply the pending moves to counters and distances; the arrays are those of the state.

    With contrast codes, only the counters are updated; see `recode`.
    """
    total, distances = totals[0], sums[0]
    lags = counts.shape[0]
    noted = (0, 0)
    for m in range(total.moves):
        slot, left = moves[m].slot, moves[m].left
        for lag in range(max(left, 0), min(left + 2, lags)):
            before = counts[lag, slot]
            now = before + (-1 if lag == left else 1)
            counts[lag, slot] = now
            if saturation == 0:
                continue
            before, now = min(before, saturation), min(now, saturation)
            arrays = columns, distances, changes
            column = lags - 1 - lag
            noted = note_changes(slot, column, before, now, noted, total, counters, arrays)
    total.moves = 0
    if noted[0] + noted[1] > 0:
        update_blocks(distances, columns, changes, noted[0], noted[1], total.places)


@kernel(inner=True)
def recode(contrast, counts, totals, counters, columns, sums, changes):
    """Update contrast codes and distances from the counters; the arrays are those of the state.

    Most codes of a sum of windows stay the same; only changed ones take a pass over the places.
    """
    of_windows, added = np.zeros(counts.shape[1], dtype=np.int64), np.int64(0)
    for i in range(len(sums)):
        while added < SUMS[i]:
            for slot in range(of_windows.size):
                of_windows[slot] += counts[added, slot]
            added += 1
        codes, total, arrays = contrast.codes[i], totals[i], (columns, sums[i], changes)
        write_codes(of_windows, contrast, i, codes[1])
        noted = (0, 0)
        for slot in range(of_windows.size):
            before, now = codes[0, slot], codes[1, slot]
            codes[0, slot] = now
            noted = note_changes(slot, 0, before, now, noted, total, counters, arrays)
        if noted[0] + noted[1] > 0:
            update_blocks(sums[i], columns, changes, noted[0], noted[1], total.places)


@kernel
def settle(s):
    """Apply the pending moves to counters and distances of the state."""
    take_moves(s.moves, s.totals, s.counts, s.saturation, s.counters, s.columns, s.sums, s.changes)
    if s.saturation == 0:
        recode(s.contrast, s.counts, s.totals, s.counters, s.columns, s.sums, s.changes)


@kernel
def advance(s, until):
    """Advance the time to T = `until`, which only changes windows of a fixed time."""
    if s.tau > 0:
        while not age(s.time, s.slot, s.bound, s.moves, s.totals, s.tau, 0, until):
            settle(s)


@kernel(inline="always")
def write_codes(counts, contrast, of_sum, out):
    """Compute the contrast codes of a window, as `ContrastCode.encode` does.

    Parameters
    ----------
    counts : ndarray of int64, shape (J,)
        Counters of the window, or of a sum of windows.
    of_sum : int
        Which of the means are those of these counters.
    out : ndarray of int64, shape (J,)
        Codes.
    """
    levels, means, bits = contrast.levels, contrast.means[of_sum], contrast.bits
    half, total = np.int64(1 << (bits - 1)), np.int64(0)
    for j in range(out.size):
        out[j] = levels[min(counts[j], levels.size - 1)] - means[j]
        total += out[j]
    offset = np.int64(1 << (LEVEL_FRACTION_BITS - 1)) - (2 * total + out.size) // (2 * out.size)
    for j in range(out.size):
        out[j] = min(max((out[j] + offset) >> LEVEL_FRACTION_BITS, -half), half - 1) + half
