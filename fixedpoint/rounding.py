"""What is done with bits that do not fit: below the last one, and above the first."""

from __future__ import annotations

from enum import IntEnum

from fixedpoint.errors import FixedPointError


class _Named(IntEnum):
    """Integers inside, so that Numba compiles them; words outside."""

    def __str__(self) -> str:
        return self.name.lower().replace("_", "-")

    @classmethod
    def parse(cls, text: str):  # type: ignore[no-untyped-def]
        """Read the word that `str` writes.

        Raises
        ------
        FixedPointError
            If there is no such word.
        """
        for member in cls:
            if str(member) == text:
                return member
        raise FixedPointError(
            f"{cls.__name__.lower()} {text!r}: choose from {', '.join(map(str, cls))}"
        )


class Rounding(_Named):
    """To which neighbour a number between two goes."""

    FLOOR = 0
    """Down: what a shift to the right does."""
    CEIL = 1
    """Up."""
    ZERO = 2
    """Towards zero: truncation of the magnitude."""
    NEAREST_UP = 3
    """To the nearer one, from the middle up."""
    NEAREST_EVEN = 4
    """To the nearer one, from the middle to the even one."""
    NEAREST_AWAY = 5
    """To the nearer one, from the middle away from zero."""


class Overflow(_Named):
    """What becomes of a number outside the format."""

    SATURATE = 0
    """The nearest number that the format has."""
    WRAP = 1
    """The lowest bits of its two's complement."""
    ERROR = 2
    """An error."""
