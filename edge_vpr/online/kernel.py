"""The kernel of the localiser: converts events to matches without returning to Python."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.windows import MAX_WINDOWS
from edge_vpr.matching.filter_recursion import Predictions
from edge_vpr.online.answers import filter_answer, judge, sequence_answer
from edge_vpr.online.event_intake import few_in_order
from edge_vpr.online.followed import Followed
from edge_vpr.online.state import Sliding
from edge_vpr.online.state_kernels import age, note, take_moves

# why the kernel returned
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)

Few = tuple[int, int, int, int, int]
"""Result of `follow_few`."""


@kernel
def follow(box, slots, times, until):
    """Process selected events, then advance the time to `until`; stop where Python is needed.

    Parameters
    ----------
    box : Boxed
        Of `Followed`; its arrays are changed in place.
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)
        Events at selected pixels, in time order.
    until : int
        Time of the last event, selected or not, in microseconds.

    Returns
    -------
    read, given, why : int
        Events taken, matches written to `Followed.out`, and `DONE`, `MATCHES_FULL`, `RING_FULL`, or
        `WINDOW_OVER`: a window of the place filter has ended, and its counts are complete.
    """
    f = Followed(*box.value)
    s, c, predicted, out = Sliding(*f.s), f.control[0], Predictions(*f.predicted), f.out
    ring_slot, ring_time, bound = s.slot, s.time, s.bound
    moves, totals, counts, code, counters = s.moves, s.totals, s.counts, s.code, s.counters
    columns, sums, steps = s.columns, s.sums, s.steps
    tau, n, length, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    metric = f.metric
    given, i = 0, 0
    # counted down, because a division would take as long as the rest of an event's processing
    left = c.every - bound[0] % c.every if c.every > 0 else np.int64(-1)
    # each iteration is a tick or an event, until there are no more of either
    while True:
        now = times[i] if i < slots.size else until
        tick = c.interval > 0 and c.next_tick <= now
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        # a tick at the end of a window belongs to it; an event at the same time to the next window
        over = seen_until > c.window_end if tau > 0 else bound[0] >= c.window_end
        if over:
            seen_until = c.window_end
        elif not tick and i == slots.size:
            return i, given, DONE
        elif given == len(out):
            return i, given, MATCHES_FULL
        room = 0 if tick or over else n
        while not (
            age(ring_time, ring_slot, bound, moves, totals, tau, room, seen_until)
            and totals[0].moves < len(moves)
        ):
            take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        if over:
            take_moves(moves, totals, counts, code, counters, columns, sums, steps)
            return i, given, WINDOW_OVER
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
        row, events = out[given], bound[0] - bound[1]
        if metric.size > 0:
            answered = filter_answer(predicted, metric, sums, c, events, row)
        else:
            answered = sequence_answer(sums, totals[0], c, length, row)
        if answered:
            row["t"], row["events"] = now, events
            # start of a fixed-count window: the time of its oldest event
            row["start"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            judge(row, f.trust, f.probability, c.least_trust)
            given += 1


@kernel
def follow_few(box, events):
    """Process a few events; none if `selected_in_order` would refuse one of them.

    Parameters
    ----------
    box : Boxed
    events : ndarray of EVENT_DTYPE, shape (m,)
        1 to `FEW`.

    Returns
    -------
    read, given, why : int
        Selected events taken, see `follow`; `REFUSED` if events are off the sensor, not in the
        order of time, or over more ticks than may be, and nothing was taken.
    selected : int
        Events that are now in `Followed.slots` and `Followed.times`.
    last : int
        Time of the last event.
    """
    f = Followed(*box.value)
    c, last = f.control[0], events[events.size - 1]["t"]
    selected = few_in_order(f.table, events, c.floor, c.off_slots, f.slots, f.times)
    if selected < 0 or (c.interval > 0 and (last - c.next_tick) // c.interval > MAX_WINDOWS):
        return 0, 0, REFUSED, 0, last
    c.floor, c.now = last, last + 1
    read, given, why = follow(box, f.slots[:selected], f.times[:selected], last)
    return read, given, why, selected, last
