"""The contrast code: logarithm of a count less the mean of its counter and that of its window.

Other light multiplies all counts of a pixel by a factor, which adds a constant to their logarithms:
their differences to the mean of the drive do not change. A slower camera multiplies all counts of a
window by a factor, so that the mean of the window's differences is subtracted too. All arithmetic
is in integers: logarithms come from a table in units of 1/256 octave, and the running mean is
updated by a shift.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from operator import index

import numpy as np
import numpy.typing as npt

from fixedpoint.formats import CONTRAST_BITS, FixedPointError

#: fraction bits of a logarithm: units of 1/256 octave
LEVEL_FRACTION_BITS = 8
#: additional fraction bits of a running mean over those of a logarithm
MEAN_FRACTION_BITS = 8
#: the running mean moves by 1 / 2**shift of the difference: 1/16 at first, 1/256 in the end
FIRST_SHIFT, LAST_SHIFT = 4, 8
#: count at which the code saturates
FULL_SCALE = 1023

#: windows that are coded at once: their logarithms take eight times the memory of codes
_ROWS = 1 << 12

Integers = npt.NDArray[np.integer]


@cache
def _levels() -> npt.NDArray[np.int32]:
    """Return ``round(256 log2(1 + c))`` of each count up to `FULL_SCALE`, in 10 ms."""
    # floor(x + 1/2) = floor((floor(2 x) + 1) / 2), and floor(log2 n) is the bit length less 1
    counts = range(1, FULL_SCALE + 2)
    levels = np.array(
        [(n ** (2 << LEVEL_FRACTION_BITS)).bit_length() // 2 for n in counts], np.int32
    )
    levels.setflags(write=False)
    return levels


@dataclass(frozen=True)
class ContrastCode:
    """Code ``round(log2(1 + c) - mean - window mean)``, saturated to `bits` bits with sign.

    Parameters
    ----------
    bits : int
        1 to 8. A code is stored plus ``2**(bits - 1)``: 0 to ``2**bits - 1``.
    """

    bits: int = 3

    def __post_init__(self) -> None:
        if not 1 <= index(self.bits) <= CONTRAST_BITS:
            raise FixedPointError(
                f"contrast code of {self.bits} bits: expected 1 to {CONTRAST_BITS}"
            )

    @property
    def levels(self) -> npt.NDArray[np.int32]:
        """``round(256 log2(1 + c))`` of each count c up to `FULL_SCALE`, shape (1_024,); exact."""
        return _levels()

    def level(self, counts: Integers) -> npt.NDArray[np.int32]:
        """Return the logarithm of ``1 + count`` in units of 1/256 octave, of the same shape."""
        return self.levels[np.minimum(counts, np.uint16(FULL_SCALE))]

    def encode(self, counts: Integers, mean: Integers) -> npt.NDArray[np.uint8]:
        """Code counts, each against the mean of its counter.

        Parameters
        ----------
        counts : ndarray of int, shape (..., J)
            Not negative.
        mean : ndarray of int, shape (J,)
            Of the logarithms, in units of 1/256 octave.

        Returns
        -------
        ndarray of uint8, of the shape of `counts`
        """
        codes = np.empty(counts.shape, np.uint8)
        rows, coded = (each.reshape(-1, counts.shape[-1]) for each in (counts, codes))
        for first in range(0, len(rows), _ROWS):
            part = slice(first, first + _ROWS)
            rounded = self.fine(rows[part], mean) + (1 << (LEVEL_FRACTION_BITS - 1))
            coded[part] = rounded >> LEVEL_FRACTION_BITS
        return codes

    def mean(self, counts: Integers) -> npt.NDArray[np.int32]:
        """Return the mean of each counter's logarithms over a drive, rounded to the nearest.

        Parameters
        ----------
        counts : ndarray of int, shape (n, J)
            n of at least 1.

        Returns
        -------
        ndarray of int32, shape (J,)
        """
        n, total = len(counts), np.zeros(counts.shape[1], np.int64)
        for first in range(0, n, _ROWS):
            total += self.level(counts[first : first + _ROWS]).sum(axis=0, dtype=np.int64)
        return ((2 * total + n) // (2 * n)).astype(np.int32)

    def window_mean(self, deviations: Integers) -> npt.NDArray[np.int64]:
        """Return the mean of each window's deviations, rounded to the nearest.

        Parameters
        ----------
        deviations : ndarray of int, shape (..., J)
            Logarithms less the means of their counters, in units of 1/256 octave.

        Returns
        -------
        ndarray of int64, shape (...)
        """
        total, counters = deviations.sum(axis=-1, dtype=np.int64), deviations.shape[-1]
        mean: npt.NDArray[np.int64] = (2 * total + counters) // (2 * counters)
        return mean

    def fine(self, counts: Integers, mean: Integers) -> npt.NDArray[np.int64]:
        """Return the codes of `encode` before they are rounded, in units of 1/256.

        Parameters
        ----------
        counts : ndarray of int, shape (..., J)
            Not negative.
        mean : ndarray of int, shape (J,)
            See `encode`.

        Returns
        -------
        ndarray of int64, of the shape of `counts`
            0 to ``256 * (2**bits - 1)``.
        """
        deviations = self.level(counts) - mean
        half = np.int64(1 << (self.bits - 1 + LEVEL_FRACTION_BITS))
        relative = deviations - self.window_mean(deviations)[..., None]
        return np.clip(relative + half, 0, ((1 << self.bits) - 1) << LEVEL_FRACTION_BITS)

    def decode(self, codes: Integers, mean: Integers) -> npt.NDArray[np.int64]:
        """Return a typical count for each code, for plots, of the same shape.

        Contrast codes have lost what all counters of a window share.
        """
        octaves = (
            codes.astype(np.float64) - (1 << (self.bits - 1)) + mean / (1 << LEVEL_FRACTION_BITS)
        )
        counts = np.rint(np.exp2(octaves) - 1)
        return np.clip(counts, 0, FULL_SCALE).astype(np.int64)


class RunningMean:
    """Running mean of the logarithms of each counter, starting from the mean of the reference.

    Window number w (from 0) moves the mean by ``1 / 2**shift`` of its difference, rounded down,
    with ``shift = min(floor(log2(16 + w)), 8)``: quickly at first, then slowly.

    Parameters
    ----------
    mean : ndarray of int, shape (J,)
        Where it starts, in units of 1/256 octave.

    Attributes
    ----------
    total : ndarray of int32, shape (J,)
        The mean in units of 1/65,536 octave.
    windows : int
        How many windows it has seen.
    """

    def __init__(self, mean: Integers) -> None:
        self.total = np.asarray(mean, dtype=np.int32) << MEAN_FRACTION_BITS
        self.windows = 0

    @property
    def mean(self) -> npt.NDArray[np.int32]:
        """The mean in units of 1/256 octave, rounded to the nearest, shape (J,)."""
        return (self.total + (1 << (MEAN_FRACTION_BITS - 1))) >> MEAN_FRACTION_BITS

    def update(self, levels: Integers) -> None:
        """Update by the logarithms of one window, shape (J,), in units of 1/256 octave."""
        shift = min(((1 << FIRST_SHIFT) + self.windows).bit_length() - 1, LAST_SHIFT)
        self.total = self.total + (
            ((levels.astype(np.int32) << MEAN_FRACTION_BITS) - self.total) >> shift
        )
        self.windows += 1
