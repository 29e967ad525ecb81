"""Model of the place filter: one metric for each place, advanced by each window in integers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from firmware_model.comparator import MatchResult, SearchModel
from firmware_model.design import Design
from firmware_model.largest_values import (
    EVIDENCE_TOP,
    FRACTION_BITS,
    METRIC_TOP,
    RECIPROCAL_BITS,
    TRUST_BITS,
)
from firmware_model.running import moved

#: prices of a step of 0, 1 and 2 places in a quiet window
QUIET_STEPS = (0, 0, 1)
#: the trust moves by 1/4 of the difference to the margin in each window
TRUST_SHIFT = 2
#: while the place stays the same, the trust falls by 1/16 in each window
STANDING_SHIFT = 4


class PlaceFilterModel:
    """Metrics of all places: the price of the cheapest way to be there now.

    Attributes
    ----------
    metrics : list of int, length K
        Of the latest window.
    reciprocal : int
        ``floor(2**16 / spread)`` of the distances of the latest window that did not pause; 0 before
        there is one. Hardware takes a restoring divider of 17 steps for it, outside the loop over
        the places.
    place, trust : int
        Of the latest match; the place is -1 before the first.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self.metrics = [0] * design.places
        self.reciprocal = 0
        self.place, self.trust = -1, 0

    def predictions(self, quiet: bool) -> list[int]:
        """Return the price of being at each place one window later, without evidence."""
        if self.place < 0:
            return [0] * self.design.places
        least = min(self.metrics)
        return [self.prediction(place, quiet, least) for place in range(self.design.places)]

    def prediction(self, place: int, quiet: bool, least: int) -> int:
        """Return the price of being at one place one window later; `least` is the lowest metric."""
        steps, back = (QUIET_STEPS, ()) if quiet else (self.design.steps, self.design.back)
        cheapest = self.design.restart << FRACTION_BITS
        for origin, price in (
            *((place - step, price) for step, price in enumerate(steps)),
            *((place + step, price) for step, price in enumerate(back, 1)),
        ):
            if 0 <= origin < self.design.places:
                cheapest = min(cheapest, self.metrics[origin] - least + (price << FRACTION_BITS))
        return cheapest

    def match(
        self, number: int, quiet: bool, paused: bool, distances: Callable[[], Iterable[int]]
    ) -> MatchResult:
        """Advance by a window, and return its match.

        Parameters
        ----------
        number : int
            Of the window.
        quiet, paused : bool
            See `WindowResult`.
        distances : callable
            Gives those to all places; not called if the window pauses.
        """
        predictions = self.predictions(quiet)
        if paused:
            self.metrics = predictions
        else:
            found = list(distances())
            reciprocal = self.reciprocal or reciprocal_of_spread(found)
            least = min(found)
            self.metrics = [
                min(prediction + evidence(distance - least, reciprocal), METRIC_TOP)
                for prediction, distance in zip(predictions, found, strict=True)
            ]
            # spread of this window, for the next one
            self.reciprocal = reciprocal_of_spread(found)
        return self._answer(number)

    def _answer(self, number: int) -> MatchResult:
        search = SearchModel(self.design)
        for place, metric in enumerate(self.metrics):
            search.take(place, metric)
        result = search.result(number)
        assert result is not None, "there is a place"
        margin = METRIC_TOP if result.second_sum is None else result.second_sum - result.sum
        design = self.design
        last = max(len(design.steps), len(QUIET_STEPS)) - 1
        follows = self.place >= 0 and -len(design.back) <= result.place - self.place <= last
        kept = self.trust if follows else 0
        trust = moved(kept, margin << TRUST_BITS, TRUST_SHIFT)
        if result.place == self.place:  # the same view gives no new information
            trust = min(trust, kept - (kept >> STANDING_SHIFT))
        self.place, self.trust = result.place, trust
        return result._replace(trust=trust, accepted=result.accepted and trust >= design.trust)


def evidence(difference: int, reciprocal: int) -> int:
    """Return the evidence against a place, from its distance less the smallest one, saturated."""
    return min((difference * reciprocal) >> (RECIPROCAL_BITS - FRACTION_BITS), EVIDENCE_TOP)


def reciprocal_of_spread(distances: list[int]) -> int:
    """Return ``floor(2**16 / s)`` with s the mean absolute deviation, rounded down, at least 1."""
    mean = sum(distances) // len(distances)
    spread = sum(abs(distance - mean) for distance in distances) // len(distances)
    return (1 << RECIPROCAL_BITS) // max(spread, 1)
