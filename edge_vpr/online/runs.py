"""Runs, which feed events to the kernel `process_events`, and do the work that needs Python.

`SequenceRun` matches by sequences, `FilterRun` by the place filter. They hold the state of a
localiser.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.compiling import SharedState, specialise
from edge_vpr.descriptors.unseen import UnseenTime
from edge_vpr.descriptors.windows import Window
from edge_vpr.events import NO_EVENTS, TIME_LIMIT_US, Events
from edge_vpr.matching.place_filter import PlaceFilter, WindowRows
from edge_vpr.online.kernels import (
    CHUNK_EVENTS,
    CONTROL,
    DONE,
    GO_ON,
    NEVER,
    RING_FULL,
    WINDOW_OVER,
    OnlineState,
    Stop,
    process_events,
)
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_windows import (
    UNLIMITED,
    SlidingWindows,
    advance,
    grown,
    recount,
    settle,
    start,
    with_distances,
)
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometer, OdometerCheck
from fixedpoint.activity import SUMS
from fixedpoint.own_mean import OwnMeanCode, RunningMean


class MatchRow(NamedTuple):
    """One match, with the column names of ``matches.csv``.

    With the place filter, distances are metrics and L is 1.
    """

    time_us: int  #: Time of the match, by the clock of the events.
    #: Best place; the first one in a tie. Of a map ``route.along_m[place]`` are its metres.
    place: int
    distance: float  #: Of the best place: mean over the L windows of the sequence.
    second: int  #: Best place outside the exclusion zone; -1 if there is none.
    second_distance: float  #: Its distance; NaN if there is none.
    ratio: float  #: `distance` / `second_distance`; NaN if there is no second place.
    ties: int  #: Other places with the same distance.
    events: int  #: Number in the newest window, at the selected pixels.
    start_us: int  #: Start of the newest window.
    #: See `filter_match.FilterMatch`, with sequences the margin; higher means more confident.
    trust: int
    misfit: int  #: See `filter_match.FilterMatch`; -1 with sequences.
    probability: float  #: That the match is correct; NaN if unknown.
    lost: bool  #: Whether it is rejected at the precision of the settings.


#: Records with the fields of `MatchRow`.
MATCH_DTYPE = np.dtype(list(get_type_hints(MatchRow).items()))


_NOTHING = NO_EVENTS.columns[:3]  # instead of events


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
    reference: ReferenceMap,
    windows: SlidingWindows,
    schedule: MatchSchedule,
    place_filter: PlaceFilter | None = None,
) -> OnlineState:
    """Return the state of the kernel before the first event.

    Parameters
    ----------
    windows : SlidingWindows
        Windows with the distances to this map.
    schedule : MatchSchedule
        Schedule of matches.
    place_filter : PlaceFilter, optional
        Its arrays are shared, not copied.
    """
    settings, acceptance = reference.settings, reference.acceptance
    control = np.zeros(1, dtype=CONTROL).view(np.recarray)
    first = control[0]
    first.every, first.interval = schedule.events, schedule.interval_us
    first.change, first.exclusion = schedule.change, settings.exclusion_places
    first.next_tick, first.last_reported = schedule.interval_us, -1
    first.window_end = NEVER
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
    first.windows, limits = settings.windows_per_match, np.empty(0, dtype=np.int64)
    if place_filter is not None:
        assert reference.limits is not None
        filter_state, filter_table = place_filter.state, place_filter.transitions.table
        rows = WindowRows.empty(1, place_filter.sums, len(place_filter))
        limits = reference.limits.astype(np.int64)
    return OnlineState(
        windows,
        filter_state,
        filter_table,
        rows,
        length,
        limits,
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
    schedule, place_filter
        See `_state_before`.

    Attributes
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Places of the map.
    state : OnlineState
        Replaced when an array has to grow.
    kernel_state : KernelState
        The same for `process_events`; call `go_on` with its result.
    unseen_time : UnseenTime
        Finds the gaps of the stream.
    """

    def __init__(
        self,
        reference: ReferenceMap,
        window: Window,
        schedule: MatchSchedule,
        place_filter: PlaceFilter | None = None,
    ) -> None:
        self.places, settings = reference.places.counts, reference.settings
        self.unseen_time = UnseenTime(window)
        code: OwnMeanCode | int | None = reference.own_mean_code
        if code is None:
            shared = settings.shared_code
            code = UNLIMITED if shared is None else shared.top
        sums = SUMS[: 1 if place_filter is None else place_filter.sums]
        length = max(settings.windows_per_match, sums[-1])
        windows = start(self.places, window, length, code, reference.mean, len(sums))
        state = _state_before(reference, windows, schedule, place_filter)
        # not a record array, whose field access takes 1 us
        self._control = np.asarray(state.control).view(CONTROL)[0]
        self._out = state.out.view(np.uint8).data
        self._hold(state)

    def _hold(self, state: OnlineState) -> None:
        self.state, self.kernel_state = state, SharedState(state).kernel_state
        self._process: Callable[..., Stop] = specialise(
            process_events, self.kernel_state, *_NOTHING, GO_ON
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
        """Call the kernel with events that are `Events.packed`."""
        if events.size > self.state.slots.size:
            # uninitialised: only pages with selected events take memory
            slots, times = np.empty(events.size, np.int32), np.empty(events.size, np.int64)
            self._hold(self.state._replace(slots=slots, times=times))
        return self._process(self.kernel_state, events.t, events.x, events.y, GO_ON)

    def advance(self, until_us: int) -> MatchRows:
        """Advance the time without events."""
        return self.go_on(self._process(self.kernel_state, *_NOTHING, until_us))

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
            stop = self._process(self.kernel_state, *_NOTHING, GO_ON)

    def unseen(self, halves: int) -> None:
        """Note that nothing was seen for so many halves of a window, until now."""

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
            "seen": np.array([self.unseen_time.seen_us, self.unseen_time.told], dtype=np.int64),
        }

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`; the map must have the saved places."""
        self._control["now"], self._control["floor"] = now_us, floor_us
        tick, place = arrays["schedule"].tolist()
        self._control["next_tick"], self._control["last_reported"] = tick, place
        seen_us, told = arrays["seen"].tolist()
        self.unseen_time.seen_us, self.unseen_time.told = seen_us, bool(told)
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


# The place filter event by event: within windows, and at the end of each window.


class FilterRun(MatchRun):
    """Matching by the place filter, also within windows.

    Attributes
    ----------
    odometer_check : OdometerCheck
        Check of live odometer readings.
    means : list of RunningMean
        Of the contrast codes of each sum of windows.
    """

    def __init__(self, reference: ReferenceMap, window: Window, schedule: MatchSchedule) -> None:
        self.place_filter = PlaceFilter.of(reference.places, reference.settings, reference.along_mm)
        super().__init__(reference, window, schedule, place_filter=self.place_filter)
        self.odometer = Odometer(self.place_filter.transitions.spacing_mm)
        self.odometer_check = OdometerCheck(_events_per_s(reference))
        assert reference.own_mean_code is not None and reference.mean is not None
        self._code = reference.own_mean_code
        self.means = [RunningMean(reference.mean) for _ in range(self.place_filter.sums)]
        self._windows = 0  # finished
        self._silence: tuple[object, ...] = ()  # the filter after a window without events
        self._set_window_end()

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading: until the window ends, places are predicted by the driven distance."""
        self.place_filter.transitions.check_odometry()
        self.odometer.read(distance_mm)
        self._travel()

    def unseen(self, halves: int) -> None:
        """See `MatchRun.unseen`."""
        self.place_filter.unseen(halves)
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
            for i, mean in enumerate(self.means):
                mean.update(self._code.level(s.counts[: SUMS[i]].sum(axis=0)))
                s.contrast.means[i] = mean.mean
        if s.bound[0] == s.bound[1]:
            self._skip_silence(read)
        else:
            self._silence = ()
        self._set_window_end()

    def _skip_silence(self, odometry: bool) -> None:
        """Skip windows without events once they leave the filter unchanged."""
        found, c = self.place_filter, self._control
        before = self._silence
        self._silence = tuple(part.tobytes() for part in found.to_arrays().values())
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
        arrays = super().to_arrays() | found.to_arrays()
        arrays["filter_windows"] = np.array([self._windows], dtype=np.int64)
        if meter.fresh or meter.anchored or meter.anchor != meter.latest:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored, meter.before]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
            arrays["odometer_check"] = self.odometer_check.to_array()
        arrays["filter_mean"] = np.stack([mean.total for mean in self.means])
        arrays["filter_mean_windows"] = np.array([self.means[0].windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`."""
        found = self.place_filter
        found.resume(arrays)
        (self._windows,) = arrays["filter_windows"].tolist()
        if "filter_odometer" in arrays:
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored, meter.before = arrays[
                "filter_odometer"
            ].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self.odometer_check.resume(arrays["odometer_check"])
            self._travel()
        self._set_window_end()
        for i, mean in enumerate(self.means):
            mean.total = arrays["filter_mean"][i].copy()
            mean.windows = int(arrays["filter_mean_windows"][0])
            self.state.windows.contrast.means[i] = mean.mean
        super().resume(arrays, now_us, floor_us)


def _events_per_s(reference: ReferenceMap) -> int:
    """Return the selected events per second of a map's drive; 0 if unknown."""
    windows = reference.windows
    passed_us = int(windows.centre_us[-1] - windows.centre_us[0])
    events = round(float(windows.selected_events.mean()) * (len(windows) - 1))
    return events * 1_000_000 // passed_us if passed_us > 0 else 0
