"""Exact operations on raw integers, and the format that each result needs.

Operands are widened to Python's integers before anything is done to them, so that neither NumPy's
wrap nor a silent promotion can occur. Those of one operation have the same number of fraction bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from operator import index
from typing import Protocol

from fixedpoint.errors import FixedOverflowError, FixedPointError
from fixedpoint.formats import FixedFormat
from fixedpoint.rounding import Overflow, Rounding


class Real(Protocol):
    """A number that is a ratio of integers: int, float, Fraction, Decimal, NumPy's scalars."""

    def as_integer_ratio(self) -> tuple[int, int]:
        """Numerator and denominator."""
        ...


def round_ratio(numerator: int, denominator: int, rounding: Rounding) -> int:
    """Round ``numerator / denominator`` to an integer.

    Parameters
    ----------
    numerator, denominator : int
        The denominator is positive.
    rounding : Rounding

    Raises
    ------
    FixedPointError
        If the denominator is not positive.
    """
    n, d = index(numerator), index(denominator)
    if d < 1:
        raise FixedPointError(f"division by {d}: expected a positive denominator")
    below, rest = divmod(n, d)
    match Rounding(rounding):
        case Rounding.FLOOR:
            up = False
        case Rounding.CEIL:
            up = rest > 0
        case Rounding.ZERO:
            up = rest > 0 and n < 0
        case Rounding.NEAREST_UP:
            up = 2 * rest >= d
        case Rounding.NEAREST_EVEN:
            up = 2 * rest > d or (2 * rest == d and below % 2 == 1)
        case Rounding.NEAREST_AWAY:
            up = 2 * rest > d or (2 * rest == d and n > 0)
    return below + up


def round_shift(raw: int, shift: int, rounding: Rounding) -> int:
    """Multiply by ``2**-shift`` and round; a negative shift is exact."""
    raw, shift = index(raw), index(shift)
    return raw << -shift if shift <= 0 else round_ratio(raw, 1 << shift, rounding)


def fit(raw: int, to: FixedFormat, overflow: Overflow) -> int:
    """Bring an integer into a format, its fraction bits being the same.

    Raises
    ------
    FixedOverflowError
        If it is outside and `overflow` is ERROR.
    """
    raw = index(raw)
    if to.lowest <= raw <= to.highest:
        return raw
    match Overflow(overflow):
        case Overflow.SATURATE:
            return to.lowest if raw < to.lowest else to.highest
        case Overflow.WRAP:
            return (raw - to.lowest) % (1 << to.width) + to.lowest
        case Overflow.ERROR:
            raise FixedOverflowError(
                f"{raw} is outside {to.lowest} to {to.highest} of {to}: "
                "take a wider format, or let it saturate or wrap"
            )


def quantize(value: Real, to: FixedFormat, rounding: Rounding, overflow: Overflow) -> int:
    """Bring a number into a format: first rounded, then fitted.

    Parameters
    ----------
    value : int, float, Fraction, Decimal, or a NumPy scalar
        Taken exactly: 0.1 is the double nearest to a tenth.
    to : FixedFormat
    rounding : Rounding
    overflow : Overflow

    Returns
    -------
    int
        Raw integer.

    Raises
    ------
    FixedOverflowError
        If it is outside and `overflow` is ERROR.
    FixedPointError
        If it is not a finite number.
    """
    try:
        ratio = Fraction(*_integer_ratio(value))
    except (AttributeError, OverflowError, ValueError, TypeError):
        raise FixedPointError(f"{value!r} is not a finite number: replace it first") from None
    scaled = ratio / to.step
    return fit(round_ratio(scaled.numerator, scaled.denominator, rounding), to, overflow)


def _integer_ratio(value: Real) -> tuple[int, int]:
    try:
        return index(value), 1  # type: ignore[arg-type]
    except TypeError:
        return value.as_integer_ratio()


def resize(
    raw: int, of: FixedFormat, to: FixedFormat, rounding: Rounding, overflow: Overflow
) -> int:
    """Bring a number from one format into another: first rounded, then fitted.

    Raises
    ------
    FixedOverflowError
        If it is outside and `overflow` is ERROR.
    FixedPointError
        If `raw` is not of the format `of`.
    """
    return fit(round_shift(of.checked(raw), of.frac - to.frac, rounding), to, overflow)


def saturating_add(a: int, b: int, of: FixedFormat) -> int:
    """Add two numbers of a format, and stop at its ends.

    Raises
    ------
    FixedPointError
        If an operand is not of the format.
    """
    return fit(of.checked(a) + of.checked(b), of, Overflow.SATURATE)


def absolute_difference(a: int, b: int) -> int:
    """Tell how far two raw integers are apart, ``|a - b|``; see `difference_format`."""
    return abs(index(a) - index(b))


def sad(a: Iterable[int], b: Iterable[int]) -> int:
    """Sum of absolute differences, exact; see `sad_format`.

    Raises
    ------
    FixedPointError
        If one has more numbers than the other.
    """
    a, b = list(a), list(b)
    if len(a) != len(b):
        raise FixedPointError(f"difference of {len(a)} and {len(b)} numbers: give as many of each")
    return sum(map(absolute_difference, a, b))


def exact_sum(values: Iterable[int]) -> int:
    """Sum, exact; see `sum_format`."""
    return sum(map(index, values))


def difference_format(of: FixedFormat) -> FixedFormat:
    """Format of ``|a - b|``: unsigned, and no wider.

    The largest is ``highest - lowest``, which is ``2**width - 1`` with a sign and without.
    """
    return FixedFormat(False, of.width, of.frac)


def sum_format(of: FixedFormat, n: int) -> FixedFormat:
    """Narrowest format that holds the sum of any `n` numbers of a format.

    Taken from the extreme sums, ``n * lowest`` and ``n * highest``. Adding a logarithm rounded up
    would waste bits: three numbers of one bit sum to 3, which has 2 bits and not 3; and growing in
    two steps, by 150 and then by 10, makes 16 bits of 4, where 1500 * 15 = 22500 has 15.

    Raises
    ------
    FixedPointError
        If `n` is less than 1.
    """
    if index(n) < 1:
        raise FixedPointError(f"sum of {n} numbers: expected 1 or more")
    # of two's complement, a width that holds -m also holds m - 1
    extreme = max(-n * of.lowest - 1, n * of.highest)
    return FixedFormat(of.signed, extreme.bit_length() + of.signed, of.frac)


def sad_format(of: FixedFormat, n: int) -> FixedFormat:
    """Narrowest format that holds the SAD of `n` pairs of numbers of a format.

    For L descriptors of J counters, ``n = L * J``: the sum of L SADs is one SAD of all their pairs.

    Raises
    ------
    FixedPointError
        If `n` is less than 1.
    """
    return sum_format(difference_format(of), n)
