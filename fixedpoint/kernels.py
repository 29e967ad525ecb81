"""The operations of `fixedpoint.ops` as scalar kernels, which Numba inlines where they are called.

They do not check their operands, but widen each to 64 bits with a sign before anything is done to
it: by Numba's own rules ``uint8(3) - uint8(5)`` is 2**64 - 2. Formats have at most 60 bits, and
every raw integer on the way is less than 2**61 in magnitude, a left-shifted one too. The result is
an int64; it fits the container of the format that `fixedpoint.ops` states for it.

Write a mode as a constant (``Rounding.FLOOR``), and the compiler drops the others.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from fixedpoint.errors import FixedOverflowError
from fixedpoint.rounding import Overflow, Rounding

#: a right shift by this or more leaves less than a half of any raw integer
_ALL_BITS = 62


@njit(cache=True, nogil=True)
def lowest(of):  # type: ignore[no-untyped-def]
    """Smallest raw integer of a `FixedFormat`."""
    return -(np.int64(1) << np.int64(of.width - 1)) if of.signed else np.int64(0)


@njit(cache=True, nogil=True)
def highest(of):  # type: ignore[no-untyped-def]
    """Largest raw integer of a `FixedFormat`."""
    return (np.int64(1) << np.int64(of.width - of.signed)) - np.int64(1)


@njit(cache=True, nogil=True)
def saturate(raw, to):  # type: ignore[no-untyped-def]
    """Nearest raw integer that the format has."""
    return min(max(np.int64(raw), lowest(to)), highest(to))


@njit(cache=True, nogil=True)
def wrap(raw, to):  # type: ignore[no-untyped-def]
    """Lowest bits, as two's complement where the format has a sign."""
    least = lowest(to)
    mask = (np.int64(1) << np.int64(to.width)) - np.int64(1)
    return ((np.int64(raw) - least) & mask) + least


@njit(cache=True, nogil=True)
def fit(raw, to, overflow):  # type: ignore[no-untyped-def]
    """Bring an integer into a format; see `fixedpoint.ops.fit`."""
    if overflow == Overflow.WRAP:
        return wrap(raw, to)
    nearest = saturate(raw, to)
    if overflow == Overflow.ERROR and nearest != np.int64(raw):
        raise FixedOverflowError("a raw integer is outside its format")
    return nearest


@njit(cache=True, nogil=True)
def round_shift(raw, shift, rounding):  # type: ignore[no-untyped-def]
    """Multiply by ``2**-shift`` and round; see `fixedpoint.ops.round_shift`."""
    raw, shift = np.int64(raw), np.int64(min(shift, _ALL_BITS))
    if shift <= 0:
        return raw << -shift
    below = raw >> shift
    rest = raw - (below << shift)
    half = np.int64(1) << (shift - np.int64(1))
    if rounding == Rounding.FLOOR:
        up = False
    elif rounding == Rounding.CEIL:
        up = rest > 0
    elif rounding == Rounding.ZERO:
        up = rest > 0 and raw < 0
    elif rounding == Rounding.NEAREST_UP:
        up = rest >= half
    elif rounding == Rounding.NEAREST_EVEN:
        up = rest > half or (rest == half and (below & np.int64(1)) == 1)
    else:
        up = rest > half or (rest == half and raw > 0)
    return below + np.int64(up)


@njit(cache=True, nogil=True)
def resize(raw, of, to, rounding, overflow):  # type: ignore[no-untyped-def]
    """Bring a number from one format into another; see `fixedpoint.ops.resize`."""
    return fit(round_shift(raw, of.frac - to.frac, rounding), to, overflow)


@njit(cache=True, nogil=True)
def quantize(value, to, rounding, overflow):  # type: ignore[no-untyped-def]
    """Bring a double into a format; see `fixedpoint.ops.quantize`.

    ``value * 2**frac`` must be a finite double.
    """
    scaled = math.ldexp(float(value), to.frac)
    if scaled == 0.0 and value != 0.0:
        scaled = math.copysign(0.25, value)  # any fraction is rounded as one too small to hold
    # the two parts of a double are exact, whereas scaled - floor(scaled) is not
    whole = np.trunc(scaled)
    rest = abs(scaled - whole)
    if rounding == Rounding.FLOOR:
        out = rest > 0 and scaled < 0
    elif rounding == Rounding.CEIL:
        out = rest > 0 and scaled > 0
    elif rounding == Rounding.ZERO:
        out = False
    elif rounding == Rounding.NEAREST_UP:
        out = rest > 0.5 or (rest == 0.5 and scaled > 0)
    elif rounding == Rounding.NEAREST_EVEN:
        out = rest > 0.5 or (rest == 0.5 and np.fmod(whole, 2.0) != 0.0)
    else:
        out = rest >= 0.5
    if out:
        whole += math.copysign(1.0, scaled)
    # doubles beyond 64 bits must be brought within before they become integers
    beyond = math.ldexp(1.0, to.width)
    if overflow == Overflow.WRAP:
        whole = np.fmod(whole, beyond)
    return fit(np.int64(min(max(whole, -beyond), beyond)), to, overflow)


@njit(cache=True, nogil=True)
def saturating_add(a, b, of):  # type: ignore[no-untyped-def]
    """Add two numbers of a format, and stop at its ends."""
    return saturate(np.int64(a) + np.int64(b), of)


@njit(cache=True, nogil=True)
def absolute_difference(a, b):  # type: ignore[no-untyped-def]
    """Tell how far two raw integers are apart, ``|a - b|``."""
    return abs(np.int64(a) - np.int64(b))


@njit(cache=True, nogil=True)
def sad(a, b):  # type: ignore[no-untyped-def]
    """Sum of absolute differences of two arrays of raw integers, of equal length."""
    total = np.int64(0)
    for i in range(a.size):
        total += absolute_difference(a[i], b[i])
    return total


@njit(cache=True, nogil=True)
def exact_sum(values):  # type: ignore[no-untyped-def]
    """Sum of an array of raw integers."""
    total = np.int64(0)
    for i in range(values.size):
        total += np.int64(values[i])
    return total
