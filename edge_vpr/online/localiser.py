"""The localiser, which matches after every event by updates of distances.

From the bottom up: the schedule of matches; runs, which feed the kernel `process_events` (by
sequences, by the place filter, some windows late); `Localiser`, which a program calls; and its
saved state. The kernel and its state are in `kernels`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr import __version__
from edge_vpr.archive import (
    Arrays,
    archive_errors,
    checksum_of,
    present,
    read_archive,
    write_archive,
)
from edge_vpr.compiling import SharedState, plain, specialise
from edge_vpr.confidence import Confidence, accept_match
from edge_vpr.descriptors.counting import check_columns, window_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import MAX_WINDOWS, Descriptors, FixedTime, Window, narrow
from edge_vpr.errors import EdgeVprError, EventError, MapError, UsageError, expect
from edge_vpr.events import EVENT_DTYPE, NO_EVENTS, TIME_LIMIT_US, Events, Sensor, check_event_array
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.place_filter import FilterMatch, PlaceFilter, WindowRows
from edge_vpr.matching.prediction import check_no_transitions
from edge_vpr.matching.smoothing import FixedLag, Late
from edge_vpr.online.kernels import (
    CHUNK_EVENTS,
    CONTROL,
    DONE,
    GO_ON,
    NEVER,
    REFUSED,
    RING_FULL,
    UNLIMITED,
    WINDOW_OVER,
    OnlineState,
    SlidingWindows,
    Stop,
    advance,
    check_order,
    grown,
    process_events,
    recount,
    settle,
    start,
    with_distances,
    write_distances,
)
from edge_vpr.route import MOST_MM, Odometer, OdometerCheck, Odometry
from edge_vpr.settings import Settings, duration_us
from fixedpoint.own_mean import OwnMeanCode, RunningMean

# Schedule of matches: after a number of events, at times, or when the place changes.


@dataclass(frozen=True)
class MatchSchedule:
    """Schedule of matches or descriptors, by events, by time, or by both.

    >>> MatchSchedule(interval_us=50_000)
    MatchSchedule(events=0, interval_us=50000, change=False)
    >>> MatchSchedule.parse("50ms", Settings()) == MatchSchedule(interval_us=50_000)
    True

    Parameters
    ----------
    events : int
        Number of events at the selected pixels after which to match; 0: not by events.
    interval_us : int
        Match at every multiple of this time, before the events of that time; 0: not by time.
    change : bool
        Whether to report only matches whose place differs from the last reported one.
    """

    events: int = 0
    interval_us: int = 0
    change: bool = False

    def __post_init__(self) -> None:
        for name, kind in (("events", int), ("interval_us", int), ("change", bool)):
            value = getattr(self, name)
            if type(value) is not kind or value > TIME_LIMIT_US:
                raise UsageError(
                    f"matches with {name} = {value!r}: expected {kind.__name__}, at most "
                    f"{TIME_LIMIT_US}"
                )
        if self.events < 0 or self.interval_us < 0 or not (self.events or self.interval_us):
            raise UsageError(
                f"a match every {self.events} events and every {self.interval_us} us: "
                "expected a positive number of one of them"
            )

    @classmethod
    def window(cls, settings: Settings) -> MatchSchedule:
        """Return the schedule with a match at the end of each non-overlapping window."""
        if settings.window == "time":
            return cls(interval_us=settings.tau_us)
        return cls(events=settings.events_per_window)

    @classmethod
    def parse(
        cls, when: str | MatchSchedule | None, settings: Settings, default: str = "50ms"
    ) -> MatchSchedule:
        """Return the schedule of live matches with a map.

        Parameters
        ----------
        when : str, MatchSchedule or None
            See `read_every`; None: the default, or ``window`` with a delay.
        settings : Settings
            Settings of the map.
        """
        if isinstance(when, MatchSchedule):
            return when
        text = when or ("window" if settings.match_delay else default)
        schedule = read_every(text)
        if schedule is not None and settings.match_delay:
            raise UsageError(
                f"every={text!r} with a delay of {settings.match_delay} windows, which gives a "
                "match at the end of each window: leave every= out, or set delay=0"
            )
        return schedule or cls.window(settings)

    def check_ticks(self, from_us: int, until_us: int) -> None:
        """Raise UsageError if time jumps over more than a million intervals."""
        if self.interval_us and (until_us - from_us) // self.interval_us > MAX_WINDOWS:
            raise UsageError(
                f"time jumps to {until_us} us, over more than {MAX_WINDOWS} times every "
                f"{self.interval_us} us: check the recording's clock, or ask less often"
            )


def read_every(text: str) -> MatchSchedule | None:
    """Parse ``event``, a number of events, a time such as ``10ms``, ``window``, or ``change``.

    Returns
    -------
    MatchSchedule or None
        None for ``window``, whose length depends on the map or design.
    """
    if text == "window":
        return None
    if text in ("event", "change"):
        return MatchSchedule(events=1, change=text == "change")
    if text.isascii() and text.isdigit() and int(text) > 0:
        return MatchSchedule(events=int(text))
    try:
        return MatchSchedule(interval_us=duration_us(text))
    except UsageError:
        raise UsageError(
            f"every={text!r}: expected event, a number of events, a time such as 10ms, window, "
            "or change"
        ) from None


# Record of one match of the localiser.


#: One match, with the column names of ``matches.csv``. With the place filter, distances are metrics
#: and L is 1.
MATCH_DTYPE = np.dtype(
    [
        ("time_us", "<i8"),  # time of the match, by the clock of the events
        ("place", "<i8"),  # best place; the first one in a tie
        ("distance", "<f8"),  # of the best place: mean over the L windows of the sequence
        ("second", "<i8"),  # best place outside the exclusion zone; -1 if there is none
        ("second_distance", "<f8"),  # its distance; NaN if there is none
        ("ratio", "<f8"),  # distance / second_distance; NaN if there is no second place
        ("events", "<i8"),  # number in the newest window, at the selected pixels
        ("start_us", "<i8"),  # start of the newest window
        # see `place_filter.FilterMatch`, with sequences the margin; higher means more confident
        ("trust", "<i8"),
        ("misfit", "<i8"),  # see `place_filter.FilterMatch`; -1 with sequences
        ("probability", "<f8"),  # that the match is correct; NaN if unknown
        ("lost", "?"),  # whether it is rejected at the precision of the settings
    ]
)


# Runs, which feed events to the kernel and do the work that needs Python when it returns.


#: arrays of MATCH_DTYPE
MatchRows = list[npt.NDArray[np.void]]
NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)
#: Number of matches after which the kernel returns.
MATCHES_AT_ONCE = 4_096


def join_matches(found: MatchRows) -> npt.NDArray[np.void]:
    """Concatenate arrays of matches; one alone is returned as it is."""
    if len(found) == 1:
        return found[0]
    return np.concatenate(found) if found else NO_MATCHES


def _state_before(
    reference: MapRecord,
    windows: SlidingWindows,
    schedule: MatchSchedule,
    recent: int = 0,
    place_filter: PlaceFilter | None = None,
) -> OnlineState:
    """Return the state of the kernel before the first event.

    Parameters
    ----------
    windows : SlidingWindows
        Windows with the distances to this map.
    schedule : MatchSchedule
        Schedule of matches.
    recent : int
        Number of the newest places that are not searched.
    place_filter : PlaceFilter, optional
        Its arrays are shared, not copied.
    """
    settings, acceptance = reference.settings, reference.acceptance
    control = np.zeros(1, dtype=CONTROL).view(np.recarray)
    first = control[0]
    first.every, first.interval = schedule.events, schedule.interval_us
    first.change, first.exclusion = schedule.change, settings.exclusion_places
    first.next_tick, first.last_reported = schedule.interval_us, -1
    first.recent, first.window_end = recent, NEVER
    first.least_trust = -2 * TIME_LIMIT_US
    trust, probability = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.float64)
    if acceptance.confidence is not None:
        # copies, because Numba gives read-only arrays another type
        trust, probability = (
            acceptance.confidence.trust.copy(),
            acceptance.confidence.probability.copy(),
        )
        if acceptance.precision is not None:
            first.least_trust = acceptance.confidence.least_trust(acceptance.precision)
    filter_state = filter_table = rows = None
    length = settings.windows_per_match if place_filter is None else None
    if place_filter is not None:
        filter_state, filter_table = place_filter.state, place_filter.transitions.table
        rows = WindowRows.empty(1, len(place_filter))
    return OnlineState(
        windows,
        filter_state,
        filter_table,
        rows,
        length,
        control,
        trust,
        probability,
        reference.pixel_map.table(),
        np.empty(CHUNK_EVENTS, dtype=np.int32),
        np.empty(CHUNK_EVENTS, dtype=np.int64),
        np.zeros(MATCHES_AT_ONCE, dtype=MATCH_DTYPE),
    )


class MatchRun:
    """The state of the localiser and the calls of its kernel, whatever it matches by.

    Counters and distances are updated when they are read, to the time `now_us`: all earlier events
    have been processed.

    Parameters
    ----------
    schedule, recent, place_filter
        See `_state_before`.

    Attributes
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Places of the map, and appended places.
    state : OnlineState
        Replaced when an array has to grow.
    kernel_state : KernelState
        The same for `process_events`; call `go_on` with its result.
    """

    def __init__(
        self,
        reference: MapRecord,
        window: Window,
        schedule: MatchSchedule,
        recent: int = 0,
        place_filter: PlaceFilter | None = None,
    ) -> None:
        self.places, settings = reference.places.counts, reference.settings
        code: OwnMeanCode | int | None = reference.own_mean_code
        if code is None:
            shared = settings.shared_code
            code = UNLIMITED if shared is None else shared.top
        windows = start(self.places, window, settings.windows_per_match, code, reference.mean)
        state = _state_before(reference, windows, schedule, recent, place_filter)
        # not a record array, whose field access takes 1 us
        self._control = np.asarray(state.control).view(CONTROL)[0]
        self._out = state.out.view(np.uint8).data
        self._hold(state)

    def _hold(self, state: OnlineState) -> None:
        self.state, self.kernel_state = state, SharedState(state).kernel_state
        self._process: Callable[..., Stop] = specialise(
            process_events, self.kernel_state, NO_EVENTS, GO_ON
        )

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

    def process(self, events: Events) -> Stop:
        """Call the kernel with events in a contiguous, writable array."""
        if events.size > self.state.slots.size:
            # uninitialised: only pages with selected events take memory
            slots, times = np.empty(events.size, np.int32), np.empty(events.size, np.int64)
            self._hold(self.state._replace(slots=slots, times=times))
        return self._process(self.kernel_state, events, GO_ON)

    def advance(self, until_us: int) -> MatchRows:
        """Advance the time without events."""
        return self.go_on(self._process(self.kernel_state, NO_EVENTS, until_us))

    def go_on(self, stop: Stop) -> MatchRows:
        """Call the kernel until all events are processed, and return all matches.

        Parameters
        ----------
        stop : tuple
            Result of the first call, which has not refused the events.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        found = []
        while True:
            given, why = stop
            if given:
                found.append(self._taken(given))
            if why == DONE:
                return found
            if why == RING_FULL:
                self._hold(self.state._replace(windows=grown(self.state.windows)))
            elif why == WINDOW_OVER:
                self._window_over()
            stop = self._process(self.kernel_state, NO_EVENTS, GO_ON)

    def finish(self) -> MatchRows:
        """Return the matches that a delay still holds, at the end of a drive."""
        return []

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        # as bytes: NumPy copies records field by field
        room = bytearray(self._out[: given * MATCH_DTYPE.itemsize])
        return np.frombuffer(room, dtype=MATCH_DTYPE)

    def _window_over(self) -> None:
        """Finish a window that the place filter has ended."""
        raise NotImplementedError

    def settled(self) -> SlidingWindows:
        """Return the windows, with counters and distances updated to the current time."""
        advance(self.state.windows, self.now_us)
        settle(self.state.windows)
        return self.state.windows

    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Return the distance of the sequence that ends at each place, shape (K - L + 1,)."""
        s = self.settled()
        return s.sums[: s.totals["sums"][0]].astype(np.int64) + s.totals["common"][0]

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which indicates a fault of edge-vpr.
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
            "schedule": schedule,
        }

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`; the map must have the saved places."""
        self._control["now"], self._control["floor"] = now_us, floor_us
        tick, place = arrays["schedule"].tolist()
        self._control["next_tick"], self._control["last_reported"] = tick, place
        s, first = self.state.windows, int(arrays["bound"][-1])
        while s.slot.size < arrays["slot"].size:
            s = grown(s)
        at = np.arange(first, first + arrays["slot"].size) & (s.slot.size - 1)
        s.slot[at] = arrays["slot"]
        s.time[at] = arrays["time"]
        s.bound[:] = arrays["bound"]
        s.counts[:] = recount(s)
        self._hold(self.state._replace(windows=with_distances(s, self.places)))


# Sequences event by event.


class SequenceRun(MatchRun):
    """Matching by the sequence of the newest L windows."""

    def append(self, counts: npt.NDArray[np.integer]) -> None:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes if the map has a code.
        """
        if counts.shape != self.places.shape[1:] or counts.dtype.kind not in "iu":
            raise MapError(
                f"descriptor of {counts.dtype} and shape {counts.shape}: expected "
                f"{self.places.shape[1]} whole numbers, as `DescriptorStream` gives them"
            )
        most = min(self.state.windows.saturation, np.iinfo(np.int32).max)
        if counts.min() < 0 or counts.max() > most:
            raise MapError(
                f"descriptor holds {counts.min()} to {counts.max()}: expected 0 to {most}"
            )
        wide = np.promote_types(self.places.dtype, narrow(counts).dtype)
        self.places = np.concatenate([self.places.astype(wide), counts[None].astype(wide)])
        self._hold(self.state._replace(windows=with_distances(self.settled(), self.places)))


# The place filter event by event: within windows, and at the end of each window.


class FilterRun(MatchRun):
    """Matching by the place filter, also within windows.

    Attributes
    ----------
    odometer_check : OdometerCheck
        Check of live odometer readings.
    mean : RunningMean
        Of contrast codes.
    """

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        self.place_filter = PlaceFilter.of(
            reference.places, reference.settings, reference.jumps, reference.along_mm
        )
        super().__init__(reference, window, schedule, place_filter=self.place_filter)
        self.odometer = Odometer(self.place_filter.transitions.spacing_mm)
        self.odometer_check = OdometerCheck(*_means_per_s(reference))
        assert reference.own_mean_code is not None and reference.mean is not None
        self._code, self.mean = reference.own_mean_code, RunningMean(reference.mean)
        self._windows = 0  # finished
        self._silence: tuple[object, ...] = ()  # the filter after a window without events
        self._set_window_end()

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading: until the window ends, places are predicted by the driven distance."""
        self.place_filter.transitions.check_odometry()
        self.odometer.read(distance_mm)
        self._travel()

    def _travel(self) -> None:
        travelled = self.odometer.travelled_mm
        if travelled is not None:
            self.place_filter.predict_travelled(travelled, self.odometer.driven_mm)

    def _set_window_end(self) -> None:
        self._control["window_end"] = (self._windows + 1) * self.state.windows.tau

    def _window_over(self) -> None:
        s, read = self.state.windows, self.odometer.fresh
        self._windows += 1
        self.odometer.end_window()
        if not self._control["paused"]:
            self.mean.update(self._code.level(s.counts[0]))
            s.contrast.means[:] = self.mean.mean
        if s.bound[0] == s.bound[1]:
            self._skip_silence(read)
        else:
            self._silence = ()
        self._set_window_end()

    def _skip_silence(self, odometry: bool) -> None:
        """Skip windows without events once they leave the filter unchanged."""
        found, c = self.place_filter, self._control
        before = self._silence
        self._silence = found.numbers, found.state.metric.tobytes()
        if self._silence == before and not odometry:
            read, until = c["read"], c["until"]
            if read < c["selected"]:
                until = self.state.times[read]
            if c["interval"]:
                until = min(until, c["next_tick"])
            self._windows = max(self._windows, int(until) // self.state.windows.tau - 1)

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        found, meter = self.place_filter, self.odometer
        state = [*found.numbers, self._windows]
        arrays = super().to_arrays() | {
            "filter_metric": found.state.metric,
            "filter_state": np.array(state, dtype=np.int64),
        }
        if meter.fresh or meter.anchored or meter.anchor != meter.latest:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored, meter.before]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
            arrays["odometer_check"] = self.odometer_check.to_array()
        arrays["filter_mean"] = self.mean.total
        arrays["filter_mean_windows"] = np.array([self.mean.windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        found = self.place_filter
        *numbers, self._windows = arrays["filter_state"].tolist()
        found.resume(arrays["filter_metric"], numbers)
        if "filter_odometer" in arrays:
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored, meter.before = arrays[
                "filter_odometer"
            ].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self.odometer_check.resume(arrays["odometer_check"])
            self._travel()
        self._set_window_end()
        self.mean.total = arrays["filter_mean"].copy()
        self.mean.windows = int(arrays["filter_mean_windows"][0])
        self.state.windows.contrast.means[:] = self.mean.mean
        super().resume(arrays, now_us, floor_us)


def _means_per_s(reference: MapRecord) -> tuple[int, int]:
    """Return the speed of a map's drive in mm/s, and its selected events per second; 0: unknown."""
    along_mm, windows = reference.along_mm, reference.windows
    passed_us = int(windows.centre_us[-1] - windows.centre_us[0])
    if along_mm is None or passed_us <= 0:
        return 0, 0
    events = round(float(windows.selected_events.mean()) * (len(windows) - 1))
    way_mm = int(along_mm[-1] - along_mm[0])
    return way_mm * 1_000_000 // passed_us, events * 1_000_000 // passed_us


# The place filter event by event, with matches that come some windows late.


class DelayedRun(FilterRun):
    """Matching of each window after N more windows have ended.

    The kernel matches at the end of each window. Time and events of its match are kept, place and
    trust are replaced by those of `FixedLag`.

    Parameters
    ----------
    reference : MapRecord
        Its settings give N.
    schedule : MatchSchedule
        A match at the end of each window.
    """

    def __init__(self, reference: MapRecord, window: Window, schedule: MatchSchedule) -> None:
        settings = reference.settings
        if schedule != MatchSchedule.window(settings):
            raise UsageError(
                f"a delay of {settings.delay} windows gives a match at the end of each window: "
                "match every window, or set delay to 0"
            )
        super().__init__(reference, window, schedule)
        self._lag = FixedLag(self.place_filter.transitions, settings.match_delay)
        self._given: np.void | None = None  # match of the kernel for the window that ends
        self._undecided: deque[np.void | None] = deque()  # None for a window that was skipped
        self._decided: list[np.void] = []

    def go_on(self, stop: Stop) -> MatchRows:
        """See `MatchRun.go_on`."""
        super().go_on(stop)
        return self._drained()

    def finish(self) -> MatchRows:
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
            steps = self.state.trust_steps, self.state.probability_steps
            plain(accept_match)(row, *steps, self._control["least_trust"])
            self._decided.append(row)

    def _drained(self) -> MatchRows:
        decided, self._decided = self._decided, []
        return [np.array(decided, dtype=MATCH_DTYPE)] if decided else []

    def to_arrays(self) -> Arrays:
        """Raise UsageError: windows that wait for later ones cannot be saved."""
        raise UsageError(
            "a localiser with a delay cannot be saved: set delay to 0, or keep the events"
        )

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Raise MapError: a saved state has no waiting windows."""
        raise MapError("the state has a delay, with which none can be saved")


# The localiser, as a program calls it.


__all__ = ["MATCH_DTYPE", "Localiser"]

KIND = "localiser state"


class Localiser:
    """Matches a stream of events with a map, event by event.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> localiser = ReferenceMap.build(monday, pixels=50).localiser("window")
    >>> places = [int(match["place"]) for events in tuesday for match in localiser.update(events)]
    >>> tuple(places[-3:])
    (6, 8, 10)

    It holds the counters of the newest L consecutive windows (`SlidingWindows`), and the distances
    of this sequence to all places. An event changes each distance by a few steps of +-1, so that
    no event needs a complete comparison.

    Parameters
    ----------
    reference : MapRecord
        Map, whose settings are those of a profile (`Settings.profile`).
    every : str or MatchSchedule, optional
        Schedule of matches: ``"event"``, a number of events such as ``"100"``, a time such as
        ``"50ms"``, ``"window"``, or ``"change"`` of the place. By default after each event; with a
        delay at the end of each window, the only schedule then. There is no match before the L
        windows are complete.
    recent : int
        Number of the map's newest places that are not searched, for a rover that appends places
        while it drives.
    check_every : int
        For debugging: recompute and compare everything after this number of selected events.
    """

    def __init__(
        self,
        reference: MapRecord,
        *,
        every: str | MatchSchedule | None = None,
        recent: int = 0,
        check_every: int = 0,
    ) -> None:
        expect(reference, MapRecord, "reference", "a ReferenceMap, as of ReferenceMap.load(path)")
        if reference.settings.smooth:  # which needs later windows
            reference = reference.matched_with(replace(reference.settings, smooth=False))
        self.settings = settings = reference.settings
        if settings.profile is None:
            raise UsageError(settings.beyond_profile)
        if every is not None:
            expect(every, (str, MatchSchedule), "every", "a text such as '50ms' or 'window'")
        self.every = MatchSchedule.parse(every, settings, "event")
        self._reference, self._recent, self._check_every = reference, recent, check_every
        self._window, length = window_of(settings), settings.windows_per_match
        reference.check()
        places, counters = reference.places.counts.shape
        check_extent(places, counters, length, recent, self._window)
        filtered = settings.matching == "filter"
        if recent and filtered:
            raise UsageError(
                f"{recent} recent places are left out by sequences only: set matching to sequence"
            )
        self.run: MatchRun
        if filtered:
            filter_run = DelayedRun if settings.match_delay else FilterRun
            self.run = filter_run(reference, self._window, self.every)
        else:
            check_no_transitions(reference.jumps, odometry=False)
            self.run = SequenceRun(reference, self._window, self.every, recent)

    def __len__(self) -> int:
        return len(self.run.places)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Counts of each window, newest first, as a copy of shape (L, J)."""
        return self.run.settled().counts.copy()

    @property
    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Distances of the sequences that end at each place, shape (K - L + 1,).

        Element m belongs to place m + L - 1.
        """
        return self.run.distance_sums()

    @property
    def complete(self) -> bool:
        """Whether the L windows and those of a delay are complete; before, there is no match."""
        return self.filled >= 1

    @property
    def filled(self) -> float:
        """Share of the L windows and those of a delay that is complete, 0 to 1."""
        windows = self.settings.windows_per_match + self.settings.match_delay
        if isinstance(self._window, FixedTime):
            return min(1.0, self.run.now_us / (windows * self._window.tau_us))
        return min(1.0, self.selected / (windows * self._window.events))

    @property
    def next_match_us(self) -> int:
        """Time before which there is no match, if matches are scheduled by time only; else 0."""
        return 0 if self.every.events else self.run.next_tick

    def update(self, events: Events) -> npt.NDArray[np.void]:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray with fields t, x and y, shape (n,)
            In time order, and not earlier than previous events.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Scheduled matches, in order.

        Raises
        ------
        EventError
            If time runs backwards or a pixel lies off the sensor; the state is then as it was.
        UsageError
            If time jumps over more than a million ticks of the schedule.
        """
        try:
            if not events.size:
                return NO_MATCHES
            if type(events) is not np.ndarray or events.dtype != EVENT_DTYPE:
                events = self._plain(events)
            elif not events.flags.carray:
                events = events.copy()
        except (AttributeError, IndexError, ValueError):
            check_event_array(events)  # only now, since it takes as long as a few events
            raise
        if self._check_every:
            return self._verified(events)
        stop = self.run.process(events)
        if stop[1] == REFUSED:
            self._check(events)
        return join_matches(self.run.go_on(stop))

    def _verified(self, events: Events) -> npt.NDArray[np.void]:
        """Process events in parts, and verify the state after each part."""
        self._check(events)
        selected = self._reference.pixel_map.table()[events["y"], events["x"]] >= 0
        ends = np.flatnonzero(selected)[self._check_every - 1 :: self._check_every] + 1
        found = []
        for part in np.split(events, ends[ends < events.size]):
            found += self.run.go_on(self.run.process(part))
            self.verify()
        return join_matches(found)

    def _check(self, events: Events) -> None:
        """Raise the error of events of EVENT_DTYPE, if there is one."""
        check_order(events, self.run.floor_us, self._reference.pixel_map.sensor)
        self.every.check_ticks(self.run.next_tick, int(events["t"][-1]))

    def _plain(self, events: Events) -> Events:
        """Return events of another layout as an array of EVENT_DTYPE."""
        check_columns(events["x"], events["y"], None)
        plain = np.zeros(events.shape, dtype=EVENT_DTYPE)
        plain["t"], plain["x"], plain["y"] = events["t"], events["x"], events["y"]
        return plain

    @property
    def selected(self) -> int:
        """Events at the selected pixels so far."""
        return int(self.run.state.windows.bound[0])

    def advance(self, until_us: int) -> npt.NDArray[np.void]:
        """Advance the time to T = `until_us` without events, and return the scheduled matches.

        Parameters
        ----------
        until_us : int
            Not earlier than the last event.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
        """
        expect(until_us, (int, np.integer), "until_us", "whole microseconds")
        floor_us = self.run.floor_us
        if until_us < floor_us:
            raise EventError(
                f"time runs backwards, from {floor_us} to {until_us} us: name a later time"
            )
        if until_us > TIME_LIMIT_US:
            raise EventError(
                f"time {until_us} us lies beyond {TIME_LIMIT_US}: check the clock's unit"
            )
        self.every.check_ticks(self.run.next_tick, until_us)
        found = join_matches(self.run.advance(until_us))
        if self._check_every:
            self.verify()
        return found

    def finish(self) -> npt.NDArray[np.void]:
        """Return the matches that a delay still holds, at the end of a drive.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Matches of the last windows, which fewer windows than the delay follow; m is 0 without
            a delay.
        """
        return join_matches(self.run.finish())

    def read_odometer(
        self, time_us: int, distance_m: float, *, checked: bool = True
    ) -> npt.NDArray[np.void]:
        """Advance the time to `time_us` and take a reading of the robot's odometer.

        The distance since the previous window then determines the costs of steps. Give at least one
        reading per window, better ten; a window without a reading uses the costs of the settings.

        Parameters
        ----------
        time_us : int
            Time of the reading, not earlier than the last event. Events of the same time come
            first.
        distance_m : float
            Driven metres, from any zero; it decreases when the robot drives backwards.
        checked : bool
            Whether to ignore leaps and implausible readings (`odometer_check`). Without, the
            matches equal those of a recording with the same readings to the bit.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Matches scheduled by then.
        """
        run = self.run
        if not isinstance(run, FilterRun):
            check_no_transitions(None, odometry=True)
            return NO_MATCHES
        expect(time_us, (int, np.integer), "time_us", "whole microseconds")
        expect(distance_m, (int, float, np.number), "distance_m", "metres as a number")
        if not abs(distance_m) * 1e3 <= MOST_MM:
            raise UsageError(f"odometer at {distance_m} m: expected at most {MOST_MM // 1000} m")
        run.place_filter.transitions.check_odometry()
        matches, distance_mm = self.advance(time_us), round(distance_m * 1e3)
        check = run.odometer_check
        if not checked:
            run.read_odometer(distance_mm)
        elif check.read(int(time_us), distance_mm, self.selected):
            run.read_odometer(check.distance_mm)
        return matches

    @property
    def odometer_check(self) -> OdometerCheck | None:
        """Findings about the odometer; None with sequences."""
        return self.run.odometer_check if isinstance(self.run, FilterRun) else None

    def skip_ticks(self, until_us: int) -> None:
        """Skip the times of the schedule before `until_us`, except the last one.

        Parameters
        ----------
        until_us : int
            Next time that `update` or `advance` reaches.
        """
        interval = self.every.interval_us
        if interval:
            last = until_us // interval * interval
            self.run.next_tick = max(self.run.next_tick, last)

    def go_unseen(self, until_us: int, passed_us: int) -> None:
        """Advance the time to `until_us` over a gap, in which the robot may have driven on.

        Parameters
        ----------
        until_us : int
            Of the first event after the gap.
        passed_us : int
            Length of the gap; the place filter takes any way forward for possible that a robot can
            drive in it at twice the speed of the map.
        """
        self.advance(until_us)
        if isinstance(self.run, FilterRun):
            centres = self._reference.windows.centre_us
            place_us = max(int(centres[-1] - centres[0]) // max(len(centres) - 1, 1), 1)
            self.run.place_filter.spread(2 * passed_us // place_us + 1)

    def append(self, counts: npt.NDArray[np.integer]) -> int:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes if the localiser has a code.

        Returns
        -------
        int
            Number of the new place.
        """
        if not isinstance(self.run, SequenceRun):
            raise UsageError("places are added while matching by sequences only: map the drive")
        self.run.append(counts)
        return len(self) - 1

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Save the map and the state, from which `load` continues exactly.

        Parameters
        ----------
        path : path
            An ``.npz`` file, written atomically.
        overwrite : bool
            Replace an existing file.
        """
        run = self.run
        arrays = map_arrays(self._reference) | run.to_arrays()
        meta = self._meta() | {"now_us": run.now_us, "floor_us": run.floor_us}
        write_archive(path, KIND, arrays, meta, overwrite=overwrite)

    def checksum(self) -> str:
        """Return a checksum of the map, the settings and the version, which a state belongs to."""
        arrays = map_arrays(self._reference) | {"places": self.run.places}
        return checksum_of(self._meta() | {"edge_vpr": __version__}, arrays)

    def _meta(self) -> dict[str, Any]:
        return {
            "sensor": list(self._reference.pixel_map.sensor),
            "settings": self.settings.to_dict(),
            "every": asdict(self.every),
            "recent": self._recent,
        }

    @classmethod
    def load(cls, path: str | Path, *, check_every: int = 0) -> Localiser:
        """Load a localiser from a file of `save`.

        Raises
        ------
        MapError
            If the file is missing, unreadable, damaged, or of another version.
        """
        arrays, meta = read_archive(path, KIND)
        with archive_errors(path, "save the state again"):
            found = cls(
                searched_map(arrays, meta),
                every=MatchSchedule(**meta["every"]),
                recent=meta["recent"],
                check_every=check_every,
            )
            found.run.resume(arrays, meta["now_us"], meta["floor_us"])
        return found

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which indicates a fault of edge-vpr.
        """
        self.run.verify()


# Feeding of events and odometer readings to a localiser in time order.


class OdometryFeed:
    """Feeds events and readings to a localiser in time order; at equal times, events come first.

    Parameters
    ----------
    odometry : Odometry, optional
        Without it, only events are fed.
    """

    def __init__(self, localiser: Localiser, odometry: Odometry | None = None) -> None:
        self._localiser, self._read = localiser, 0
        empty = np.empty(0, dtype=np.int64)
        self._times = empty if odometry is None else np.maximum(odometry.time_us, 0)
        self._metres = [] if odometry is None else (odometry.distance_mm / 1e3).tolist()

    def update(self, events: Events) -> list[npt.NDArray[np.void]]:
        """Feed the next events, and the readings up to the last of them.

        Parameters
        ----------
        events : ndarray with fields t, x and y, shape (n,)
            See `Localiser.update`.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        if events.size == 0:
            return []
        found, begin = [], 0
        stop = int(np.searchsorted(self._times, events["t"][-1], side="right"))
        at = np.searchsorted(events["t"], self._times[self._read : stop], side="right").tolist()
        for reading, first in zip(range(self._read, stop), at, strict=True):
            if first > begin:
                found.append(self._localiser.update(events[begin:first]))
                begin = first
            time_us = int(self._times[reading])
            metres = self._metres[reading]
            found.append(self._localiser.read_odometer(time_us, metres, checked=False))
        self._read = stop
        found.append(self._localiser.update(events[begin:]))
        return found


# The part of a map that a saved localiser needs.


def map_arrays(reference: MapRecord) -> Arrays:
    """Return the arrays of a map for `searched_map`, without the places."""
    arrays = present(
        pixel_x=reference.pixel_map.x,
        pixel_y=reference.pixel_map.y,
        mean=reference.mean,
        jumps=reference.jumps,
    )
    if reference.confidence is not None:
        arrays |= reference.confidence.to_arrays()
    if reference.settings.matching == "filter":
        arrays |= present(activity=reference.places.selected_events, odometer_mm=reference.along_mm)
    return arrays


def searched_map(arrays: Arrays, meta: Mapping[str, Any]) -> MapRecord:
    """Build a map with only the parts that a localiser needs.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Of `map_arrays`, and ``places``.
    meta : mapping
        With ``sensor`` and ``settings``.
    """
    pixel_map = PixelMap(Sensor(*meta["sensor"]), arrays["pixel_x"], arrays["pixel_y"])
    sensor = pixel_map.sensor
    no_times = np.zeros(len(arrays["places"]), dtype=np.int64)
    figures = np.broadcast_to(np.float32(0), (sensor.height, sensor.width))
    return MapRecord(
        Settings.from_dict(meta["settings"]),
        pixel_map,
        Descriptors(arrays["places"], no_times, no_times, no_times, arrays.get("activity")),
        saliency=figures,
        hot=np.broadcast_to(np.False_, figures.shape),
        mean=arrays.get("mean"),
        confidence=Confidence.from_arrays(arrays),
        jumps=arrays.get("jumps"),
        odometer_mm=arrays.get("odometer_mm"),
    )


# Limits of the kernels.


#: Largest number of counters of all windows of a sequence: 128 MB in the kernels.
MAX_COUNTERS = 1 << 24
#: Largest number of windows x places x counters: minutes of work at the start.
MAX_COMPARISONS = 1 << 36


def check_extent(places: int, counters: int, length: int, recent: int, window: Window) -> None:
    """Refuse sizes that would overflow the kernels' integers, or need too much memory or time.

    Parameters
    ----------
    places, counters, length, recent : int
        K, J, L, and the number of newest places that are not searched.
    """
    if type(recent) is not int or recent < 0 or places < length + recent:
        raise UsageError(
            f"a map of {places} places cannot hold sequences of {length} besides {recent} recent "
            "places: take a shorter sequence or a longer map"
        )
    if length * counters > MAX_COUNTERS or length * places * counters > MAX_COMPARISONS:
        raise UsageError(
            f"sequences of {length} windows of {counters} counters on {places} places are too "
            "much for matching after every event: take a shorter sequence"
        )
    span = window.tau_us if isinstance(window, FixedTime) else window.events
    if length * span > TIME_LIMIT_US:
        raise UsageError(
            f"a sequence of {length} windows of {window} is longer than {TIME_LIMIT_US} us or "
            "events: take shorter windows"
        )
