"""Sequences event by event: the window sums of distances, and a match when the schedule asks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.online.kernel import CONTROL, DONE, RING_FULL, follow
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import Sliding, grown

_MATCHES_AT_ONCE = 4_096


class SequenceRun:
    """Feeds events to the sequence of the newest L windows.

    Parameters
    ----------
    schedule : MatchSchedule
        When to give a match.
    exclusion : int
        The second best place is looked for more than this many places from the best.
    recent : int
        So many of the newest places are not searched.
    """

    def __init__(self, schedule: MatchSchedule, exclusion: int, recent: int) -> None:
        self._recent = recent
        self._control = np.zeros(1, dtype=CONTROL).view(np.recarray)
        control = self._control[0]
        control.every, control.interval = schedule.events, schedule.interval_us
        control.change, control.exclusion = schedule.change, exclusion
        control.next_tick, control.place_told = schedule.interval_us, -1
        self._out = np.empty((_MATCHES_AT_ONCE, 7), dtype=np.int64)

    @property
    def next_tick(self) -> int:
        """Time of the next match that the schedule's interval asks for, in microseconds."""
        return int(self._control[0].next_tick)

    @next_tick.setter
    def next_tick(self, time_us: int) -> None:
        self._control[0].next_tick = time_us

    def prepared(self, s: Sliding) -> Sliding:
        """Return the state as it is: the codes of sequences do not change."""
        return s

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
        slots : ndarray of int32, shape (m,)
        times : ndarray of int64, shape (m,)
        until : int

        Returns
        -------
        s : Sliding
        rows : list of ndarray of int64, shape (n, 7)
            The integers of MATCH_DTYPE, in its order.
        """
        rows: list[npt.NDArray[np.int64]] = []
        self._control[0].places = s.totals["sums"][0] - self._recent
        consumed = 0
        while True:
            read, given, why = follow(
                s, self._control, slots[consumed:], times[consumed:], until, self._out
            )
            consumed += read
            if given:
                rows.append(self._out[:given].copy())
            if why == RING_FULL:
                s = grown(s)
            elif why == DONE:
                return s, rows

    def to_arrays(self) -> Arrays:
        """Return what `resume` needs, as arrays of an archive."""
        control = self._control[0]
        return {"policy": np.array([control.next_tick, control.place_told], dtype=np.int64)}

    def resume(self, arrays: Arrays) -> None:
        """Take up what `to_arrays` gave."""
        self._control[0].next_tick, self._control[0].place_told = arrays["policy"].tolist()
