"""Selection of mutants by the places of their changes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TypeVar

from firmware_model.errors import ToolError

Mutant = TypeVar("Mutant")


def mutants_at(
    every: Iterable[Mutant],
    places: Sequence[str],
    places_of: Callable[[Mutant], Collection[str]],
    expected: str,
) -> list[Mutant]:
    """Select mutants, in their order; all if there are no places.

    Parameters
    ----------
    every : iterable of Mutant
    places : sequence of str
    places_of : callable
        Returns the names of the places where a mutant is.
    expected : str
        What names a place, for the error.

    Raises
    ------
    ToolError
        If a place has no mutant.
    """
    named = [(mutant, set(places_of(mutant))) for mutant in every]
    for place in places:
        if not any(place in names for _, names in named):
            raise ToolError(f"no mutant is at {place!r}: give {expected}")
    return [mutant for mutant, names in named if not places or not names.isdisjoint(places)]
