"""Conversion between values of settings and their text on the command line and in files."""

from __future__ import annotations

import re
from fractions import Fraction

from edge_vpr.errors import UsageError

_MICROSECONDS = {"us": 1, "ms": 1_000, "s": 1_000_000, "": 1_000_000}
#: a price of the place filter is one byte, and 255 marks a step that is not allowed
MOST_PRICE = 254
MOST_PRICES = 16


def duration_us(text: str) -> int:
    """Read ``1s``, ``250ms``, ``500us`` or ``0.5`` (seconds) as whole microseconds.

    Raises
    ------
    UsageError
        If the text has another form, or is not a positive whole number of microseconds.
    """
    form = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(us|ms|s|)\s*", text)
    if form:
        microseconds = Fraction(form[1]) * _MICROSECONDS[form[2]]
        if microseconds.denominator == 1 and microseconds >= 1:
            return int(microseconds)
    raise UsageError(f"duration {text!r}: expected a time such as 1s, 250ms or 500us")


def duration_word(microseconds: int) -> str:
    """Write a duration in the largest unit in which it is a whole number.

    Examples
    --------
    >>> duration_word(1_000_000), duration_word(250_000), duration_word(7)
    ('1s', '250ms', '7us')
    """
    unit = next(unit for unit in ("s", "ms", "us") if microseconds % _MICROSECONDS[unit] == 0)
    return f"{microseconds // _MICROSECONDS[unit]}{unit}"


def prices(text: str) -> tuple[int, ...]:
    """Read a list of prices of the place filter, such as ``1,0,1``.

    Raises
    ------
    UsageError
        If the text is not a list of whole numbers.
    """
    try:
        return tuple(int(price) for price in text.split(","))
    except ValueError:
        raise UsageError(f"{text!r}: expected prices such as 1,0,1") from None


def prices_word(values: tuple[int, ...]) -> str:
    """Write prices in the form that `prices` reads."""
    return ",".join(map(str, values))


def are_prices(values: tuple[object, ...]) -> bool:
    """Return whether all values are prices that the place filter can store."""
    return len(values) <= MOST_PRICES and all(
        type(price) is int and 0 <= price <= MOST_PRICE for price in values
    )
