"""Kernels of the sliding windows: enter events, move them from lag to lag, update distances."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.online.vector_kernels import MAX_STEPS, update_blocks
from fixedpoint.own_mean import LEVEL_BITS

# Functions that are called for every event take single arrays, or are inlined: reading an array
# from the state changes a reference count, which takes longer than the processing of the event.


@kernel(inline="always")
def note(moves, totals, slot, left):
    """Note that an event at `slot` has left the lag `left` (-1 for a new event)."""
    at = totals[0].moves
    moves[at].slot = slot
    moves[at].left = left
    totals[0].moves = at + 1


@kernel(inline="always")
def age(time, slot, bound, moves, totals, tau, n, until):
    """Note the moves of events that become too old for their lag by T = `until`.

    Fixed-count windows make room for one more event instead.

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
            if totals[0].moves == len(moves):
                return False
            note(moves, totals, slot[bound[lag + 1] & mask], lag)
            bound[lag + 1] += 1
    return True


@kernel
def take_moves(moves, totals, counts, code, counters, columns, sums, steps):
    """Update counters and distances by the noted moves; the arrays are those of `s`."""
    total = totals[0]
    lags = counts.shape[0]
    arrivals = expiries = 0
    for m in range(total.moves):
        slot, left = moves[m].slot, moves[m].left
        for lag in range(max(left, 0), min(left + 2, lags)):
            up = -1 if lag == left else 1
            less = counts[lag, slot] + min(up, 0)
            counts[lag, slot] += up
            first, last = less, less + 1
            if code.size > 0:
                table = counters[slot].table
                first = np.int64(code[table, min(first, code.shape[1] - 1)])
                last = np.int64(code[table, min(last, code.shape[1] - 1)])
            for step in range(first, last):
                # if all counts of the map are on one side, all places change by the same amount
                if step >= counters[slot].high:
                    total.common += up
                    continue
                if step < counters[slot].low:
                    total.common -= up
                    continue
                if arrivals + expiries == MAX_STEPS:
                    update_blocks(sums, columns, steps, arrivals, expiries, total.sums)
                    arrivals = expiries = 0
                if up > 0:
                    at = arrivals
                    arrivals += 1
                else:
                    expiries += 1
                    at = MAX_STEPS - expiries
                steps[0, at] = slot * total.stride + lags - 1 - lag
                steps[1, at] = step
    total.moves = 0
    if arrivals + expiries > 0:
        update_blocks(sums, columns, steps, arrivals, expiries, total.sums)


@kernel
def settle(s):
    """Update counters and distances of the state by the noted moves."""
    take_moves(s.moves, s.totals, s.counts, s.code, s.counters, s.columns, s.sums, s.steps)


@kernel
def advance(s, until):
    """Advance the time to T = `until`, which changes fixed-time windows only."""
    if s.tau > 0:
        while not age(s.time, s.slot, s.bound, s.moves, s.totals, s.tau, 0, until):
            settle(s)


@kernel
def write_codes(levels, mean, bits, code):
    """Write the own-mean code of each count for each counter, as in `OwnMeanCode.tables`.

    Parameters
    ----------
    levels : ndarray of int32, shape (size,)
        Of `OwnMeanCode`.
    mean : ndarray of int32, shape (J,)
    bits : int
    code : ndarray of uint16, shape (J, size)
        Written to.
    """
    half = np.int32(1 << (bits - 1))
    for j in range(code.shape[0]):
        offset = np.int32((1 << (LEVEL_BITS - 1)) - mean[j])
        row = code[j]
        for c in range(row.size):
            octaves = np.int32((levels[c] + offset) >> LEVEL_BITS)
            row[c] = min(max(octaves, -half), half - 1) + half
