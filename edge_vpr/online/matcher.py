"""The matcher of the localiser: one kernel over events, and what needs Python at its stops."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays, check_array, check_range
from edge_vpr.compiling import KernelState, entry, kernel, plain
from edge_vpr.descriptors.windows import MAX_WINDOWS, Window, narrow
from edge_vpr.errors import EdgeVprError, MapError, UsageError
from edge_vpr.events import EVENT_DTYPE, Events
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.drive import FixedLag, Late, filter_of
from edge_vpr.matching.place_filter import FilterMatch, PlaceFilter
from edge_vpr.online.kernels import (
    acceptance,
    advance,
    age,
    match_now,
    note,
    recode,
    selected_in_order,
    settle,
    take_moves,
    write_distances,
)
from edge_vpr.online.state import (
    CONTROL,
    MATCH_DTYPE,
    MatchSchedule,
    OnlineState,
    OwnCodes,
    SlidingWindows,
    filter_state,
    grown,
    recount,
    start,
    with_distances,
)
from edge_vpr.route import Odometer
from fixedpoint.own_mean import RunningMean

# The kernel of the localiser: converts events to matches without returning to Python.


# why the kernel returned
DONE, MATCHES_FULL, RING_FULL, WINDOW_OVER, REFUSED = range(5)
#: in place of a time
GO_ON = -1

Stop = tuple[int, int, int]
"""Result of `follow`."""


@kernel
def follow(box, events, until):
    """Process events, or go on with those of an earlier call; stop where Python is needed.

    Parameters
    ----------
    box : BoxedState
        Of `OnlineState`; its arrays are changed in place.
    events : ndarray of EVENT_DTYPE, shape (m,)
        As many as `OnlineState.slots` has room for.
    until : int
        Without events: time to advance to, or `GO_ON` with what `OnlineState.control` says is left
        of an earlier call.

    Returns
    -------
    given, why : int
        Matches written to `OnlineState.out`, and `DONE`, `MATCHES_FULL`, `RING_FULL`,
        `WINDOW_OVER`: the place filter has ended a window; or `REFUSED`: an event is off the
        sensor, not in the order of time, or over more ticks than may be, and nothing was taken.
    until : int
        Time of the last event, selected or not.
    """
    f = OnlineState(*box.value)
    s, c, out = SlidingWindows(*f.s), f.control[0], f.out
    if events.size > 0:
        last = events[events.size - 1]["t"]
        selected = selected_in_order(f.table, events, c.floor, c.off_slots, f.slots, f.times)
        if selected < 0 or (c.interval > 0 and (last - c.next_tick) // c.interval > MAX_WINDOWS):
            return 0, REFUSED, last
        c.floor, c.until, c.now, c.read, c.selected = last, last, last + 1, 0, selected
    elif until != GO_ON:
        c.floor, c.until, c.now, c.read, c.selected = until, until, max(c.now, until), 0, 0
    slots, times, until = f.slots, f.times, c.until
    ring_slot, ring_time, bound = s.slot, s.time, s.bound
    moves, totals, counts, code, counters = s.moves, s.totals, s.counts, s.code, s.counters
    columns, sums, steps = s.columns, s.sums, s.steps
    own = OwnCodes(*s.own)
    state, step, rows, length = f.state, f.step, f.rows, f.length
    tau, n, windows, mask = s.tau, s.n, s.counts.shape[0], s.slot.size - 1
    given, i, end = 0, c.read, c.selected
    # counted down, because a division would take as long as the rest of an event's processing
    left = c.every - bound[0] % c.every if c.every > 0 else np.int64(-1)
    # each iteration is a tick or an event, until there are no more of either
    while True:
        now = times[i] if i < end else until
        tick = c.interval > 0 and c.next_tick <= now
        now = c.next_tick if tick else now
        seen_until = now if tick else now + 1
        # a tick at the end of a window belongs to it; an event at the same time to the next window
        over = seen_until > c.window_end if tau > 0 else bound[0] >= c.window_end
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
            take_moves(moves, totals, counts, code, counters, columns, sums, steps)
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
        take_moves(moves, totals, counts, code, counters, columns, sums, steps)
        if own.levels.size > 0:
            recode(own, counts, totals, counters, columns, sums, steps)
        row, in_window = out[given], bound[0] - bound[1]
        if match_now(state, step, rows, sums, totals[0], c, length, in_window, over, row):
            row["time_us"], row["events"] = now, in_window
            # start of a fixed-count window: the time of its oldest event
            row["start_us"] = seen_until - tau if tau > 0 else ring_time[bound[1] & mask]
            acceptance(row, f.trust, f.probability, c.least_trust)
            given += 1
        why = WINDOW_OVER
        if over:
            break
    c.read = i
    return given, why, until


# Feeds events to the kernel, and does the work at its stops that needs Python.


Found = list[npt.NDArray[np.void]]
_NO_EVENTS = np.empty(0, dtype=EVENT_DTYPE)


class MatchRun:
    """Matches by the sequence of the newest L windows; holds the state of the localiser.

    Counters and distances are updated when they are read. They are then those at the time
    `now_us`; all earlier events have been processed.

    Parameters
    ----------
    schedule : MatchSchedule
        When to give a match.
    recent : int
        So many of the newest places are not searched.
    place_filter : PlaceFilter, optional
        What matches in place of sequences, see `FilterRun`.

    Attributes
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Those of the map, and those that were appended.
    state : OnlineState
        In its place comes another one where an array has to grow.
    boxed : BoxedState
        The same for `follow`; call `go_on` after it.
    """

    #: Name of the array of the schedule in an archive.
    schedule_name = "policy"

    def __init__(
        self,
        reference: MapRecord,
        window: Window,
        schedule: MatchSchedule,
        recent: int = 0,
        place_filter: PlaceFilter | None = None,
    ) -> None:
        self.places, self._codes = reference.places.counts, reference.codes
        windows = start(
            self.places, window, reference.settings.windows_per_match,
            reference.own_mean_code or self._codes, reference.mean,
        )  # fmt: skip
        state = OnlineState.begin(reference, windows, schedule, recent, place_filter)
        # not as a record array, whose fields take 1 us each
        self._control = np.asarray(state.control).view(CONTROL)[0]
        self._out = state.out.view(np.uint8).data
        self._hold(state)

    def _hold(self, state: OnlineState) -> None:
        self.state, self.boxed = state, KernelState(state).boxed
        self._follow: Callable[..., Stop] = entry(follow, self.boxed, _NO_EVENTS, GO_ON)

    @property
    def next_tick(self) -> int:
        """Time of the next match by the interval of the schedule, in microseconds."""
        return int(self._control["next_tick"])

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._control["next_tick"] = time_us

    @property
    def floor_us(self) -> int:
        """Earliest time that the next event may have."""
        return int(self._control["floor"])

    @property
    def now_us(self) -> int:
        """T: all earlier events have been processed."""
        return int(self._control["now"])

    def follow(self, events: Events) -> Stop:
        """Call the kernel of this name, with events in one piece that may be written to."""
        if events.size > self.state.slots.size:
            # of this room, memory is taken only where selected events are written
            slots, times = np.empty(events.size, np.int32), np.empty(events.size, np.int64)
            self._hold(self.state._replace(slots=slots, times=times))
        return self._follow(self.boxed, events, GO_ON)

    def advance(self, until_us: int) -> Found:
        """Advance the time without events."""
        return self.go_on(self._follow(self.boxed, _NO_EVENTS, until_us))

    def go_on(self, stop: Stop) -> Found:
        """Call the kernel until all events are processed, and return all matches.

        Parameters
        ----------
        stop : tuple
            Of the first call, which is not that the events are refused.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        found = []
        while True:
            given, why, _ = stop
            if given:
                found.append(self._taken(given))
            if why == DONE:
                return found
            if why == RING_FULL:
                self._hold(self.state._replace(s=grown(self.state.s)))
            elif why == WINDOW_OVER:
                self._window_over()
            stop = self._follow(self.boxed, _NO_EVENTS, GO_ON)

    def finish(self) -> Found:
        """Return the matches of windows that wait for later ones, at the end of a drive."""
        return []

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        # as bytes, because NumPy copies records field by field
        room = bytearray(self._out[: given * MATCH_DTYPE.itemsize])
        return np.frombuffer(room, dtype=MATCH_DTYPE)

    def _window_over(self) -> None:
        """Do what is left to do when the place filter has ended a window."""
        raise NotImplementedError

    def settled(self) -> SlidingWindows:
        """Return the windows, with counters and distances of the present time."""
        advance(self.state.s, self.now_us)
        settle(self.state.s)
        return self.state.s

    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Return the distance of the sequence that ends at each place, shape (K - L + 1,)."""
        s = self.settled()
        return s.sums[: s.totals["sums"][0]].astype(np.int64) + s.totals["common"][0]

    def append(self, counts: npt.NDArray[np.integer]) -> None:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes where the map has a code.

        Raises
        ------
        MapError
            If the descriptor has another length, or holds what the map cannot.
        """
        if counts.shape != self.places.shape[1:] or counts.dtype.kind not in "iu":
            raise MapError(
                f"descriptor of {counts.dtype} and shape {counts.shape}: expected "
                f"{self.places.shape[1]} whole numbers, as `DescriptorStream` gives them"
            )
        most = np.iinfo(np.int32).max if self._codes is None else int(self._codes.tables.max())
        if counts.min() < 0 or counts.max() > most:
            raise MapError(
                f"descriptor holds {counts.min()} to {counts.max()}: expected 0 to {most}, in "
                "codes where the map has a code"
            )
        wide = np.promote_types(self.places.dtype, narrow(counts).dtype)
        self.places = np.concatenate([self.places.astype(wide), counts[None].astype(wide)])
        self._hold(self.state._replace(s=with_distances(self.settled(), self.places)))

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        s = self.settled()
        fresh = with_distances(s, self.places)
        used = slice(fresh.totals["sums"][0])
        same = (
            np.array_equal(recount(s), s.counts)
            and np.array_equal(fresh.sums[used], s.sums[used])
            and fresh.totals["common"] == s.totals["common"]
        )
        if not same:
            raise EdgeVprError(
                f"counters or distances have drifted by {self.now_us} us: this is a fault of "
                "edge-vpr, report it with the recording"
            )

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        s, control = self.settled(), self._control
        alive = np.arange(s.bound[-1], s.bound[0]) & (s.slot.size - 1)
        schedule = np.array([control["next_tick"], control["last_reported"]], dtype=np.int64)
        return {
            "places": self.places,
            "slot": s.slot[alive],
            "time": s.time[alive],
            "bound": s.bound,
            self.schedule_name: schedule,
        }

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`; the map has the saved places."""
        self._control["now"], self._control["floor"] = now_us, floor_us
        tick, place = arrays[self.schedule_name].tolist()
        self._control["next_tick"], self._control["last_reported"] = tick, place
        s, first = self.state.s, int(arrays["bound"][-1])
        while s.slot.size < arrays["slot"].size:
            s = grown(s)
        at = np.arange(first, first + arrays["slot"].size) & (s.slot.size - 1)
        s.slot[at] = arrays["slot"]
        s.time[at] = arrays["time"]
        s.bound[:] = arrays["bound"]
        s.counts[:] = recount(s)
        self._hold(self.state._replace(s=with_distances(s, self.places)))


# The place filter event by event: within windows, and at the end of each window.


class FilterRun(MatchRun):
    """Matches by the place filter, within windows too.

    Attributes
    ----------
    mean : RunningMean or None
        Of own-mean codes.
    """

    schedule_name = "filter_schedule"

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        self.place_filter = filter_of(
            reference.places, reference.settings, reference.jumps, reference.along_mm
        )
        super().__init__(reference, window, schedule, place_filter=self.place_filter)
        self.odometer = Odometer()
        self._code = reference.own_mean_code
        self.mean = None
        if self._code is not None and reference.mean is not None:
            self.mean = RunningMean(reference.mean)
        self._windows = 0  # finished
        self._silence: tuple[object, ...] = ()  # the filter after a window without events
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
        s = self.state.s
        self._control["window_end"] = (self._windows + 1) * (s.tau or s.n)

    def _window_over(self) -> None:
        s, read = self.state.s, self.odometer.fresh
        self._windows += 1
        self.odometer.end_window()
        if self.mean is not None and self._code is not None and not self._control["paused"]:
            self.mean.update(self._code.level(s.counts[0]))
            s.own.means[:] = self.mean.mean
        if s.tau and s.bound[0] == s.bound[1]:
            self._skip_silence(read)
        else:
            self._silence = ()
        self._set_window_end()

    def _skip_silence(self, odometry: bool) -> None:
        """Skip windows without events, as soon as they change nothing any more."""
        found, c = self.place_filter, self._control
        before = self._silence
        self._silence = found.numbers, found.state.metric.tobytes()
        if self._silence == before and not odometry:
            read, until = c["read"], c["until"]
            if read < c["selected"]:
                until = self.state.times[read]
            if c["interval"]:
                until = min(until, c["next_tick"])
            self._windows = max(self._windows, int(until) // self.state.s.tau - 1)

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

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        found = self.place_filter
        *numbers, self._windows = filter_state(arrays)
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
            self.state.s.own.means[:] = self.mean.mean
        super().resume(arrays, now_us, floor_us)


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

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        settings = reference.settings
        if schedule != MatchSchedule.window(settings):
            raise UsageError(
                f"a delay of {settings.delay} windows gives a match at the end of each window: "
                "match every window, or set delay to 0"
            )
        super().__init__(reference, window, schedule)
        self._lag = FixedLag(
            self.place_filter.transitions, settings.exclusion_places, settings.late
        )
        self._given: np.void | None = None  # by the kernel, of the window that ends
        self._undecided: deque[np.void | None] = deque()  # None of a window that was skipped
        self._decided: list[np.void] = []

    def go_on(self, stop: Stop) -> Found:
        """See `MatchRun.go_on`."""
        super().go_on(stop)
        return self._drained()

    def finish(self) -> Found:
        """See `MatchRun.finish`."""
        self._decide(self._lag.finish())
        return self._drained()

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        rows = super()._taken(given)
        (self._given,) = rows
        return rows[:0]

    def _window_over(self) -> None:
        assert self.state.rows is not None
        self._undecided.append(self._given)
        self._given = None
        self._decide(self._lag.add(self.state.rows, [self.odometer.travelled_mm]))
        super()._window_over()

    def _decide(self, late: Late) -> None:
        for column in late[0].tolist():
            row, match = self._undecided.popleft(), FilterMatch(*column)
            if row is None:
                continue
            row["place"], row["second"] = match.place, match.second
            row["trust"], row["misfit"] = match.trust, match.misfit
            plain(write_distances)(row, match.metric, match.second_metric, 1)
            trust, probability = self.state.trust, self.state.probability
            plain(acceptance)(row, trust, probability, self._control["least_trust"])
            self._decided.append(row)

    def _drained(self) -> Found:
        decided, self._decided = self._decided, []
        return [np.array(decided, dtype=MATCH_DTYPE)] if decided else []

    def to_arrays(self) -> Arrays:
        """Raise UsageError: the windows that wait for later ones are not saved."""
        raise UsageError(
            "a localiser with a delay cannot be saved: set delay to 0, or keep the events"
        )

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Raise MapError: no state holds the windows that wait."""
        raise MapError("the state has a delay, with which none can be saved")
