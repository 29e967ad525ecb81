"""Descriptors of windows that slide, without a map: as often as asked, overlapping or not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.descriptors.counters import select_events
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedTime, Window, WindowCounts, collect
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import EVENT_DTYPE, TIME_LIMIT_US, Events
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import advance, grown, push, settle, start

_EVENTS_AT_ONCE = 1 << 16  # bounds the buffers, whatever the chunk
#: Up to so many events are looked up in one pass.
_FEW = 64


class SlidingWindow:
    """The newest `tau` microseconds, or the newest N events at the selected pixels.

    A ring of (slot, time) holds the events of the window; each arriving one expires the old ones.
    With a policy of one descriptor a window (`MatchSchedule.window`) the windows do not overlap,
    and are those of `DescriptorStream`.

    Parameters
    ----------
    pixel_map : PixelMap
    window : FixedTime or FixedCount
        Its length.
    every : MatchSchedule
        When to give a descriptor, without `change`. None is given before the window is full.
    polarity : bool
        Count ON and OFF events apart.

    Raises
    ------
    UsageError
        If descriptors are asked for at a change of place.

    Examples
    --------
    >>> from edge_vpr.events import Sensor, make_events
    >>> from edge_vpr.descriptors.windows import FixedTime
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> window = SlidingWindow(two, FixedTime(tau_us=10), every=MatchSchedule(interval_us=5))
    >>> window.update(make_events(t=[0, 4, 9, 16], x=[1, 2, 1, 1], y=[0, 0, 0, 0])).counts
    array([[2, 1],
           [1, 0]], dtype=uint8)
    """

    def __init__(
        self, pixel_map: PixelMap, window: Window, *, every: MatchSchedule, polarity: bool = False
    ) -> None:
        if every.change:
            raise UsageError("descriptors name no place that could change: leave change out")
        self.every = every
        self._table = pixel_map.table()
        self._polarity = polarity
        self._window = window
        self._floor = 0  # no event may be earlier
        self._next_tick = every.interval_us
        # a map of one place, all zeros, whose distance nobody asks for
        no_map = np.zeros((1, len(pixel_map) * (2 if polarity else 1)), dtype=np.uint8)
        self._s = start(no_map, window, 1, None)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Events in the window by slot, shape (J,) or with polarity (2 J,); a copy."""
        settle(self._s)
        return self._s.counts[0].copy()

    def update(self, events: Events) -> Descriptors:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
            In time order, after all those before.

        Returns
        -------
        Descriptors
            Of the moments that the policy asks for. A window of N events spans from its first event
            to that moment; `events` counts those at the selected pixels.

        Raises
        ------
        EventError
            If time runs backwards or a pixel lies off the sensor; the state is then as it was.
        UsageError
            If time jumps over more than a million intervals of the policy.
        """
        taken: list[WindowCounts] = []
        if events.size:
            last = int(events["t"][-1])
            slots, times = selected_in_order(self._table, events, self._floor, self._polarity)
            self.every.check_ticks(self._next_tick, last)
            for slot, time in zip(slots.tolist(), times.tolist(), strict=True):
                self._tick(time, taken)
                self._push(slot, time)
                if self.every.events and self._s.bound[0] % self.every.events == 0:
                    self._take(time, time + 1, taken)
            self._tick(last, taken)
            self._floor = last
            advance(self._s, last + 1)
        return collect(taken, self._s.counts.shape[1])

    def _push(self, slot: int, time: int) -> None:
        while not push(self._s, slot, time):
            self._s = grown(self._s)

    def _tick(self, until: int, taken: list[WindowCounts]) -> None:
        while self.every.interval_us and self._next_tick <= until:
            advance(self._s, self._next_tick)
            self._take(self._next_tick, self._next_tick, taken)
            self._next_tick += self.every.interval_us

    def _take(self, time: int, until: int, taken: list[WindowCounts]) -> None:
        if isinstance(self._window, FixedTime):
            begin, end, full = until - self._window.tau_us, until, until >= self._window.tau_us
        else:
            full = bool(self._s.bound[0] >= self._window.events)
            begin, end = int(self._s.time[self._s.bound[1] & (self._s.time.size - 1)]), time
        if full:
            counts = self.counts
            taken.append(WindowCounts(counts, begin, end, int(counts.sum())))


def selected_in_order(
    table: npt.NDArray[np.signedinteger], events: Events, floor_us: int, polarity: bool
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    """Find the events at selected pixels, and check that time does not run backwards.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (height, width)
        Of `PixelMap.table`.
    events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
        At least one.
    floor_us : int
        No event may be earlier: the time of the last event before these, or until which time has
        passed without any.
    polarity : bool
        Give OFF events slots of their own.

    Returns
    -------
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)

    Raises
    ------
    EventError
        If time runs backwards or a pixel lies off the sensor.
    """
    if events.size <= _FEW and events.dtype == EVENT_DTYPE:
        slots, times = np.empty(events.size, dtype=np.int32), np.empty(events.size, dtype=np.int64)
        off_slots = int(table.max()) + 1 if polarity else 0
        found = _few_in_order(table, events, floor_us, off_slots, slots, times)
        if found >= 0:
            return slots[:found], times[:found]
    t = events["t"]
    if t[0] < floor_us or t[-1] < t[0]:
        raise EventError(
            f"time runs backwards, from {floor_us} to {min(t[0], t[-1])} us: sort the events, or "
            "drop the late ones"
        )
    if t[-1] > TIME_LIMIT_US:
        raise EventError(
            f"an event at {t[-1]} us lies beyond {TIME_LIMIT_US} us: check the unit of its clock"
        )
    some_slots, some_times = [], []
    for begin in range(0, events.size, _EVENTS_AT_ONCE):
        some = events[begin : begin + _EVENTS_AT_ONCE]
        p = some["p"] if polarity else None
        index, selected = select_events(table, some["x"], some["y"], p)
        some_slots.append(selected)
        some_times.append(some["t"][index])
    joined = np.concatenate(some_times)
    if joined.size and (np.any(joined[1:] < joined[:-1]) or joined[0] < t[0] or joined[-1] > t[-1]):
        raise EventError("time runs backwards within the chunk: sort the events, or drop some")
    return np.concatenate(some_slots), joined


@njit(cache=True, nogil=True)
def _few_in_order(table, events, floor, off_slots, slots, times):  # type: ignore[no-untyped-def]
    """Do the same in one pass, without columns; -1 if anything is wrong, which is told elsewhere.

    Of an event alone, the checks of columns take longer than all the rest.
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
            slots[n] = slot + (0 if event["p"] else off_slots)
            times[n] = t
            n += 1
    return n
