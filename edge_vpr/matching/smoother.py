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
from typing import NamedTuple

import numpy as np

from edge_vpr.matching.place_filter import (
    TRUST_BITS,
    FilterMatch,
    Metrics,
    Transitions,
    WindowRows,
    go_back,
    match_summed,
    misfit_of,
    smooth_windows,
    support_after,
    trust_of,
)

#: Distance driven since the window before, in millimetres; None where it is not known.
Way = int | None


class SmoothedMatch(NamedTuple):
    """Match of a window that later ones have decided with.

    Attributes
    ----------
    metrics : ndarray of int32, shape (K,)
        Cost of the best path through each place.
    """

    match: FilterMatch
    metrics: Metrics


class BackwardPass:
    """Cost of going on from each place, from the last window of a drive back to the first.

    Parameters
    ----------
    exclusion : int
        See `PlaceFilter`.
    """

    def __init__(self, transitions: Transitions, exclusion: int) -> None:
        self._transitions, self._exclusion = transitions, exclusion
        self._cost = np.zeros(transitions.places, dtype=np.int32)
        self._ahead = np.empty(transitions.places, dtype=np.int32)

    def begin(self) -> None:
        """Begin again at the last window of a drive."""
        self._cost[:] = 0

    def go_back(self, row: WindowRows, way: Way) -> None:
        """Go back before one window, without matching it."""
        go_back(
            self._cost, self._ahead, self._transitions.by_step, row.activity[0], row.evidence[0]
        )
        if way is not None:
            self._cost = self._transitions.by_distance(self._ahead, way, back=True)

    def match(self, row: WindowRows) -> SmoothedMatch:
        """Match one window by its metrics and the cost of going on, with the margin as trust."""
        metric, columns = row.metrics[0].copy(), np.empty(6, dtype=np.int64)
        columns[5] = match_summed(metric, self._cost, self._exclusion, columns)
        return SmoothedMatch(FilterMatch(*columns.tolist()), metric)

    def add_to(self, rows: WindowRows, ways: Sequence[Way]) -> None:
        """Add the costs of the rest of the drive to the metrics of the n windows before it.

        Parameters
        ----------
        rows : WindowRows
            Of n windows; their metrics become the costs of the best path through each place, and
            their columns the matches by these, with the margin as trust.
        ways : sequence of int or None
            Of each window.
        """
        for first, last in reversed(list(runs(ways, len(ways)))):
            run = rows.part(first, last)
            smooth_windows(
                self._cost, self._ahead, self._transitions.by_step, self._exclusion,
                run.activity, run.evidence, run.metrics, run.columns,
            )  # fmt: skip
            way = ways[first]
            if way is not None:
                self._cost = self._transitions.by_distance(self._ahead, way, back=True)


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
        self._transitions, self._onward = transitions, BackwardPass(transitions, exclusion)
        self._delay = delay
        self._held: deque[tuple[WindowRows, Way]] = deque()  # windows that are not decided
        self._place, self._support = -1, 0
        self._misfits = (0, 0)  # of the two windows before

    def add(self, row: WindowRows, way: Way) -> SmoothedMatch | None:
        """Add the next window, and decide the one N windows before it, if there is one.

        Parameters
        ----------
        row : WindowRows
            Of this one window, by the place filter.
        """
        self._held.append((row, way))
        return self._decide() if len(self._held) > self._delay else None

    def finish(self) -> Iterator[SmoothedMatch]:
        """Decide the last windows, which have fewer than N after them."""
        while self._held:
            yield self._decide()

    def _decide(self) -> SmoothedMatch:
        """Decide the first window that is held."""
        row, way = self._held.popleft()
        self._onward.begin()
        for later in reversed(self._held):
            self._onward.go_back(*later)
        match, metric = self._onward.match(row)
        place, before = match.place, self._place
        follows = before >= 0 and self._transitions.lead_to(before, place, way)
        kept = self._support if follows else 0
        self._support = support_after(kept, place == before, match.trust >> TRUST_BITS)
        self._place = place
        misfit = misfit_of(int(row.evidence[0, place]))
        trust = trust_of(self._support, max(misfit, *self._misfits))
        self._misfits = (misfit, self._misfits[0])
        return SmoothedMatch(match._replace(trust=trust), metric)


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
