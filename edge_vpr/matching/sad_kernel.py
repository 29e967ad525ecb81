"""The SAD kernel: sums of absolute differences between the rows of two packed matrices.

The loop vectoriser widens a plain Numba loop over 8-bit counts to 32 bits, which is four times
slower than the hardware allows. The innermost step is therefore written as LLVM IR, once for all
processors: load two vectors, zero-extend, subtract, absolute value, add up. LLVM recognises this
pattern as a sum of absolute differences and uses the instructions of the processor for it:
``vpsadbw`` on x86-64, ``uabd`` and ``udot`` on a Cortex-A76, ``uabd`` and ``uaddl`` on a
Cortex-A53.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from edge_vpr.compiling import kernel

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
    """Make ``_add_piece(a, i, b, first, last, start, width, out)`` for arrays of these types.

    It adds to ``out[i, first:last]`` the absolute differences of `width` bytes from byte `start` of
    row i of a and of rows first to last of b. There is one loop for each multiple of PAD up to
    _PIECE, so that the loop has vectors of fixed length and no branches.
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


# a, b : uint8 or uint16, (M, width) and (N, width), contiguous, whole vectors of PAD bytes in a row
# out : int32 or int64, (M, N), contiguous; the sum of row i of a and row j of b is added to [i, j]
# Unchecked, as all kernels: ReferenceIndex checks. LLVM IR cannot run as plain Python.
add_sad: Any = (
    _add_sad_in_python
    if config.DISABLE_JIT  # type: ignore[attr-defined]
    else kernel(_add_sad)
)
