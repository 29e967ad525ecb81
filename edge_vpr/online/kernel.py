"""The kernel of the localiser: events at selected pixels in, matches out."""

from __future__ import annotations

import numpy as np
from numba import njit

from edge_vpr.online.state_kernels import age, note, take_moves
from edge_vpr.online.vector_kernels import least_in

# why the kernel returned
DONE, MATCHES_FULL, RING_FULL = range(3)
#: When a match is given, see `edge_vpr.online.schedule.MatchSchedule`, with the next tick and the
#: place told last; and what is searched: width of the zone around the best place, number of sums.
CONTROL = np.dtype(
    [
        ("every", np.int64),
        ("interval", np.int64),
        ("change", np.int64),
        ("next_tick", np.int64),
        ("place_told", np.int64),
        ("exclusion", np.int64),
        ("places", np.int64),
    ]
)


@njit(cache=True, nogil=True)
def follow(s, control, slots, times, until, out):
    """Feed selected events, then let time pass to `until`; stop where a buffer is full.

    Parameters
    ----------
    s : Sliding
    control : ndarray of CONTROL, shape (1,)
        Changed in place: the next tick, and the place told last.
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)
        Events at selected pixels, in time order.
    until : int
        Time of the last event, selected or not, in microseconds.
    out : ndarray of int64, shape (n, 7)
        Matches are written here: the integers of MATCH_DTYPE, in its order.

    Returns
    -------
    read, given, why : int
        Events taken, matches written, and `DONE`, `MATCHES_FULL` or `RING_FULL`.
    """
    c, ring_slot, ring_time, bound = control[0], s.slot, s.time, s.bound
    moves, totals, counts, code, counters = s.moves, s.totals, s.counts, s.code, s.counters
    columns, sums, steps = s.columns, s.sums, s.steps
    tau, n, length, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i = 0, 0
    # counted down: a division for each event would take as long as the rest of its bookkeeping
    left = c.every - bound[0] % c.every if c.every > 0 else np.int64(-1)
    # one turn is a tick, or the next event, until both have come to an end
    while True:
        now = times[i] if i < slots.size else until
        tick = c.interval > 0 and c.next_tick <= now
        if not tick and i == slots.size:
            return i, given, DONE
        if given == len(out):
            return i, given, MATCHES_FULL
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        while not (
            age(ring_time, ring_slot, bound, moves, totals, tau, 0 if tick else n, seen_until)
            and totals[0].moves < len(moves)
        ):
            take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        if tick:
            c.next_tick += c.interval
        else:
            if bound[0] - bound[length] > mask:
                return i, given, RING_FULL
            ring_slot[bound[0] & mask] = slots[i]
            ring_time[bound[0] & mask] = now
            bound[0] += 1
            note(moves, totals, slots[i], -1)
            i += 1
            left -= 1
            if left != 0:
                continue
            left = c.every
        complete = seen_until >= length * tau if tau > 0 else bound[0] >= length * n
        if not complete:
            continue
        take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        best, least = least_in(sums, totals[0].sums, 0, c.places)
        if c.change and best == c.place_told:
            continue
        c.place_told = best
        second, second_least = _second(sums, totals[0].sums, best, c.exclusion, c.places)
        out[given, 0] = now
        out[given, 1] = best + length - 1
        out[given, 2] = np.int64(least) + totals[0].common
        out[given, 3] = second + length - 1 if second >= 0 else -1
        out[given, 4] = np.int64(second_least) + totals[0].common if second >= 0 else -1
        out[given, 5] = bound[0] - bound[1]
        # of a window of a number of events, the time of the oldest
        out[given, 6] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
        given += 1


@njit(cache=True, nogil=True, inline="always")
def _second(sums, count, best, exclusion, places):
    """Look for the best outside the exclusion zone; -1 if there is nothing outside."""
    second, second_least = -1, sums[best]
    if best - exclusion > 0:
        second, second_least = least_in(sums, count, 0, best - exclusion)
    if best + exclusion + 1 < places:
        after, after_least = least_in(sums, count, best + exclusion + 1, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    return second, second_least
