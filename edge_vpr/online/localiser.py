"""The localiser: a match after every event, from distances that are updated, not recomputed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import (
    Arrays,
    check_array,
    check_range,
    damaged,
    present,
    read_archive,
    whole_number,
    write_archive,
)
from edge_vpr.compiling import BoxedState, entry, kernel
from edge_vpr.confidence import TRUST_TOP, Confidence
from edge_vpr.descriptors.cleaning import CausalBurstFilter, keep
from edge_vpr.descriptors.counting import check_columns
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedTime, Window
from edge_vpr.errors import EventError, MapError, UsageError, expect
from edge_vpr.events import EVENT_DTYPE, TIME_LIMIT_US, Events, Sensor, check_event_array
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.drive import check_no_ways
from edge_vpr.matching.place_filter import (
    LASTING_BITS,
    METRIC_TOP,
    RECIPROCAL_BITS,
    RESIDUAL_TOP,
    TRUST_BITS,
)
from edge_vpr.online.kernels import check_order
from edge_vpr.online.matcher import (
    CHUNK_EVENTS,
    DONE,
    GO_ON,
    MATCH_DTYPE,
    REFUSED,
    DelayedRun,
    FilterRun,
    Found,
    MatchRun,
    MatchSchedule,
    OnlineState,
    Stop,
    filter_state,
    follow,
)
from edge_vpr.pipeline import window_of
from edge_vpr.route import MOST_MM, Odometry
from edge_vpr.settings import Settings

# The localiser: a match after every event, from distances that are updated, not recomputed.


__all__ = ["MATCH_DTYPE", "Localiser"]

KIND = "localiser state"
NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


class Localiser:
    """Matches a stream of events with a map, event by event.

    >>> from edge_vpr import ReferenceMap
    >>> from edge_vpr.simulation import simulate_pair
    >>> monday, tuesday = simulate_pair(0, "tiny", length_m=40)
    >>> localiser = ReferenceMap.build(monday, pixels=50).localiser("window")
    >>> places = [int(match["place"]) for events in tuesday for match in localiser.update(events)]
    >>> tuple(places[-3:])
    (3, 4, 5)

    It holds the counters of the newest L windows, one directly after the other
    (`edge_vpr.online.matcher`), and the distances of this sequence to all places. An event changes
    each distance by a few steps of +-1, so that the best place is known without a new comparison.

    Parameters
    ----------
    reference : MapRecord
        Its settings say the window, the sequence length, the exclusion zone, and the code of
        its counts.
    every : str or MatchSchedule, optional
        When to give a match: ``"event"``, a number of events such as ``"100"``, a time such as
        ``"50ms"``, ``"window"``, or ``"change"`` of the place. By default after each event, or with
        a delay at the end of each window, which is the only schedule then. No match is given before
        the L windows are complete.
    recent : int
        So many of the map's newest places are left out of the search; for a rover that appends
        places while it drives.
    check_every : int
        For debugging: after so many selected events, recompute everything and compare.

    Raises
    ------
    MapError
        If arrays of the map were changed so that they no longer fit each other.
    UsageError
        If the map is shorter than a sequence, the sequence too long to be followed, or the codes
        are own-mean ones without the place filter.
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
        if every is not None:
            expect(every, (str, MatchSchedule), "every", "a text such as '50ms' or 'window'")
        self.every = MatchSchedule.parse(every, settings, "event")
        self._reference, self._recent, self._check_every = reference, recent, check_every
        self._window, length = window_of(settings), settings.windows_per_match
        reference.check()
        reference.check_counters()
        places, counters = reference.places.counts.shape
        check_extent(places, counters, length, recent, self._window)
        filtered = settings.matching == "filter"
        if reference.own_mean_code is not None and not filtered:
            raise UsageError(
                "own-mean codes follow the mean of a drive, which sequences after every event do "
                "not: set matching to filter, or counter_scaling to shared when the map is made"
            )
        if recent and filtered:
            raise UsageError(
                f"{recent} recent places are left out by sequences only: set matching to sequence"
            )
        self._run: MatchRun
        if filtered:
            filter_run = DelayedRun if settings.late else FilterRun
            self._run = filter_run(reference, self._window, self.every)
        else:
            check_no_ways(reference.jumps, odometry=False)
            self._run = MatchRun(reference, self._window, self.every, recent)

    def __len__(self) -> int:
        return len(self._run.places)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Counts of each window, newest first, shape (L, J); a copy."""
        return self._run.settled().counts.copy()

    @property
    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Distances of the sequences that end at each place, shape (K - L + 1,).

        Element m belongs to place m + L - 1.
        """
        return self._run.distance_sums()

    @property
    def map_bytes(self) -> int:
        """Size of the map in the form that is searched, in bytes."""
        return self._run.state.s.columns.nbytes

    @property
    def complete(self) -> bool:
        """Whether the L windows and those of a delay are complete; there are no matches before."""
        return self.filled >= 1

    @property
    def filled(self) -> float:
        """Share of these windows that is complete, 0 to 1."""
        windows = self.settings.windows_per_match + self.settings.late
        if isinstance(self._window, FixedTime):
            return min(1.0, self._run.now_us / (windows * self._window.tau_us))
        return min(1.0, self.selected / (windows * self._window.events))

    @property
    def next_match_us(self) -> int:
        """Time before which there is no match, if matches are given by time only; else 0."""
        return 0 if self.every.events else self._run.next_tick

    def update(self, events: Events) -> npt.NDArray[np.void]:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
            In time order, after all those before; any number of them.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            The matches that the policy asks for, in order.

        Raises
        ------
        EventError
            If time runs backwards or a pixel lies off the sensor; the state is then as it was.
        UsageError
            If time jumps over more than a million ticks of the policy.
        """
        try:
            if not events.size:
                return NO_MATCHES
            if type(events) is not np.ndarray or events.dtype != EVENT_DTYPE:
                events = self._plain(events)
            elif not events.flags.carray:
                events = events.copy()
        except (AttributeError, IndexError, ValueError):
            check_event_array(events)  # which would take as long as a few events
            raise
        if self._check_every:
            return self._verified(events)
        stop = self._run.follow(events)
        if stop[1] == REFUSED:
            self._check(events)
        return _joined(self._run.go_on(stop))

    def _verified(self, events: Events) -> npt.NDArray[np.void]:
        """Process events in parts, and verify the state after each."""
        self._check(events)
        selected = self._reference.pixel_map.table()[events["y"], events["x"]] >= 0
        ends = np.flatnonzero(selected)[self._check_every - 1 :: self._check_every] + 1
        found = []
        for part in np.split(events, ends[ends < events.size]):
            found += self._run.go_on(self._run.follow(part))
            self.verify()
        return _joined(found)

    def _check(self, events: Events) -> None:
        """Raise what is wrong with events of EVENT_DTYPE, if anything is."""
        check_order(events, self._run.floor_us, self._reference.pixel_map.sensor)
        self.every.check_ticks(self._run.next_tick, int(events["t"][-1]))

    def _plain(self, events: Events) -> Events:
        """Return events of another layout as an array of EVENT_DTYPE."""
        p = events["p"] if self.settings.polarity else None
        check_columns(events["x"], events["y"], p)
        plain = np.zeros(events.shape, dtype=EVENT_DTYPE)
        plain["t"], plain["x"], plain["y"] = events["t"], events["x"], events["y"]
        if p is not None:
            plain["p"] = p
        return plain

    @property
    def run(self) -> MatchRun:
        """What feeds its kernel, for kernels that decode events too."""
        return self._run

    @property
    def selected(self) -> int:
        """Events at the selected pixels so far."""
        return int(self._run.state.s.bound[0])

    def advance(self, until_us: int) -> npt.NDArray[np.void]:
        """Advance the time without events to T = `until_us`, and return the matches due until then.

        Parameters
        ----------
        until_us : int
            Not earlier than the last event.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
        """
        expect(until_us, (int, np.integer), "until_us", "whole microseconds")
        floor_us = self._run.floor_us
        if until_us < floor_us:
            raise EventError(
                f"time runs backwards, from {floor_us} to {until_us} us: name a later time"
            )
        if until_us > TIME_LIMIT_US:
            raise EventError(
                f"time {until_us} us lies beyond {TIME_LIMIT_US}: check the clock's unit"
            )
        self.every.check_ticks(self._run.next_tick, until_us)
        found = _joined(self._run.advance(until_us))
        if self._check_every:
            self.verify()
        return found

    def finish(self) -> npt.NDArray[np.void]:
        """Return the matches that a delay still holds, at the end of a drive.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Of the last windows, with fewer windows after them than the settings ask for; m is 0
            without a delay.
        """
        return _joined(self._run.finish())

    def read_odometer(self, time_us: int, distance_m: float) -> npt.NDArray[np.void]:
        """Advance the time to `time_us` and take a reading of the robot's odometer.

        The distance since the window before then decides the costs of moves. Give at least one
        reading in each window, better ten. A window without one uses the costs of the settings.

        Parameters
        ----------
        time_us : int
            Of the reading; not earlier than the last event. Events of the same time come before it.
        distance_m : float
            Metres driven, from any zero; it falls where the robot drives backwards.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Matches of the ticks until then.

        Raises
        ------
        EventError
            If time runs backwards.
        UsageError
            If the map does not say how far its places are from each other, matching is by
            sequences, or the distance is not finite or beyond 1e9 m.
        """
        run = self._run
        if not isinstance(run, FilterRun):
            check_no_ways(None, odometry=True)
            return NO_MATCHES
        expect(distance_m, (int, float, np.number), "distance_m", "metres as a number")
        if not abs(distance_m) * 1e3 <= MOST_MM:
            raise UsageError(f"odometer at {distance_m} m: expected at most {MOST_MM // 1000} m")
        run.place_filter.transitions.check_odometry()
        matches = self.advance(time_us)
        run.read_odometer(round(distance_m * 1e3))
        return matches

    def skip_ticks(self, until_us: int) -> None:
        """Skip the ticks of the schedule before `until_us`, except the last one.

        Parameters
        ----------
        until_us : int
            Time that `update` or `advance` reaches next.
        """
        interval = self.every.interval_us
        if interval:
            last = until_us // interval * interval
            self._run.next_tick = max(self._run.next_tick, last)

    def append(self, counts: npt.NDArray[np.integer]) -> int:
        """Add a place at the end of the map.

        Parameters
        ----------
        counts : ndarray of int, shape (J,)
            Its descriptor, in codes where the localiser has a code.

        Returns
        -------
        int
            Number of the new place.

        Raises
        ------
        MapError
            If the descriptor has another length.
        """
        if self.settings.matching == "filter":
            raise UsageError("places are added while matching by sequences only: map the drive")
        self._run.append(counts)
        return len(self) - 1

    def save(self, path: str | Path) -> None:
        """Save the map and the state, so that `load` continues exactly from here.

        Parameters
        ----------
        path : path
            An ``.npz`` file, written atomically.
        """
        run, reference = self._run, self._reference
        arrays = map_arrays(reference) | run.to_arrays()
        meta = {
            "sensor": list(reference.pixel_map.sensor),
            "settings": self.settings.to_dict(),
            "every": asdict(self.every),
            "recent": self._recent,
            "now_us": run.now_us,
            "floor_us": run.floor_us,
        }
        write_archive(path, KIND, arrays, meta)

    @classmethod
    def load(cls, path: str | Path, *, check_every: int = 0) -> Localiser:
        """Load a localiser that `save` wrote, and continue from there.

        Raises
        ------
        MapError
            If the file is missing, unreadable, or from a newer version.
        """
        arrays, meta = read_archive(path, KIND)
        with damaged(path, "save the state again"):
            found = cls(
                searched_map(arrays, meta),
                every=MatchSchedule(**meta["every"]),
                recent=meta["recent"],
                check_every=check_every,
            )
            found._resume(arrays, meta)
        return found

    def _resume(self, arrays: Arrays, meta: Mapping[str, Any]) -> None:
        """Restore the state from what `save` wrote, which is checked."""
        places, counters = self._run.places.shape
        length, filtered = self.settings.windows_per_match, isinstance(self._run, FilterRun)
        now_us, floor_us = check_state(
            arrays,
            meta,
            counters=counters,
            length=length,
            ends=places - length + 1,
            window=self._window,
            every=self.every,
            filtered=filtered,
        )
        if filtered:
            check_filter_state(arrays, places, self._window, self.every, floor_us)
        self._run.resume(arrays, now_us, floor_us)

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        self._run.verify()


def _joined(found: Found) -> npt.NDArray[np.void]:
    if len(found) == 1:
        return found[0]
    return np.concatenate(found) if found else NO_MATCHES


# Feeding of events and odometer readings to a localiser in time order.


class OdometryFeed:
    """Feeds a localiser in time order; at the same time, events come before readings.

    Parameters
    ----------
    odometry : Odometry, optional
        Without it, only the events are fed.
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
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
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
            found.append(self._localiser.read_odometer(time_us, self._metres[reading]))
        self._read = stop
        found.append(self._localiser.update(events[begin:]))
        return found


# From events to matches in one compiled call: removal of bursts, then the localiser.


#: A step of the clock is a jump if it is longer than this time and than this number of ticks.
JUMP_US = 1_000_000
MOST_TICKS = 10_000

Kernel = Callable[..., Any]
Step = tuple[int, Found, int, tuple[Events, ...]]
"""How far a stream has been matched: the time up to which it is known, the matches, the time of the
last event matched (-1 if none was), and events in no burst that have yet to be matched."""


class Follower:
    """Feeds events to a burst filter and a localiser in one compiled call."""

    def __init__(self, bursts: CausalBurstFilter, localiser: Localiser) -> None:
        bursts.make_room(CHUNK_EVENTS)
        self._bursts, self._run = bursts, localiser.run
        # the last kernel, all state that it was bound to, and its code with this state
        self._bound: tuple[Kernel | None, tuple[BoxedState, ...], Kernel] = None, (), follow_kept

    def bound(self, kernel: Kernel, sample: object, *decoder: BoxedState) -> Kernel:
        """Return a kernel of one argument: `follow_kept`, or one that decodes and calls it.

        Parameters
        ----------
        kernel : callable
            Its arguments are the boxes for `follow_kept`, those of the decoder, and one more.
        sample : object
            Of the type of this one.
        decoder : BoxedState
            State of the decoder.
        """
        parts = self._bursts.box.boxed, self._run.boxed, *decoder
        known, its_parts, code = self._bound
        if kernel is not known or parts != its_parts:
            code = partial(entry(kernel, *parts, sample), *parts)
            self._bound = kernel, parts, code
        return code

    def follow(self, events: Events, reached_us: int) -> Step:
        """Match the next events, with which the stream has reached `reached_us`."""
        if not 0 < events.size <= CHUNK_EVENTS:
            return reached_us, [], -1, (self._bursts.update(events),)
        if not events.flags.carray:
            events = events.copy()
        return self.go_on(events, reached_us, *self.bound(follow_kept, events)(events))

    def go_on(self, events: Events, reached_us: int, kept: int, stop: Stop) -> Step:
        """Do what remains to do after `follow_kept` with `events`."""
        if stop[1] == REFUSED:
            return reached_us, [], -1, (self._bursts.kept(events, kept),)
        return reached_us, self._run.go_on(stop), int(stop[2]), ()


@kernel
def follow_kept(bursts, followed, events):  # type: ignore[no-untyped-def]
    """Remove bursts, and process the other events unless their times jump.

    Parameters
    ----------
    bursts, followed : BoxedState
        Of a `CausalBurstFilter` and of a `Localiser`.
    events : ndarray of EVENT_DTYPE, shape (n,)
        0 to `CHUNK_EVENTS`.

    Returns
    -------
    kept : int
        Events that are in no burst.
    stop : tuple
        See `follow`.
    """
    n = keep(bursts, events)
    kept = bursts.value[-1][:n]
    if n == 0:
        return n, (0, DONE, np.int64(-1))
    c, last = OnlineState(*followed.value).control[0], kept[n - 1]["t"]
    if c.interval > 0 and last - c.floor > MOST_TICKS * c.interval:
        return n, (0, REFUSED, last)
    return n, follow(followed, kept, GO_ON)


# The part of a map that a saved localiser needs.


def map_arrays(reference: MapRecord) -> Arrays:
    """Return the arrays of a map that `searched_map` needs, without the places, for an archive."""
    arrays = present(
        pixel_x=reference.pixel_map.x,
        pixel_y=reference.pixel_map.y,
        full_scale=reference.full_scale,
        mean=reference.mean,
        jumps=reference.jumps,
    )
    if reference.confidence is not None:
        arrays |= reference.confidence.to_arrays()
    if reference.settings.matching == "filter":
        arrays |= present(activity=reference.places.activity, odometer_mm=reference.along_mm)
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
        full_scale=arrays.get("full_scale"),
        mean=arrays.get("mean"),
        confidence=Confidence.from_arrays(arrays),
        jumps=arrays.get("jumps"),
        odometer_mm=arrays.get("odometer_mm"),
    )


# Checks of a saved state of a localiser, before kernels use it as indices.


#: Largest number of counters of all windows of a sequence: 128 MB in the kernels.
MAX_COUNTERS = 1 << 24
#: Largest number of windows x places x counters: minutes of work at the start.
MAX_COMPARISONS = 1 << 36


def check_extent(places: int, counters: int, length: int, recent: int, window: Window) -> None:
    """Refuse sizes that would overflow the kernels' integers, or take too much memory or time.

    Parameters
    ----------
    places, counters, length, recent : int
        K, J (or 2 J), L, and the newest places that are left out.

    Raises
    ------
    UsageError
        If the map is shorter than a sequence, or one of the above is too large.
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


def check_state(
    arrays: Arrays,
    meta: Mapping[str, Any],
    *,
    counters: int,
    length: int,
    ends: int,
    window: Window,
    every: MatchSchedule,
    filtered: bool,
) -> tuple[int, int]:
    """Check that the arrays are a possible state of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``slot`` and ``time`` of the events in the windows, ``bound``; of sequences ``policy``.
    meta : mapping
        With ``now_us`` and ``floor_us``.
    counters, length, ends : int
        J (or 2 J), L, and the number of places that a sequence can end at.
    filtered : bool
        Whether the place filter matches, and not sequences.

    Returns
    -------
    now_us, floor_us : int
        T: all events before it have been taken; and the time that no event may be earlier than.

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    floor_us = whole_number(meta, "floor_us", 0, TIME_LIMIT_US)
    now_us = whole_number(meta, "now_us", floor_us, floor_us + 1)
    check_array(arrays["slot"], "slot", (np.int32,), (None,))
    n = arrays["slot"].size
    check_range(arrays["slot"], "slot", 0, counters - 1)
    check_array(arrays["time"], "time", (np.int64,), (n,))
    check_range(arrays["time"], "time", 0, min(floor_us, now_us - 1))
    if (np.diff(arrays["time"]) < 0).any():
        raise MapError("time of the events in the windows runs backwards: expected sorted times")
    check_array(arrays["bound"], "bound", (np.int64,), (length + 1,))
    check_range(arrays["bound"], "bound", 0, TIME_LIMIT_US)
    bound = arrays["bound"]
    expected = _bounds(arrays, window, length, now_us)
    if not np.array_equal(bound, expected) or bound[0] - bound[-1] != n:
        raise MapError(
            f"bound is {bound.tolist()} and the {n} events in the windows make it "
            f"{expected.tolist()}"
        )
    if not filtered:  # the place filter has a schedule of its own
        _check_schedule(arrays, "policy", ends, every, floor_us)
    return now_us, floor_us


def _bounds(arrays: Arrays, window: Window, length: int, now_us: int) -> npt.NDArray[np.int64]:
    """Return the number of the event with which each lag begins, shape (L + 1,)."""
    last, n = int(arrays["bound"][0]), arrays["slot"].size
    lags = np.arange(length + 1, dtype=np.int64)
    if isinstance(window, FixedTime):
        return last - n + np.searchsorted(arrays["time"], now_us - lags * window.tau_us)
    return np.maximum(last - lags * window.events, 0)


def check_filter_state(
    arrays: Arrays, places: int, window: Window, every: MatchSchedule, floor_us: int
) -> None:
    """Check that the arrays are a possible state of the place filter of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Of `FilterRun.to_arrays`.
    places : int
        K.
    floor_us : int
        Until when time has passed.

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    check_array(arrays["filter_metric"], "filter_metric", (np.int32,), (places,))
    check_range(arrays["filter_metric"], "filter_metric", 0, METRIC_TOP)
    reciprocal, mean_activity, place, support, *residuals, lasting, windows = filter_state(arrays)
    ended = floor_us // window.tau_us if isinstance(window, FixedTime) else (
        int(arrays["bound"][0]) // window.events
    )  # fmt: skip
    within = (
        0 <= reciprocal <= 1 << RECIPROCAL_BITS
        and 0 <= mean_activity <= TIME_LIMIT_US
        and (0 <= place < places if windows else place == -1)
        and 0 <= support <= TRUST_TOP
        and 0 <= min(residuals) <= max(residuals) <= RESIDUAL_TOP
        and abs(lasting) <= 2 * RESIDUAL_TOP << (TRUST_BITS + LASTING_BITS)
    )
    if not within or windows != ended:
        raise MapError(
            f"filter_state holds {arrays['filter_state'].tolist()} for {places} places after "
            f"{ended} windows: save the state again"
        )
    _check_schedule(arrays, "filter_schedule", places, every, floor_us)
    if "filter_odometer" in arrays:
        check_array(arrays["filter_odometer"], "filter_odometer", (np.int64,), (4,))
        check_range(arrays["filter_odometer"][:2], "filter_odometer", -MOST_MM, MOST_MM)
        check_range(arrays["filter_odometer"][2:], "filter_odometer", 0, 1)
    if "filter_mean" in arrays:
        check_array(arrays["filter_mean_windows"], "filter_mean_windows", (np.int64,), (1,))
        check_range(arrays["filter_mean_windows"], "filter_mean_windows", 0, max(windows, 0))


def _check_schedule(
    arrays: Arrays, name: str, places: int, every: MatchSchedule, floor_us: int
) -> None:
    check_array(arrays[name], name, (np.int64,), (2,))
    tick, place = arrays[name].tolist()
    interval = every.interval_us
    if tick != ((floor_us // interval + 1) * interval if interval else 0):
        raise MapError(f"the state says the next time for a match is {tick} us, at {floor_us} us")
    if not -1 <= place < places:
        raise MapError(f"the state names the place {place}: expected -1 to {places - 1}")
