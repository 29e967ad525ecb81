"""Model of the comparator: distances to all places, best and second best place, acceptance."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from operator import sub
from typing import NamedTuple

from firmware_model.design import Design
from firmware_model.memories import Memories


class MatchResult(NamedTuple):
    """One match; second and second_sum are None if every place lies in the exclusion zone.

    With the place filter, the two sums are metrics, and there is a trust: the mean margin of this
    window and those before, each with 3/4 of the weight of the next, in units of 1/16 of a metric.
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


class ComparatorModel:
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
    best, second, left : Candidate or None
    delay : deque of Candidate, at most r + 1
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
