"""Kernels of the localiser, which match after every event.

`process_events` is the one that a `Localiser` calls.
"""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.confidence import NO_MISFIT, accept_match
from edge_vpr.descriptors.activity import is_pause
from edge_vpr.descriptors.windows import MAX_WINDOWS
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.match import write_distances
from edge_vpr.matching.place_filter import FilterState, WindowRows, end_window, match_window
from edge_vpr.matching.prediction import FilterTable
from edge_vpr.matching.search import exclusion_zone
from edge_vpr.online.sliding_windows import (
    ContrastCodes,
    SlidingWindows,
    age,
    note,
    recode,
    take_moves,
)
from edge_vpr.online.state import OnlineState
from edge_vpr.online.sums import least_in, ties_behind

# Kernels that match: the best place and the confidence in it.


@kernel(inline="always")
def sequence_match(sums, total, c, length, row):
    """Match by the nearest sequence.

    Parameters
    ----------
    sums : ndarray of uint16 or uint32
        A row of those of `SlidingWindows`, without pending moves.
    total : record of TOTALS
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
    places = total.places
    best, least = least_in(sums, places, np.int64(0), places)
    if c.change and best == c.last_reported:
        return False
    c.last_reported = best
    second, second_least = _second(sums, best, c.exclusion, places)
    best_sum, second_sum = np.int64(least) + total.common, np.int64(-1)
    row["place"], row["second"], row["trust"] = best + length - 1, -1, 0
    row["ties"] = ties_behind(sums, places, best, places)
    row["misfit"] = NO_MISFIT
    if second >= 0:
        row["second"] = second + length - 1
        second_sum = np.int64(second_least) + total.common
        row["trust"] = second_sum - best_sum
    write_distances(row, best_sum, second_sum, length)
    return True


@kernel(inline="always")
def _second(sums, best, exclusion, places):
    """Return the best place outside the exclusion zone and its sum; -1 if there is none."""
    second, second_least = -1, sums[best]
    first, end = exclusion_zone(best, exclusion)
    if first > 0:
        second, second_least = least_in(sums, places, np.int64(0), first)
    if end < places:
        after, after_least = least_in(sums, places, end, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    return second, second_least


@kernel(inner=True)
def match_now(state, filter_table, rows, s, total, c, length, limits, over, out, i):
    """Match by the place filter or by sequences, or end the window of the place filter.

    `state`, `filter_table` and `rows` are None with sequences, `length` with the place filter.
    Numba prunes branches on arguments that are None, so that only one of the two is compiled.

    Parameters
    ----------
    state, filter_table, rows, s, total, c, length, limits
        Of `OnlineState`, without pending moves. `rows` is updated, and in `c` the place of the last
        match, or whether the window was a pause.
    over : bool
        Whether the window ends: the filter then advances, and there is no match.
    out : ndarray of MATCH_DTYPE
        Output in row `i`; `accept_match` and `process_events` write the other fields.

    Returns
    -------
    bool
        Whether there is a match: not if only changes are requested and the place is the same.
    """
    if state is None:
        if length is not None:  # or a filter's kernel takes a second longer to compile
            return sequence_match(s.sums[0], total, c, length, out[i])
        return False
    state, rows = FilterState(*state), WindowRows(*rows)
    distances = np.empty(rows.evidence.shape[1:], dtype=np.int32)
    for of_sum in range(len(distances)):
        for k in range(distances.shape[1]):
            distances[of_sum, k] = s.sums[of_sum, k]
    events = np.int64(0)
    for j in range(limits.size):
        events += min(s.counts[0, j], limits[j])
    match_window(state, FilterTable(*filter_table), distances, events, rows, 0)
    if over:
        c.paused = is_pause(events, state.numbers[0].mean_activity)
        end_window(state, rows.metrics[0])
        return False
    best = rows.matches[0]["place"]
    if c.change and best == c.last_reported:
        return False
    c.last_reported = best
    out[i] = rows.matches[0]
    return True


# Checks and selection of events: time order, sensor, selected pixels.


@kernel(inner=True)
def selected_in_order(table, t, x, y, floor, slots, times):
    """Write the events at selected pixels, unless any event is out of order or off the sensor.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (height, width)
        Slot of each pixel, negative where it is not selected.
    t, x, y : ndarray, shape (n,)
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
        Number of events at selected pixels; -1 for invalid events, see `Localiser.update`.
    """
    last, n = floor, 0
    for i in range(t.size):
        now = t[i]
        if now < last or now > TIME_LIMIT_US or y[i] >= table.shape[0] or x[i] >= table.shape[1]:
            return -1
        last = now
        slot = table[y[i], x[i]]
        if slot >= 0:
            slots[n] = slot
            times[n] = now
            n += 1
    return n


# The kernel of the localiser, which processes events to matches without returning to Python.


# reasons for the kernel to return
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)
#: in place of a time
GO_ON = -1

Stop = tuple[int, int]
"""Result of `process_events`."""


@kernel
def process_events(kernel_state, t, x, y, until):
    """Process events, or continue with those of an earlier call, until Python code is needed.

    Parameters
    ----------
    kernel_state : KernelState
        Of an `OnlineState`; its arrays are updated in place.
    t, x, y : ndarray, shape (m,)
        Events, at most as many as `OnlineState.slots` has room for.
    until : int
        Without events: the time to advance to, or `GO_ON` to continue an earlier call.

    Returns
    -------
    n_matches, why : int
        Number of matches written to `OnlineState.out`; and `DONE`, `MATCHES_FULL`, `RING_FULL`,
        `WINDOW_OVER` (the place filter has ended a window), or `REFUSED`: an event is off the
        sensor, out of order, or beyond too many ticks, and no event was processed.
    """
    f = OnlineState(*kernel_state.value)
    s, c, out = SlidingWindows(*f.windows), f.control[0], f.out
    if t.size > 0:
        last = t[t.size - 1]
        selected = selected_in_order(f.table, t, x, y, c.floor, f.slots, f.times)
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
    tau, n, lags, mask, limits = s.tau, s.n, s.counts.shape[0], s.slot.size - 1, f.limits
    # not a constant, for which Numba would compile `match_now` once more
    n_matches, i, end = np.int64(0), c.read, c.selected
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
        if over:
            seen_until = c.window_end
        elif not tick and i == end:
            why = DONE
            break
        if n_matches == len(out):
            why = MATCHES_FULL
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
            if bound[0] - bound[lags] > mask:
                why = RING_FULL
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
        complete = seen_until >= c.windows * tau if tau > 0 else bound[0] >= c.windows * n
        if not complete:
            continue
        take_moves(moves, totals, counts, saturation, counters, columns, sums, changes)
        if saturation == 0:
            recode(contrast, counts, totals, counters, columns, sums, changes)
        row, in_window = out[n_matches], bound[0] - bound[1]
        if match_now(
            state, filter_table, rows, s, totals[0], c, length, limits, over, out, n_matches
        ):
            row["time_us"], row["events"] = now, in_window
            # start of a fixed-count window: the time of its oldest event
            row["start_us"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            accept_match(row, f.trust_steps, f.probability_steps, c.least_trust)
            n_matches += 1
        if over:
            why = WINDOW_OVER
            break
    c.read = i
    return n_matches, why
