"""Sums of absolute differences (SAD) from a descriptor to each place."""

from __future__ import annotations

import math
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError

# The SAD kernel: sums of absolute differences between the rows of two packed matrices.
#
# LLVM's loop vectoriser widens a plain Numba loop over 8-bit counts to 32 bits, which is four times
# slower than the hardware allows. The innermost step is therefore written as LLVM IR, once for all
# processors: load two vectors, zero-extend, subtract, take the absolute value, add. LLVM recognises
# this pattern as a sum of absolute differences and selects the processor's instructions for it:
# ``vpsadbw`` on x86-64, ``uabd`` and ``udot`` on a Cortex-A76, ``uabd`` and ``uaddl`` on a
# Cortex-A53.


#: bytes to which a row is padded: the narrowest vector that the kernel loads
PAD = 32
# The widest vector spans several registers, whose partial sums are added lane by lane. The slow
# sum across lanes is then needed only once per vector.
_WIDTHS = (256, 128, 64, 32)
_PIECE = _WIDTHS[0]
# Number of rows of b that are processed together.
_ROWS = 4
# Bytes of rows of b that are processed at a time, so that they stay in the first-level cache.
_TILE = 16384
_INT1, _INT8, _INT32, _INT64 = (ir.IntType(bits) for bits in (1, 8, 32, 64))


def _type_add_piece(
    context: Any, a: Any, i: Any, b: Any, first: Any, last: Any, start: Any, width: Any, out: Any
) -> Any:
    """Type ``_add_piece(a, i, b, first, last, start, width, out)`` for these arrays.

    It adds to ``out[i, first:last]`` the absolute differences between row i of a and rows first to
    last of b, over `width` bytes from byte `start`. There is one loop for each multiple of PAD up
    to _PIECE, so that each loop has vectors of fixed length and no branches.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a_data, a_stride = _bytes_of(context, builder, a, args[0])
        b_data, b_stride = _bytes_of(context, builder, b, args[2])
        out_data, out_stride = _bytes_of(context, builder, out, args[7])
        i, first, last, start, width = (args[n] for n in (1, 3, 4, 5, 6))
        row = _at(builder, a_data, builder.mul(i, a_stride), start)
        sums = _at(builder, out_data, builder.mul(i, out_stride), _INT64(0))
        sums = builder.bitcast(sums, _integer(out).as_pointer())
        middle = builder.sub(last, builder.and_(builder.sub(last, first), _INT64(_ROWS - 1)))
        end = builder.append_basic_block("end")
        switch = builder.switch(width, end)
        for case in range(PAD, _PIECE + 1, PAD):
            switch.add_case(_INT64(case), builder.append_basic_block(f"width{case}"))
            builder.position_at_end(switch.cases[-1][1])
            for j0, j1, step in ((first, middle, _ROWS), (middle, last, 1)):
                with cgutils.for_range_slice(builder, j0, j1, _INT64(step)) as (j, _):
                    rows = [builder.add(j, _INT64(n)) for n in range(step)]
                    others = [_at(builder, b_data, builder.mul(r, b_stride), start) for r in rows]
                    # all sums come before the first store, so that row i is loaded only once
                    sads = [_row_sad(builder, _integer(a), row, other, case) for other in others]
                    for r, sad in zip(rows, sads, strict=True):
                        total = builder.gep(sums, [r])
                        wide = sad if out.dtype.bitwidth == 32 else builder.zext(sad, _integer(out))
                        builder.store(builder.add(builder.load(total), wide), total)
            builder.branch(end)
        builder.position_at_end(end)
        return context.get_dummy_value()

    indices = (types.int64,) * 2
    return types.void(a, types.int64, b, *indices, *indices, out), codegen


def _row_sad(builder: Any, integer: Any, row: Any, other: Any, width: int) -> Any:
    """Emit the sum of absolute differences of `width` bytes at two addresses, as 32 bits."""
    parts, offset = [], 0
    for size in _WIDTHS:
        if width & size:
            lanes = size * 8 // integer.width
            wide = ir.VectorType(_INT32, lanes)
            vectors = []
            for address in (row, other):
                address = builder.gep(address, [_INT64(offset)])
                address = builder.bitcast(address, ir.VectorType(integer, lanes).as_pointer())
                vectors.append(builder.zext(builder.load(address, align=1), wide))
            difference = builder.sub(*vectors)
            absolute = _call(builder, f"llvm.abs.v{lanes}i32", wide, difference, _INT1(0))
            parts.append(_call(builder, f"llvm.vector.reduce.add.v{lanes}i32", _INT32, absolute))
            offset += size
    return reduce(builder.add, parts)


def _bytes_of(context: Any, builder: Any, kind: Any, matrix: Any) -> tuple[Any, Any]:
    """Emit the address of a matrix and the number of bytes from row to row."""
    array = context.make_array(kind)(context, builder, matrix)
    data = builder.bitcast(array.data, _INT8.as_pointer())
    return data, builder.extract_value(array.strides, 0)


def _at(builder: Any, data: Any, row: Any, offset: Any) -> Any:
    return builder.gep(data, [builder.add(row, offset)])


def _integer(array: Any) -> Any:
    return ir.IntType(array.dtype.bitwidth)


def _call(builder: Any, name: str, result: Any, *values: Any) -> Any:
    kind = ir.FunctionType(result, [value.type for value in values])
    function = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
    return builder.call(function, values)


_add_piece: Any = intrinsic(_type_add_piece)


def _add_sad(a: Any, b: Any, out: Any) -> None:
    width = a.shape[1] * a.itemsize
    rows = max(_ROWS, _TILE // max(width, 1))
    for first in range(0, b.shape[0], rows):
        last = min(first + rows, b.shape[0])
        for i in range(a.shape[0]):
            for start in range(0, width, _PIECE):
                _add_piece(a, i, b, first, last, start, min(width - start, _PIECE), out)


def _add_sad_in_python(a: Any, b: Any, out: Any) -> None:
    for row, sums in zip(a, out, strict=True):
        sums += np.abs(b.astype(np.int64) - row).sum(axis=1)


# a, b : uint8 or uint16, (M, width) and (N, width), contiguous, rows of whole vectors of PAD bytes
# out : int32 or int64, (M, N), contiguous; the SAD of row i of a and row j of b is added to [i, j]
# Like all kernels, it checks nothing: ReferenceIndex does. LLVM IR cannot run as plain Python.
add_sad: Any = (
    _add_sad_in_python
    if config.DISABLE_JIT  # type: ignore[attr-defined]
    else kernel(_add_sad)
)


# Distances between descriptors, as sums of absolute differences (SAD).
#
# ``D[k, j]`` is the SAD of reference place k and query j over the J selected pixels. A reference is
# packed once: its lowest count is subtracted, and the rest is stored in 8 or 16 bits. A query is
# clipped to the range of the reference and packed in the same way. The clipped amount is then added
# to its distances: for a count q above the range, ``|q - r| = (q - high) + |high - r|`` at every
# place, and similarly below. The distance is thus exact for every query.


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

    >>> index = ReferenceIndex(np.array([[3, 0, 1], [0, 2, 2]], dtype=np.uint16))
    >>> index.distances(np.array([0, 1, 2]))
    array([5, 1], dtype=int32)

    Parameters
    ----------
    reference : ndarray of int, shape (K, J)
        Descriptors of the places; any integer dtype, counts of at most 32 bits.

    Attributes
    ----------
    places, pixels : int
        K and J.
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

    def distances(self, descriptor: npt.ArrayLike) -> Distances:
        """Return the distance of one query descriptor to every place.

        Parameters
        ----------
        descriptor : ndarray of int, shape (J,)
            Any integer dtype, counts of at most 32 bits.

        Returns
        -------
        ndarray of int32, shape (K,)
            int64 if J times the largest difference reaches 2**31.
        """
        counts = _integers(descriptor, "descriptor", 1)[None]
        if self._wide is not None:
            return self.rows(counts)[0]
        self._check_pixels(counts)
        out = np.zeros((1, self.places), dtype=self._sum_dtype)
        excess = _match(counts, self._low, self._high, self._packed, out)
        return self._add_excess(out, np.array([excess]))[0] if excess else out[0]

    def matrix(self, queries: npt.ArrayLike) -> Distances:
        """Return the distance of every query to every place (method.md section 4).

        Parameters
        ----------
        queries : ndarray of int, shape (Q, J)
            Any integer dtype, counts of at most 32 bits.

        Returns
        -------
        ndarray of int32, shape (K, Q)
            Row = reference place, column = query; int64 if J times the largest difference reaches
            2**31.
        """
        return self.rows(queries).T

    def rows(self, queries: npt.ArrayLike) -> Distances:
        """Return the transpose of `matrix`: a row for each query, contiguous.

        Parameters
        ----------
        queries : ndarray of int, shape (Q, J)
            See `matrix`.

        Returns
        -------
        ndarray of int32 or int64, shape (Q, K)
        """
        counts = _integers(queries, "queries", 2)
        self._check_pixels(counts)
        if self._wide is not None:
            return self._wide_rows(self._wide, counts)
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

    def _wide_rows(self, places: npt.NDArray[np.int64], counts: Integers) -> Distances:
        low, high = _range(counts)
        largest = self.pixels * (max(high, self._high) - min(low, self._low))
        out = np.empty((len(counts), self.places), dtype=_sum_dtype(largest))
        for row, query in zip(out, counts.astype(np.int64), strict=True):
            row[:] = np.abs(places - query).sum(axis=1)
        return out


#: number of distances in memory at a time, so that memory does not grow with the drive
BLOCK_DISTANCES = 4_000_000
#: largest numbers of levels, and of counts, that are processed together
_LEVELS, _COUNTS = 1 << 16, 1 << 22


def typical_distances(places: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.int64]:
    """Return the mean distance of each place to all places, less the mean of these means.

    Means are rounded down. The result is negative for a place without contrast, which is nearer to
    any view than other places are.

    Parameters
    ----------
    places : ndarray of int, shape (K, J)
        Descriptors of the places, K at least 1.

    Returns
    -------
    ndarray of int64, shape (K,)

    Examples
    --------
    >>> typical_distances(np.array([[0, 0], [4, 0], [9, 2]])).tolist()
    [1, -1, 2]
    """
    low, wide = int(places.min()), int(places.max()) - int(places.min()) + 1
    together = max(min(_LEVELS // wide, _COUNTS // len(places)), 1)  # columns
    total = np.zeros(len(places), dtype=np.int64)
    for first in range(0, places.shape[1], together):
        some = places[:, first : first + together]
        levels = np.arange(low, low + wide) if wide <= _LEVELS else np.unique(some)
        of = np.searchsorted(levels, some) if wide > _LEVELS else some.astype(np.int64) - low
        of += len(levels) * np.arange(some.shape[1])
        places_at = np.bincount(of.ravel(), minlength=levels.size * some.shape[1])
        places_at = places_at.reshape(-1, levels.size)
        # from one level to the next, each place at or below adds to the sum, each above subtracts
        below = np.cumsum(places_at, axis=1)[:, :-1]
        change = (2 * below - len(places)) * np.diff(levels)
        start = (places_at * (levels - levels[0])).sum(axis=1, keepdims=True)
        sums = np.hstack([start, start + np.cumsum(change, axis=1)])
        total += sums.ravel()[of].sum(axis=1)
    mean = total // len(places)
    return np.asarray(mean - mean.sum() // len(places))


def _integers(values: npt.ArrayLike, name: str, ndim: int) -> Integers:
    """Check counts, and convert them to a dtype and layout for which the kernel is compiled."""
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
    """Return zeros aligned to a cache line, since a vector across two lines takes two loads."""
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
    """Pack a query and compare it in one call: with few places, calls take most of the time."""
    query = np.zeros((1, places.shape[1]), dtype=places.dtype)
    excess = np.zeros(1, dtype=np.int64)
    _pack(counts, low, high, query, excess)
    add_sad(query, places, out)
    return excess[0]
