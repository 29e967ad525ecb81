"""Formats of unsigned integers: counters, codes, distances, metrics."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index

from fixedpoint.errors import FixedPointError


@dataclass(frozen=True)
class UnsignedFormat:
    """Integers from 0 to ``2**width - 1``.

    Parameters
    ----------
    width : int
        Bits, at least 1.

    Examples
    --------
    >>> counter = UnsignedFormat(4)
    >>> counter.sum_of(150), counter.sum_of(10 * 150)
    (UnsignedFormat(width=12), UnsignedFormat(width=15))
    """

    width: int

    def __post_init__(self) -> None:
        try:
            width = index(self.width)
        except TypeError:
            raise FixedPointError(
                f"format of width {self.width!r}: expected a number of bits"
            ) from None
        if width < 1:
            raise FixedPointError(f"format of width {width}: expected 1 bit or more")
        object.__setattr__(self, "width", width)

    @classmethod
    def holding(cls, largest: int) -> UnsignedFormat:
        """Return the narrowest format that holds 0 to `largest`."""
        return cls(max(1, index(largest).bit_length()))

    @property
    def highest(self) -> int:
        """Largest integer."""
        return (1 << self.width) - 1

    def sum_of(self, n: int) -> UnsignedFormat:
        """Return the narrowest format that holds the sum of any `n` integers of this one.

        An absolute difference is no wider than its operands, so that this is also the format of a
        SAD of n counters. The width is that of the largest sum. Adding the logarithm of n, rounded
        up, would waste bits: the sum of three numbers of one bit is at most 3, which needs 2 bits.
        """
        if index(n) < 1:
            raise FixedPointError(f"sum of {n} numbers: expected 1 or more")
        return self.holding(n * self.highest)


def packed_bytes(counters: int, bits: int) -> int:
    """Bytes of one descriptor of `counters` codes, packed without gaps."""
    return -(-counters * bits // 8)
