"""Event counters: each event touches the counter of its own pixel, and only selected ones have one.

The kernels take the coordinates as columns, in chunks of any size, contiguous or as fields of a
structured event array. A table of the sensor gives each pixel's slot, or -1 where nothing counts:
almost every event ends there, so that sixteen look-ups share one branch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from edge_vpr.errors import EventError, UsageError

Column = npt.NDArray[Any]
Counts = npt.NDArray[np.signedinteger[Any]]

# Coordinates are checked a block at a time, in a loop that vectorises, and the block is then still
# in a near cache: the check costs a tenth, and no event can reach memory outside the table. Fields
# of a structured array are first copied to contiguous columns: faster than to stride twice.
_BLOCK = 16384
_GROUP = 16
_NO_LIMIT = np.iinfo(np.int64).max
# what the kernels return in place of a number of events
_OFF_SENSOR = -1
_OFF_COUNTS = -2


@njit(cache=True, nogil=True)
def _below(column: Any, limit: int) -> bool:
    highest = np.uint16(0)
    for i in range(column.size):
        highest = np.uint16(max(highest, column[i]))
    return bool(highest < limit)


@njit(cache=True, nogil=True)
def _skip(table: Any, row: Any, x: Any, y: Any, start: int) -> int:
    """Step over groups of events of which none lies at a selected pixel."""
    while start + _GROUP <= x.size:
        # loops over slices vectorise and unroll: no index can be negative
        xs, ys = x[start : start + _GROUP], y[start : start + _GROUP]
        # the slots' common sign bit is set only if all of them are -1
        common = np.int64(-1)
        for i in range(_GROUP):
            common &= table[np.uint64(ys[i]) * row + np.uint64(xs[i])]
        if common >= 0:
            break
        start += _GROUP
    return start


@njit(cache=True, nogil=True)
def _scan(table: Any, width: int, x: Any, y: Any, first: int, index: Any, slots: Any) -> int:
    """Note which events of the block from event `first` on lie at selected pixels; their number."""
    xs = np.ascontiguousarray(x[first : first + _BLOCK])
    ys = np.ascontiguousarray(y[first : first + _BLOCK])
    if not (_below(xs, width) and _below(ys, table.size // width)):
        return _OFF_SENSOR
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


@njit(cache=True, nogil=True)
def _count(
    table: Any, width: int, x: Any, y: Any, p: Any, counts: Any, slots_end: int, budget: int
) -> tuple[int, int]:
    """Count until the budget is spent; the OFF counts start at `slots_end`."""
    block = min(x.size, _BLOCK)
    index, slots = np.empty(block, np.int64), np.empty(block, np.int32)
    counted = 0
    for first in range(0, x.size, _BLOCK):
        found = _scan(table, width, x, y, first, index, slots)
        if found < 0:
            return _OFF_SENSOR, counted
        for i in range(found):
            slot = np.int64(slots[i])
            if slot >= slots_end:
                return _OFF_COUNTS, counted
            if p is not None and not p[index[i]]:
                slot += slots_end
            counts[slot] += 1
            counted += 1
            if counted == budget:
                return index[i] + 1, counted
    return x.size, counted


@njit(cache=True, nogil=True)
def _select(
    table: Any, width: int, x: Any, y: Any, p: Any, slots_end: int, index: Any, slots: Any
) -> int:
    """List the events at selected pixels; the slots of OFF events start at `slots_end`."""
    selected = 0
    for first in range(0, x.size, _BLOCK):
        found = _scan(table, width, x, y, first, index[selected:], slots[selected:])
        if found < 0:
            return _OFF_SENSOR
        if p is not None:
            for i in range(selected, selected + found):
                slots[i] += 0 if p[index[i]] else slots_end
        selected += found
    return selected


@njit(cache=True, nogil=True)
def _frame(x: Any, y: Any, flat: Any, width: int) -> int:
    height, row = flat.size // width, np.uint64(width)
    for first in range(0, x.size, _BLOCK):
        xs = np.ascontiguousarray(x[first : first + _BLOCK])
        ys = np.ascontiguousarray(y[first : first + _BLOCK])
        if not (_below(xs, width) and _below(ys, height)):
            return _OFF_SENSOR
        for i in range(xs.size):
            flat[np.uint64(ys[i]) * row + np.uint64(xs[i])] += 1
    return x.size


def count_events(
    table: npt.NDArray[np.signedinteger[Any]],
    x: Column,
    y: Column,
    counts: Counts,
    p: Column | None = None,
) -> int:
    """Add a chunk of events to the counters of the selected pixels.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (H, W)
        Slot of each pixel, 0 to J-1, or -1 where no event counts.
    x, y : ndarray of uint16, shape (n,)
        Columns and rows, contiguous or fields of a structured array.
    counts : ndarray of int32 or int64, shape (J,), or (2J,) with polarity
        Counters, added to in place; with polarity the OFF counts follow the ON counts.
    p : ndarray of bool, shape (n,), optional
        Polarities (True = ON), to count ON and OFF events apart.

    Returns
    -------
    int
        Number of events counted, that is, of events at selected pixels.

    Raises
    ------
    UsageError
        If a dtype or shape differs from the above.
    EventError
        If an event lies outside the table; the events before it may be counted already.
    """
    return count_until(table, x, y, counts, _NO_LIMIT, p)[1]


def count_until(
    table: npt.NDArray[np.signedinteger[Any]],
    x: Column,
    y: Column,
    counts: Counts,
    budget: int,
    p: Column | None = None,
) -> tuple[int, int]:
    """Count as :func:`count_events` does, but stop after the event that spends the budget.

    Parameters
    ----------
    table, x, y, counts, p
        As for :func:`count_events`.
    budget : int
        Number of events at selected pixels after which to stop, 0 or more.

    Returns
    -------
    consumed : int
        Number of events read; the next chunk starts with event `consumed`.
    counted : int
        Number of them counted; `budget` if it was spent.

    Raises
    ------
    UsageError, EventError
        As for :func:`count_events`; also if `budget` is negative.
    """
    _check_pixels(table, "table", (np.int16, np.int32))
    _check_columns(x, y, p)
    if counts.ndim != 1 or counts.dtype not in (np.int32, np.int64):
        raise UsageError(
            f"counters are {counts.dtype} of shape {counts.shape}: give int32 or int64, 1-D"
        )
    if p is not None and counts.size % 2:
        raise UsageError(
            f"{counts.size} counters cannot hold as many ON as OFF counts: give two per slot"
        )
    if budget < 0:
        raise UsageError(f"budget of {budget} events is negative: give 0 or more")
    if budget == 0:
        return 0, 0
    height, width = table.shape
    slots_end = counts.size if p is None else counts.size // 2
    consumed, counted = _count(
        table.reshape(-1), width, x, y, p, counts, slots_end, min(budget, _NO_LIMIT)
    )
    if consumed == _OFF_SENSOR:
        raise _off_sensor(x, y, width, height)
    if consumed == _OFF_COUNTS:
        raise UsageError(
            f"table names slot {table.max()} and there are counters for {slots_end} slots: "
            f"give counters for {table.max() + 1}"
        )
    return int(consumed), int(counted)


def select_events(
    table: npt.NDArray[np.signedinteger[Any]], x: Column, y: Column, p: Column | None = None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
    """Find the events at selected pixels.

    Parameters
    ----------
    table, x, y, p
        As for :func:`count_events`.

    Returns
    -------
    index : ndarray of int64, shape (m,)
        Which events of the chunk, in order.
    slots : ndarray of int32, shape (m,)
        Their slots; with polarity, those of OFF events follow those of ON events.

    Raises
    ------
    UsageError, EventError
        As for :func:`count_events`.
    """
    _check_pixels(table, "table", (np.int16, np.int32))
    _check_columns(x, y, p)
    height, width = table.shape
    slots_end = 0 if p is None else int(table.max()) + 1
    index, slots = np.empty(x.size, dtype=np.int64), np.empty(x.size, dtype=np.int32)
    selected = _select(table.reshape(-1), width, x, y, p, slots_end, index, slots)
    if selected == _OFF_SENSOR:
        raise _off_sensor(x, y, width, height)
    return index[:selected], slots[:selected]


def count_frame(x: Column, y: Column, frame: Counts) -> None:
    """Add a chunk of events to a count image of the whole sensor.

    Parameters
    ----------
    x, y : ndarray of uint16, shape (n,)
        Columns and rows, contiguous or fields of a structured array.
    frame : ndarray of int32 or int64, shape (H, W)
        Count image, added to in place.

    Raises
    ------
    UsageError
        If a dtype or shape differs from the above.
    EventError
        If an event lies outside the image; the events before it may be counted already.
    """
    _check_pixels(frame, "count image", (np.int32, np.int64))
    _check_columns(x, y, None)
    height, width = frame.shape
    if _frame(x, y, frame.reshape(-1), width) == _OFF_SENSOR:
        raise _off_sensor(x, y, width, height)


def _check_pixels(pixels: npt.NDArray[Any], name: str, dtypes: tuple[type, ...]) -> None:
    if (
        pixels.ndim != 2
        or not pixels.size
        or pixels.dtype not in dtypes
        or not pixels.flags.c_contiguous
    ):
        raise UsageError(
            f"{name} is {pixels.dtype} of shape {pixels.shape}: give a contiguous (H, W) array of "
            + " or ".join(dtype.__name__ for dtype in dtypes)
        )


def _check_columns(x: Column, y: Column, p: Column | None) -> None:
    for name, column in (("x", x), ("y", y)):
        if column.dtype != np.uint16:
            raise UsageError(
                f"column {name} is {column.dtype}, not uint16: build events with make_events"
            )
    if p is not None and p.dtype != np.bool_:
        raise UsageError(f"column p is {p.dtype}, not bool: build events with make_events")
    shapes = {column.shape for column in (x, y, p) if column is not None}
    if len(shapes) > 1 or x.ndim != 1:
        raise UsageError(
            f"event columns have the shapes {sorted(shapes)}: give one value per event in each"
        )


def _off_sensor(x: Column, y: Column, width: int, height: int) -> EventError:
    return EventError(
        f"event at column {x.max()} or row {y.max()} lies off the {width}x{height} sensor: "
        "name the right sensor, or drop such events when reading"
    )
