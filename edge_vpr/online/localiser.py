"""The localiser: a match after every event, from distances that are updated, not recomputed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import damaged, read_archive, write_archive
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events
from edge_vpr.matching.drive_matching import check_no_ways
from edge_vpr.odometry import MOST_MM
from edge_vpr.online.localiser_state import NO_MATCHES, LocaliserState
from edge_vpr.online.match_records import MATCH_DTYPE
from edge_vpr.online.match_run import MatchRun
from edge_vpr.online.saved_map import searched_map
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sequence_run import SequenceRun
from edge_vpr.reference_map import ReferenceMap

__all__ = ["MATCH_DTYPE", "Localiser"]

KIND = "localiser state"


class Localiser:
    """Matches a stream of events with a map, event by event.

    It holds the counters of the newest L windows, one directly after the other
    (`edge_vpr.online.state`), and the distances of this sequence to all places. An event changes
    each distance by a few steps of +-1, so that the best place is known without a new comparison.

    Parameters
    ----------
    reference : ReferenceMap
        Its settings say the window, the sequence length, the exclusion zone, and the code of
        its counts.
    every : MatchSchedule
        When to give a match; by default after each event, or with a delay at the end of each
        window, which is the only schedule then. None is given before the L windows are complete.
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
        if reference.settings.smooth:  # which needs later windows
            reference = reference.matched_with(replace(reference.settings, smooth=False))
        self.settings = settings = reference.settings
        if every is None:
            every = MatchSchedule.window(settings) if settings.late else MatchSchedule(events=1)
        self.every = every
        self._state = LocaliserState(reference, self.every, recent, check_every)

    def __len__(self) -> int:
        return len(self._state.windows.places)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Counts of each window, newest first, shape (L, J); a copy."""
        return self._state.windows.counts_at(self._state.now)

    @property
    def distance_sums(self) -> npt.NDArray[np.int64]:
        """Distances of the sequences that end at each place, shape (K - L + 1,).

        Element m belongs to place m + L - 1.
        """
        return self._state.windows.sums_at(self._state.now)

    @property
    def map_bytes(self) -> int:
        """Size of the map in the form that is searched, in bytes."""
        return self._state.windows.s.columns.nbytes

    @property
    def complete(self) -> bool:
        """Whether the L windows and those of a delay are complete; there are no matches before."""
        seen, whole = self._state.seen_and_whole()
        return seen >= whole

    @property
    def filled(self) -> float:
        """Share of these windows that is complete, 0 to 1."""
        seen, whole = self._state.seen_and_whole()
        return min(1.0, seen / whole)

    @property
    def next_match_us(self) -> int:
        """Time before which there is no match, if matches are given by time only; else 0."""
        return 0 if self.every.events else self._state.run.next_tick

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
            return NO_MATCHES
        return self._state.take(events)

    @property
    def run(self) -> MatchRun:
        """What feeds its kernel, for kernels that decode events too."""
        return self._state.run

    @property
    def selected(self) -> int:
        """Events at the selected pixels so far."""
        return int(self._state.windows.s.bound[0])

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
        floor_us = self._state.run.floor_us
        if until_us < floor_us:
            raise EventError(
                f"time runs backwards, from {floor_us} to {until_us} us: name a later time"
            )
        if until_us > TIME_LIMIT_US:
            raise EventError(
                f"time {until_us} us lies beyond {TIME_LIMIT_US}: check the clock's unit"
            )
        return self._state.advance(until_us)

    def finish(self) -> npt.NDArray[np.void]:
        """Return the matches that a delay still holds, at the end of a drive.

        Returns
        -------
        ndarray of MATCH_DTYPE, shape (m,)
            Of the last windows, with fewer windows after them than the settings ask for; m is 0
            without a delay.
        """
        return self._state.finish()

    def read_odometer(self, time_us: int, distance_m: float) -> npt.NDArray[np.void]:
        """Advance the time to `time_us` and take a reading of the robot's odometer.

        The distance since the window before then decides the prices of moves. Give at least one
        reading in each window, better ten. A window without one uses the prices of the settings.

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
        run = self._state.run
        if isinstance(run, SequenceRun):
            check_no_ways(None, odometry=True)
            return NO_MATCHES
        if not abs(distance_m) * 1e3 <= MOST_MM:
            raise UsageError(f"odometer at {distance_m} m: expected at most {MOST_MM // 1000} m")
        run.place_filter.moves.check_odometry()
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
            run = self._state.run
            run.next_tick = max(run.next_tick, last)

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
        self._state.windows.append(counts, self._state.now)
        return len(self) - 1

    def save(self, path: str | Path) -> None:
        """Save the map and the state, so that `load` continues exactly from here.

        Parameters
        ----------
        path : path
            An ``.npz`` file, written atomically.
        """
        write_archive(path, KIND, *self._state.to_archive())

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
            found._state.resume(arrays, meta)
        return found

    def verify(self) -> None:
        """Recompute counters and distances from the events in the windows, and compare.

        Raises
        ------
        EdgeVprError
            If anything differs, which no sequence of events can bring about.
        """
        self._state.verify()
