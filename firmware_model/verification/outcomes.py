"""What becomes of mutants: printed one by one, and kept, so that a run may go on."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Generic, Literal, Protocol, TypeVar

from firmware_model.errors import ToolError

Outcome = Literal["found", "survives", "does not compile"]
#: file, line as it is, and what it becomes; without what is left and right of them
Change = tuple[str, str, str]

#: mutants that do the same as the source, and why
EQUAL = Path(__file__).with_name("equal_mutants.csv")


class AnyMutant(Protocol):
    """A source with one change."""

    @property
    def change(self) -> Change:
        """What is changed."""

    @property
    def place(self) -> str:
        """File and line, as ``vpr.c:300``."""

    @property
    def places(self) -> set[str]:
        """All names of where it is."""


M = TypeVar("M", bound=AnyMutant)


def mutants_at(every: Sequence[M], places: Sequence[str], expected: str) -> list[M]:
    """Select mutants, in their order; all if there are no places.

    Parameters
    ----------
    expected : str
        What names a place, for the error.

    Raises
    ------
    ToolError
        If a place has no mutant.
    """
    for place in places:
        if not any(place in mutant.places for mutant in every):
            raise ToolError(f"no mutant is at {place!r}: give {expected}")
    return [mutant for mutant in every if not places or not mutant.places.isdisjoint(places)]


def equal_mutants() -> dict[Change, str]:
    """Return why some mutants do the same as the source."""
    with EQUAL.open(encoding="ascii", newline="") as file:
        return {(file, line, becomes): why for file, line, becomes, why in [*csv.reader(file)][1:]}


class Outcomes(Generic[M]):
    """What became of some mutants.

    Parameters
    ----------
    every : sequence of mutants
        All that are run.
    tested_by : str
        Digest of the sources and of what is run on them.
    keep : path, optional
        CSV file, to which each outcome is written as soon as it is known, and which may have some
        of an earlier run.

    Raises
    ------
    ToolError
        If `keep` is of other sources or tests.
    """

    def __init__(self, every: Sequence[M], tested_by: str, keep: Path | None = None) -> None:
        self._every, self._keep = every, keep
        self._known: dict[Change, str] = {}
        if keep is None:
            return
        if not keep.exists():
            keep.write_text(f"{tested_by}\n", encoding="ascii")
        with keep.open(encoding="ascii", newline="") as file:
            if file.readline().strip() != tested_by:
                raise ToolError(f"{keep} is of other sources or vectors: name a new file")
            for outcome, place, line, becomes, _ in csv.reader(file):
                self._known[place, line, becomes] = outcome

    def left(self) -> list[M]:
        """Return the mutants that have no outcome yet."""
        return [mutant for mutant in self._every if _key(mutant) not in self._known]

    def add(self, mutant: M, outcome: Outcome, by: str = "") -> None:
        """Print an outcome, and keep it.

        Parameters
        ----------
        by : str
            What found it.
        """
        self._known[_key(mutant)] = outcome
        if self._keep is not None:
            with self._keep.open("a", encoding="ascii", newline="") as file:
                csv.writer(file, lineterminator="\n").writerow([outcome, *_key(mutant), by])
        number = f"{len(self._known):,} of {len(self._every):,}"
        print(f"{number}: {mutant.place}: {outcome}{by and f' by {by}'}", flush=True)

    def report(self) -> Iterator[str]:
        """Yield the survivors, and how many mutants had each outcome."""
        equal = equal_mutants()
        number: Counter[str] = Counter()
        for mutant in self._every:
            outcome = self._known.get(_key(mutant), "left")
            if outcome == "survives":
                why = equal.get(mutant.change)
                outcome = "equal" if why else outcome
                said = f"equal: {why}" if why else outcome
                _, line, becomes = mutant.change
                yield f"{mutant.place}: {said}\n  - {line}\n  + {becomes}"
            number[outcome] += 1
        counts = ", ".join(f"{outcome}: {count:,}" for outcome, count in sorted(number.items()))
        yield f"{len(self._every):,} mutants; {counts}"


def _key(mutant: AnyMutant) -> Change:
    """Return what is changed and where: the same line may be in a file twice."""
    return mutant.place, *mutant.change[1:]
