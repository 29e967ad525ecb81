"""The place filter event by event, with matches that come some windows late."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.errors import MapError, UsageError
from edge_vpr.matching.filter_recursion import WindowRows
from edge_vpr.matching.smoothing import Decided, FixedLag
from edge_vpr.online.answers import judge
from edge_vpr.online.filter_run import FilterRun
from edge_vpr.online.followed_windows import FollowedWindows
from edge_vpr.online.kernel import Few
from edge_vpr.online.match_records import MATCH_DTYPE
from edge_vpr.online.match_run import Found
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap


class DelayedRun(FilterRun):
    """Gives the match of each window when N more windows have ended.

    The kernel gives a match at the end of each window. Its time and events are kept, and its place
    and trust are replaced by those of `FixedLag`.

    Parameters
    ----------
    reference : ReferenceMap
        Its settings say N.
    windows : FollowedWindows
    schedule : MatchSchedule
        At the end of each window.

    Raises
    ------
    UsageError
        If matches are wanted at other times.
    """

    def __init__(
        self, reference: ReferenceMap, windows: FollowedWindows, schedule: MatchSchedule
    ) -> None:
        settings = reference.settings
        if schedule != MatchSchedule.window(settings):
            raise UsageError(
                f"a delay of {settings.delay} windows gives a match at the end of each window: "
                "match every window, or set delay to 0"
            )
        super().__init__(reference, windows, schedule)
        self._lag = FixedLag(self.place_filter.moves, settings.exclusion, settings.late)
        self._given: np.void | None = None  # by the kernel, of the window that ends
        self._undecided: deque[np.void | None] = deque()  # None of a window that was skipped
        self._decided: list[np.void] = []

    def feed(self, slots: npt.NDArray[np.int32], times: npt.NDArray[np.int64], until: int) -> Found:
        """See `MatchRun.feed`."""
        super().feed(slots, times, until)
        return self._drained()

    def go_on(self, result: Few) -> Found:
        """See `MatchRun.go_on`."""
        super().go_on(result)
        return self._drained()

    def finish(self) -> Found:
        """See `MatchRun.finish`."""
        for decided in self._lag.finish():
            self._replace(decided)
        return self._drained()

    def _taken(self, given: int) -> npt.NDArray[np.void]:
        rows = super()._taken(given)
        (self._given,) = rows
        return rows[:0]

    def _ended(self, rows: WindowRows) -> None:
        self._undecided.append(self._given)
        self._given = None
        decided = self._lag.add(rows, self.odometer.travelled_mm)
        if decided is not None:
            self._replace(decided)

    def _replace(self, decided: Decided) -> None:
        row, match = self._undecided.popleft(), decided.match
        if row is None:
            return
        row["place"], row["distance_sum"] = match.place, match.metric
        row["second"], row["second_sum"] = match.second, match.second_metric
        row["trust"] = match.trust
        judge(row, self._followed.trust, self._followed.probability, self._control.least_trust)
        self._decided.append(row)

    def _drained(self) -> Found:
        decided, self._decided = self._decided, []
        return [np.array(decided, dtype=MATCH_DTYPE)] if decided else []

    def to_arrays(self) -> Arrays:
        """Raise UsageError: the windows that wait for later ones are not saved."""
        raise UsageError(
            "a localiser with a delay cannot be saved: set delay to 0, or keep the events"
        )

    def resume(self, arrays: Arrays) -> None:
        """Raise MapError: no state holds the windows that wait."""
        raise MapError("the state has a delay, with which none can be saved")
