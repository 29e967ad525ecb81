"""The place filter event by event: between two window ends, and at each of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.array_checks import check_array, check_range
from edge_vpr.descriptors.pauses import mean_activity
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.place_filter import PlaceFilter
from edge_vpr.matching.step_prices import StepPrices
from edge_vpr.odometry import Odometer
from edge_vpr.online.filter_kernel import CONTROL, Predicted, follow_filtered
from edge_vpr.online.kernel import DONE, RING_FULL
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import Sliding, grown
from edge_vpr.online.state_distances import compared
from edge_vpr.online.state_kernels import advance, settle
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.own_mean import RunningMean

_MATCHES_AT_ONCE = 4_096


class FilterRun:
    """Feeds events to the place filter, window by window, and matches in between.

    Parameters
    ----------
    reference : ReferenceMap
    schedule : MatchSchedule
        When to give a match.

    Attributes
    ----------
    place_filter : PlaceFilter
    mean : RunningMean or None
        Of own-mean codes.
    odometer : Odometer
    """

    def __init__(self, reference: ReferenceMap, schedule: MatchSchedule) -> None:
        settings = reference.settings
        self.place_filter = PlaceFilter(
            len(reference), StepPrices.of(settings), settings.exclusion,
            mean_activity(reference.places.activity),
            jumps=reference.jumps, along_mm=reference.along_mm,
        )  # fmt: skip
        self.odometer = Odometer()
        self._code = reference.own_mean_code
        self.mean = None
        if self._code is not None and reference.mean is not None:
            self.mean = RunningMean(reference.mean)
        self._index = ReferenceIndex(reference.places.counts)
        self._control = np.zeros(1, dtype=CONTROL).view(np.recarray)
        control = self._control[0]
        control.every, control.interval = schedule.events, schedule.interval_us
        control.change = schedule.change
        control.next_tick, control.place_told = schedule.interval_us, -1
        control.exclusion = settings.exclusion
        self._out = np.empty((_MATCHES_AT_ONCE, 8), dtype=np.int64)
        self._windows = 0  # finished

    @property
    def next_tick(self) -> int:
        """Time of the next match that the schedule's interval asks for, in microseconds."""
        return int(self._control[0].next_tick)

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._control[0].next_tick = time_us

    def prepared(self, s: Sliding) -> Sliding:
        """Return the state with the codes of the present means, compared with the map."""
        if self.mean is None or self._code is None:
            return s
        tables = self._code.tables(self.mean.mean)
        s.counters["table"] = np.arange(len(tables))
        s = s._replace(code=tables)
        return compared(s, self._index)

    def read_odometer(self, distance_mm: int) -> None:
        """Take a reading; until the window is over, places are predicted by the way since.

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

    def run(
        self,
        s: Sliding,
        slots: npt.NDArray[np.int32],
        times: npt.NDArray[np.int64],
        until: int,
    ) -> tuple[Sliding, list[npt.NDArray[np.int64]]]:
        """Feed selected events, then let time pass to `until`.

        Parameters
        ----------
        s : Sliding
            Of one window.
        slots : ndarray of int32, shape (m,)
        times : ndarray of int64, shape (m,)
        until : int

        Returns
        -------
        s : Sliding
        rows : list of ndarray of int64, shape (n, 8)
            The integers of MATCH_DTYPE.
        """
        rows: list[npt.NDArray[np.int64]] = []
        begin = 0
        while True:
            if s.tau:
                end = (self._windows + 1) * s.tau
                stop = begin + int(np.searchsorted(times[begin:], end))
                ends = end <= until
                piece_until = min(end, until)
            else:
                stop = min(times.size, begin + int((self._windows + 1) * s.n - s.bound[0]))
                ends = int(s.bound[0]) + stop - begin == (self._windows + 1) * s.n
                piece_until = int(times[stop - 1]) if ends else until
            s = self._piece(s, slots[begin:stop], times[begin:stop], piece_until, rows)
            begin = stop
            if not ends:
                return s, rows
            if s.tau:
                advance(s, piece_until)
            s = self._finish_window(s)
            if s.tau:
                event = int(times[begin]) if begin < times.size else until
                tick = self.next_tick if self._control[0].interval else event
                self._skip_silence(s, min(event, tick))

    def _piece(
        self,
        s: Sliding,
        slots: npt.NDArray[np.int32],
        times: npt.NDArray[np.int64],
        until: int,
        rows: list[npt.NDArray[np.int64]],
    ) -> Sliding:
        found = self.place_filter
        predicted = Predicted(
            found.prediction, found.paused, found.follows, np.empty_like(found.metric)
        )
        control = self._control[0]
        control.usual, control.reciprocal = found.activity.usual, found.reciprocal
        control.place, control.trust = found.place, found.trust
        consumed = 0
        while True:
            read, given, why = follow_filtered(
                s, predicted, self._control, slots[consumed:], times[consumed:], until, self._out
            )
            consumed += read
            rows.append(self._out[:given].copy())
            if why == RING_FULL:
                s = grown(s)
            elif why == DONE:
                return s

    def _finish_window(self, s: Sliding) -> Sliding:
        settle(s)
        self._windows += 1
        counts, found = s.counts[0], self.place_filter
        events = int(counts.sum())
        paused = found.activity.pauses(events)
        # what all distances have in common changes neither the evidence nor its spread
        found.advance(s.sums[: len(found)], events)
        self.odometer.end_window()
        if self.mean is None or self._code is None or paused:
            return s
        self.mean.update(self._code.level(counts))
        return self.prepared(s)

    def _skip_silence(self, s: Sliding, until: int) -> None:
        """Pass over windows without events, up to `until`, once they change nothing any more."""
        found = self.place_filter
        while s.bound[0] == s.bound[1] and (self._windows + 2) * s.tau <= until:
            read = self.odometer.fresh
            before = (found.place, found.trust, found.activity.usual)
            metric = found.metric
            self._finish_window(s)
            same = before == (found.place, found.trust, found.activity.usual)
            if same and not read and np.array_equal(metric, found.metric):
                self._windows = until // s.tau - 1

    def to_arrays(self) -> Arrays:
        """Return what `resume` needs, as arrays of an archive."""
        found = self.place_filter
        arrays: Arrays = {
            "filter_metric": found.metric,
            "filter_state": np.array(
                [found.reciprocal, found.activity.usual, found.place, found.trust, self._windows],
                dtype=np.int64,
            ),
            "filter_schedule": np.array(
                [self._control[0].next_tick, self._control[0].place_told], dtype=np.int64
            ),
        }
        meter = self.odometer
        if meter.fresh or meter.anchored:
            state = [meter.latest, meter.anchor, meter.fresh, meter.anchored]
            arrays["filter_odometer"] = np.array(state, dtype=np.int64)
        if self.mean is not None:
            arrays["filter_mean"] = self.mean.total
            arrays["filter_mean_windows"] = np.array([self.mean.windows], dtype=np.int64)
        return arrays

    def resume(self, arrays: Arrays) -> None:
        """Take up what `to_arrays` gave."""
        found = self.place_filter
        reciprocal, usual, place, trust, self._windows = arrays["filter_state"].tolist()
        found.resume(arrays["filter_metric"], reciprocal, usual, place, trust)
        self._control[0].next_tick, self._control[0].place_told = arrays["filter_schedule"].tolist()
        if "filter_odometer" in arrays:
            found.moves.check_odometry()
            meter = self.odometer
            meter.latest, meter.anchor, fresh, anchored = arrays["filter_odometer"].tolist()
            meter.fresh, meter.anchored = bool(fresh), bool(anchored)
            self._travel()
        if self.mean is not None:
            check_array(arrays["filter_mean"], "filter_mean", (np.int32,), self.mean.total.shape)
            check_range(arrays["filter_mean"], "filter_mean", 0, np.iinfo(np.int32).max)
            self.mean.total = arrays["filter_mean"].copy()
            self.mean.windows = int(arrays["filter_mean_windows"][0])
