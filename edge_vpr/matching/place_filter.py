"""The place filter: finds the place from the newest window and the possible moves before it.

This is Viterbi's algorithm over the places of a route (the min-plus form of a discrete Bayes
filter), in unsigned integers of fixed widths. Each place has one metric: the price of the cheapest
way to be there now. Each window adds the price of a move from the place before, and evidence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pauses import Activity
from edge_vpr.errors import UsageError
from edge_vpr.matching.filter_recursion import NUMBERS, Predictions, WindowRows, advance_windows
from edge_vpr.matching.moves import Moves
from edge_vpr.matching.step_prices import Metrics, StepPrices


class FilterMatch(NamedTuple):
    """Match of the filter after a window.

    Attributes
    ----------
    place : int
        Place of the least metric; the lowest of equals.
    metric : int
    second, second_metric : int
        Least metric outside the exclusion zone; -1 if nothing lies outside.
    ties : int
        Other places of the same least metric.
    trust : int
        How far to trust the answer: the margin (second metric less the least) of this window and
        those before, with weights that fall by 3/4 a window, in units of 1/16 of a metric. It
        starts at 0 where the answer jumps. It does not rise where the place stays the same, since
        the same view again says nothing new: see `trust_after`.
    """

    place: int
    metric: int
    second: int
    second_metric: int
    ties: int
    trust: int


class PlaceFilter:
    """Metrics of all places, advanced window by window.

    Parameters
    ----------
    places : int
        K.
    prices : StepPrices
    exclusion : int
        The second best is searched more than this many places from the best.
    activity : int
        Events that a window of the reference has at the selected pixels on average, in units of
        1/256 event; 0 if only windows without events are quiet.
    quiet_shift : int
        Evidence of a quiet window is divided by ``2**quiet_shift``, rounded down.
    jumps, along_mm : ndarray, optional
        Of the map, see `Moves`.

    Attributes
    ----------
    moves : Moves
    metric : ndarray of int32, shape (K,)
        Of 10 bits, 2 of them fraction bits.
    prediction, quiet : ndarray of int32, shape (K,)
        Price of being at each place one window later, without its evidence; `quiet` if that window
        is quiet.
    follows : ndarray of bool, shape (K,)
        Which places follow from the latest answer, so that its trust is kept.
    reciprocal : int
        ``floor(2**16 / spread)`` of the window before: scales the evidence. 0 before the first,
        and after a spread above 2**16: then the window's own does.
    activity : Activity
        How many events a window usually has.
    place, trust : int
        Of the latest answer; the place is -1 before the first.
    """

    def __init__(
        self,
        places: int,
        prices: StepPrices,
        exclusion: int = 3,
        activity: int = 0,
        *,
        quiet_shift: int = 0,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> None:
        self.moves = Moves(places, prices, jumps, along_mm)
        self.exclusion, self.quiet_shift = exclusion, quiet_shift
        self.activity = Activity(activity)
        self.metric = np.zeros(places, dtype=np.int32)
        self.prediction = np.zeros(places, dtype=np.int32)
        self.quiet = np.zeros(places, dtype=np.int32)
        self.follows = np.zeros(places, dtype=np.bool_)
        self.reciprocal = 0
        self.place, self.trust = -1, 0

    def __len__(self) -> int:
        return len(self.metric)

    def answer(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Return the match for an unfinished window, without advancing.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            Of the window to every place.
        events : int
            At the selected pixels in the window.

        Raises
        ------
        UsageError
            If there is not one distance of each place, or they are not integers.
        """
        rows, _ = self._rows(distances[np.newaxis], np.array([events], dtype=np.int64))
        return FilterMatch(*rows.columns[0].tolist())

    def advance(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Advance by a finished window, and return its match.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
        events : int
            At the selected pixels in the window.
        """
        rows = self.advance_windows(distances[np.newaxis], np.array([events], dtype=np.int64))
        return FilterMatch(*rows.columns[0].tolist())

    def advance_windows(
        self, distances: npt.NDArray[np.integer], events: npt.NDArray[np.int64]
    ) -> WindowRows:
        """Advance by n finished windows, n at least 1, one after the other.

        Parameters
        ----------
        distances : ndarray of int, shape (n, K)
        events : ndarray of int64, shape (n,)
            At the selected pixels in each window.
        """
        rows, numbers = self._rows(distances, events)
        self.reciprocal, self.activity.usual, self.place, self.trust = numbers[0].tolist()
        self.metric = rows.metrics[-1].copy()
        self._predict()
        return rows

    def resume(self, metric: Metrics, reciprocal: int, usual: int, place: int, trust: int) -> None:
        """Continue from the state of another filter with the same map and prices."""
        self.metric = metric.copy()
        self.reciprocal, self.activity.usual = reciprocal, usual
        self.place, self.trust = place, trust
        if place >= 0:
            self._predict()

    def travel(self, travelled_mm: int) -> None:
        """Predict by odometry instead of steps until the window ends.

        Parameters
        ----------
        travelled_mm : int
            Millimetres from the end of the window before to now, or to the end of this one; below
            0 backwards.

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        prediction = self.moves.by_distance(self.metric, travelled_mm)
        if self.place >= 0:
            self.prediction = self.quiet = prediction
            self.follows = self.moves.following(self.place, travelled_mm)

    def _predict(self) -> None:
        self.prediction = self.moves.by_steps(self.metric)
        self.quiet = self.moves.if_quiet(self.metric)
        self.follows = self.moves.following(self.place, None)

    def _rows(
        self, distances: npt.NDArray[np.integer], events: npt.NDArray[np.int64]
    ) -> tuple[WindowRows, npt.NDArray[np.void]]:
        """Return the results of windows, and the state after the last one."""
        if distances.shape[1:] != self.metric.shape:
            raise UsageError(
                f"{distances.shape[1]} distances to {len(self)} places: give one of each place"
            )
        if distances.dtype.kind not in "iu":
            raise UsageError(
                f"distances are {distances.dtype}: give whole numbers, for example multiplied by "
                "1,000 and rounded"
            )
        # the kernel is compiled for two kinds of distances: those of recorded drives, and any other
        exact = np.int32 if distances.dtype == np.int32 else np.int64
        distances = np.ascontiguousarray(distances, dtype=exact)
        rows = WindowRows.empty(*distances.shape)
        numbers = np.zeros(1, dtype=NUMBERS).view(np.recarray)
        numbers[0] = (self.reciprocal, self.activity.usual, self.place, self.trust)
        predicted = Predictions(self.prediction, self.quiet, self.follows)
        advance_windows(
            numbers, predicted, self.moves.by_step, self.exclusion, self.quiet_shift, distances,
            events, rows,
        )  # fmt: skip
        return rows, numbers
