"""The place filter: which place follows from the places before, and from the newest window.

Viterbi's recursion over the places of a route, which is the min-plus form of a discrete Bayes
filter, in unsigned integers of stated width. Each place has one metric: the price of the cheapest
way to be there now. A window adds evidence to it, and prices the step from the place before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pauses import Activity
from edge_vpr.errors import UsageError
from edge_vpr.matching.filter_arithmetic import (
    TRUST_BITS,
    add_evidence,
    least_and_second,
    reciprocal_of_spread,
    trust_after,
)
from edge_vpr.matching.moves import Moves
from edge_vpr.matching.step_prices import METRIC_TOP, Metrics, StepPrices


class FilterMatch(NamedTuple):
    """Answer of the filter after a window.

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
        1/256 event; 0 if windows never pause.
    jumps, along_mm : ndarray, optional
        Of the map, see `Moves`.

    Attributes
    ----------
    moves : Moves
    metric : ndarray of int32, shape (K,)
        Of 10 bits, 2 of them fraction bits.
    prediction, paused : ndarray of int32, shape (K,)
        Price of being at each place one window later, without its evidence; while the camera
        stands, `paused`.
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
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> None:
        self.moves = Moves(places, prices, jumps, along_mm)
        self.exclusion = exclusion
        self.activity = Activity(activity)
        self.metric = np.zeros(places, dtype=np.int32)
        self.prediction = np.zeros(places, dtype=np.int32)
        self.paused = np.zeros(places, dtype=np.int32)
        self.follows = np.zeros(places, dtype=np.bool_)
        self.reciprocal = 0
        self.place, self.trust = -1, 0

    def __len__(self) -> int:
        return len(self.metric)

    def answer(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Return the match for a window that is not over, without advancing.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
            Of the window to every place.
        events : int
            At the selected pixels in the window.
        """
        return self._answer(self._with_evidence(distances, events))

    def advance(self, distances: npt.NDArray[np.integer], events: int) -> FilterMatch:
        """Take a finished window, and return its match.

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
        events : int
            At the selected pixels in the window.
        """
        self.metric = self._with_evidence(distances, events)
        found = self._answer(self.metric)
        self.place, self.trust = found.place, found.trust
        if not self.activity.pauses(events):
            self.reciprocal = reciprocal_of_spread(distances)
        self.activity.update(events)
        self._predict()
        return found

    def resume(self, metric: Metrics, reciprocal: int, usual: int, place: int, trust: int) -> None:
        """Take up the state of another filter of the same map and prices; see its attributes."""
        self.metric = metric.copy()
        self.reciprocal, self.activity.usual = reciprocal, usual
        self.place, self.trust = place, trust
        if place >= 0:
            self._predict()

    def travel(self, travelled_mm: int) -> None:
        """Predict by odometry, in place of steps, until the window is over.

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
            self.prediction = self.paused = prediction
            self.follows = self.moves.following(self.place, travelled_mm)

    def _predict(self) -> None:
        self.prediction = self.moves.by_steps(self.metric)
        self.paused = self.moves.while_paused(self.metric)
        self.follows = self.moves.following(self.place, None)

    def _with_evidence(self, distances: npt.NDArray[np.integer], events: int) -> Metrics:
        if distances.shape != self.metric.shape:
            raise UsageError(
                f"{distances.size} distances to {len(self)} places: give one of each place"
            )
        if self.activity.pauses(events):
            return np.minimum(self.paused, METRIC_TOP).astype(np.int32)
        reciprocal = self.reciprocal or reciprocal_of_spread(distances)
        metric = np.empty_like(self.prediction)
        add_evidence(self.prediction, distances, reciprocal, metric)
        return metric

    def evidence(self, distances: npt.NDArray[np.integer], events: int) -> Metrics:
        """Return what a window adds to the metric of each place, of 8 bits, shape (K,).

        Parameters
        ----------
        distances : ndarray of int, shape (K,)
        events : int
            At the selected pixels in the window.
        """
        evidence = np.zeros_like(self.metric)
        if not self.activity.pauses(events):
            reciprocal = self.reciprocal or reciprocal_of_spread(distances)
            add_evidence(np.zeros_like(evidence), distances, reciprocal, evidence)
        return evidence

    def _answer(self, metric: Metrics) -> FilterMatch:
        found = match_of(metric, self.exclusion)
        kept = self.trust if self.follows[found.place] else 0
        margin = found.trust >> TRUST_BITS
        return found._replace(trust=trust_after(kept, found.place == self.place, margin))


def match_of(metric: Metrics, exclusion: int) -> FilterMatch:
    """Return the match of these metrics; its trust is the margin, in units of 1/16 of a metric.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
    exclusion : int
        The second best is more than this many places away.
    """
    place, second, ties = least_and_second(metric, exclusion)
    least = int(metric[place])
    second_metric = int(metric[second]) if second >= 0 else -1
    margin = second_metric - least if second >= 0 else METRIC_TOP
    return FilterMatch(place, least, second, second_metric, ties, margin << TRUST_BITS)
