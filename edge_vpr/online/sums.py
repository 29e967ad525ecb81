"""Vector kernels of sums: change the sums of all places by +-1, and find the smallest one.

When a counter of the window changes from v to v + 1, its distance to a place changes by +1 if the
count in the map is at most v, and by -1 otherwise. Several such changes (arrivals and expiries at
any pixels) are accumulated in 8-bit lanes and then added to the sums in one pass.

The intrinsics emit generic vector IR, which LLVM compiles for any target; it would widen plain
loops to 32 bits or more. With Numba's compiler off, NumPy makes the same changes.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from edge_vpr.compiling import kernel

#: places in one vector; arrays end with this many padding elements
LANES = 64
#: changes in one pass; their sum must fit into a signed byte
MAX_CHANGES = 120
#: places whose sums stay in the first-level cache between update and search
BLOCK = 4096

_I8, _I32, _I64 = ir.IntType(8), ir.IntType(32), ir.IntType(64)


def _splat(builder, value):
    vector = ir.VectorType(value.type, LANES)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return builder.shuffle_vector(first, nothing, zeros)


def _load(builder, data, index, vector):
    pointer = builder.bitcast(builder.gep(data, [index]), vector.as_pointer())
    return builder.load(pointer, align=1)


def _loop(builder, start, stop, step, carried, body):
    """``for i in range(start, stop, step): carried = body(i, carried)``."""
    before = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "body", "end"))
    builder.branch(head)
    builder.position_at_end(head)
    i = builder.phi(_I64)
    i.add_incoming(start, before)
    value = builder.phi(carried.type)
    value.add_incoming(carried, before)
    builder.cbranch(builder.icmp_signed("<", i, stop), inside, after)
    builder.position_at_end(inside)
    new = body(i, value)
    i.add_incoming(builder.add(i, ir.Constant(_I64, step)), builder.block)
    value.add_incoming(new, builder.block)
    builder.branch(head)
    builder.position_at_end(after)
    return value


def _smaller(builder, a, b):
    return builder.select(builder.icmp_unsigned("<", a, b), a, b)


def _least_lane(builder, vector):
    """Return the smallest lane, by halving the vector until one lane is left."""
    width = LANES
    while width > 1:
        width //= 2
        nothing = ir.Constant(vector.type, ir.Undefined)
        low, high = (
            builder.shuffle_vector(
                vector,
                nothing,
                ir.Constant(ir.VectorType(_I32, width), list(range(first, first + width))),
            )
            for first in (0, width)
        )
        vector = _smaller(builder, low, high)
    return builder.extract_element(vector, ir.Constant(_I32, 0))


@intrinsic
def _vector_change(typing_context, sums, columns, changes, arrivals, expiries, start, stop):
    """Apply the first `arrivals` and the last `expiries` changes, and find the least sum."""
    signature = sums.dtype(sums, columns, changes, arrivals, expiries, start, stop)

    def codegen(context, builder, signature, arguments):
        sums_a, columns_a, changes_a = (
            context.make_array(signature.args[i])(context, builder, arguments[i]).data
            for i in range(3)
        )
        arrivals, expiries, start, stop = arguments[3:]
        end = ir.Constant(_I64, MAX_CHANGES)
        count_type = ir.IntType(columns.dtype.bitwidth)
        sum_vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)
        byte_vector = ir.VectorType(_I8, LANES)
        # each arrival adds 1 and each expiry subtracts 1; the opposite if the map's count is larger
        change = builder.sub(arrivals, expiries)
        base = _splat(builder, builder.trunc(change, sum_vector.element))

        def one_vector(place, least):
            def add_above(sign):
                def one_step(o, total):
                    offset = builder.load(builder.gep(changes_a, [o]))
                    counts = _load(
                        builder,
                        columns_a,
                        builder.add(offset, place),
                        ir.VectorType(count_type, LANES),
                    )
                    level = builder.load(builder.gep(changes_a, [builder.add(o, end)]))
                    level = _splat(builder, builder.trunc(level, count_type))
                    # all ones, that is -1, where the map's count is above the level
                    above = builder.sext(builder.icmp_unsigned(">", counts, level), byte_vector)
                    return builder.add(total, above) if sign > 0 else builder.sub(total, above)

                return one_step

            total = ir.Constant(byte_vector, [0] * LANES)
            total = _loop(builder, ir.Constant(_I64, 0), arrivals, 1, total, add_above(1))
            total = _loop(builder, builder.sub(end, expiries), end, 1, total, add_above(-1))
            wide = builder.sext(total, sum_vector)
            pointer = builder.bitcast(builder.gep(sums_a, [place]), sum_vector.as_pointer())
            old = builder.load(pointer, align=1)
            new = builder.add(builder.add(old, base), builder.add(wide, wide))
            builder.store(new, pointer, align=1)
            return _smaller(builder, new, least)

        largest = ir.Constant(sum_vector, [2**sums.dtype.bitwidth - 1] * LANES)
        return _least_lane(builder, _loop(builder, start, stop, LANES, largest, one_vector))

    return signature, codegen


@intrinsic
def _vector_least(typing_context, sums, start, stop):
    """Return the smallest of ``sums[start:stop]``, which is at least one vector long."""

    def codegen(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        start, stop = arguments[1:]
        vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)

        # the last vector may overlap the one before it
        last = builder.sub(stop, ir.Constant(_I64, LANES))
        least = _loop(
            builder,
            start,
            last,
            LANES,
            _load(builder, data, last, vector),
            lambda i, value: _smaller(builder, value, _load(builder, data, i, vector)),
        )
        return _least_lane(builder, least)

    return sums.dtype(sums, start, stop), codegen


@intrinsic
def _vector_find(typing_context, sums, start, value):
    """Return the first i with ``sums[start + i] == value`` in one vector, or LANES."""

    def codegen(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)
        equal = builder.icmp_unsigned(
            "==", _load(builder, data, arguments[1], vector), _splat(builder, arguments[2])
        )
        # number of trailing zeros of the comparison; 64 if no bit is set
        return builder.cttz(builder.bitcast(equal, _I64), ir.Constant(ir.IntType(1), 0))

    return types.int64(sums, start, sums.dtype), codegen


@intrinsic
def _vector_count(typing_context, sums, start, lanes, value):
    """Return how many of the first 1 to LANES sums from `start` on have a value."""

    def codegen(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        vector = ir.VectorType(ir.IntType(sums.dtype.bitwidth), LANES)
        equal = builder.icmp_unsigned(
            "==", _load(builder, data, arguments[1], vector), _splat(builder, arguments[3])
        )
        others = builder.sub(ir.Constant(_I64, LANES), arguments[2])
        return builder.ctpop(builder.shl(builder.bitcast(equal, _I64), others))

    return types.int64(sums, start, lanes, sums.dtype), codegen


if config.DISABLE_JIT:

    def change_sums(sums, columns, changes, arrivals, expiries, start, stop):
        """Apply +-1 changes to ``sums[start:stop]`` and find the smallest, as the kernel below."""
        for o in (*range(arrivals), *range(MAX_CHANGES - expiries, MAX_CHANGES)):
            offset, level = changes[:, o]
            column = columns[offset + start : offset + stop]
            change = np.where(column > level, -1, 1) * (1 if o < arrivals else -1)
            sums[start:stop] += change.astype(sums.dtype)  # -1 wraps, as intended
        return sums[start:stop].min()

    def _least(sums, start, stop):
        return sums[start:stop].min()

    def _first_equal(sums, start, stop, value):
        return start + int(np.argmax(sums[start:stop] == value))

    def _count(sums, start, stop, value):
        return np.count_nonzero(sums[start:stop] == value)

else:

    @kernel(inline="always")
    def change_sums(sums, columns, changes, arrivals, expiries, start, stop):
        """Apply +-1 changes to ``sums[start:stop]``, and return the smallest sum.

        Padding elements after `stop` change too; they must be larger than all sums.

        Parameters
        ----------
        sums : ndarray of uint16 or uint32, shape (places + LANES + blocks,)
            Sums of the places, padding, and the smallest sum of each block.
        columns : ndarray of uint8 or uint16
            Map, the places of one pixel after another, and LANES padding elements.
        changes : ndarray of int64, shape (2, MAX_CHANGES)
            For each step, the index in `columns` of the count that belongs to ``sums[0]``, and the
            smaller of the two counts of the step.
        arrivals, expiries : int
            The first `arrivals` changes increase a count, the last `expiries` decrease one;
            together at most MAX_CHANGES.
        start, stop : int
            `start` is a multiple of LANES.

        Returns
        -------
        least
        """
        return _vector_change(sums, columns, changes, arrivals, expiries, start, stop)

    @kernel(inline="always")
    def _least(sums, start, stop):
        if stop - start >= LANES:
            return _vector_least(sums, start, stop)
        least = sums[start]
        for i in range(start + 1, stop):
            least = min(least, sums[i])
        return least

    @kernel(inline="always")
    def _first_equal(sums, start, stop, value):
        i = start
        while True:
            # reading past `stop` is harmless: the value occurs before it
            lane = _vector_find(sums, i, value)
            if lane < LANES:
                return i + lane
            i += LANES

    @kernel(inline="always")
    def _count(sums, start, stop, value):
        total = 0
        for i in range(start, stop, LANES):
            # reading past `stop` is harmless: the array ends with padding
            total += _vector_count(sums, i, min(LANES, stop - i), value)
        return total


@kernel(inline="always")
def least_in(sums, count, start, stop):
    """Return the first index of the smallest of ``sums[start:stop]``, and its value.

    Parameters
    ----------
    sums : ndarray of uint16 or uint32, shape (count + LANES + blocks,)
        At the end, the smallest of each BLOCK of the first `count` sums, see `update_blocks`.
    count, start, stop : int
        ``start < stop <= count``.

    Returns
    -------
    index, value
    """
    best_block = -1
    best = sums[start]
    for block in range(start // BLOCK, (stop - 1) // BLOCK + 1):
        first, end = block * BLOCK, min((block + 1) * BLOCK, count)
        whole = start <= first and end <= stop
        least = (
            sums[count + LANES + block]
            if whole
            else _least(sums, max(start, first), min(stop, end))
        )
        if best_block < 0 or least < best:
            best_block, best = block, least
    return _first_equal(sums, max(start, best_block * BLOCK), stop, best), best


@kernel(inline="always")
def ties_behind(sums, count, best, stop):
    """Return how many of ``sums[best + 1 : stop]``, none of which is smaller, equal ``sums[best]``.

    Parameters
    ----------
    sums, count
        See `least_in`.
    best, stop : int
        ``best < stop <= count``.
    """
    ties = 0
    for block in range(best // BLOCK, (stop - 1) // BLOCK + 1):
        # the block may be smaller behind `stop`
        if sums[count + LANES + block] <= sums[best]:
            first, end = max(best + 1, block * BLOCK), min(stop, (block + 1) * BLOCK)
            ties += _count(sums, first, end, sums[best])
    return ties


@kernel(inline="always")
def update_blocks(sums, columns, changes, arrivals, expiries, count):
    """Apply changes to the first `count` sums, and store the smallest of each block after them."""
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        sums[count + LANES + start // BLOCK] = change_sums(
            sums, columns, changes, arrivals, expiries, start, stop
        )
