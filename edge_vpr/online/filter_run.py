"""The place filter event by event: within windows, and at the end of each window."""

from __future__ import annotations

import numpy as np

from edge_vpr.archive import Arrays
from edge_vpr.array_checks import check_array, check_range
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive_matching import filter_of
from edge_vpr.matching.filter_recursion import WindowRows
from edge_vpr.odometry import Odometer
from edge_vpr.online.followed import Followed
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.match_run import MatchRun
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state_distances import compared
from edge_vpr.online.state_kernels import write_codes
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.own_mean import RunningMean


class FilterRun(MatchRun):
    """Feeds events to the place filter, and gives matches within windows too.

    Parameters
    ----------
    reference : ReferenceMap
    windows : FollowedWindows
        Of this map, and one window long.
    schedule : MatchSchedule
        When to give a match.

    Attributes
    ----------
    place_filter : PlaceFilter
    mean : RunningMean or None
        Of own-mean codes.
    odometer : Odometer
    """

    schedule_name = "filter_schedule"

    def __init__(
        self, reference: ReferenceMap, windows: FollowedWindows, schedule: MatchSchedule
    ) -> None:
        super().__init__(windows, Followed.begin(reference, windows.s, schedule))
        self.place_filter = filter_of(
            reference.places, reference.settings, reference.jumps, reference.along_mm
        )
        self.odometer = Odometer()
        self._code = reference.own_mean_code
        self.mean = None
        if self._code is not None and reference.mean is not None:
            self.mean = RunningMean(reference.mean)
        self._index = ReferenceIndex(reference.places.counts)
        self._windows = 0  # finished
        self._predict()

    def prepare(self) -> None:
        """Code the counters with the present means, and compare them with the map."""
        if self.mean is None or self._code is None:
            return
        levels, mean, s = self._code.levels, self.mean.mean, self.windows.s
        if s.code.shape != (mean.size, levels.size):
            s.counters["table"] = np.arange(mean.size)
            s = s._replace(code=np.empty((mean.size, levels.size), dtype=np.uint16))
            self.windows.s = s
        write_codes(levels, mean, self._code.bits, s.code)
        compared(s, self._index)

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading; until the window ends, places are predicted by the distance driven.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        self.place_filter.moves.check_odometry()
        self.odometer.read(distance_mm)
        self._travel()

    def _travel(self) -> None:
        travelled = self.odometer.travelled_mm
        if travelled is not None:
            self.place_filter.travel(travelled)
            self._predict()

    def _predict(self) -> None:
        """Copy the state of the filter to the kernel, after each change."""
        found, control, predicted = self.place_filter, self._control, self._followed.predicted
        predicted.moving[:], predicted.quiet[:] = found.prediction, found.quiet
        predicted.follows[:] = found.follows
        control.usual, control.reciprocal = found.activity.usual, found.reciprocal
        control.place, control.trust = found.place, found.trust
        s = self.windows.s
        control.window_end = (self._windows + 1) * (s.tau or s.n)

    def _end_window(self, next_us: int) -> None:
        self._finish_window()
        if self.windows.s.tau:
            tick = self.next_tick if self._control.interval else next_us
            self._skip_silence(min(next_us, tick))
        self._predict()

    def _finish_window(self) -> None:
        s, found = self.windows.s, self.place_filter
        self._windows += 1
        counts = s.counts[0]
        events = int(counts.sum())
        paused = found.activity.pauses(events)
        # the common part of all distances changes neither the evidence nor its spread
        distances = s.sums[np.newaxis, : len(found)]
        self._ended(found.advance_windows(distances, np.array([events], dtype=np.int64)))
        self.odometer.end_window()
        if self.mean is not None and self._code is not None and not paused:
            self.mean.update(self._code.level(counts))
            self.prepare()

    def _ended(self, rows: WindowRows) -> None:
        """Take the results of a window that has ended."""

    def _skip_silence(self, until: int) -> None:
        """Skip windows without events up to `until`, as soon as they change nothing any more."""
        found, s = self.place_filter, self.windows.s
        while s.bound[0] == s.bound[1] and (self._windows + 2) * s.tau <= until:
            read = self.odometer.fresh
            before = (found.place, found.trust, found.activity.usual)
            metric = found.metric
            self._finish_window()
            same = before == (found.place, found.trust, found.activity.usual)
            if same and not read and np.array_equal(metric, found.metric):
                self._windows = until // s.tau - 1

    def to_arrays(self) -> Arrays:
        """Return the arrays that `resume` needs, for an archive."""
        found, meter = self.place_filter, self.odometer
        state = [found.reciprocal, found.activity.usual, found.place, found.trust, self._windows]
        arrays = super().to_arrays() | {
            "filter_metric": found.metric,
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
        reciprocal, usual, place, trust, self._windows = arrays["filter_state"].tolist()
        found.resume(arrays["filter_metric"], reciprocal, usual, place, trust)
        if "filter_odometer" in arrays:
            found.moves.check_odometry()
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored = arrays["filter_odometer"].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self._travel()
        self._predict()
        if self.mean is not None:
            check_array(arrays["filter_mean"], "filter_mean", (np.int32,), self.mean.total.shape)
            check_range(arrays["filter_mean"], "filter_mean", 0, np.iinfo(np.int32).max)
            self.mean.total = arrays["filter_mean"].copy()
            self.mean.windows = int(arrays["filter_mean_windows"][0])
