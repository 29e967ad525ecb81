"""A match after every event: distances are changed by what the event changes, not recomputed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays, damaged, read_archive, write_archive
from edge_vpr.confidence import Confidence, Judge
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedTime, narrow
from edge_vpr.errors import EdgeVprError, EventError, MapError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events, Sensor
from edge_vpr.map_checks import check_map
from edge_vpr.matching.matches import check_no_ways
from edge_vpr.odometry import MOST_MM
from edge_vpr.online.filter_run import FilterRun
from edge_vpr.online.kernel import DONE, NEXT_TICK, RING_FULL, follow
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_window import selected_in_order
from edge_vpr.online.state import (
    BASE,
    advance,
    grown,
    recount,
    settle,
    start,
    with_distances,
)
from edge_vpr.online.state_checks import check_extent, check_filter_state, check_state
from edge_vpr.pipeline import window_of
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

#: One match: time in microseconds; best place (ties: the lowest) and the best one outside the
#: exclusion zone (-1: none); their distances, summed over the L windows of the sequence; best over
#: second; events at the selected pixels in the newest window, and its start; trust, higher is
#: surer (of the place filter as `place_filter.FilterMatch` has it, of sequences the margin);
#: probability of being right (NaN: not known), and whether the match is lost at the precision that
#: the settings want. The place filter has metrics in place of distances, and windows in place of
#: sequences.
MATCH_DTYPE = np.dtype(
    [
        ("t", "<i8"),
        ("place", "<i8"),
        ("distance_sum", "<i8"),
        ("second", "<i8"),
        ("second_sum", "<i8"),
        ("ratio", "<f8"),
        ("events", "<i8"),
        ("start", "<i8"),
        ("trust", "<i8"),
        ("probability", "<f8"),
        ("lost", "?"),
    ]
)
KIND = "localiser state"

_MATCHES_AT_ONCE = 4_096
_NO_MATCHES = np.empty(0, dtype=MATCH_DTYPE)


class Localiser:
    """Follows a stream of events and says where it is on the map.

    It keeps the counters of the newest L windows, one behind the other (`edge_vpr.online.state`),
    and the distance of that sequence to every place. An event changes each distance by a few times
    +-1, so that the best place is known after it without a new comparison.

    Parameters
    ----------
    reference : ReferenceMap
        Its settings say the window, the sequence length, the exclusion zone, and the code of
        its counts.
    every : MatchSchedule
        When to give a match. None is given before the L windows are complete.
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
        If the map is shorter than a sequence, or the sequence too long to be followed.

    Examples
    --------
    >>> localiser = Localiser(reference, every=MatchSchedule(events=1))       # doctest: +SKIP
    >>> for events in recording:                                      # doctest: +SKIP
    ...     for match in localiser.update(events):
    ...         print(match["t"], match["place"], match["ratio"])
    """

    def __init__(
        self,
        reference: ReferenceMap,
        *,
        every: MatchSchedule | None = None,
        recent: int = 0,
        check_every: int = 0,
    ) -> None:
        if reference.settings.smooth:  # which takes later windows
            reference = reference.matched_with(replace(reference.settings, smooth=False))
        settings = reference.settings
        self.settings = settings
        self.every = MatchSchedule(events=1) if every is None else every
        self._recent = recent
        self._check_every = check_every
        self._pixel_map = reference.pixel_map
        self._table = reference.pixel_map.table()
        self._window = window_of(settings)
        self._length = settings.windows_per_match
        self._full_scale = reference.full_scale
        self._codes = None if reference.own_mean_code is not None else reference.codes
        self._mean, self._activity = reference.mean, reference.places.activity
        self._places = reference.places.counts
        self._confidence, self._judge = reference.confidence, reference.judge
        check_map(
            settings, reference.pixel_map, reference.places, reference.saliency, reference.hot,
            reference.full_scale, reference.mean, reference.route, reference.jumps,
            reference.odometer_mm,
        )  # fmt: skip
        self._jumps, self._along = reference.jumps, reference.along_mm
        places, counters = self._places.shape
        check_extent(places, counters, self._length, recent, self._window)
        self._policy = np.array([self.every.interval_us, -1], dtype=np.int64)
        self._now = 0  # T: all events before it have been taken
        self._floor = 0  # no event may be earlier
        self._s = start(self._places, self._window, self._length, self._codes)
        self._filter = None
        if settings.matching == "filter":
            if recent:
                raise UsageError(
                    f"{recent} recent places are left out by sequences only: set matching to "
                    "sequence"
                )
            self._filter = FilterRun(reference, self.every)
            self._s = self._filter.prepared(self._s)
        else:
            check_no_ways(reference.jumps, odometry=False)
        self._out = np.empty((_MATCHES_AT_ONCE, 7), dtype=np.int64)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Events in each window, newest first, shape (L, J); a copy."""
        self._settle()
        return self._s.counts.copy()

    @property
    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Distance of the sequence that ends at each place, shape (K - L + 1,).

        Element m belongs to place m + L - 1.
        """
        self._settle()
        sums = self._s.sums[: len(self._places) - self._length + 1].astype(np.int64)
        return sums + self._s.number[BASE]

    @property
    def map_bytes(self) -> int:
        """Size of the map as it is searched: every place, laid out by pixel."""
        return self._s.columns.nbytes

    @property
    def complete(self) -> bool:
        """Whether the L windows are complete, so that matches are given."""
        seen, whole = self._seen_and_whole()
        return seen >= whole

    @property
    def filled(self) -> float:
        """Share of the L windows that has been seen, 0 to 1."""
        seen, whole = self._seen_and_whole()
        return min(1.0, seen / whole)

    @property
    def _next_tick(self) -> int:
        return int(self._policy[NEXT_TICK]) if self._filter is None else self._filter.next_tick

    @property
    def next_match_us(self) -> int:
        """Time before which there is no match, where they are given by time alone; else 0."""
        return 0 if self.every.events else self._next_tick

    def _seen_and_whole(self) -> tuple[int, int]:
        if isinstance(self._window, FixedTime):
            return self._now, self._length * self._window.tau_us
        return int(self._s.bound[0]), self._length * self._window.events

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
        if events.size == 0:
            return _NO_MATCHES
        last = int(events["t"][-1])
        slots, times = selected_in_order(self._table, events, self._floor, self.settings.polarity)
        self.every.check_ticks(self._next_tick, last)
        matches = self._run(slots, times, last)
        self._floor, self._now = last, last + 1
        return matches

    def advance(self, until_us: int) -> npt.NDArray[np.void]:
        """Let time pass without events, to T = `until_us`; the ticks until then give matches.

        Parameters
        ----------
        until_us : int
            Not earlier than the last event.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
        """
        if until_us < self._floor:
            raise EventError(
                f"time runs backwards, from {self._floor} to {until_us} us: name a later time"
            )
        if until_us > TIME_LIMIT_US:
            raise EventError(
                f"time {until_us} us lies beyond {TIME_LIMIT_US}: check the clock's unit"
            )
        self.every.check_ticks(self._next_tick, until_us)
        nothing = np.empty(0, dtype=np.int64)
        matches = self._run(nothing.astype(np.int32), nothing, until_us)
        self._floor, self._now = until_us, max(self._now, until_us)
        return matches

    def read_odometer(self, time_us: int, distance_m: float) -> npt.NDArray[np.void]:
        """Let time pass to `time_us` and take a reading of the robot's odometer.

        The way since the window before then prices the steps from place to place. Give one reading
        or more in each window, better ten; a window without one is priced by the settings.

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
        if self._filter is None:
            check_no_ways(None, odometry=True)
            return _NO_MATCHES
        if not abs(distance_m) * 1e3 <= MOST_MM:
            raise UsageError(f"odometer at {distance_m} m: expected at most {MOST_MM // 1000} m")
        self._filter.place_filter.moves.check_odometry()
        matches = self.advance(time_us)
        self._filter.read_odometer(round(distance_m * 1e3))
        return matches

    def skip_ticks(self, until_us: int) -> None:
        """Leave out the ticks of the policy before `until_us`, but for the last of them.

        Parameters
        ----------
        until_us : int
            Time that `update` or `advance` reaches next.
        """
        interval = self.every.interval_us
        if interval:
            last = max(self._next_tick, until_us // interval * interval)
            if self._filter is None:
                self._policy[NEXT_TICK] = last
            else:
                self._filter.next_tick = last

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
        if counts.shape != self._places.shape[1:] or counts.dtype.kind not in "iu":
            raise MapError(
                f"descriptor of {counts.dtype} and shape {counts.shape}: expected "
                f"{self._places.shape[1]} whole numbers, as `DescriptorStream` gives them"
            )
        most = np.iinfo(np.int32).max if self._codes is None else int(self._codes.tables.max())
        if counts.min() < 0 or counts.max() > most:
            raise MapError(
                f"descriptor holds {counts.min()} to {counts.max()}: expected 0 to {most}, in "
                "codes where the map has a code"
            )
        if self._filter is not None:
            raise UsageError("places are added while matching by sequences only: map the drive")
        wide = np.promote_types(self._places.dtype, narrow(counts).dtype)
        self._places = np.concatenate([self._places.astype(wide), counts[None].astype(wide)])
        self._settle()
        self._s = with_distances(self._s, self._places)
        return len(self._places) - 1

    def save(self, path: str | Path) -> None:
        """Write the map and the state, so that `load` goes on as this localiser would.

        Parameters
        ----------
        path : path
            An ``.npz`` file, written atomically.
        """
        self._settle()
        first, last = int(self._s.bound[-1]), int(self._s.bound[0])
        alive = np.arange(first, last) & (self._s.slot.size - 1)
        arrays = {
            "pixel_x": self._pixel_map.x,
            "pixel_y": self._pixel_map.y,
            "places": self._places,
            "slot": self._s.slot[alive],
            "time": self._s.time[alive],
            "bound": self._s.bound,
            "policy": self._policy,
        }
        if self._full_scale is not None:
            arrays["full_scale"] = self._full_scale
        if self._mean is not None:
            arrays["mean"] = self._mean
        if self._jumps is not None:
            arrays["jumps"] = self._jumps
        if self._along is not None and self._filter is not None:
            arrays["odometer_mm"] = self._along
        if self._confidence is not None:
            arrays |= self._confidence.to_arrays()
        if self._filter is not None:
            arrays["activity"] = self._activity
            arrays |= self._filter.to_arrays()
        meta = {
            "sensor": list(self._pixel_map.sensor),
            "settings": self.settings.to_dict(),
            "every": asdict(self.every),
            "recent": self._recent,
            "now_us": self._now,
            "floor_us": self._floor,
        }
        write_archive(path, KIND, arrays, meta)

    @classmethod
    def load(cls, path: str | Path, *, check_every: int = 0) -> Localiser:
        """Read what `save` wrote, and go on from there.

        Raises
        ------
        MapError
            If the file is missing, unreadable, or from a newer version.
        """
        arrays, meta = read_archive(path, KIND)
        with damaged(path, "save the state again"):
            found = cls(
                _bare_map(arrays, meta),
                every=MatchSchedule(**meta["every"]),
                recent=meta["recent"],
                check_every=check_every,
            )
            found._resume(arrays, meta)
        return found

    def _resume(self, arrays: Arrays, meta: Mapping[str, Any]) -> None:
        clock = check_state(
            arrays,
            meta,
            counters=self._places.shape[1],
            length=self._length,
            ends=len(self._places) - self._length + 1,
            window=self._window,
            every=self.every,
            filtered=self._filter is not None,
        )
        bound = arrays["bound"]
        first = int(bound[-1])
        while self._s.slot.size < arrays["slot"].size:
            self._s = grown(self._s)
        at = np.arange(first, first + arrays["slot"].size) & (self._s.slot.size - 1)
        self._s.slot[at] = arrays["slot"]
        self._s.time[at] = arrays["time"]
        self._s.bound[:] = bound
        self._s.counts[:] = recount(self._s)
        self._policy[:] = arrays["policy"]
        if self._filter is not None:
            check_filter_state(arrays, len(self._places), self._window, self.every, clock.floor_us)
            self._filter.resume(arrays)
            self._s = self._filter.prepared(self._s)
        self._s = with_distances(self._s, self._places)
        self._now, self._floor = clock.now_us, clock.floor_us

    def _settle(self) -> None:
        """Bring windows, counters and distances up to date; an update leaves that to the next."""
        advance(self._s, self._now)
        settle(self._s)

    def _run(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> npt.NDArray[np.void]:
        """Feed selected events, then the ticks up to `until`, in pieces that fit the buffers."""
        found = []
        step = self._check_every or max(slots.size, 1)
        for begin in range(0, max(slots.size, 1), step):
            stop = min(begin + step, slots.size)
            last = stop == slots.size
            found += self._run_piece(
                slots[begin:stop], times[begin:stop], until if last else int(times[stop - 1])
            )
            if self._check_every:
                self.verify()
        if not found:
            return _NO_MATCHES
        return np.concatenate(found) if len(found) > 1 else found[0]

    def _run_piece(
        self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int
    ) -> list[npt.NDArray[np.void]]:
        if self._filter is not None:
            self._s, rows = self._filter.run(self._s, slots, times, until)
            return [_matches(row, self._judge) for row in rows]
        found, consumed = [], 0
        while True:
            read, given, why = follow(
                self._s,
                slots[consumed:],
                times[consumed:],
                until,
                self.every.events,
                self.every.interval_us,
                self.every.change,
                self.settings.exclusion,
                len(self._places) - self._length + 1 - self._recent,
                self._policy,
                self._out,
            )
            consumed += read
            if given:
                found.append(_matches(self._out[:given], self._judge))
            if why == RING_FULL:
                self._s = grown(self._s)
            elif why == DONE:
                return found

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        self._settle()
        fresh = with_distances(self._s, self._places)
        same = (
            np.array_equal(recount(self._s), self._s.counts)
            and np.array_equal(fresh.sums[: fresh.shape[1]], self._s.sums[: fresh.shape[1]])
            and fresh.number[BASE] == self._s.number[BASE]
        )
        if not same:
            raise EdgeVprError(
                f"counters or distances have drifted by {self._now} us: this is a fault of "
                "edge-vpr, report it with the recording"
            )


def _bare_map(arrays: Arrays, meta: Mapping[str, Any]) -> ReferenceMap:
    """Build a map of what a localiser needs of it, without times and figures."""
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
        full_scale=arrays.get("full_scale"),
        mean=arrays.get("mean"),
        confidence=Confidence.from_arrays(arrays),
        jumps=arrays.get("jumps"),
        odometer_mm=arrays.get("odometer_mm"),
    )


def _matches(rows: npt.NDArray[np.int64], judge: Judge) -> npt.NDArray[np.void]:
    """Name the columns of the kernel's rows, and add what follows from them."""
    matches = np.empty(len(rows), dtype=MATCH_DTYPE)
    derived = ("ratio", "trust", "probability", "lost")
    names = [name for name in MATCH_DTYPE.names or () if name not in derived]
    if rows.shape[1] > len(names):
        names.append("trust")
    for name, column in zip(names, rows.T, strict=True):
        matches[name] = column
    best, second = matches["distance_sum"], matches["second_sum"]
    if "trust" not in names:
        matches["trust"] = np.where(matches["second"] < 0, 0, second - best)
    matches["probability"], matches["lost"] = judge.judge(matches["trust"])
    matches["ratio"] = np.nan
    matches["ratio"][second == 0] = 1.0
    np.divide(best, second, out=matches["ratio"], where=second > 0)
    return matches
