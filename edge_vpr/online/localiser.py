"""The localiser, which matches after every event by updates of distances; its saved state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
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
from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.counting import window_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedTime, Window
from edge_vpr.errors import EventError, UsageError, expect
from edge_vpr.events import (
    TIME_LIMIT_US,
    Events,
    Sensor,
    as_events,
)
from edge_vpr.matching.prediction import check_no_odometry
from edge_vpr.online.kernels import REFUSED, check_order
from edge_vpr.online.runs import (
    NO_MATCHES,
    FilterRun,
    MatchRows,
    MatchRun,
    SequenceRun,
    join_matches,
)
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import MOST_MM, OdometerCheck, Odometry
from edge_vpr.settings import Settings

__all__ = ["Localiser"]

KIND = "localiser state"


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
    """

    def __init__(
        self, reference: ReferenceMap, *, every: str | MatchSchedule | None = None
    ) -> None:
        expect(
            reference, ReferenceMap, "reference", "a ReferenceMap, as of ReferenceMap.load(path)"
        )
        if reference.settings.smooth:  # which needs later windows
            reference = reference.matched_with(replace(reference.settings, smooth=False))
        self.settings = settings = reference.settings
        if settings.profile is None:
            raise UsageError(settings.beyond_profile)
        if every is not None:
            expect(every, (str, MatchSchedule), "every", "a text such as '50ms' or 'window'")
        self.every = MatchSchedule.parse(every, settings, "event")
        self._reference = reference
        self._window, length = window_of(settings), settings.windows_per_match
        reference.check()
        places, counters = reference.places.counts.shape
        check_extent(places, counters, length, self._window)
        self.run: MatchRun
        if settings.matching == "filter":
            self.run = FilterRun(reference, self._window, self.every)
        else:
            self.run = SequenceRun(reference, self._window, self.every)

    def __len__(self) -> int:
        return len(self.run.places)

    def __repr__(self) -> str:
        return f"Localiser({len(self)} places, at {self.run.now_us / 1e6:g} s)"

    @property
    def filled(self) -> float:
        """Share of the L windows that is complete, 0 to 1."""
        windows = self.settings.windows_per_match
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
        unseen_time, last_us = self.run.unseen_time, int(events.t[-1])
        if not unseen_time.is_near(last_us):
            self._check(events)
            return join_matches(self._update_over_gaps(events))
        stop = self.run.process(events)
        if stop[1] == REFUSED:
            self._check(events)
        unseen_time.seen_us, unseen_time.told = last_us, False
        return join_matches(self.run.go_on(stop))

    def _update_over_gaps(self, events: Events) -> MatchRows:
        """Feed checked events, and tell the run when nothing was seen between them."""
        run, found, begin = self.run, [], 0
        for time_us, halves in run.unseen_time.feed(events.t):
            end = int(np.searchsorted(events.t, time_us))
            if end > begin:
                found += run.go_on(run.process(events[begin:end]))
                begin = end
            found += run.advance(time_us)
            run.unseen(halves)
        return found + run.go_on(run.process(events[begin:]))

    def _check(self, events: Events) -> None:
        """Raise the error of events, if there is one."""
        check_order(events, self.run.floor_us, self._reference.pixel_map.sensor)
        self.every.check_ticks(self.run.next_tick, int(events.t[-1]))

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
        found: MatchRows = []
        for time_us, halves in self.run.unseen_time.until(until_us):
            found += self.run.advance(max(time_us, floor_us))
            self.run.unseen(halves)
        return join_matches(found + self.run.advance(until_us))

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
            Whether to leave out leaps and a stuck odometer (`odometer_check`). Without, the
            matches equal those of a recording with the same readings to the bit.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Matches scheduled by then.
        """
        run = self.run
        if not isinstance(run, FilterRun):
            check_no_odometry(odometry=True)
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
        }

    @classmethod
    def load(cls, path: str | Path) -> Localiser:
        """Load a localiser from a file of `save`.

        Raises
        ------
        MapError
            If the file is missing, unreadable, damaged, or of another version.
        """
        arrays, meta = read_archive(path, KIND)
        with archive_errors(path, "save the state again"):
            found = cls(searched_map(arrays, meta), every=MatchSchedule(**meta["every"]))
            found.run.resume(arrays, meta["now_us"], meta["floor_us"])
        return found


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
        stop = self._read_by(int(events.t[-1]))
        at = np.searchsorted(events.t, self._times[self._read : stop], side="right").tolist()
        for reading, first in zip(range(self._read, stop), at, strict=True):
            if first > begin:
                found.append(self._localiser.update(events[begin:first]))
                begin = first
            found.append(self._reading(reading))
        self._read = stop
        found.append(self._localiser.update(events[begin:]))
        return found

    def finish(self, end_us: int | None) -> list[npt.NDArray[np.void]]:
        """Feed the readings up to the end of the drive, if it is known, and return what is left."""
        found = []
        if end_us is not None:
            stop = self._read_by(end_us)
            found = [self._reading(reading) for reading in range(self._read, stop)]
            self._read = stop
            found.append(self._localiser.advance(end_us))
        return found

    def _read_by(self, time_us: int) -> int:
        """Return how many readings there are up to a time."""
        return int(np.searchsorted(self._times, time_us, side="right"))

    def _reading(self, reading: int) -> npt.NDArray[np.void]:
        return self._localiser.read_odometer(
            int(self._times[reading]), self._metres[reading], checked=False
        )


# The part of a map that a saved localiser needs.


def map_arrays(reference: ReferenceMap) -> Arrays:
    """Return the arrays of a map for `searched_map`, without the places."""
    arrays = present(
        pixel_x=reference.pixel_map.x,
        pixel_y=reference.pixel_map.y,
        mean=reference.mean,
        limits=reference.limits,
    )
    if reference.confidence is not None:
        arrays |= reference.confidence.to_arrays()
    if reference.settings.matching == "filter":
        arrays |= present(activity=reference.places.counted_events, odometer_mm=reference.along_mm)
    return arrays


def searched_map(arrays: Arrays, meta: Mapping[str, Any]) -> ReferenceMap:
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
    return ReferenceMap(
        Settings.from_dict(meta["settings"]),
        pixel_map,
        Descriptors(arrays["places"], no_times, no_times, no_times, arrays.get("activity")),
        saliency=figures,
        hot=np.broadcast_to(np.False_, figures.shape),
        mean=arrays.get("mean"),
        limits=arrays.get("limits"),
        confidence=Confidence.from_arrays(arrays),
        odometer_mm=arrays.get("odometer_mm"),
    )


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
