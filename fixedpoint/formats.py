"""Formats of unsigned integers: counters, codes, distances, metrics; their limits and their error.

It needs no NumPy, which --help therefore does not load. Each message of the error gives the value,
what was expected, and the remedy.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import index

#: largest number of bits of a saturating count, and of a contrast code
MAX_BITS, CONTRAST_BITS = 16, 8
#: largest count of 16 bits
MAX_COUNT = 65_535


class FixedPointError(ValueError):
    """A format, a code or an operand does not fit the operation."""


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
