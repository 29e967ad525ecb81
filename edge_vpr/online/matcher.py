"""The matcher of the localiser: kernels over events, and what needs Python between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays, check_array, check_range
from edge_vpr.compiling import BoxedState, KernelState, entry, kernel
from edge_vpr.descriptors.windows import MAX_WINDOWS
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Events
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.drive import filter_of
from edge_vpr.matching.place_filter import FilterState, StepTable, WindowRows
from edge_vpr.matching.smoother import FixedLag, SmoothedMatch
from edge_vpr.online.kernels import (
    acceptance,
    age,
    few_in_order,
    filter_answer,
    note,
    recode,
    sequence_answer,
    take_moves,
    write_distances,
)
from edge_vpr.online.state import (
    MATCH_DTYPE,
    MatchSchedule,
    OnlineState,
    OnlineWindows,
    OwnCodes,
    SlidingWindows,
    grown,
)
from edge_vpr.route import Odometer
from fixedpoint.own_mean import RunningMean

# The kernel of the localiser: converts events to matches without returning to Python.


# why the kernel returned
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)

Chunked = tuple[int, int, int, int, int]
"""Result of `follow_chunk`."""


@kernel
def follow(box, slots, times, until):
    """Process selected events, then advance the time to `until`; stop where Python is needed.

    Parameters
    ----------
    box : BoxedState
        Of `OnlineState`; its arrays are changed in place.
    slots : ndarray of int32, shape (m,)
        Of the events, in the order of their times.
    times : ndarray of int64, shape (m,)
        Events at selected pixels, in time order.
    until : int
        Time of the last event, selected or not, in microseconds.

    Returns
    -------
    read, given, why : int
        Events taken, matches written to `OnlineState.out`, and `DONE`, `MATCHES_FULL`, `RING_FULL`,
        or `WINDOW_OVER`: a window of the place filter has ended, and its counts are complete.
    """
    f = OnlineState(*box.value)
    s, c, out = SlidingWindows(*f.s), f.control[0], f.out
    state, step = FilterState(*f.state), StepTable(*f.step)
    ring_slot, ring_time, bound = s.slot, s.time, s.bound
    moves, totals, counts, code, counters = s.moves, s.totals, s.counts, s.code, s.counters
    columns, sums, steps = s.columns, s.sums, s.steps
    own, rows = OwnCodes(*s.own), WindowRows(*f.rows)
    tau, n, length, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
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
            if own.levels.size > 0:
                recode(own, counts, totals, counters, columns, sums, steps)
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
        if own.levels.size > 0:
            recode(own, counts, totals, counters, columns, sums, steps)
        row, events = out[given], bound[0] - bound[1]
        if state.metric.size > 0:
            answered = filter_answer(state, step, rows, sums, c, events, row)
        else:
            answered = sequence_answer(sums, totals[0], c, length, row)
        if answered:
            row["time_us"], row["events"] = now, events
            # start of a fixed-count window: the time of its oldest event
            row["start_us"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            acceptance(row, f.trust, f.probability, c.least_trust)
            given += 1


@kernel
def follow_chunk(box, events):
    """Process a few events; none if `selected_in_order` would refuse one of them.

    Parameters
    ----------
    events : ndarray of EVENT_DTYPE, shape (m,)
        1 to `CHUNK_EVENTS`.

    Returns
    -------
    read, given, why : int
        Selected events taken, see `follow`; `REFUSED` if events are off the sensor, not in the
        order of time, or over more ticks than may be, and nothing was taken.
    selected : int
        Events that are now in `OnlineState.slots` and `OnlineState.times`.
    last : int
        Time of the last event.
    """
    f = OnlineState(*box.value)
    c, last = f.control[0], events[events.size - 1]["t"]
    selected = few_in_order(f.table, events, c.floor, c.off_slots, f.slots, f.times)
    if selected < 0 or (c.interval > 0 and (last - c.next_tick) // c.interval > MAX_WINDOWS):
        return 0, 0, REFUSED, 0, last
    c.floor, c.now = last, last + 1
    read, given, why = follow(box, f.slots[:selected], f.times[:selected], last)
    return read, given, why, selected, last


# Feeds events to the kernel, and does the work between its calls that needs Python.


Found = list[npt.NDArray[np.void]]


class MatchRun:
    """Runs the kernel of a localiser on its state.

    Parameters
    ----------
    windows : OnlineWindows
        Its state may be replaced between two calls.
    """

    #: Name of the array of the schedule in an archive.
    schedule_name = "policy"

    def __init__(self, windows: OnlineWindows, followed: OnlineState) -> None:
        self.windows = windows
        self._followed = followed
        self._control = followed.control[0]
        self._box: KernelState[OnlineState] | None = None
        self._chunk: Callable[..., Chunked] | None = None  # code of `follow_chunk` for the box
        self._out = followed.out.view(np.uint8).data

    @property
    def next_tick(self) -> int:
        """Time of the next match by the interval of the schedule, in microseconds."""
        return int(self._followed.control["next_tick"][0])

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._followed.control["next_tick"] = time_us

    @property
    def floor_us(self) -> int:
        """Earliest time that the next event may have."""
        return int(self._followed.control["floor"][0])

    @floor_us.setter
    def floor_us(self, time_us: int) -> None:
        self._followed.control["floor"] = time_us

    @property
    def now_us(self) -> int:
        """T: all earlier events have been processed."""
        return int(self._followed.control["now"][0])

    @now_us.setter
    def now_us(self, time_us: int) -> None:
        self._followed.control["now"] = time_us

    def feed(self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int) -> Found:
        """Process selected events, then advance the time to `until`.

        Parameters
        ----------
        slots : ndarray of int32, shape (m,)
            Of the events, in the order of their times.
        times : ndarray of int64, shape (m,)
            In time order, none before `floor_us`.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        self.floor_us = until
        return self._go_on(slots, times, until, follow(self.boxed, slots, times, until))

    def follow_chunk(self, events: Events) -> Chunked:
        """Call the kernel of this name, with events in one piece that may be written to."""
        box = self.boxed
        if self._chunk is None:
            self._chunk = entry(follow_chunk, box, events)
        return self._chunk(box, events)

    def go_on(self, result: Chunked) -> Found:
        """Process the events that `follow_chunk` has left, and return all matches.

        Parameters
        ----------
        result : Chunked
            Which is not that the events are refused.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        read, given, why, selected, last = result
        if why == DONE:
            return [self._taken(given)] if given else []
        slots, times = self._followed.slots[:selected], self._followed.times[:selected]
        return self._go_on(slots, times, int(last), (read, given, why))

    def finish(self) -> Found:
        """Return the matches of windows that wait for later ones, at the end of a drive."""
        return []

    def _go_on(
        self,
        slots: npt.NDArray[np.int32],
        times: npt.NDArray[np.int64],
        until: int,
        result: tuple[int, int, int],
    ) -> Found:
        """Call the kernel until all events are processed."""
        found, begin = [], 0
        while True:
            read, given, why = result
            begin += read
            if given:
                found.append(self._taken(given))
            if why == DONE:
                return found
            if why == RING_FULL:
                self.windows.s = grown(self.windows.s)
            elif why == WINDOW_OVER:
                self._end_window(int(times[begin]) if begin < times.size else until)
            result = follow(self.boxed, slots[begin:], times[begin:], until)

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        # as bytes, because NumPy copies records field by field
        room = bytearray(self._out[: given * MATCH_DTYPE.itemsize])
        return np.frombuffer(room, dtype=MATCH_DTYPE)

    @property
    def boxed(self) -> BoxedState:
        """State for `follow` and `follow_chunk`; call `go_on` after the latter."""
        if self._box is None or self._followed.s is not self.windows.s:
            self._followed = self._followed._replace(s=self.windows.s)
            self._rebound()
            self._box, self._chunk = KernelState(self._followed), None
        return self._box.boxed

    def _rebound(self) -> None:
        """Update the control record for another map or other windows."""

    def _end_window(self, next_us: int) -> None:
        """Finish a window of the place filter; the next event or tick is at `next_us`."""
        raise NotImplementedError

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        control = self._control
        told = np.array([control.next_tick, control.last_reported], dtype=np.int64)
        return {self.schedule_name: told}

    def resume(self, arrays: Arrays) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        self._control.next_tick, self._control.last_reported = arrays[self.schedule_name].tolist()


# The place filter event by event: within windows, and at the end of each window.


class FilterRun(MatchRun):
    """Feeds events to the place filter, and gives matches within windows too.

    Parameters
    ----------
    windows : OnlineWindows
        Of this map, and one window long.
    schedule : MatchSchedule
        When to give a match.

    Attributes
    ----------
    mean : RunningMean or None
        Of own-mean codes.
    """

    schedule_name = "filter_schedule"

    def __init__(
        self, reference: MapRecord, windows: OnlineWindows, schedule: MatchSchedule
    ) -> None:
        self.place_filter = filter_of(
            reference.places, reference.settings, reference.jumps, reference.along_mm
        )
        state = OnlineState.begin(reference, windows.s, schedule, self.place_filter)
        super().__init__(windows, state)
        self.odometer = Odometer()
        self._code = reference.own_mean_code
        self.mean = None
        if self._code is not None and reference.mean is not None:
            self.mean = RunningMean(reference.mean)
        self._windows = 0  # finished
        self._set_window_end()

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading; until the window ends, places are predicted by the distance driven.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        self.place_filter.transitions.check_odometry()
        self.odometer.read(distance_mm)
        self._travel()

    def _travel(self) -> None:
        travelled = self.odometer.travelled_mm
        if travelled is not None:
            self.place_filter.predict_travelled(travelled)

    def _set_window_end(self) -> None:
        s = self.windows.s
        self._control.window_end = (self._windows + 1) * (s.tau or s.n)

    def _end_window(self, next_us: int) -> None:
        self._finish_window()
        if self.windows.s.tau:
            tick = self.next_tick if self._control.interval else next_us
            self._skip_silence(min(next_us, tick))
        self._set_window_end()

    def _finish_window(self) -> None:
        s, found = self.windows.s, self.place_filter
        self._windows += 1
        counts = s.counts[0]
        events = int(counts.sum())
        paused = found.pauses(events)
        # the common part of all distances changes neither the evidence nor its spread
        distances = s.sums[np.newaxis, : len(found)]
        self._ended(found.update_windows(distances, np.array([events], dtype=np.int64)))
        self.odometer.end_window()
        if self.mean is not None and self._code is not None and not paused:
            self.mean.update(self._code.level(counts))
            s.own.means[:] = self.mean.mean

    def _ended(self, rows: WindowRows) -> None:
        """Take the results of a window that has ended."""

    def _skip_silence(self, until: int) -> None:
        """Skip windows without events up to `until`, as soon as they change nothing any more."""
        found, s = self.place_filter, self.windows.s
        while s.bound[0] == s.bound[1] and (self._windows + 2) * s.tau <= until:
            read = self.odometer.fresh
            before, metric = found.numbers, found.state.metric.copy()
            self._finish_window()
            same = before == found.numbers
            if same and not read and np.array_equal(metric, found.state.metric):
                self._windows = until // s.tau - 1

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        found, meter = self.place_filter, self.odometer
        state = [*found.numbers, self._windows]
        arrays = super().to_arrays() | {
            "filter_metric": found.state.metric,
            "filter_state": np.array(state, dtype=np.int64),
        }
        if meter.fresh or meter.anchored:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
        if self.mean is not None:
            arrays["filter_mean"] = self.mean.total
            arrays["filter_mean_windows"] = np.array([self.mean.windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        super().resume(arrays)
        found = self.place_filter
        *numbers, self._windows = arrays["filter_state"].tolist()
        found.resume(arrays["filter_metric"], numbers)
        if "filter_odometer" in arrays:
            found.transitions.check_odometry()
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored = arrays["filter_odometer"].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self._travel()
        self._set_window_end()
        if self.mean is not None:
            check_array(arrays["filter_mean"], "filter_mean", (np.int32,), self.mean.total.shape)
            check_range(arrays["filter_mean"], "filter_mean", 0, np.iinfo(np.int32).max)
            self.mean.total = arrays["filter_mean"].copy()
            self.mean.windows = int(arrays["filter_mean_windows"][0])
            self.windows.s.own.means[:] = self.mean.mean


# Matching by sequences event by event.


class SequenceRun(MatchRun):
    """Feeds events to the sequence of the newest L windows.

    Parameters
    ----------
    windows : OnlineWindows
        Of this map.
    schedule : MatchSchedule
        When to give a match.
    recent : int
        So many of the newest places are not searched.
    """

    def __init__(
        self,
        reference: MapRecord,
        windows: OnlineWindows,
        schedule: MatchSchedule,
        recent: int,
    ) -> None:
        super().__init__(windows, OnlineState.begin(reference, windows.s, schedule))
        self._recent = recent

    def _rebound(self) -> None:
        self._control.places = self.windows.s.totals["sums"][0] - self._recent


# The place filter event by event, with matches that come some windows late.


class DelayedRun(FilterRun):
    """Gives the match of each window when N more windows have ended.

    The kernel gives a match at the end of each window. Its time and events are kept, and its place
    and trust are replaced by those of `FixedLag`.

    Parameters
    ----------
    reference : MapRecord
        Its settings say N.
    schedule : MatchSchedule
        At the end of each window.

    Raises
    ------
    UsageError
        If matches are wanted at other times.
    """

    def __init__(
        self, reference: MapRecord, windows: OnlineWindows, schedule: MatchSchedule
    ) -> None:
        settings = reference.settings
        if schedule != MatchSchedule.window(settings):
            raise UsageError(
                f"a delay of {settings.delay} windows gives a match at the end of each window: "
                "match every window, or set delay to 0"
            )
        super().__init__(reference, windows, schedule)
        self._lag = FixedLag(
            self.place_filter.transitions, settings.exclusion_places, settings.late
        )
        self._given: np.void | None = None  # by the kernel, of the window that ends
        self._undecided: deque[np.void | None] = deque()  # None of a window that was skipped
        self._decided: list[np.void] = []

    def feed(self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int) -> Found:
        """See `MatchRun.feed`."""
        super().feed(slots, times, until)
        return self._drained()

    def go_on(self, result: Chunked) -> Found:
        """See `MatchRun.go_on`."""
        super().go_on(result)
        return self._drained()

    def finish(self) -> Found:
        """See `MatchRun.finish`."""
        for decided in self._lag.finish():
            self._replace(decided)
        return self._drained()

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        rows = super()._taken(given)
        (self._given,) = rows
        return rows[:0]

    def _ended(self, rows: WindowRows) -> None:
        self._undecided.append(self._given)
        self._given = None
        decided = self._lag.add(rows, self.odometer.travelled_mm)
        if decided is not None:
            self._replace(decided)

    def _replace(self, decided: SmoothedMatch) -> None:
        row, match = self._undecided.popleft(), decided.match
        if row is None:
            return
        row["place"], row["second"], row["trust"] = match.place, match.second, match.trust
        write_distances(row, match.metric, match.second_metric, 1)
        acceptance(row, self._followed.trust, self._followed.probability, self._control.least_trust)
        self._decided.append(row)

    def _drained(self) -> Found:
        decided, self._decided = self._decided, []
        return [np.array(decided, dtype=MATCH_DTYPE)] if decided else []

    def to_arrays(self) -> Arrays:
        """Raise UsageError: the windows that wait for later ones are not saved."""
        raise UsageError(
            "a localiser with a delay cannot be saved: set delay to 0, or keep the events"
        )

    def resume(self, arrays: Arrays) -> None:
        """Raise MapError: no state holds the windows that wait."""
        raise MapError("the state has a delay, with which none can be saved")
