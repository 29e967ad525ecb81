"""Event counters of selected pixels, or of every pixel.

Coordinates are given as columns in chunks of any size, contiguous or as fields of an event array.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counter_kernels import (
    OFF_COUNTS,
    OFF_SENSOR,
    count_pixels,
    count_slots,
    select_slots,
)
from edge_vpr.errors import EventError, UsageError

Column = npt.NDArray[Any]
Counts = npt.NDArray[np.signedinteger[Any]]

_NO_LIMIT = np.iinfo(np.int64).max


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
    _check_writeable(counts, "counters")
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
    consumed, counted = count_slots(
        table.reshape(-1), width, x, y, p, counts, slots_end, min(budget, _NO_LIMIT)
    )
    if consumed == OFF_SENSOR:
        raise _off_sensor(x, y, width, height)
    if consumed == OFF_COUNTS:
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
    selected = select_slots(table.reshape(-1), width, x, y, p, slots_end, index, slots)
    if selected == OFF_SENSOR:
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
    _check_writeable(frame, "count image")
    _check_columns(x, y, None)
    height, width = frame.shape
    if count_pixels(x, y, frame.reshape(-1), width) == OFF_SENSOR:
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


def _check_writeable(counts: Counts, name: str) -> None:
    if not counts.flags.writeable:
        raise UsageError(f"{name}: the array may only be read: give a copy to count in")


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
