"""Smoothing of the place filter: the windows after a window decide with.

The metric of a place is the cost of the cheapest path that leads there. With the filter run
backwards, it is the cost of the cheapest path from there to the end of the drive. The sum is the
cost of the best path of the whole drive through this place: the min-plus form of forward-backward
smoothing. Fixed-lag smoothing does this for the newest window and the N before it: each match then
comes N windows late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from edge_vpr.matching.place_filter import (
    HeldWindows,
    Metrics,
    Transitions,
    WindowRows,
    go_back,
    match_late,
    smooth_windows,
)

#: Distance driven since the window before, in millimetres; None where it is not known.
Way = int | None
#: Columns of `FilterMatch`, shape (m, 7), and costs of the best path through each place, (m, K).
Late = tuple[npt.NDArray[np.int64], Metrics]


class BackwardPass:
    """Cost of going on from each place, from the last window of a drive back to the first.

    Parameters
    ----------
    exclusion : int
        See `PlaceFilter`.
    """

    def __init__(self, transitions: Transitions, exclusion: int) -> None:
        self._transitions, self._exclusion = transitions, exclusion
        self._onward = np.zeros(transitions.places, dtype=np.int16)
        self._ahead = np.empty(transitions.places, dtype=np.int16)

    def add_to(self, rows: WindowRows, ways: Sequence[Way]) -> None:
        """Add the costs of the rest of the drive to the metrics of the n windows before it.

        Parameters
        ----------
        rows : WindowRows
            Of n windows; their metrics become the costs of the best path through each place, and
            their columns the matches by these, with the margin as trust and `window_misfit` as
            misfit.
        ways : sequence of int or None
            Of each window.
        """
        for first, last in reversed(list(runs(ways, len(ways)))):
            smooth_windows(
                self._onward, self._ahead, self._transitions.by_step, self._exclusion,
                rows.part(first, last),
            )  # fmt: skip
            way = ways[first]
            if way is not None:
                _travel_back(self._transitions, self._ahead, way, self._onward)


def _travel_back(
    transitions: Transitions, ahead: npt.NDArray[np.int16], way: int, onward: npt.NDArray[np.int16]
) -> None:
    """Write the cost of going on by odometry instead of steps; see `go_back`."""
    onward[:] = transitions.by_distance(ahead.astype(np.int32), way, back=True)


class FixedLag:
    """Matches each window by the windows before it and the N after it.

    Parameters
    ----------
    exclusion : int
        See `PlaceFilter`.
    delay : int
        N.
    """

    def __init__(self, transitions: Transitions, exclusion: int, delay: int) -> None:
        self._transitions, self._exclusion, self._delay = transitions, exclusion, delay
        self._held = HeldWindows.empty(delay, transitions)
        self._ways: deque[Way] = deque()  # of the windows that are held

    def add(self, rows: WindowRows, ways: Sequence[Way]) -> Late:
        """Add the next n windows, and match those that have N after them.

        Parameters
        ----------
        rows : WindowRows
            Of these windows, by the place filter.
        ways : sequence of int or None
            Of each window.

        Returns
        -------
        columns : ndarray of int64, shape (m, 7)
            Of `FilterMatch`.
        metrics : ndarray of int32, shape (m, K)
            Cost of the best path through each place.
        """
        return self._match(rows, ways, self._delay)

    def finish(self) -> Late:
        """Match the last windows, which have fewer than N after them; returns as `add`."""
        return self._match(WindowRows.empty(0, self._transitions.places), [], 0)

    def _match(self, rows: WindowRows, ways: Sequence[Way], delay: int) -> Late:
        self._ways.extend(ways)
        number = max(len(self._ways) - delay, 0)
        columns = np.empty((number, 7), dtype=np.int64)
        metrics = np.empty((number, self._transitions.places), dtype=np.int32)
        if all(way is None for way in self._ways):
            match_late(
                self._held, self._transitions.by_step, self._exclusion, rows, delay, True, False,
                columns, metrics,
            )  # fmt: skip
            for _ in range(number):
                self._ways.popleft()
            return columns, metrics
        for i in range(len(ways)):
            match_late(
                self._held, self._transitions.by_step, self._exclusion, rows.part(i, i + 1),
                self._delay + 1, False, False, columns[:0], metrics[:0],
            )  # fmt: skip
            j = number - (len(ways) - i)
            if j >= 0:
                self._match_first(columns[j : j + 1], metrics[j : j + 1])
        if not ways:
            for j in range(number):
                self._match_first(columns[j : j + 1], metrics[j : j + 1])
        return columns, metrics

    def _match_first(self, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Match the first window that is held, with the distances driven between the others."""
        held, transitions = self._held, self._transitions
        first, windows, place = held.numbers[0].tolist()[:3]
        held.onward[:] = 0
        for i in range(windows - 1, 0, -1):
            at, way = (first + i) % len(held.metrics), self._ways[i]
            go_back(held.onward, held.ahead, transitions.by_step, held.costs[at], held.evidence[at])
            if way is not None:
                _travel_back(transitions, held.ahead, way, held.onward)
        way = self._ways.popleft()
        travelled = way is not None and place >= 0
        if way is not None and place >= 0:
            held.follows[:] = transitions.following(place, way)
        match_late(
            held, transitions.by_step, self._exclusion, WindowRows.empty(0, transitions.places),
            windows - 1, False, travelled, columns, metrics,
        )  # fmt: skip


def runs(ways: Sequence[Way], most: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of runs of windows in which only the first has a known distance.

    Parameters
    ----------
    most : int
        Largest number of windows in a run.
    """
    begin = 0
    while begin < len(ways):
        end = begin + 1
        while end < len(ways) and end - begin < most and ways[end] is None:
            end += 1
        yield begin, end
        begin = end
