"""The comparator: distances to all places, the sequence or the place filter, acceptance."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import sub
from typing import NamedTuple

from firmware_model.model.descriptor import moved
from firmware_model.model.design import (
    EVIDENCE_TOP,
    FRACTION_BITS,
    MARGIN_TOP,
    METRIC_TOP,
    RECIPROCAL_BITS,
    RESIDUAL_TOP,
    TRUST_BITS,
    Design,
)
from firmware_model.model.memories import Memories
from fixedpoint.activity import ACTIVITY_COSTS, ROW_BITS, SAME_ROW, WEIGHT_BITS, WEIGHT_FROM


class MatchResult(NamedTuple):
    """One match; second and second_sum are None if every place lies in the exclusion zone.

    With the place filter, the two sums are metrics, and there is a trust, in units of 1/16 of a
    metric: the support, which is a running mean of the margins, less the largest residual of this
    window and the two before, and at least 0.
    """

    window: int
    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int
    accepted: bool
    trust: int | None = None


class Candidate(NamedTuple):
    """A place and its sum."""

    place: int
    sum: int


class DistanceModel:
    """Compares a descriptor with every place, P codes in each cycle."""

    def __init__(self, memories: Memories) -> None:
        self.design = memories.design
        self._places = memories.places

    def steps(self, place: int, query: Sequence[int]) -> Iterator[int]:
        """Yield the partial sums of absolute differences, one memory word after another.

        Yields
        ------
        int
            The accumulator after each word of P lanes; the last is the distance. Lanes beyond the
            last slot are zero in both, and add nothing.
        """
        design, total = self.design, 0
        for first in range(0, design.slots, design.lanes):
            lanes = range(first, min(first + design.lanes, design.slots))
            total += sum(abs(query[slot] - self._places[place][slot]) for slot in lanes)
            yield total

    def distance(self, place: int, query: Sequence[int]) -> int:
        """Sum of absolute differences to one place: the last of `steps`, computed at once."""
        return sum(map(abs, map(sub, query, self._places[place])))


class SearchModel:
    """Finds the best and the second best of sums that come in ascending order of places.

    The best is a running minimum; an equal sum does not replace it, so that the lowest place wins.
    The second best is the best place more than r away from the best. When a new best is found, the
    places left of its zone have left a delay line of r + 1 sums, and `left` is the best of them.
    The places right of the zone come later.

    Attributes
    ----------
    ties : int
        Further places with the best's sum.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self.best: Candidate | None = None
        self.second: Candidate | None = None
        self.left: Candidate | None = None
        self.delay: deque[Candidate] = deque()
        self.ties = 0

    def take(self, place: int, total: int) -> None:
        """Process the sum of the next place."""
        taken = Candidate(place, total)
        if len(self.delay) > self.design.exclusion:
            self.left = _nearer(self.left, self.delay.popleft())
        self.delay.append(taken)
        if self.best is None or taken.sum < self.best.sum:
            self.best, self.second, self.ties = taken, self.left, 0
            return
        self.ties += taken.sum == self.best.sum
        if place - self.best.place > self.design.exclusion:
            self.second = _nearer(self.second, taken)

    @property
    def accepted(self) -> bool:
        """Whether there is a second best, and it is far enough behind the best."""
        if self.best is None or self.second is None:
            return False
        return accepts(self.design, self.best.sum, self.second.sum)

    def result(self, window: int) -> MatchResult | None:
        """Return the match; None if there were no sums."""
        if self.best is None:
            return None
        second, second_sum = self.second or (None, None)
        return MatchResult(window, *self.best, second, second_sum, self.ties, self.accepted)


def accepts(design: Design, best: int, second: int) -> bool:
    """Return whether the second best sum is far enough behind the best, in integers."""
    if design.accept == "margin":
        return second - best >= design.margin
    numerator, denominator = design.ratio
    return second > 0 and best * denominator <= second * numerator


def _nearer(held: Candidate | None, later: Candidate) -> Candidate:
    return later if held is None or later.sum < held.sum else held


# Model of sequences: the distances of the last L windows are added along diagonals.


class SequenceModel:
    """Keeps the distances of the last L windows to every place, and adds them up.

    ``sum[k] = distance[k] + distance one window ago[k - 1] + ...``, L terms. There is no sum before
    L windows are complete, nor for places below L - 1, whose diagonal leaves the map.

    Attributes
    ----------
    history : list of L lists of K int
        A ring of rows: row ``newest`` is of the window that ended last. What was not yet written
        is None: it is never added.
    seen : int
        Windows so far, at most L.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self.history: list[list[int | None]] = [
            [None] * design.places for _ in range(design.length)
        ]
        self.newest = 0
        self.seen = 0

    def next_window(self) -> None:
        """Begin another window, whose distances overwrite those of L windows ago."""
        self.newest = (self.newest + 1) % self.design.length
        self.seen = min(self.seen + 1, self.design.length)

    def steps(self, place: int, distance: int) -> Iterator[int | None]:
        """Store a distance, and yield the partial sums with those before it.

        Yields
        ------
        int or None
            The sum so far, in each of L cycles; the last is the sequence's. None if there is none.
        """
        self.history[self.newest][place] = distance
        complete = self.seen == self.design.length and place >= self.design.length - 1
        total = distance
        yield total if complete else None
        for ago in range(1, self.design.length):
            if complete:
                term = self.history[(self.newest - ago) % self.design.length][place - ago]
                assert term is not None, "a complete sequence has been written"
                total += term
            yield total if complete else None

    def sum(self, place: int, distance: int) -> int | None:
        """Store a distance; return the sum of the sequence that ends at this place."""
        *_, last = self.steps(place, distance)
        return last


# Model of the place filter: one metric for each place, advanced by each window in integers.


#: the support moves by 1/4 of the difference to the margin in each window
TRUST_SHIFT = 2
#: while the place stays the same, the support falls by 1/16 in each window
STANDING_SHIFT = 4


class PlaceFilterModel:
    """Metrics of all places: the cost of the cheapest path that ends there now.

    Attributes
    ----------
    metrics : list of int, length K
        Of the latest window.
    reciprocal : int
        ``floor(2**16 / spread)`` of the distances of the latest window that did not pause; 0 before
        there is one. Hardware takes a restoring divider of 17 steps for it, outside the loop over
        the places.
    place, support : int
        Of the latest match; the place is -1 before the first.
    spread : int
        Of the distances of the latest window that did not pause, at least 1; 0 before there is one.
    margin, kept : int
        Of the latest match, and the support that it began with: that of the match before, or 0.
    residual, residual_before, worst : int
        Evidence against the latest match, against the one before it, and the largest of the last
        three; each of 5 bits.
    """

    def __init__(self, memories: Memories) -> None:
        self.design = design = memories.design
        self._place_activity = memories.place_activity
        self.metrics = [0] * design.places
        self.reciprocal = 0
        self.place, self.support = -1, 0
        self.residual, self.residual_before = 0, 0
        self.spread, self.margin, self.kept, self.worst = 0, 0, 0, 0

    def predictions(self, activity: int) -> list[int]:
        """Return the cost of being at each place after a window, without its evidence."""
        if self.place < 0:
            return [0] * self.design.places
        least = min(self.metrics)
        return [self.prediction(place, activity, least) for place in range(self.design.places)]

    def prediction(self, place: int, activity: int, least: int) -> int:
        """Return the cost of being at one place; `least` is the lowest metric."""
        cheapest = self.design.restart << FRACTION_BITS
        back = (cost << FRACTION_BITS for cost in self.design.back)
        for origin, cost in (
            *((place - step, cost) for step, cost in enumerate(self.steps(place, activity))),
            *((place + step, cost) for step, cost in enumerate(back, 1)),
        ):
            if 0 <= origin < self.design.places:
                cheapest = min(cheapest, self.metrics[origin] - least + cost)
        return cheapest

    def steps(self, place: int, activity: int) -> Sequence[int]:
        """Return the costs of steps of 0, 1, 2 ... places to a place, with fraction bits."""
        if self.design.activity_costs:
            row = row_of_costs(activity - self._place_activity[place])
            return self.design.costs_by_activity[row]
        return [cost << FRACTION_BITS for cost in self.design.steps]

    def match(
        self, number: int, activity: int, paused: bool, distances: Callable[[], Iterable[int]]
    ) -> MatchResult:
        """Advance by a window, and return its match.

        Parameters
        ----------
        number : int
            Of the window.
        paused : bool
            See `WindowResult`.
        distances : callable
            Gives those to all places; not called if the window pauses.
        """
        predictions = self.predictions(activity)
        if paused:
            self.metrics = predictions
        else:
            found = list(distances())
            reciprocal = self.reciprocal or reciprocal_of_spread(found)
            least, weight = min(found), weight_of(activity)
            self.metrics = [
                min(prediction + evidence(distance - least, reciprocal, weight), METRIC_TOP)
                for prediction, distance in zip(predictions, found, strict=True)
            ]
            # spread of this window, for the next one
            self.reciprocal = reciprocal_of_spread(found)
            self.spread = spread_of(found)
        return self._answer(number, predictions)

    def _answer(self, number: int, predictions: list[int]) -> MatchResult:
        search = SearchModel(self.design)
        for place, metric in enumerate(self.metrics):
            search.take(place, metric)
        result = search.result(number)
        assert result is not None, "there is a place"
        margin = METRIC_TOP if result.second_sum is None else result.second_sum - result.sum
        design, step = self.design, result.place - self.place
        follows = self.place >= 0 and -len(design.back) <= step <= design.largest_step
        kept = self.support if follows else 0
        self.support = moved(kept, min(margin, MARGIN_TOP) << TRUST_BITS, TRUST_SHIFT)
        if result.place == self.place:  # the same view gives no new information
            self.support = min(self.support, kept - (kept >> STANDING_SHIFT))
        self.place = result.place
        self.margin, self.kept = margin, kept
        # the evidence: the least metric never saturates, because the nearest place has none
        residual = min(result.sum - predictions[result.place], RESIDUAL_TOP)
        worst = max(residual, self.residual, self.residual_before)
        trust = max(self.support - (worst << TRUST_BITS), 0)
        self.residual, self.residual_before, self.worst = residual, self.residual, worst
        return result._replace(trust=trust, accepted=result.accepted and trust >= design.trust)


def row_of_costs(activity: int) -> int:
    """Return the row of `COSTS_BY_ACTIVITY` of a window's activity less that of a place."""
    row = (activity + (1 << (ROW_BITS - 1))) >> ROW_BITS
    return min(max(row + SAME_ROW, 0), len(ACTIVITY_COSTS) - 1)


def weight_of(activity: int) -> int:
    """Return the weight of a window's evidence, in eighths."""
    return min(max((activity - WEIGHT_FROM) >> 1, 0), 1 << WEIGHT_BITS)


def evidence(difference: int, reciprocal: int, weight: int) -> int:
    """Return the evidence against a place, from its distance less the smallest one, saturated."""
    unweighted = (difference * reciprocal) >> (RECIPROCAL_BITS - FRACTION_BITS)
    return (min(unweighted, EVIDENCE_TOP) * weight) >> WEIGHT_BITS


def reciprocal_of_spread(distances: list[int]) -> int:
    """Return ``floor(2**16 / s)`` with s the spread of the distances."""
    return (1 << RECIPROCAL_BITS) // spread_of(distances)


def spread_of(distances: list[int]) -> int:
    """Return the mean absolute deviation, rounded down, at least 1."""
    mean = sum(distances) // len(distances)
    spread = sum(abs(distance - mean) for distance in distances) // len(distances)
    return max(spread, 1)
