"""Kernels that count events at selected pixels.

A table gives the slot of each pixel of the sensor, or -1 for pixels that are not selected. Almost
all events are at such pixels, so that sixteen look-ups share one branch.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from edge_vpr.compiling import kernel

# Coordinates are checked in blocks, in a loop that vectorises, so that no event can reach memory
# outside the table. The block is then still in the cache, and the check costs a tenth of the time.
# Fields of a structured array are first copied to contiguous columns, which is faster.
_BLOCK = 16384
_GROUP = 16
# returned in place of a number of events
OFF_SENSOR = -1
OFF_COUNTS = -2


@kernel
def _below(column: Any, limit: int) -> bool:
    highest = np.uint16(0)
    for i in range(column.size):
        highest = np.uint16(max(highest, column[i]))
    return bool(highest < limit)


@kernel
def _skip(table: Any, row: Any, x: Any, y: Any, start: int) -> int:
    """Skip groups of events without any at a selected pixel."""
    while start + _GROUP <= x.size:
        # loops over slices vectorise and unroll: no index can be negative
        xs, ys = x[start : start + _GROUP], y[start : start + _GROUP]
        # the AND of the slots is negative only if all of them are -1
        common = np.int64(-1)
        for i in range(_GROUP):
            common &= table[np.uint64(ys[i]) * row + np.uint64(xs[i])]
        if common >= 0:
            break
        start += _GROUP
    return start


@kernel
def _scan(table: Any, width: int, x: Any, y: Any, first: int, index: Any, slots: Any) -> int:
    """Find events at selected pixels in the block from event `first` on; return their number."""
    xs = np.ascontiguousarray(x[first : first + _BLOCK])
    ys = np.ascontiguousarray(y[first : first + _BLOCK])
    if not (_below(xs, width) and _below(ys, table.size // width)):
        return OFF_SENSOR
    row = np.uint64(width)
    found = start = 0
    while start < xs.size:
        start = _skip(table, row, xs, ys, start)
        end = min(start + _GROUP, xs.size)
        for i in range(start, end):
            slot = table[np.uint64(ys[i]) * row + np.uint64(xs[i])]
            if slot >= 0:
                index[found], slots[found] = first + i, slot
                found += 1
        start = end
    return found


@kernel
def count_slots(
    table: Any, width: int, x: Any, y: Any, p: Any, counts: Any, slots_end: int, budget: int
) -> tuple[int, int]:
    """Count until the budget is spent; the OFF counts start at `slots_end`."""
    block = min(x.size, _BLOCK)
    index, slots = np.empty(block, np.int64), np.empty(block, np.int32)
    counted = 0
    for first in range(0, x.size, _BLOCK):
        found = _scan(table, width, x, y, first, index, slots)
        if found < 0:
            return OFF_SENSOR, counted
        for i in range(found):
            slot = np.int64(slots[i])
            if slot >= slots_end:
                return OFF_COUNTS, counted
            if p is not None and not p[index[i]]:
                slot += slots_end
            counts[slot] += 1
            counted += 1
            if counted == budget:
                return index[i] + 1, counted
    return x.size, counted


@kernel
def select_slots(
    table: Any, width: int, x: Any, y: Any, p: Any, slots_end: int, index: Any, slots: Any
) -> int:
    """List the events at selected pixels; the slots of OFF events start at `slots_end`."""
    selected = 0
    for first in range(0, x.size, _BLOCK):
        found = _scan(table, width, x, y, first, index[selected:], slots[selected:])
        if found < 0:
            return OFF_SENSOR
        if p is not None:
            for i in range(selected, selected + found):
                slots[i] += 0 if p[index[i]] else slots_end
        selected += found
    return selected


@kernel
def count_pixels(x: Any, y: Any, flat: Any, width: int) -> int:
    """Count every event at its own pixel."""
    height, row = flat.size // width, np.uint64(width)
    for first in range(0, x.size, _BLOCK):
        xs = np.ascontiguousarray(x[first : first + _BLOCK])
        ys = np.ascontiguousarray(y[first : first + _BLOCK])
        if not (_below(xs, width) and _below(ys, height)):
            return OFF_SENSOR
        for i in range(xs.size):
            flat[np.uint64(ys[i]) * row + np.uint64(xs[i])] += 1
    return x.size
