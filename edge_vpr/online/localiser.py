"""The localiser, which matches after every event by updates of distances; its saved state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import numpy as np
import numpy.typing as npt

from edge_vpr import __version__
from edge_vpr.archive import Arrays, checksum_of, present
from edge_vpr.compiling import shared_state, specialise
from edge_vpr.descriptors.unseen import UnseenTime
from edge_vpr.descriptors.windows import FixedTime, Window, window_of
from edge_vpr.errors import EventError, UsageError, expect
from edge_vpr.events import (
    NO_EVENTS,
    TIME_LIMIT_US,
    Events,
    as_events,
    check_events,
)
from edge_vpr.matching.match import MATCH_DTYPE, NO_MATCHES, MatchRows, join_matches
from edge_vpr.matching.place_filter import NUMBERS, PlaceFilter
from edge_vpr.matching.prediction import odometry_of_sequences
from edge_vpr.odometry import MOST_MM, Odometer, OdometerCheck
from edge_vpr.online.kernels import (
    DONE,
    GO_ON,
    REFUSED,
    RING_FULL,
    WINDOW_OVER,
    Stop,
    process_events,
)
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_windows import (
    SlidingWindows,
    advance,
    grown,
    recount,
    settle,
    with_distances,
)
from edge_vpr.online.state import CONTROL, OnlineState, state_before
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.activity import SUMS
from fixedpoint.own_mean import RunningMean

__all__ = ["Localiser"]

_NOTHING = NO_EVENTS.columns[:3]  # instead of events


class Localiser:
    """Matches a stream of events with a map, event by event.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> localiser = ReferenceMap.build(monday, pixels=50).localiser("window")
    >>> places = [int(match["place"]) for events in tuesday for match in localiser.update(events)]
    >>> tuple(places[-3:]), localiser
    ((6, 6, 11), Localiser(12 places, at 8.57585 s))

    It holds the counters of the newest L consecutive windows (`SlidingWindows`), and the distances
    of this sequence to all places. An event changes each distance by a few steps of +-1, so that
    no event needs a complete comparison. It is for one thread: another one that calls it meanwhile
    damages what it holds.

    Parameters
    ----------
    reference : ReferenceMap
        Map, whose settings are those of a profile (`Settings.profile`).
    every : str or MatchSchedule, optional
        Schedule of matches: ``"event"``, a number of events such as ``"100"``, a time such as
        ``"50ms"``, ``"window"``, or ``"change"`` of the place. By default after each event. There
        is no match before the L windows are complete.

    Attributes
    ----------
    places : ndarray of unsigned int, shape (K, J)
        Places of the map.
    state : OnlineState
        All arrays. Counters and distances are updated when they are read, to the time `now_us`: all
        earlier events have been processed.
    unseen_time : UnseenTime
        Finds the gaps of the stream.
    odometer : Odometer
        The robot's, in the present window.
    odometer_check : OdometerCheck
        Findings about live readings.
    means : list of RunningMean
        Of the contrast codes of each sum of windows; none with sequences.
    """

    def __init__(
        self, reference: ReferenceMap, *, every: str | MatchSchedule | None = None
    ) -> None:
        expect(
            reference, ReferenceMap, "reference", "a ReferenceMap, as of ReferenceMap.load(path)"
        )
        reference = reference.causal()
        self.settings = settings = reference.settings
        if settings.profile is None:
            raise UsageError(settings.beyond_profile)
        self.every = MatchSchedule.parse(every, settings, "event")
        self._reference = reference
        self._window, length = window_of(settings), settings.windows_per_match
        reference.check()
        self.places = reference.places.counts
        check_extent(len(self.places), self.places.shape[1], length, self._window)
        self.unseen_time = UnseenTime(self._window)
        self._filter: PlaceFilter | None = None
        self.odometer, self.odometer_check = Odometer(), OdometerCheck()
        self._code, self.means = settings.contrast_code, list[RunningMean]()
        self._windows = 0  # that the place filter has finished
        self._silence: tuple[object, ...] = ()  # the filter after a window without events
        if settings.matching == "filter":
            self._filter = PlaceFilter.of(reference.places, settings, reference.along_mm)
            self.odometer = Odometer(self._filter.transitions.spacing_mm)
            assert reference.mean is not None
            self.means = [RunningMean(reference.mean) for _ in range(self._filter.sums)]
        self._hold(state_before(reference, self.every, self._filter))
        # not a record array, whose field access takes 1 us
        self._control = np.asarray(self.state.control).view(CONTROL)[0]
        self._out = self.state.out.view(np.uint8)
        self._set_window_end()

    def __len__(self) -> int:
        return len(self.places)

    def __repr__(self) -> str:
        return f"Localiser({len(self)} places, at {self.now_us / 1e6:g} s)"

    @property
    def filled(self) -> float:
        """Share of the L windows that is complete, 0 to 1."""
        windows = self.settings.windows_per_match
        if isinstance(self._window, FixedTime):
            return min(1.0, self.now_us / (windows * self._window.tau_us))
        selected = int(self.state.windows.bound[0])
        return min(1.0, selected / (windows * self._window.events))

    @property
    def now_us(self) -> int:
        """T: all earlier events have been processed."""
        return int(self._control["now"])

    @property
    def floor_us(self) -> int:
        """Earliest time that the next event may have."""
        return int(self._control["floor"])

    @property
    def next_tick(self) -> int:
        """Time of the next match by the interval of the schedule, in microseconds."""
        return int(self._control["next_tick"])

    @property
    def next_match_us(self) -> int:
        """Time before which there is no match, if matches are scheduled by time only; else 0."""
        return 0 if self.every.events else self.next_tick

    # -- events, time, and the robot's odometer

    def update(self, events: Events) -> npt.NDArray[np.void]:
        """Feed the next events.

        Parameters
        ----------
        events : Events
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
        events = as_events(events)
        if not events.size:
            return NO_MATCHES
        unseen_time, last_us = self.unseen_time, int(events.t[-1])
        if not unseen_time.is_near(last_us):
            self._check(events)
            return join_matches(self._update_over_gaps(events))
        stop = self._call(events)
        if stop[1] == REFUSED:
            self._check(events)
        unseen_time.seen_us, unseen_time.told = last_us, False
        return join_matches(self._go_on(stop))

    def _update_over_gaps(self, events: Events) -> MatchRows:
        """Feed checked events, and tell the filter when nothing was seen between them."""
        matches, begin = [], 0
        for time_us, halves in self.unseen_time.feed(events.t):
            end = int(np.searchsorted(events.t, time_us))
            if end > begin:
                matches += self._go_on(self._call(events[begin:end]))
                begin = end
            matches += self._advance(time_us)
            self._unseen(halves)
        return matches + self._go_on(self._call(events[begin:]))

    def _check(self, events: Events) -> None:
        """Raise the error of events, if there is one."""
        check_events(events, self._reference.pixel_map.sensor, after=self.floor_us)
        last_us = int(events.t[-1])
        if last_us > TIME_LIMIT_US:
            raise EventError(
                f"an event at {last_us} us lies beyond {TIME_LIMIT_US} us: check the unit of its "
                "clock"
            )
        self.every.check_ticks(self.next_tick, last_us)

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
        floor_us = self.floor_us
        if until_us < floor_us:
            raise EventError(
                f"time runs backwards, from {floor_us} to {until_us} us: name a later time"
            )
        if until_us > TIME_LIMIT_US:
            raise EventError(
                f"time {until_us} us lies beyond {TIME_LIMIT_US}: check the clock's unit"
            )
        self.every.check_ticks(self.next_tick, until_us)
        parts: MatchRows = []
        for time_us, halves in self.unseen_time.until(until_us):
            parts += self._advance(max(time_us, floor_us))
            self._unseen(halves)
        return join_matches(parts + self._advance(until_us))

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
            Whether to leave out leaps (`odometer_check`). Without, the matches equal those of a
            recording with the same readings to the bit.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Matches scheduled by then.
        """
        if self._filter is None:
            raise odometry_of_sequences()
        expect(time_us, (int, np.integer), "time_us", "whole microseconds")
        expect(distance_m, (int, float, np.number), "distance_m", "metres as a number")
        if not abs(distance_m) * 1e3 <= MOST_MM:
            raise UsageError(f"odometer at {distance_m} m: expected at most {MOST_MM // 1000} m")
        self._filter.transitions.check_odometry()
        matches, distance_mm = self.advance(time_us), round(distance_m * 1e3)
        check = self.odometer_check
        if not checked or check.read(int(time_us), distance_mm):
            self.odometer.read(check.distance_mm if checked else distance_mm)
            self._travel()
        return matches

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
            self._control["next_tick"] = max(self.next_tick, last)

    # -- the kernel, and the work that needs Python when it returns

    def _hold(self, state: OnlineState) -> None:
        """Hold a state, of which an array has grown."""
        self.state, self._kernel_state = state, shared_state(state)
        self._process: Callable[..., Stop] = specialise(
            process_events, self._kernel_state, *_NOTHING, GO_ON
        )

    def _call(self, events: Events) -> Stop:
        """Call the kernel with events that are `Events.packed`."""
        if events.size > self.state.slots.size:
            # uninitialised: only pages with selected events take memory
            slots, times = np.empty(events.size, np.int32), np.empty(events.size, np.int64)
            self._hold(self.state._replace(slots=slots, times=times))
        return self._process(self._kernel_state, events.t, events.x, events.y, GO_ON)

    def _advance(self, until_us: int) -> MatchRows:
        """Advance the time without events."""
        return self._go_on(self._process(self._kernel_state, *_NOTHING, until_us))

    def _go_on(self, stop: Stop) -> MatchRows:
        """Call the kernel until all events are processed, and return all matches.

        Parameters
        ----------
        stop : tuple
            Result of the first call, which has not refused the events.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        parts = []
        while True:
            matches, why = stop
            if matches:
                # copied as bytes: NumPy copies records field by field
                taken = self._out[: matches * MATCH_DTYPE.itemsize].copy()
                parts.append(taken.view(MATCH_DTYPE))
            if why == DONE:
                return parts
            if why == RING_FULL:
                self._hold(self.state._replace(windows=grown(self.state.windows)))
            elif why == WINDOW_OVER:
                self._window_over()
            stop = self._process(self._kernel_state, *_NOTHING, GO_ON)

    # -- the place filter between its windows

    def _unseen(self, halves: int) -> None:
        """Note that nothing was seen for so many halves of a window, until now."""
        if self._filter is not None:
            self._filter.unseen(halves)
            self._travel()

    def _travel(self) -> None:
        """Predict places by the driven distance, if it is known, until the window ends."""
        travelled = self.odometer.travelled_mm
        if travelled is not None and self._filter is not None:
            self._filter.predict_travelled(travelled, self.odometer.driven_mm)

    def _set_window_end(self) -> None:
        if self._filter is not None:
            self._control["window_end"] = (self._windows + 1) * self.state.windows.tau

    def _window_over(self) -> None:
        """Finish a window that the place filter has ended."""
        s, read = self.state.windows, self.odometer.fresh
        self._windows += 1
        self.odometer.end_window()
        if not self._control["paused"]:
            assert self._code is not None
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
        assert self._filter is not None
        c, before = self._control, self._silence
        self._silence = tuple(part.tobytes() for part in self._filter.to_arrays().values())
        if self._silence == before and not odometry:
            read, until = c["read"], c["until"]
            if read < c["selected"]:
                until = self.state.times[read]
            if c["interval"]:
                until = min(until, c["next_tick"])
            self._windows = max(self._windows, int(until) // self.state.windows.tau - 1)

    # -- keeping the state

    def settled(self) -> SlidingWindows:
        """Return the windows, with counters and distances updated to the current time."""
        advance(self.state.windows, self.now_us)
        settle(self.state.windows)
        return self.state.windows

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        s, c = self.settled(), self._control
        alive = np.arange(s.bound[-1], s.bound[0]) & (s.slot.size - 1)
        arrays = {
            "slot": s.slot[alive],
            "time": s.time[alive],
            "bound": s.bound,
            "schedule": np.array([c["next_tick"], c["last_reported"]], dtype=np.int64),
            "seen": np.array([self.unseen_time.seen_us, self.unseen_time.told], dtype=np.int64),
        }
        if self._filter is None:
            return arrays
        arrays |= self._filter.to_arrays()
        arrays["filter_windows"] = np.array([self._windows], dtype=np.int64)
        meter = self.odometer
        if meter.fresh or meter.anchored or meter.anchor != meter.latest:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored, meter.before]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
            arrays["odometer_check"] = self.odometer_check.to_array()
        arrays["filter_mean"] = np.stack([mean.total for mean in self.means])
        arrays["filter_mean_windows"] = np.array([self.means[0].windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays, now_us: int, floor_us: int) -> None:
        """Restore the state from the arrays of `to_arrays`; the map must have the saved places."""
        if self._filter is not None:
            self._resume_filter(self._filter, arrays)
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

    def _resume_filter(self, place_filter: PlaceFilter, arrays: Arrays) -> None:
        place_filter.resume(arrays)
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

    def fresh(self) -> Localiser:
        """Return another localiser for the same map and schedule, before its first event."""
        return Localiser(self._reference, every=self.every)

    def checksum(self) -> str:
        """Return a checksum of the map, the settings and the version, which a state belongs to.

        Between two versions, the names of the filter's numbers say which numbers a state has.
        """
        reference = self._reference
        arrays = present(
            places=self.places,
            pixel_x=reference.pixel_map.x,
            pixel_y=reference.pixel_map.y,
            mean=reference.mean,
            limits=reference.limits,
        )
        if reference.confidence is not None:
            arrays |= reference.confidence.to_arrays()
        if reference.settings.matching == "filter":
            activity = reference.places.counted_events
            arrays |= present(activity=activity, odometer_mm=reference.along_mm)
        meta = {
            "sensor": list(reference.pixel_map.sensor),
            "settings": self.settings.to_dict(),
            "every": asdict(self.every),
            "edge_vpr": __version__,
            "numbers": NUMBERS.names,
        }
        return checksum_of(meta, arrays)


# Limits of the kernels.


#: Largest number of counters of all windows of a sequence: 128 MB in the kernels.
MAX_COUNTERS = 1 << 24
#: Largest number of windows x places x counters: minutes of work at the start.
MAX_COMPARISONS = 1 << 36


def check_extent(places: int, counters: int, length: int, window: Window) -> None:
    """Refuse sizes that would overflow the kernels' integers, or need too much memory or time.

    Parameters
    ----------
    places, counters, length : int
        K, J and L.
    """
    if places < length:
        raise UsageError(
            f"a map of {places} places cannot hold sequences of {length}: take a shorter sequence "
            "or a longer map"
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
