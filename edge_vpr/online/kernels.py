"""State and kernels of the localiser, which update distances and match after every event.

From the bottom up: vector updates of the sums; the state of sliding windows; the kernels that
update it; those that match; and `process_events`, the one kernel that a `MatchRun` calls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from edge_vpr.compiling import kernel, plain
from edge_vpr.confidence import NO_MISFIT, accept_match
from edge_vpr.descriptors.windows import MAX_WINDOWS, FixedTime, Window, is_pause
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events, Sensor, check_events
from edge_vpr.matching.distances import aligned_zeros
from edge_vpr.matching.place_filter import FilterState, WindowRows, end_window, match_window
from edge_vpr.matching.prediction import FilterTable
from edge_vpr.matching.search import exclusion_zone
from fixedpoint.own_mean import LEVEL_BITS, OwnMeanCode

# Vector kernels of online matching: change all sums by +-1, and find the smallest one.
#
# When a counter of the window changes from v to v + 1, its distance to a place changes by +1 if
# the count in the map is at most v, and by -1 otherwise. Several such changes (arrivals and
# expiries at any pixels) are accumulated in 8-bit lanes and then added to the sums in one pass.
#
# The intrinsics emit generic vector IR, which LLVM compiles for any target; it would widen plain
# loops to 32 bits or more. With Numba's compiler off, NumPy makes the same changes.


#: places in one vector; arrays end with this many padding elements
LANES = 64
#: changes in one pass; their sum must fit into a signed byte
MAX_CHANGES = 120
#: places whose sums stay in the first-level cache between update and search
BLOCK = 4096

_I8, _I32, _I64 = ir.IntType(8), ir.IntType(32), ir.IntType(64)


def _splat(builder, value):
    vector = ir.VectorType(value.type, LANES)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return builder.shuffle_vector(first, nothing, zeros)


def _load(builder, data, index, vector):
    pointer = builder.bitcast(builder.gep(data, [index]), vector.as_pointer())
    return builder.load(pointer, align=1)


def _loop(builder, start, stop, step, carried, body):
    """``for i in range(start, stop, step): carried = body(i, carried)``."""
    before = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "body", "end"))
    builder.branch(head)
    builder.position_at_end(head)
    i = builder.phi(_I64)
    i.add_incoming(start, before)
    value = builder.phi(carried.type)
    value.add_incoming(carried, before)
    builder.cbranch(builder.icmp_signed("<", i, stop), inside, after)
    builder.position_at_end(inside)
    new = body(i, value)
    i.add_incoming(builder.add(i, ir.Constant(_I64, step)), builder.block)
    value.add_incoming(new, builder.block)
    builder.branch(head)
    builder.position_at_end(after)
    return value


def _smaller(builder, a, b):
    return builder.select(builder.icmp_unsigned("<", a, b), a, b)


def _least_lane(builder, vector):
    """Return the smallest lane, by halving the vector until one lane is left."""
    width = LANES
    while width > 1:
        width //= 2
        nothing = ir.Constant(vector.type, ir.Undefined)
        low, high = (
            builder.shuffle_vector(
                vector,
                nothing,
                ir.Constant(ir.VectorType(_I32, width), list(range(first, first + width))),
            )
            for first in (0, width)
        )
        vector = _smaller(builder, low, high)
    return builder.extract_element(vector, ir.Constant(_I32, 0))


@intrinsic
def _vector_change(typing_context, sums, columns, changes, arrivals, expiries, start, stop):
    """Apply the first `arrivals` and the last `expiries` changes, and find the least sum."""
    signature = sums.dtype(sums, columns, changes, arrivals, expiries, start, stop)

    def codegen(context, builder, signature, arguments):
        sums_a, columns_a, changes_a = (
            context.make_array(signature.args[i])(context, builder, arguments[i]).data
            for i in range(3)
        )
        arrivals, expiries, start, stop = arguments[3:]
        end = ir.Constant(_I64, MAX_CHANGES)
        count_type = ir.IntType(columns.dtype.bitwidth)
        sum_vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)
        byte_vector = ir.VectorType(_I8, LANES)
        # each arrival adds 1 and each expiry subtracts 1; the opposite if the map's count is larger
        change = builder.sub(arrivals, expiries)
        base = _splat(builder, builder.trunc(change, sum_vector.element))

        def one_vector(place, least):
            def add_above(sign):
                def one_step(o, total):
                    offset = builder.load(builder.gep(changes_a, [o]))
                    counts = _load(
                        builder,
                        columns_a,
                        builder.add(offset, place),
                        ir.VectorType(count_type, LANES),
                    )
                    level = builder.load(builder.gep(changes_a, [builder.add(o, end)]))
                    level = _splat(builder, builder.trunc(level, count_type))
                    # all ones, that is -1, where the map's count is above the level
                    above = builder.sext(builder.icmp_unsigned(">", counts, level), byte_vector)
                    return builder.add(total, above) if sign > 0 else builder.sub(total, above)

                return one_step

            total = ir.Constant(byte_vector, [0] * LANES)
            total = _loop(builder, ir.Constant(_I64, 0), arrivals, 1, total, add_above(1))
            total = _loop(builder, builder.sub(end, expiries), end, 1, total, add_above(-1))
            wide = builder.sext(total, sum_vector)
            pointer = builder.bitcast(builder.gep(sums_a, [place]), sum_vector.as_pointer())
            old = builder.load(pointer, align=1)
            new = builder.add(builder.add(old, base), builder.add(wide, wide))
            builder.store(new, pointer, align=1)
            return _smaller(builder, new, least)

        largest = ir.Constant(sum_vector, [2**sums.dtype.bitwidth - 1] * LANES)
        return _least_lane(builder, _loop(builder, start, stop, LANES, largest, one_vector))

    return signature, codegen


@intrinsic
def _vector_least(typing_context, sums, start, stop):
    """Return the smallest of ``sums[start:stop]``, which is at least one vector long."""

    def codegen(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        start, stop = arguments[1:]
        vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)

        # the last vector may overlap the one before it
        last = builder.sub(stop, ir.Constant(_I64, LANES))
        least = _loop(
            builder,
            start,
            last,
            LANES,
            _load(builder, data, last, vector),
            lambda i, value: _smaller(builder, value, _load(builder, data, i, vector)),
        )
        return _least_lane(builder, least)

    return sums.dtype(sums, start, stop), codegen


@intrinsic
def _vector_find(typing_context, sums, start, value):
    """Return the first i with ``sums[start + i] == value`` in one vector, or LANES."""

    def codegen(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)
        equal = builder.icmp_unsigned(
            "==", _load(builder, data, arguments[1], vector), _splat(builder, arguments[2])
        )
        # number of trailing zeros of the comparison; 64 if no bit is set
        return builder.cttz(builder.bitcast(equal, _I64), ir.Constant(ir.IntType(1), 0))

    return types.int64(sums, start, sums.dtype), codegen


if config.DISABLE_JIT:

    def change_sums(sums, columns, changes, arrivals, expiries, start, stop):
        """Apply +-1 changes to ``sums[start:stop]`` and find the smallest, as the kernel below."""
        for o in (*range(arrivals), *range(MAX_CHANGES - expiries, MAX_CHANGES)):
            offset, level = changes[:, o]
            column = columns[offset + start : offset + stop]
            change = np.where(column > level, -1, 1) * (1 if o < arrivals else -1)
            sums[start:stop] += change.astype(sums.dtype)  # -1 wraps, as intended
        return sums[start:stop].min()

    def _least(sums, start, stop):
        return sums[start:stop].min()

    def _first_equal(sums, start, stop, value):
        return start + int(np.argmax(sums[start:stop] == value))

else:

    @kernel(inline="always")
    def change_sums(sums, columns, changes, arrivals, expiries, start, stop):
        """Apply +-1 changes to ``sums[start:stop]``, and return the smallest sum.

        Padding elements after `stop` change too; they must be larger than all sums.

        Parameters
        ----------
        sums : ndarray of uint16 or uint32, shape (places + LANES + blocks,)
            Sums of the places, padding, and the smallest sum of each block.
        columns : ndarray of uint8 or uint16
            Map, the places of one pixel after another, and LANES padding elements.
        changes : ndarray of int64, shape (2, MAX_CHANGES)
            For each step, the index in `columns` of the count that belongs to ``sums[0]``, and the
            smaller of the two counts of the step.
        arrivals, expiries : int
            The first `arrivals` changes increase a count, the last `expiries` decrease one;
            together at most MAX_CHANGES.
        start, stop : int
            `start` is a multiple of LANES.

        Returns
        -------
        least
        """
        return _vector_change(sums, columns, changes, arrivals, expiries, start, stop)

    @kernel(inline="always")
    def _least(sums, start, stop):
        if stop - start >= LANES:
            return _vector_least(sums, start, stop)
        least = sums[start]
        for i in range(start + 1, stop):
            least = min(least, sums[i])
        return least

    @kernel(inline="always")
    def _first_equal(sums, start, stop, value):
        i = start
        while True:
            # reading past `stop` is harmless: the value occurs before it
            lane = _vector_find(sums, i, value)
            if lane < LANES:
                return i + lane
            i += LANES


@kernel(inline="always")
def least_in(sums, count, start, stop):
    """Return the first index of the smallest of ``sums[start:stop]``, and its value.

    Parameters
    ----------
    sums : ndarray of uint16 or uint32, shape (count + LANES + blocks,)
        At the end, the smallest of each BLOCK of the first `count` sums, see `update_blocks`.
    count, start, stop : int
        ``start < stop <= count``.

    Returns
    -------
    index, value
    """
    best_block = -1
    best = sums[start]
    for block in range(start // BLOCK, (stop - 1) // BLOCK + 1):
        first, end = block * BLOCK, min((block + 1) * BLOCK, count)
        whole = start <= first and end <= stop
        least = (
            sums[count + LANES + block]
            if whole
            else _least(sums, max(start, first), min(stop, end))
        )
        if best_block < 0 or least < best:
            best_block, best = block, least
    return _first_equal(sums, max(start, best_block * BLOCK), stop, best), best


@kernel(inline="always")
def update_blocks(sums, columns, changes, arrivals, expiries, count):
    """Apply changes to the first `count` sums, and store the smallest of each block after them."""
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        sums[count + LANES + start // BLOCK] = change_sums(
            sums, columns, changes, arrivals, expiries, start, stop
        )


# State of sliding windows: the newest time or events, and earlier windows of the same length.
#
# A sequence consists of L consecutive windows, which are numbered by their lag: lag 0 is the newest
# window, and lag i has the content that lag 0 had i window lengths ago. An event
# enters at lag 0, moves from lag to lag as it ages, and leaves after the last one. Each move
# subtracts one from a counter and adds one to another. At time T, lag i of windows of tau
# microseconds holds the events with ``T - (i+1) tau <= t < T - i tau``; after an event at time t,
# T is t + 1. Lag i of windows of N events holds the i N-th to (i+1) N-th newest event at the
# selected pixels.
#
# At the end of every non-overlapping window, T = k tau or the k N-th selected event, the lags are
# exactly the last L windows of `edge_vpr.descriptors.windows`.


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
#: number of sums in use.
TOTALS = np.dtype([("common", "<i8"), ("moves", "<i8"), ("stride", "<i8"), ("sums", "<i8")])


class ContrastCodes(NamedTuple):
    """Parameters and state of contrast codes, each of which depends on the whole window.

    Attributes
    ----------
    levels : ndarray of int32, shape (size,)
        Logarithm of each count, see `OwnMeanCode`; empty where the windows hold counts.
    means : ndarray of int32, shape (J,)
        Mean logarithm of each counter, in units of 1/256 octave.
    codes : ndarray of int64, shape (2, J)
        Codes that the distances include, and scratch.
    bits : int
        See `OwnMeanCode`.
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
    sums : ndarray of uint16 or uint32
        ``sums[m]``: distance of the sequence that ends at place m + L - 1, less the common part.
        After LANES padding elements, the smallest sum of each block, see `least_in`.
    changes : ndarray of int64, shape (2, MAX_CHANGES)
        Scratch for the changes of `update_blocks`.
    totals : ndarray of TOTALS, shape (1,)
        Numbers shared by all counters.
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
    code: OwnMeanCode | int,
    mean: npt.NDArray[np.int32] | None = None,
) -> SlidingWindows:
    """Build the state before the first event.

    Parameters
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Map, in its codes.
    length : int
        L.
    code : OwnMeanCode or int
        Contrast code of the counts; or the count at which they saturate, or `UNLIMITED`.
    mean : ndarray of int32, shape (J,), optional
        Initial means of contrast codes.
    """
    counters = places.shape[1]
    levels, means, bits = np.empty(0, dtype=np.int32), np.zeros(counters, dtype=np.int32), 0
    if isinstance(code, OwnMeanCode) and mean is not None:
        # copies, because Numba gives read-only arrays another type
        levels, means, bits = code.levels.copy(), mean.copy(), code.bits
    state = SlidingWindows(
        slot=np.zeros(RING_EVENTS, dtype=np.int32),
        time=np.zeros(RING_EVENTS, dtype=np.int64),
        bound=np.zeros(length + 1, dtype=np.int64),
        moves=np.zeros(MAX_MOVES, dtype=MOVE).view(np.recarray),
        counts=np.zeros((length, counters), dtype=np.int64),
        tau=window.tau_us if isinstance(window, FixedTime) else 0,
        n=0 if isinstance(window, FixedTime) else window.events,
        saturation=code if isinstance(code, int) else 0,
        contrast=ContrastCodes(levels, means, np.zeros((2, counters), dtype=np.int64), bits),
        counters=np.zeros(counters, dtype=COUNTER).view(np.recarray),
        columns=np.empty(0, dtype=np.uint8),
        sums=np.empty(0, dtype=np.uint16),
        changes=np.zeros((2, MAX_CHANGES), dtype=np.int64),
        totals=np.zeros(1, dtype=TOTALS).view(np.recarray),
    )
    return with_distances(state, places)


def with_distances(s: SlidingWindows, places: npt.NDArray[np.unsignedinteger]) -> SlidingWindows:
    """Return the state with a map laid out by pixel, and all distances of the current counters."""
    length = len(s.counts)
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
    distances = np.zeros(count + LANES, dtype=np.int64)
    for lag in range(length):
        end = length - 1 - lag
        # `ReferenceIndex` is faster, but its compilation would take longer than this
        for column, code in zip(by_pixel, coded[lag].tolist(), strict=True):
            distances += np.abs(column[end : end + count + LANES].astype(np.int64) - code)
    base = int(np.abs(coded - np.clip(coded, low, high)).sum())
    # upper bound of the distances less the base; padding exceeds it, and a search may include it
    largest = length * int((high - low).sum())
    if 2 * largest + 1 > np.iinfo(np.uint32).max:
        raise UsageError(
            f"distances of up to {largest} do not fit 32 bits: take fewer pixels, a shorter "
            "sequence, or a counter code"
        )
    distances[count:] += largest + 1
    dtype = np.uint16 if 2 * largest + 1 <= np.iinfo(np.uint16).max else np.uint32
    sums = aligned_zeros(count + LANES + -(-count // BLOCK), dtype)
    sums[: count + LANES] = distances - base
    _find_least(sums, count)
    counters = s.counters.copy()
    counters["low"], counters["high"] = low, high
    return s._replace(
        columns=columns,
        counters=counters,
        sums=sums,
        totals=np.array([(base, 0, stride, count)], dtype=TOTALS).view(np.recarray),
    )


def _find_least(sums: npt.NDArray[np.unsignedinteger], count: int) -> None:
    """Write the smallest sum of each block behind the sums, see `least_in`."""
    sums[count + LANES :] = np.minimum.reduceat(sums[:count], np.arange(0, count, BLOCK))


def _coded(s: SlidingWindows) -> npt.NDArray[np.int64]:
    """Return the codes of the counters of each lag, shape (L, J); contrast codes are stored too."""
    if s.contrast.levels.size:
        plain(write_codes)(s.counts[0], s.contrast, s.contrast.codes[0])
        return s.contrast.codes[:1]
    return np.minimum(s.counts, s.saturation)


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
def note_changes(slot, column, before, now, noted, totals, counters, arrays):
    """Append the changes from one code of a counter to another.

    Parameters
    ----------
    column : int
        Index of the lag, counted from the oldest.
    noted : tuple of int
        Numbers of pending changes up and down.
    arrays : tuple
        `columns`, `sums` and `changes` of `SlidingWindows`.

    Returns
    -------
    tuple of int
        The new `noted`.
    """
    total, (columns, sums, changes), (arrivals, expiries) = totals[0], arrays, noted
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
            update_blocks(sums, columns, changes, arrivals, expiries, total.sums)
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
    total = totals[0]
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
            arrays = columns, sums, changes
            column = lags - 1 - lag
            noted = note_changes(slot, column, before, now, noted, totals, counters, arrays)
    total.moves = 0
    if noted[0] + noted[1] > 0:
        update_blocks(sums, columns, changes, noted[0], noted[1], total.sums)


@kernel(inner=True)
def recode(contrast, counts, totals, counters, columns, sums, changes):
    """Update contrast codes and distances from the counters; the arrays are those of the state.

    Most codes stay the same; only changed ones take a pass over the places.
    """
    write_codes(counts[0], contrast, contrast.codes[1])
    noted = (0, 0)
    for slot in range(contrast.codes.shape[1]):
        before, now = contrast.codes[0, slot], contrast.codes[1, slot]
        contrast.codes[0, slot] = now
        arrays = columns, sums, changes
        noted = note_changes(slot, 0, before, now, noted, totals, counters, arrays)
    if noted[0] + noted[1] > 0:
        update_blocks(sums, columns, changes, noted[0], noted[1], totals[0].sums)


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
def write_codes(counts, contrast, out):
    """Compute the contrast codes of a window, as `OwnMeanCode.encode` does.

    Parameters
    ----------
    counts : ndarray of int64, shape (J,)
        Counters of the window.
    out : ndarray of int64, shape (J,)
        Codes.
    """
    levels, means, bits = contrast.levels, contrast.means, contrast.bits
    half, total = np.int64(1 << (bits - 1)), np.int64(0)
    for j in range(out.size):
        out[j] = levels[min(counts[j], levels.size - 1)] - means[j]
        total += out[j]
    offset = np.int64(1 << (LEVEL_BITS - 1)) - (2 * total + out.size) // (2 * out.size)
    for j in range(out.size):
        out[j] = min(max((out[j] + offset) >> LEVEL_BITS, -half), half - 1) + half


# Kernels that match: the best place and the confidence in it.


@kernel(inline="always")
def sequence_match(sums, total, c, length, row):
    """Match by the nearest sequence.

    Parameters
    ----------
    sums : ndarray of uint16 or uint32
        Of `SlidingWindows`, without pending moves.
    c : record of CONTROL
        The place of the last match is updated.
    length : int
        L.
    row : record of MATCH_DTYPE
        Output; `accept_match` and `process_events` write the other fields.

    Returns
    -------
    bool
        Whether there is a match: not if only changes are requested and the place is the same.
    """
    places = total.sums - c.recent
    best, least = least_in(sums, total.sums, np.int64(0), places)
    if c.change and best == c.last_reported:
        return False
    c.last_reported = best
    second, second_least = _second(sums, total.sums, best, c.exclusion, places)
    best_sum, second_sum = np.int64(least) + total.common, np.int64(-1)
    row["place"], row["second"], row["trust"] = best + length - 1, -1, 0
    row["misfit"] = NO_MISFIT
    if second >= 0:
        row["second"] = second + length - 1
        second_sum = np.int64(second_least) + total.common
        row["trust"] = second_sum - best_sum
    write_distances(row, best_sum, second_sum, length)
    return True


@kernel(inline="always")
def write_distances(row, best_sum, second_sum, length):
    """Write the distances of a match and their ratio.

    Parameters
    ----------
    best_sum, second_sum : int
        Sums over the L windows; the second is negative if there is no second place.
    length : int
        L.
    """
    row["distance"] = best_sum / length
    row["second_distance"] = np.nan if second_sum < 0 else second_sum / length
    row["ratio"] = np.nan if second_sum < 0 else 1.0
    if second_sum > 0:
        row["ratio"] = best_sum / second_sum


@kernel(inline="always")
def _second(sums, count, best, exclusion, places):
    """Return the best place outside the exclusion zone and its sum; -1 if there is none."""
    second, second_least = -1, sums[best]
    first, end = exclusion_zone(best, exclusion)
    if first > 0:
        second, second_least = least_in(sums, count, np.int64(0), first)
    if end < places:
        after, after_least = least_in(sums, count, end, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    return second, second_least


@kernel(inner=True)
def match_now(state, filter_table, rows, sums, total, c, length, events, over, row):
    """Match by the place filter or by sequences, or end the window of the place filter.

    `state`, `filter_table` and `rows` are None with sequences, `length` with the place filter.
    Numba prunes branches on arguments that are None, so that only one of the two is compiled.

    Parameters
    ----------
    state, filter_table, rows, sums, total, c, length
        Of `OnlineState`, without pending moves. `rows` is updated, and in `c` the place of the last
        match, or whether the window was a pause.
    events : int
        Number of events in the newest window, at selected pixels.
    over : bool
        Whether the window ends: the filter then advances, and there is no match.
    row : record of MATCH_DTYPE
        Output; `accept_match` and `process_events` write the other fields.

    Returns
    -------
    bool
        Whether there is a match: not if only changes are requested and the place is the same.
    """
    if state is None:
        if length is not None:
            return sequence_match(sums, total, c, length, row)
        return False
    state, rows = FilterState(*state), WindowRows(*rows)
    metric, found = rows.metrics[0], rows.columns[0]
    # without their common part: only differences of distances matter
    distances = sums[: metric.size]
    matched = match_window(state, FilterTable(*filter_table), distances, events, rows, 0)
    if over:
        c.paused = is_pause(events, state.numbers[0].mean_activity)
        end_window(state, distances, events, metric, matched)
        return False
    best, least, second, second_least = found[0], found[1], found[2], found[3]
    if c.change and best == c.last_reported:
        return False
    c.last_reported = best
    row["place"], row["second"], row["trust"], row["misfit"] = best, second, found[5], found[6]
    write_distances(row, least, second_least, 1)
    return True


# Checks and selection of events: time order, sensor, selected pixels.


@kernel
def selected_in_order(table, events, floor, slots, times):
    """Write the events at selected pixels, unless any event is out of order or off the sensor.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (height, width)
        Slot of each pixel, negative where it is not selected.
    events : ndarray of EVENT_DTYPE, shape (n,)
        Unchecked events.
    floor : int
        Earliest allowed time.
    slots : ndarray of int32, shape (n or more,)
        Output: slots of the selected events.
    times : ndarray of int64, shape (n or more,)
        Output: times of the selected events.

    Returns
    -------
    int
        Number of events at selected pixels; -1 for invalid events, see `check_order`.
    """
    last, n = floor, 0
    for i in range(events.size):
        event = events[i]
        x, y, t = event["x"], event["y"], event["t"]
        if t < last or t > TIME_LIMIT_US or y >= table.shape[0] or x >= table.shape[1]:
            return -1
        last = t
        slot = table[y, x]
        if slot >= 0:
            slots[n] = slot
            times[n] = t
            n += 1
    return n


def check_order(events: Events, floor_us: int, sensor: Sensor) -> None:
    """Raise the error of events that `selected_in_order` refuses.

    Parameters
    ----------
    events : ndarray with fields t, x and y, shape (n,)
        At least one.
    floor_us : int
        Earliest allowed time: that of the last event before these, or up to which time has advanced
        without events.

    Raises
    ------
    EventError
        If time runs backwards or a pixel lies off the sensor.
    """
    first, last = int(events["t"][0]), int(events["t"][-1])
    if first < floor_us:
        raise EventError(
            f"time runs backwards, from {floor_us} to {first} us: sort the events, or drop the "
            "late ones"
        )
    if last > TIME_LIMIT_US:
        raise EventError(
            f"an event at {last} us lies beyond {TIME_LIMIT_US} us: check the unit of its clock"
        )
    check_events(events, sensor)


# The state of a localiser's kernel, in one tuple.


#: Initial capacity for the events of a chunk.
CHUNK_EVENTS = 4_096
#: A time later than the end of any window.
NEVER = np.iinfo(np.int64).max

#: Control of the kernel; times in microseconds.
CONTROL = np.dtype(
    [
        # when to match, see `MatchSchedule`
        ("every", "<i8"),
        ("interval", "<i8"),
        ("change", "<i8"),
        ("next_tick", "<i8"),  # time of the next match by the interval
        ("last_reported", "<i8"),  # place of the last match
        # search
        ("exclusion", "<i8"),  # of sequences: width of the zone around the best place
        ("recent", "<i8"),  # number of the newest places that are not searched
        ("least_trust", "<i8"),  # of a match that is accepted
        # place filter
        ("window_end", "<i8"),  # end of the current window; `NEVER` with sequences
        ("paused", "<i8"),  # whether the window that ended last was a pause
        # events
        ("floor", "<i8"),  # earliest time that the next event may have
        ("now", "<i8"),  # T: all earlier events have been processed, except for these:
        ("read", "<i8"),  # first selected event of the chunk that is not processed yet
        ("selected", "<i8"),  # number of selected events of the chunk
        ("until", "<i8"),  # time of the last event of the chunk, to which the time advances
    ]
)


class OnlineState(NamedTuple):
    """State of the kernel `process_events`.

    Attributes
    ----------
    windows : SlidingWindows
        Counters of the newest windows, and their distances to all places.
    filter : FilterState or None
        Arrays shared with the `PlaceFilter`; None with sequences, as are the next two.
    filter_table : FilterTable or None
        See `Transitions`.
    rows : WindowRows or None
        Scratch of the place filter, for one window.
    length : int or None
        L of sequences; None with the place filter.
    control : ndarray of CONTROL, shape (1,)
        Numbers of the kernel.
    trust_steps, probability_steps : ndarray of int64 and float64, shape (m,)
        `trust` and `probability` of `edge_vpr.confidence.Confidence`; m is 0 if it is unknown.
    table : ndarray of int16 or int32, shape (height, width)
        See `PixelMap.table`.
    slots, times : ndarray of int32 and int64, shape (CHUNK_EVENTS or more,)
        Selected events of the current chunk.
    out : ndarray of MATCH_DTYPE, shape (MATCHES_AT_ONCE,)
        Output of matches.
    """

    windows: SlidingWindows
    filter: FilterState | None
    filter_table: FilterTable | None
    rows: WindowRows | None
    length: int | None
    control: npt.NDArray[np.void]
    trust_steps: npt.NDArray[np.int64]
    probability_steps: npt.NDArray[np.float64]
    table: npt.NDArray[np.signedinteger]
    slots: npt.NDArray[np.int32]
    times: npt.NDArray[np.int64]
    out: npt.NDArray[np.void]


# The kernel of the localiser, which processes events to matches without returning to Python.


# reasons for the kernel to return
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)
#: in place of a time
GO_ON = -1

Stop = tuple[int, int]
"""Result of `process_events`."""


@kernel
def process_events(kernel_state, events, until):
    """Process events, or continue with those of an earlier call, until Python code is needed.

    Parameters
    ----------
    kernel_state : KernelState
        Of an `OnlineState`; its arrays are updated in place.
    events : ndarray of EVENT_DTYPE, shape (m,)
        At most as many as `OnlineState.slots` has room for.
    until : int
        Without events: the time to advance to, or `GO_ON` to continue an earlier call.

    Returns
    -------
    given, why : int
        Number of matches written to `OnlineState.out`; and `DONE`, `MATCHES_FULL`, `RING_FULL`,
        `WINDOW_OVER` (the place filter has ended a window), or `REFUSED`: an event is off the
        sensor, out of order, or beyond too many ticks, and no event was processed.
    """
    f = OnlineState(*kernel_state.value)
    s, c, out = SlidingWindows(*f.windows), f.control[0], f.out
    if events.size > 0:
        last = events[events.size - 1]["t"]
        selected = selected_in_order(f.table, events, c.floor, f.slots, f.times)
        if selected < 0 or (c.interval > 0 and (last - c.next_tick) // c.interval > MAX_WINDOWS):
            return 0, REFUSED
        c.floor, c.until, c.now, c.read, c.selected = last, last, last + 1, 0, selected
    elif until != GO_ON:
        c.floor, c.until, c.now, c.read, c.selected = until, until, max(c.now, until), 0, 0
    slots, times, until = f.slots, f.times, c.until
    ring_slot, ring_time, bound = s.slot, s.time, s.bound
    moves, totals, counts, counters = s.moves, s.totals, s.counts, s.counters
    saturation, contrast = s.saturation, ContrastCodes(*s.contrast)
    columns, sums, changes = s.columns, s.sums, s.changes
    state, filter_table, rows, length = f.filter, f.filter_table, f.rows, f.length
    tau, n, windows, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i, end = 0, c.read, c.selected
    # a countdown, because a division would take as long as the rest of processing an event
    left = c.every - bound[0] % c.every if c.every > 0 else np.int64(-1)
    # each iteration processes a tick or an event, until none is left
    while True:
        now = times[i] if i < end else until
        tick = c.interval > 0 and c.next_tick <= now
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        # a tick at the end of a window belongs to it; an event at the same time to the next window
        over = seen_until > c.window_end
        why = DONE
        if over:
            seen_until = c.window_end
        elif not tick and i == end:
            break
        why = MATCHES_FULL
        if given == len(out):
            break
        room = 0 if tick or over else n
        while not (
            age(ring_time, ring_slot, bound, moves, totals, tau, room, seen_until)
            and totals[0].moves < len(moves)
        ):
            take_moves(moves, totals, counts, saturation, counters, columns, sums, changes)
        if tick and not over:
            c.next_tick += c.interval
        elif not over:
            why = RING_FULL
            if bound[0] - bound[windows] > mask:
                break
            ring_slot[bound[0] & mask] = slots[i]
            ring_time[bound[0] & mask] = now
            bound[0] += 1
            note(moves, totals, slots[i], -1)
            i += 1
            left -= 1
            if left != 0:
                continue
            left = c.every
        complete = seen_until >= windows * tau if tau > 0 else bound[0] >= windows * n
        if not complete:
            continue
        take_moves(moves, totals, counts, saturation, counters, columns, sums, changes)
        if saturation == 0:
            recode(contrast, counts, totals, counters, columns, sums, changes)
        row, in_window = out[given], bound[0] - bound[1]
        if match_now(state, filter_table, rows, sums, totals[0], c, length, in_window, over, row):
            row["time_us"], row["events"] = now, in_window
            # start of a fixed-count window: the time of its oldest event
            row["start_us"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            accept_match(row, f.trust_steps, f.probability_steps, c.least_trust)
            given += 1
        why = WINDOW_OVER
        if over:
            break
    c.read = i
    return given, why
