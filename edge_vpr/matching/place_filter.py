"""The place filter: which place follows from the places before, and from the newest window.

Viterbi's recursion over the places of a route, which is the min-plus form of a discrete Bayes
filter, in unsigned integers of stated width. Each place has one metric: the price of the cheapest
way to be there now. A window adds evidence to it, and prices the step from the place before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.descriptors.pauses import Activity
from edge_vpr.errors import UsageError
from edge_vpr.settings import Settings

Metrics = npt.NDArray[np.int32]

#: fraction bits of metrics, evidence and prices
FRACTION_BITS = 2
#: largest metric: 10 bits
METRIC_TOP = (1 << 10) - 1
#: largest evidence: 8 bits
EVIDENCE_TOP = (1 << 8) - 1
#: fraction bits of the reciprocal of the spread
RECIPROCAL_BITS = 16
#: prices of a step of 0, 1, 2 ... places while nothing moves
PAUSE_STEPS = (0, 0, 1)
_PAUSE_PRICES = np.array(PAUSE_STEPS, dtype=np.int32) << FRACTION_BITS
#: trust moves by 1/4 of the difference in a window, in units of 1/16 of a margin
TRUST_SHIFT, TRUST_BITS = 2, 4
#: where the place stays the same, trust falls by 1/16 a window
STANDING_SHIFT = 4


@dataclass(frozen=True)
class StepPrices:
    """What it costs to get from place to place in one window.

    Parameters
    ----------
    forward : tuple of int
        Price of a step of 0, 1, 2 ... places.
    back : tuple of int
        Price of a step of -1, -2 ... places; empty if the route is never driven backwards.
    restart : int
        Price of getting anywhere else: the robot was carried, or the filter is wrong.

    Raises
    ------
    UsageError
        If a price does not fit the metric, or there is none.
    """

    forward: tuple[int, ...] = (1, 0, 1)
    back: tuple[int, ...] = ()
    restart: int = 16

    def __post_init__(self) -> None:
        most = (METRIC_TOP >> FRACTION_BITS) - 1
        prices = (*self.forward, *self.back, self.restart)
        if not self.forward or min(prices) < 0 or max(prices) > most:
            raise UsageError(
                f"filter prices {self.forward} forward, {self.back} back and {self.restart} for a "
                f"restart: expected 0 to {most}, and at least one step forward"
            )

    @classmethod
    def of(cls, settings: Settings) -> StepPrices:
        """Return the prices that the settings ask for; by default those of the kind of window."""
        forward = settings.filter_steps
        if forward is None:
            forward = (1, 0, 1) if settings.window == "time" else (1, 0, 0, 1)
        return cls(forward, settings.filter_back, settings.filter_restart)

    @property
    def first(self) -> int:
        """Smallest step, in places: 0, or below."""
        return -len(self.back)

    @property
    def last(self) -> int:
        """Largest step, in places, after which an answer follows from the one before."""
        return max(len(self.forward), len(PAUSE_STEPS)) - 1

    @property
    def scaled(self) -> npt.NDArray[np.int32]:
        """Prices from the smallest step to the largest, with fraction bits."""
        return np.array([*reversed(self.back), *self.forward], dtype=np.int32) << FRACTION_BITS


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

    Attributes
    ----------
    metric : ndarray of int32, shape (K,)
        Of 10 bits, 2 of them fraction bits.
    prediction, paused : ndarray of int32, shape (K,)
        Price of being at each place one window later, without its evidence; while the camera
        stands, `paused`.
    reciprocal : int
        ``floor(2**16 / spread)`` of the window before: scales the evidence. 0 before the first,
        and after a spread above 2**16: then the window's own does.
    activity : Activity
        How many events a window usually has.
    place, trust : int
        Of the latest answer; the place is -1 before the first.
    """

    def __init__(
        self, places: int, prices: StepPrices, exclusion: int = 3, activity: int = 0
    ) -> None:
        if places < 1:
            raise UsageError(f"a map of {places} places: expected at least 1")
        self.prices, self.exclusion = prices, exclusion
        self._steps = prices.scaled
        self.activity = Activity(activity)
        self.metric = np.zeros(places, dtype=np.int32)
        self.prediction = np.zeros(places, dtype=np.int32)
        self.paused = np.zeros(places, dtype=np.int32)
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

    def _predict(self) -> None:
        restart = self.prices.restart << FRACTION_BITS
        self.prediction = predict(self.metric, self._steps, self.prices.first, restart)
        self.paused = predict(self.metric, _PAUSE_PRICES, 0, restart)

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

    def _answer(self, metric: Metrics) -> FilterMatch:
        place, second, ties = least_and_second(metric, self.exclusion)
        least = int(metric[place])
        second_metric = int(metric[second]) if second >= 0 else -1
        margin = second_metric - least if second >= 0 else METRIC_TOP
        steps = self.prices.first, self.prices.last
        trust = trust_after(self.trust, self.place, place, steps, margin)
        return FilterMatch(place, least, second, second_metric, ties, trust)


@njit(cache=True, nogil=True)
def trust_after(trust: int, before: int, place: int, steps: tuple[int, int], margin: int) -> int:
    """Return the trust after a window, in units of 1/16 of a metric.

    A robot that stands sees one view again and again, which may be that of another place where
    one stood: trust then falls by 1/16 a window.

    Parameters
    ----------
    trust, before : int
        Trust and place of the window before; the place is -1 before the first.
    place : int
        Of this window.
    steps : tuple of int
        Smallest and largest step, in places, by which an answer follows from the one before.
    margin : int
        Second metric less the least.
    """
    step = place - before
    kept = np.int64(trust if before >= 0 and steps[0] <= step <= steps[1] else 0)
    raised = kept + (((np.int64(margin) << TRUST_BITS) - kept) >> TRUST_SHIFT)
    if before >= 0 and step == 0:
        raised = min(raised, kept - (kept >> STANDING_SHIFT))
    return int(raised)


@njit(cache=True, nogil=True)
def reciprocal_of_spread(distances: npt.NDArray[np.integer]) -> int:
    """Return ``floor(2**16 / s)``, with s the mean absolute deviation of the distances.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)

    Returns
    -------
    int
        s is rounded down, as is the mean that it is taken from, and at least 1.
    """
    total = np.int64(0)
    for distance in distances:
        total += np.int64(distance)
    mean = total // distances.size
    spread = np.int64(0)
    for distance in distances:
        spread += abs(np.int64(distance) - mean)
    return (1 << RECIPROCAL_BITS) // max(int(spread) // distances.size, 1)


@njit(cache=True, nogil=True)
def add_evidence(
    prediction: Metrics, distances: npt.NDArray[np.integer], reciprocal: int, metric: Metrics
) -> None:
    """Write ``min(P + E, 2**10 - 1)``, with ``E = min((D - min D) / s, 255)`` in fraction bits.

    Parameters
    ----------
    prediction : ndarray of int32, shape (K,)
    distances : ndarray of int, shape (K,)
        What all of them have in common does not matter.
    reciprocal : int
        Of s, see `reciprocal_of_spread`; 0 of a spread above 2**16: nothing is evidence then.
    metric : ndarray of int32, shape (K,)
        Written to.
    """
    shift = RECIPROCAL_BITS - FRACTION_BITS
    # a larger difference is clipped all the same, and this one fits 32 bits when multiplied
    most = np.int64((EVIDENCE_TOP << shift) // max(reciprocal, 1) + 1)
    least = np.int64(distances.min())
    for k in range(metric.size):
        difference = np.int32(min(np.int64(distances[k]) - least, most))
        evidence = np.int32((difference * np.int32(reciprocal)) >> shift)
        metric[k] = min(prediction[k] + min(evidence, EVIDENCE_TOP), METRIC_TOP)


@njit(cache=True, nogil=True)
def predict(metric: Metrics, prices: Metrics, first: int, restart: int) -> Metrics:
    """Return the cheapest price of each place one window later.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
    prices : ndarray of int32, shape (steps,)
        Of a step of ``first``, ``first + 1`` ... places.
    first : int
    restart : int

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_i (M[k - i] + price[i]), min M + restart) - min M``.
    """
    least = metric.min()
    prediction = np.full(metric.size, restart, dtype=metric.dtype)
    for i in range(prices.size):
        step = first + i
        # the price of this step to every place that it leads to
        for k in range(max(step, 0), min(metric.size, metric.size + step)):
            prediction[k] = min(prediction[k], metric[k - step] - least + prices[i])
    return prediction


@njit(cache=True, nogil=True)
def least_and_second(metric: Metrics, exclusion: int) -> tuple[int, int, int]:
    """Return the place of the least metric, the best outside the exclusion zone (-1), and ties."""
    best = 0
    for k in range(1, metric.size):
        if metric[k] < metric[best]:
            best = k
    second, ties = -1, -1
    for k in range(metric.size):
        ties += metric[k] == metric[best]
        if abs(k - best) > exclusion and (second < 0 or metric[k] < metric[second]):
            second = k
    return best, second, ties
