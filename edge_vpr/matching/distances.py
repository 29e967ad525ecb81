"""Distances between descriptors, as sums of absolute differences (SAD).

``D[k, j]`` is the SAD of reference place k and query j over the J selected pixels. A reference is
packed once: its lowest count is subtracted, and the rest is stored in 8 or 16 bits. A query is
clipped to the range of the reference and packed in the same way. The clipped amount is then added
to its distances: for a count q above the range, ``|q - r| = (q - high) + |high - r|`` at every
place, and similarly below. The distance is thus exact for every query.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.matching.sad_kernel import PAD, add_sad

Integers = npt.NDArray[np.integer[Any]]
Packed = npt.NDArray[np.unsignedinteger[Any]]
Distances = npt.NDArray[np.signedinteger[Any]]

# Counts have at most 32 bits, so that any sum of differences fits into 64 bits.
_LIMIT = 2**32
# other integers are copied
_COMPILED = frozenset(map(np.dtype, (np.uint8, np.uint16, np.int32, np.int64)))
_LINE = 64  # bytes of a cache line


class ReferenceIndex:
    """A reference traverse, packed for matching.

    Parameters
    ----------
    reference : ndarray of int, shape (K, J)
        Descriptors of the places; any integer dtype, counts of at most 32 bits.

    Attributes
    ----------
    places, pixels : int
        K and J.

    Raises
    ------
    UsageError
        If the reference is not a matrix of such integers.

    Examples
    --------
    >>> index = ReferenceIndex(np.array([[3, 0, 1], [0, 2, 2]], dtype=np.uint16))
    >>> index.distances(np.array([0, 1, 2]))
    array([5, 1], dtype=int32)
    """

    def __init__(self, reference: npt.ArrayLike) -> None:
        counts = _integers(reference, "reference", 2)
        self.places, self.pixels = counts.shape
        self._low, self._high = _range(counts)
        span = self._high - self._low
        # rare: places with a count above 65,535, which are not packed
        self._wide = counts.astype(np.int64) if span > 0xFFFF else None
        self._dtype = np.dtype(np.uint8 if span <= 0xFF else np.uint16)
        self._width = -(-self.pixels * self._dtype.itemsize // PAD) * PAD // self._dtype.itemsize
        self._sum_dtype = _sum_dtype(self.pixels * span)
        if self._wide is None:
            self._packed, _ = self._pack(counts)

    @property
    def nbytes(self) -> int:
        """Memory of the packed descriptors."""
        return self._packed.nbytes if self._wide is None else self._wide.nbytes

    def distances(self, descriptor: npt.ArrayLike) -> Distances:
        """Return the distance of one query descriptor to every place.

        Parameters
        ----------
        descriptor : ndarray of int, shape (J,)
            Any integer dtype, counts of at most 32 bits.

        Returns
        -------
        ndarray of int32, shape (K,)
            Of int64 where J times the largest difference reaches 2**31.

        Raises
        ------
        UsageError
            If the descriptor is not a vector of J such integers.
        """
        counts = _integers(descriptor, "descriptor", 1)[None]
        if self._wide is not None:
            return self.matrix(counts)[:, 0]
        self._check_pixels(counts)
        out = np.zeros((1, self.places), dtype=self._sum_dtype)
        excess = _match(counts, self._low, self._high, self._packed, out)
        return self._add_excess(out, np.array([excess]))[0] if excess else out[0]

    def matrix(self, queries: npt.ArrayLike) -> Distances:
        """Return the distance of every query to every place.

        Parameters
        ----------
        queries : ndarray of int, shape (Q, J)
            Any integer dtype, counts of at most 32 bits.

        Returns
        -------
        ndarray of int32, shape (K, Q)
            Row = reference place, column = query; of int64 where J times the largest difference
            reaches 2**31.

        Raises
        ------
        UsageError
            If the queries are not a matrix of such integers, J in a row.
        """
        counts = _integers(queries, "queries", 2)
        self._check_pixels(counts)
        if self._wide is not None:
            return self._wide_matrix(self._wide, counts)
        packed, excess = self._pack(counts)
        out = np.zeros((self.places, len(counts)), dtype=self._sum_dtype)
        add_sad(self._packed, packed, out)
        return self._add_excess(out, excess)

    def rows(self, queries: npt.ArrayLike) -> Distances:
        """Distance of every query to every place, as `matrix` gives it, with a query in each row.

        Parameters
        ----------
        queries : ndarray of int, shape (Q, J)

        Returns
        -------
        ndarray of int32 or int64, shape (Q, K)
        """
        counts = _integers(queries, "queries", 2)
        self._check_pixels(counts)
        if self._wide is not None:
            return np.ascontiguousarray(self._wide_matrix(self._wide, counts).T)
        packed, excess = self._pack(counts)
        out = np.zeros((len(counts), self.places), dtype=self._sum_dtype)
        add_sad(packed, self._packed, out)
        return self._add_excess(out, excess[:, None])

    def _check_pixels(self, counts: Integers) -> None:
        if counts.shape[1] != self.pixels:
            raise UsageError(
                f"query descriptors have {counts.shape[1]} counts and the reference "
                f"{self.pixels}: describe both with the same map"
            )

    def _pack(self, counts: Integers) -> tuple[Packed, npt.NDArray[np.int64]]:
        """Clip to the reference's range, subtract its lowest count, pad rows to whole vectors."""
        shape = (len(counts), self._width)
        packed = aligned_zeros(math.prod(shape), self._dtype).reshape(shape)
        excess = np.zeros(len(counts), dtype=np.int64)
        _pack(counts, self._low, self._high, packed, excess)
        return packed, excess

    def _add_excess(self, out: Distances, excess: npt.NDArray[np.int64]) -> Distances:
        if excess.any():
            largest = self.pixels * (self._high - self._low) + int(excess.max())
            out = out.astype(_sum_dtype(largest), copy=False)
            out += excess.astype(out.dtype)
        return out

    def _wide_matrix(self, places: npt.NDArray[np.int64], counts: Integers) -> Distances:
        low, high = _range(counts)
        largest = self.pixels * (max(high, self._high) - min(low, self._low))
        out = np.empty((self.places, len(counts)), dtype=_sum_dtype(largest))
        for j, query in enumerate(counts.astype(np.int64)):
            out[:, j] = np.abs(places - query).sum(axis=1)
        return out


def distance_matrix(reference: npt.ArrayLike, query: npt.ArrayLike) -> Distances:
    """Return the distance of every query to every reference place (method.md section 4).

    Parameters
    ----------
    reference, query : ndarray of int, shape (K, J) and (Q, J)
        Any integer dtypes, counts of at most 32 bits.

    Returns
    -------
    ndarray of int32 or int64, shape (K, Q)
        As :meth:`ReferenceIndex.matrix` gives it.

    Raises
    ------
    UsageError
        If one is not a matrix of such integers, or they differ in J.
    """
    return ReferenceIndex(reference).matrix(query)


def _integers(values: npt.ArrayLike, name: str, ndim: int) -> Integers:
    """Check counts, and convert them to a dtype and layout that the kernel is compiled for."""
    counts = np.asarray(values)
    if counts.dtype.kind not in "iu" or counts.ndim != ndim:
        raise UsageError(
            f"{name}: {counts.dtype} of shape {counts.shape}: give integers in {ndim} dimension(s)"
        )
    if counts.dtype.itemsize == 8:
        low, high = _range(counts)
        if low < -_LIMIT or high > _LIMIT:
            raise UsageError(f"{name}: counts from {low} to {high} exceed 32 bits: check the data")
    if counts.dtype not in _COMPILED:
        counts = counts.astype(np.int64)
    return np.ascontiguousarray(counts)


def _sum_dtype(largest: int) -> type[np.signedinteger[Any]]:
    return np.int32 if largest < 2**31 else np.int64


def aligned_zeros(size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return zeros that begin at a cache line, since a vector across two lines takes two loads."""
    itemsize = np.dtype(dtype).itemsize
    spacious = np.zeros(size + _LINE // itemsize, dtype=dtype)
    first = -spacious.ctypes.data % _LINE // itemsize
    return spacious[first : first + size]


def _range(counts: Integers) -> tuple[int, int]:
    return (int(counts.min()), int(counts.max())) if counts.size else (0, 0)


@kernel
def _pack(counts: Any, low: int, high: int, packed: Any, excess: Any) -> None:
    for i in range(counts.shape[0]):
        row, packed_row = counts[i], packed[i]
        beyond = np.int64(0)
        for j in range(row.size):
            count = np.int64(row[j])
            clipped: Any = min(max(count, low), high)
            packed_row[j] = clipped - low
            beyond += abs(count - clipped)
        excess[i] = beyond


@kernel
def _match(counts: Any, low: int, high: int, places: Any, out: Any) -> int:
    """Pack a query and compare it in one call; with few places, calls take most of the time."""
    query = np.zeros((1, places.shape[1]), dtype=places.dtype)
    excess = np.zeros(1, dtype=np.int64)
    _pack(counts, low, high, query, excess)
    add_sad(query, places, out)
    return excess[0]
