"""Checks and selection of events for the kernels: time order, sensor, selected pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.counters import select_events
from edge_vpr.errors import EventError
from edge_vpr.events import TIME_LIMIT_US, Events

_EVENTS_AT_ONCE = 1 << 16  # limits the buffers for chunks of any size


def selected_in_order(
    table: npt.NDArray[np.signedinteger], events: Events, floor_us: int, polarity: bool
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    """Find the events at selected pixels, and check that time does not run backwards.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (height, width)
        Of `PixelMap.table`.
    events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
        At least one.
    floor_us : int
        No event may be earlier: the time of the last event before these, or until which time has
        passed without any.
    polarity : bool
        Give OFF events slots of their own.

    Returns
    -------
    slots : ndarray of int32, shape (m,)
    times : ndarray of int64, shape (m,)

    Raises
    ------
    EventError
        If time runs backwards or a pixel lies off the sensor.
    """
    t = events["t"]
    if t[0] < floor_us or t[-1] < t[0]:
        raise EventError(
            f"time runs backwards, from {floor_us} to {min(t[0], t[-1])} us: sort the events, or "
            "drop the late ones"
        )
    if t[-1] > TIME_LIMIT_US:
        raise EventError(
            f"an event at {t[-1]} us lies beyond {TIME_LIMIT_US} us: check the unit of its clock"
        )
    some_slots, some_times = [], []
    for begin in range(0, events.size, _EVENTS_AT_ONCE):
        some = events[begin : begin + _EVENTS_AT_ONCE]
        p = some["p"] if polarity else None
        index, selected = select_events(table, some["x"], some["y"], p)
        some_slots.append(selected)
        some_times.append(some["t"][index])
    joined = np.concatenate(some_times)
    if joined.size and (np.any(joined[1:] < joined[:-1]) or joined[0] < t[0] or joined[-1] > t[-1]):
        raise EventError("time runs backwards within the chunk: sort the events, or drop some")
    return np.concatenate(some_slots), joined


@kernel
def few_in_order(table, events, floor, off_slots, slots, times):
    """Do the same in one pass without columns, and without the reason for an error.

    For a single event, the checks of columns would take longer than everything else.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (height, width)
    events : ndarray of EVENT_DTYPE, shape (n,)
    floor : int
    off_slots : int
        Where the slots of OFF events begin; 0 if polarity does not matter.
    slots : ndarray of int32, shape (n or more,)
    times : ndarray of int64, shape (n or more,)
        Written to.

    Returns
    -------
    int
        Events at selected pixels; -1 if anything is wrong.
    """
    last, n = floor, 0
    for i in range(events.size):
        event = events[i]
        x, y, t = event["x"], event["y"], event["t"]
        if t < last or t > TIME_LIMIT_US or y >= table.shape[0] or x >= table.shape[1]:
            return -1
        last = t
        slot = table[y, x]
        if slot >= 0:
            slots[n] = slot + (0 if event["p"] else off_slots)
            times[n] = t
            n += 1
    return n
