"""What runs of mutants share: the choice of mutants, and outcomes that are kept between runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from firmware_model.errors import ToolError


class _Placed(Protocol):
    @property
    def places(self) -> set[str]: ...


AnyMutant = TypeVar("AnyMutant", bound=_Placed)


def mutants_at(every: Sequence[AnyMutant], places: Sequence[str], expected: str) -> list[AnyMutant]:
    """Select mutants, in their order; all if there are no places.

    Parameters
    ----------
    expected : str
        What names a place, for the error.
    """
    for place in places:
        if not any(place in mutant.places for mutant in every):
            raise ToolError(f"no mutant is at {place!r}: give {expected}")
    return [mutant for mutant in every if not places or not mutant.places.isdisjoint(places)]


class Outcomes(dict[str, str]):
    """Outcomes by fingerprint of the mutant, of this run and of earlier ones.

    Parameters
    ----------
    file : path or None
        Where the outcomes of earlier runs stand, and new ones are added.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        lines = file.read_text(encoding="ascii").splitlines() if file and file.exists() else []
        # the last line of a run that was interrupted may be cut
        super().__init__(line.split("\t", 1) for line in lines if line.count("\t") == 1)

    def keep(self, fingerprint: str, outcome: str) -> None:
        """Add an outcome, to the file too."""
        self[fingerprint] = outcome
        if self._file is not None:
            with self._file.open("a", encoding="ascii") as out:
                out.write(f"{fingerprint}\t{outcome}\n")
