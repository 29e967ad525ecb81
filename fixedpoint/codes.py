"""Codes of event counts: tables from counts to a few bits, for the pipeline and the hardware.

The SAD of two descriptors is computed from their codes. If the steps of a code grow with the count,
the difference between 2 and 4 events has the same weight as that between 20 and 40, and the code
needs fewer bits than the count.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from operator import index
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fixedpoint.errors import FixedPointError
from fixedpoint.formats import UnsignedFormat
from fixedpoint.limits import MAX_BITS, MAX_FULL_SCALE

CodeKind = Literal["linear", "sqrt", "log"]
KINDS: tuple[str, ...] = get_args(CodeKind)

#: largest number of different codes in a descriptor
MAX_CODES = 256
#: default full scale of a code; chosen by experiment (docs/method.md)
FULL_SCALE = {"sqrt": 63, "log": 127}

Counts = npt.NDArray[np.integer]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class CounterCode:
    """A table from event count to code, not decreasing.

    The largest code is ``top = min(2**bits - 1, full_scale)``. A count c up to the full scale F has
    the following code, rounded to the nearest (halves up),

    - linear: ``top c / F``, which is c itself if F fits into the bits (a saturating counter)
    - sqrt: ``top sqrt(c / F)``
    - log: ``top log(1 + c) / log(1 + F)``

    and any larger count has the code `top`. All entries are exact, the same on every machine.

    Parameters
    ----------
    kind : {"linear", "sqrt", "log"}
        How codes grow with counts.
    bits : int
        1 to 16.
    full_scale : int
        Largest count that is told apart, 1 to 65,535; 0 takes ``2**bits - 1`` for a linear code, 63
        for a square root, 127 for a logarithm.

    Examples
    --------
    >>> CounterCode("log", 3).table[[0, 1, 2, 5, 20, 127]]
    array([0, 1, 2, 3, 4, 7], dtype=uint16)
    >>> CounterCode("linear", 2).encode(np.array([0, 1, 9]))
    array([0, 1, 3], dtype=uint8)
    """

    kind: CodeKind
    bits: int
    full_scale: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FixedPointError(f"counter code {self.kind!r}: choose from {', '.join(KINDS)}")
        if not 1 <= index(self.bits) <= MAX_BITS:
            raise FixedPointError(f"counter code of {self.bits} bits: expected 1 to {MAX_BITS}")
        if not 0 <= index(self.full_scale) <= MAX_FULL_SCALE:
            raise FixedPointError(
                f"counter code up to a count of {self.full_scale}: expected 1 to {MAX_FULL_SCALE}"
            )
        if self.full_scale == 0:
            full_scale = FULL_SCALE.get(self.kind, (1 << self.bits) - 1)
            object.__setattr__(self, "full_scale", full_scale)

    @classmethod
    def saturating(cls, limit: int) -> CounterCode:
        """Return the code of plain counts up to a limit: linear, with as many bits as the limit."""
        return cls("linear", min(index(limit).bit_length(), MAX_BITS), limit)

    def __str__(self) -> str:
        return f"{self.kind} {self.bits} bits up to {self.full_scale}"

    @property
    def top(self) -> int:
        """Largest code."""
        return min((1 << self.bits) - 1, self.full_scale)

    @property
    def format(self) -> UnsignedFormat:
        """Format of the codes."""
        return UnsignedFormat(self.bits)

    @cached_property
    def table(self) -> npt.NDArray[np.uint16]:
        """Code of each count, shape (full_scale + 1,); the last is also that of larger counts."""
        entries = {"linear": _linear, "sqrt": _square_root, "log": _logarithm}[self.kind]
        counts = np.arange(self.full_scale + 1, dtype=np.int64)
        table = entries(counts, self.top, self.full_scale).astype(np.uint16)
        table.setflags(write=False)
        return table

    def encode(self, counts: Counts) -> Counts:
        """Look counts up.

        Parameters
        ----------
        counts : ndarray of int
            Not negative.

        Returns
        -------
        ndarray of uint8 (uint16 from 9 bits on), of the same shape
        """
        # limit as uint16, since NumPy would convert a plain integer to the dtype of the counts
        clipped = np.minimum(counts, np.uint16(self.full_scale))
        return self.table[clipped].astype(self.format.numpy_dtype())

    def decode(self, codes: Counts) -> npt.NDArray[np.int64]:
        """Give a count in the middle of those with each code, for plots.

        A code that no count has gets the count of the next lower code, and `top` the full scale.
        """
        every = np.arange(self.top + 1)
        first = np.searchsorted(self.table, every, side="left")
        last = np.searchsorted(self.table, every, side="right") - 1
        middle = (first + last) // 2
        middle[-1] = self.full_scale
        return middle[codes]


@dataclass(frozen=True, eq=False)
class PixelCodes:
    """A code for each counter: all of one kind and width, each with its own full scale.

    Full scales are ``2**n - 1``, so that hardware needs at most sixteen tables and, for each
    counter, the number of its table.

    Parameters
    ----------
    codes : tuple of CounterCode
        The tables, all different.
    row : ndarray of uint8, shape (J,)
        Which of them each counter uses.
    """

    codes: tuple[CounterCode, ...]
    row: npt.NDArray[np.uint8]

    def __post_init__(self) -> None:
        if len({(code.kind, code.bits) for code in self.codes}) != 1:
            raise FixedPointError("counter codes of several kinds or widths: give one of each")
        row = np.asarray(self.row)
        if row.size and not (row.min() >= 0 and row.max() < MAX_CODES):
            raise FixedPointError(
                f"rows {row.min()} to {row.max()} of counter codes: expected 0 to {MAX_CODES - 1}"
            )
        row = row.astype(np.uint8)
        if row.ndim != 1 or row.size == 0 or row.max() >= len(self.codes):
            raise FixedPointError(
                f"rows of shape {row.shape} into {len(self.codes)} counter codes: "
                "give one a counter, and the codes that they name"
            )
        row.setflags(write=False)
        object.__setattr__(self, "row", row)

    @classmethod
    def shared(cls, code: CounterCode, counters: int) -> PixelCodes:
        """Give all counters one code."""
        return cls((code,), np.zeros(counters, dtype=np.uint8))

    @classmethod
    def scaled(cls, kind: CodeKind, bits: int, full_scale: Iterable[int]) -> PixelCodes:
        """Return codes with a full scale for each counter, for example from `learn_full_scale`."""
        scales, row = np.unique(np.asarray(list(full_scale), dtype=np.int64), return_inverse=True)
        if scales.size > MAX_CODES:
            raise FixedPointError(
                f"{scales.size} different full scales: expected at most {MAX_CODES}, as a counter "
                "names its code in 8 bits"
            )
        return cls(
            tuple(CounterCode(kind, bits, int(scale)) for scale in scales), row.astype(np.uint8)
        )

    @cached_property
    def tables(self) -> npt.NDArray[np.uint16]:
        """Code of each count, shape (codes, 1 + largest full scale); one row a code."""
        size = max(code.full_scale for code in self.codes) + 1
        return np.stack([np.pad(c.table, (0, size - c.table.size), "edge") for c in self.codes])

    def encode(self, counts: Counts) -> Counts:
        """Look counts up, each in its counter's table.

        Parameters
        ----------
        counts : ndarray of int, shape (..., J)
            Not negative.

        Returns
        -------
        ndarray of uint8 (uint16 from 9 bits on), of the same shape
        """
        if len(self.codes) == 1:
            return self.codes[0].encode(counts)
        codes = self.tables[self.row, np.minimum(counts, np.uint16(self.tables.shape[1] - 1))]
        return codes.astype(self.codes[0].format.numpy_dtype())

    def decode(self, codes: Counts) -> npt.NDArray[np.int64]:
        """Give a count in the middle of those with each code, for plots.

        Parameters
        ----------
        codes : ndarray of int, shape (..., J)
            Of J counters.

        Returns
        -------
        ndarray of int64, of the same shape
        """
        columns = [self.codes[row].decode(codes[..., j]) for j, row in enumerate(self.row.tolist())]
        return np.stack(columns, axis=-1)


def learn_full_scale(counts: Counts) -> npt.NDArray[np.uint16]:
    """Return the full scale of each counter for its counts in a reference traverse.

    It is the smallest ``2**n - 1``, n from 1 to 16, that at least nine of ten counts do not exceed.

    Parameters
    ----------
    counts : ndarray of int, shape (K, J)
        Raw counts of K windows, at least one.

    Returns
    -------
    ndarray of uint16, shape (J,)
    """
    rank = -(-9 * len(counts) // 10) - 1
    usual = np.sort(counts, axis=0)[rank].tolist()
    return np.array([(1 << min(max(c.bit_length(), 1), 16)) - 1 for c in usual], dtype=np.uint16)


def packed_bytes(counters: int, bits: int) -> int:
    """Bytes of one descriptor of `counters` codes, packed without gaps."""
    return -(-counters * bits // 8)


def _linear(counts: Whole, top: int, full_scale: int) -> Whole:
    return (2 * top * counts + full_scale) // (2 * full_scale)


def _square_root(counts: Whole, top: int, full_scale: int) -> Whole:
    # floor(y + 1/2) = (floor(2 y) + 1) // 2; below 2**52, floor and root are exact in float64
    return (np.sqrt(4 * top * top * counts // full_scale).astype(np.int64) + 1) // 2


def _logarithm(counts: Whole, top: int, full_scale: int) -> Whole:
    code = top * np.log(1 + counts) / math.log(1 + full_scale) + 0.5
    nearest = np.rint(code)
    codes = np.floor(code).astype(np.int64)
    # 1e-6 is larger than the error of any machine
    for i in np.flatnonzero(abs(code - nearest) <= 1e-6).tolist():
        count, near = int(counts[i]), int(nearest[i])
        # code >= n holds where (1 + count)**(2 top) >= (1 + full_scale)**(2 n - 1), in integers
        reached = near > 0 and (1 + count) ** (2 * top) >= (1 + full_scale) ** (2 * near - 1)
        codes[i] = near if reached else near - 1
    return codes
