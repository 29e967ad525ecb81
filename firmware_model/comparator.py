"""Distances to every place, the best of them, the second best outside its zone, and acceptance."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from firmware_model.design import Design
from firmware_model.memories import Memories


class MatchResult(NamedTuple):
    """One match; second and second_sum are None if every place lies in the exclusion zone.

    Of the place filter the two sums are metrics, and there is a trust: the margin of this window
    and those before, with weights that fall by 3/4 a window, in units of 1/16 of a metric.
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
    """Compares a descriptor with every place, P codes a cycle."""

    def __init__(self, memories: Memories) -> None:
        self.design = memories.design
        self._places = memories.places

    def steps(self, place: int, query: Sequence[int]) -> Iterator[int]:
        """Sum of absolute differences, one memory word after another.

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
        """Sum of absolute differences to one place."""
        *_, last = self.steps(place, query)
        return last


class SearchModel:
    """Takes sums in ascending order of places, and knows best and second best in one pass.

    The best is a running minimum, and a place that is only as near does not replace it: the lowest
    wins. The second best is the best of those more than r from the best. Those left of a new best's
    zone have left a delay line of r + 1 sums by then, and the best of them is `left`; those right
    of it come later.

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
        """Take the next place's sum."""
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
        """Whether there is a second best, far enough behind the best."""
        if self.best is None or self.second is None:
            return False
        return accepts(self.design, self.best.sum, self.second.sum)

    def result(self, window: int) -> MatchResult | None:
        """Give the match; None if no sum was taken."""
        if self.best is None:
            return None
        second, second_sum = self.second or (None, None)
        return MatchResult(window, *self.best, second, second_sum, self.ties, self.accepted)


def accepts(design: Design, best: int, second: int) -> bool:
    """Whether the second best sum is far enough behind the best, in integers."""
    if design.accept == "margin":
        return second - best >= design.margin
    numerator, denominator = design.ratio
    return second > 0 and best * denominator <= second * numerator


def _nearer(held: Candidate | None, later: Candidate) -> Candidate:
    return later if held is None or later.sum < held.sum else held
