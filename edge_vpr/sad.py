"""The SAD kernel: sums of absolute differences between the rows of two packed matrices.

A plain Numba loop over 8-bit counts is widened to 32 bits by the loop vectoriser and runs four
times slower than the hardware allows. So the innermost step is written as LLVM IR, once for every
processor: load two vectors, zero-extend, subtract, absolute value, add up. LLVM recognises this
idiom as a sum of absolute differences and picks the processor's instructions for it: ``vpsadbw`` on
x86-64, ``uabd`` and ``udot`` on a Cortex-A76, ``uabd`` and ``uaddl`` on a Cortex-A53.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import config, njit, types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic

from edge_vpr.errors import UsageError

Packed = npt.NDArray[np.unsignedinteger[Any]]

#: bytes to which a row is padded: the narrowest vector that the kernel loads
PAD = 32
# The widest vector spans several registers, whose partial sums are added up lane by lane: the
# costly sum across lanes comes once per vector. Rows are taken as 256, 128, 64 and 32 bytes.
# So many bytes of rows of b are taken at a time, to stay in the nearest cache.
_TILE = 16384


def _type_vector_sad(context: Any, a: Any, i: Any, b: Any, j: Any, start: Any, width: Any) -> Any:
    """Add up the absolute differences of `width` bytes from `start` of row i of a, row j of b."""
    bits = a.dtype.bitwidth
    lanes = width.literal_value * 8 // bits
    narrow = ir.VectorType(ir.IntType(bits), lanes)
    wide = ir.VectorType(ir.IntType(32), lanes)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def call(name: str, result: Any, *values: Any) -> Any:
            kind = ir.FunctionType(result, [value.type for value in values])
            name = f"llvm.{name}.v{lanes}i32"
            function = get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
            return builder.call(function, values)

        def load(kind: Any, matrix: Any, row: Any) -> Any:
            array = context.make_array(kind)(context, builder, matrix)
            offset = builder.mul(row, builder.extract_value(array.strides, 0))
            data = builder.bitcast(array.data, ir.IntType(8).as_pointer())
            address = builder.gep(data, [builder.add(offset, args[4])])
            vector = builder.load(builder.bitcast(address, narrow.as_pointer()), align=1)
            return builder.zext(vector, wide)

        difference = builder.sub(load(a, args[0], args[1]), load(b, args[2], args[3]))
        absolute = call("abs", wide, difference, ir.Constant(ir.IntType(1), 0))
        return builder.zext(call("vector.reduce.add", ir.IntType(32), absolute), ir.IntType(64))

    return types.int64(a, types.int64, b, types.int64, types.int64, width), codegen


_vector_sad: Any = intrinsic(prefer_literal=True)(_type_vector_sad)


def add_sad(a: Packed, b: Packed, out: npt.NDArray[np.signedinteger[Any]]) -> None:
    """Add to ``out[i, j]`` the sum of absolute differences of row i of a and row j of b.

    Parameters
    ----------
    a, b : ndarray of uint8 or uint16, shape (M, width) and (N, width)
        Of one dtype; the bytes of a row are contiguous and a multiple of `PAD`.
    out : ndarray of int32 or int64, shape (M, N)
        Wide enough for the sums, which the caller sees to.

    Raises
    ------
    UsageError
        If a shape or dtype differs from the above.
    """
    shape = (len(a), len(b))
    rows_fit = a.shape[1:] == b.shape[1:] and a.strides[1:] == b.strides[1:] == (a.itemsize,)
    if a.dtype != b.dtype or a.dtype.kind != "u" or not rows_fit or out.shape != shape:
        raise UsageError(
            f"rows of {a.dtype} {a.shape} and {b.dtype} {b.shape} do not give sums {out.shape}: "
            "pack both alike, one row of sums for each row of the first"
        )
    if a.shape[1] * a.itemsize % PAD:
        raise UsageError(
            f"rows of {a.shape[1] * a.itemsize} bytes are not whole vectors: pad them to {PAD}"
        )
    if config.DISABLE_JIT:  # type: ignore[attr-defined] # LLVM IR cannot run as Python
        for row, sums in zip(a, out, strict=True):
            sums += np.abs(b.astype(np.int64) - row).sum(axis=1)
    else:
        _add_sad(a, b, out)


@njit(cache=True, nogil=True)
def _add_sad(a: Any, b: Any, out: Any) -> None:
    width = a.shape[1] * a.itemsize
    rows = max(1, _TILE // max(width, 1))
    for first in range(0, b.shape[0], rows):
        last = min(first + rows, b.shape[0])
        for i in range(a.shape[0]):
            start = 0
            while start < width:
                rest = width - start
                if rest >= 256:
                    for j in range(first, last):
                        out[i, j] += _vector_sad(a, i, b, j, start, 256)
                    start += 256
                elif rest >= 128:
                    for j in range(first, last):
                        out[i, j] += _vector_sad(a, i, b, j, start, 128)
                    start += 128
                elif rest >= 64:
                    for j in range(first, last):
                        out[i, j] += _vector_sad(a, i, b, j, start, 64)
                    start += 64
                else:
                    for j in range(first, last):
                        out[i, j] += _vector_sad(a, i, b, j, start, 32)
                    start += 32
