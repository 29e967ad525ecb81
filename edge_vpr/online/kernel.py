"""The kernel of the localiser: events at selected pixels in, matches out."""

from __future__ import annotations

import numpy as np
from numba import njit

from edge_vpr.online.state import BASE, MOVES, age, take_moves
from edge_vpr.online.vector_kernels import least_in

# why the kernel returned
DONE, MATCHES_FULL, RING_FULL = range(3)
# indices into the array of the policy's state
NEXT_TICK, LAST_PLACE = range(2)


@njit(cache=True, nogil=True)
def follow(s, slots, times, until, every, interval, change, exclusion, places, policy, out):
    """Feed selected events, then let time pass to `until`; stop where a buffer is full.

    Parameters
    ----------
    s : Sliding
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)
        Events at selected pixels, in time order.
    until : int
        Time of the last event, selected or not, in microseconds.
    every, interval, change : int, int, bool
        The policy, see `edge_vpr.online.schedule.MatchSchedule`.
    exclusion, places : int
        Width of the zone around the best place; number of sums to search.
    policy : ndarray of int64, shape (2,)
        Next tick, and the place said last; changed in place.
    out : ndarray of int64, shape (n, 7)
        Matches are written here: the integers of MATCH_DTYPE, in its order.

    Returns
    -------
    read, given, why : int
        Events taken, matches written, and `DONE`, `MATCHES_FULL` or `RING_FULL`.
    """
    ring_slot, ring_time, bound, moves, number = s.slot, s.time, s.bound, s.moves, s.number
    counts, code, row, low, high, columns = s.counts, s.code, s.row, s.low, s.high, s.columns
    sums, block_least, offset, level, shape = s.sums, s.block_least, s.offset, s.level, s.shape
    tau, n, length, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i = 0, 0
    # counted down: a division for each event would take as long as the rest of its bookkeeping
    left = every - bound[0] % every if every > 0 else np.int64(-1)
    # one turn is a tick, or the next event, until both have come to an end
    while True:
        now = times[i] if i < slots.size else until
        tick = interval > 0 and policy[NEXT_TICK] <= now
        if not tick and i == slots.size:
            return i, given, DONE
        if given == len(out):
            return i, given, MATCHES_FULL
        now = policy[NEXT_TICK] if tick else now
        seen_until = now if tick else now + 1
        while not (
            age(ring_time, ring_slot, bound, moves, number, tau, 0 if tick else n, seen_until)
            and number[MOVES] < len(moves)
        ):
            take_moves(
                moves, counts, code, row, low, high, columns, sums, block_least, offset, level,
                number, shape,
            )  # fmt: skip
        if tick:
            policy[NEXT_TICK] += interval
        else:
            if bound[0] - bound[length] > mask:
                return i, given, RING_FULL
            ring_slot[bound[0] & mask] = slots[i]
            ring_time[bound[0] & mask] = now
            bound[0] += 1
            moves[number[MOVES], 0] = slots[i]
            moves[number[MOVES], 1] = -1
            number[MOVES] += 1
            i += 1
            left -= 1
            if left != 0:
                continue
            left = every
        complete = seen_until >= length * tau if tau > 0 else bound[0] >= length * n
        if not complete:
            continue
        take_moves(
            moves, counts, code, row, low, high, columns, sums, block_least, offset, level,
            number, shape,
        )  # fmt: skip
        best, least = least_in(sums, block_least, shape[1], 0, places)
        if change and best == policy[LAST_PLACE]:
            continue
        policy[LAST_PLACE] = best
        second, second_least = _second(sums, block_least, shape[1], best, exclusion, places)
        out[given, 0] = now
        out[given, 1] = best + length - 1
        out[given, 2] = np.int64(least) + number[BASE]
        out[given, 3] = second + length - 1 if second >= 0 else -1
        out[given, 4] = np.int64(second_least) + number[BASE] if second >= 0 else -1
        out[given, 5] = bound[0] - bound[1]
        # of a window of a number of events, the time of the oldest
        out[given, 6] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
        given += 1


@njit(cache=True, nogil=True, inline="always")
def _second(sums, block_least, count, best, exclusion, places):
    """Look for the best outside the exclusion zone; -1 if there is nothing outside."""
    second, second_least = -1, sums[best]
    if best - exclusion > 0:
        second, second_least = least_in(sums, block_least, count, 0, best - exclusion)
    if best + exclusion + 1 < places:
        after, after_least = least_in(sums, block_least, count, best + exclusion + 1, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    return second, second_least
