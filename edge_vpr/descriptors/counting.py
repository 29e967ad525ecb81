"""Counting: from the events of a recording to windows of counts at the selected pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.cleaning import BurstFilter
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.published import WindowSource, check_counted
from edge_vpr.descriptors.unseen import UnseenTime
from edge_vpr.descriptors.windows import (
    MAX_WINDOWS,
    Descriptors,
    FixedCount,
    FixedTime,
    Window,
    WindowCounts,
    collect,
    overlapping,
    window_of,
)
from edge_vpr.errors import EventError, MapError, UsageError, expect
from edge_vpr.events import (
    NO_EVENTS,
    Events,
    Sensor,
    as_events,
    check_after,
    check_events,
    make_events,
)
from edge_vpr.recordings.reading import EventSource
from edge_vpr.results import RemovedEvents
from edge_vpr.settings import Settings

# Kernels that count events at selected pixels.
#
# A table gives the slot of each pixel of the sensor, or -1 for pixels that are not selected. Almost
# all events are at such pixels, so that sixteen look-ups share one branch.


# Coordinates are checked in blocks, in a loop that vectorises, so that no event can reach memory
# outside the table. The block is then still in the cache, and the check costs a tenth of the time.
_BLOCK = 16384
_GROUP = 16
# returned in place of a number of events
OFF_SENSOR = -1
OFF_COUNTS = -2


@kernel(inner=True)
def _below(column: Any, limit: int) -> bool:
    highest = np.uint16(0)
    for i in range(column.size):
        highest = np.uint16(max(highest, column[i]))
    return bool(highest < limit)


@kernel(inline="always")
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
def count_slots(
    table: Any, width: int, x: Any, y: Any, counts: Any, budget: int
) -> tuple[int, int]:
    """Count until the budget is spent."""
    height, row, counted = table.size // width, np.uint64(width), 0
    for first in range(0, x.size, _BLOCK):
        xs, ys = x[first : first + _BLOCK], y[first : first + _BLOCK]
        if not (_below(xs, width) and _below(ys, height)):
            return OFF_SENSOR, counted
        start = 0
        while start < xs.size:
            start = _skip(table, row, xs, ys, start)
            for i in range(start, min(start + _GROUP, xs.size)):
                slot = np.int64(table[np.uint64(ys[i]) * row + np.uint64(xs[i])])
                if slot < 0:
                    continue
                if slot >= counts.size:
                    return OFF_COUNTS, counted
                counts[slot] += 1
                counted += 1
                if counted == budget:
                    return first + i + 1, counted
            start += _GROUP
    return x.size, counted


@kernel
def count_pixels(x: Any, y: Any, flat: Any, width: int) -> int:
    """Count every event at its own pixel."""
    height, row = np.uint64(flat.size // width), np.uint64(width)
    for i in range(x.size):
        column, line = np.uint64(x[i]), np.uint64(y[i])
        if column >= row or line >= height:
            return OFF_SENSOR
        flat[line * row + column] += 1
    return x.size


# Event counters of selected pixels, or of every pixel.
#
# Coordinates are given as columns in chunks of any size.


Column = npt.NDArray[Any]
Counts = npt.NDArray[np.signedinteger[Any]]

_NO_LIMIT = np.iinfo(np.int64).max


def count_events(
    table: npt.NDArray[np.signedinteger[Any]],
    x: Column,
    y: Column,
    counts: Counts,
) -> int:
    """Add a chunk of events to the counters of the selected pixels.

    Parameters
    ----------
    table : ndarray of int16 or int32, shape (H, W)
        Slot of each pixel, 0 to J-1, or -1 where no event counts.
    x, y : ndarray of uint16, shape (n,)
        Columns and rows.
    counts : ndarray of int32 or int64, shape (J,)
        Counters, added to in place.

    Returns
    -------
    int
        Number of events counted, that is, of events at selected pixels.
    """
    for name, array in (("table", table), ("x", x), ("y", y), ("counters", counts)):
        expect(array, np.ndarray, name, "an array")
    return count_until(table, x, y, counts, _NO_LIMIT)[1]


def count_until(
    table: npt.NDArray[np.signedinteger[Any]],
    x: Column,
    y: Column,
    counts: Counts,
    budget: int,
) -> tuple[int, int]:
    """Count as :func:`count_events` does, but stop after the event that spends the budget.

    Parameters
    ----------
    table, x, y, counts
        As for :func:`count_events`.
    budget : int
        Number of events at selected pixels after which to stop, 1 or more.

    Returns
    -------
    consumed : int
        Number of events read; the next chunk starts with event `consumed`.
    counted : int
        Number of them counted; `budget` if it was spent.
    """
    _check_pixels(table, "table", (np.int16, np.int32))
    check_columns(x, y)
    if counts.ndim != 1 or counts.dtype not in (np.int32, np.int64):
        raise UsageError(
            f"counters are {counts.dtype} of shape {counts.shape}: give int32 or int64, 1-D"
        )
    _check_writeable(counts, "counters")
    height, width = table.shape
    consumed, counted = count_slots(table.reshape(-1), width, x, y, counts, budget)
    if consumed == OFF_SENSOR:
        raise _off_sensor(x, y, width, height)
    if consumed == OFF_COUNTS:
        raise UsageError(
            f"table names slot {table.max()} and there are counters for {counts.size} slots: "
            f"give counters for {table.max() + 1}"
        )
    return int(consumed), int(counted)


def count_frame(x: Column, y: Column, frame: Counts) -> None:
    """Add a chunk of events to a count image of the whole sensor.

    Parameters
    ----------
    x, y : ndarray of uint16, shape (n,)
        Columns and rows.
    frame : ndarray of int32 or int64, shape (H, W)
        Count image, added to in place.
    """
    _check_pixels(frame, "count image", (np.int32, np.int64))
    _check_writeable(frame, "count image")
    check_columns(x, y)
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


def check_columns(x: Column, y: Column) -> None:
    """Raise UsageError unless the columns of events are of their types, and of one length."""
    for name, column in (("x", x), ("y", y)):
        if column.dtype != np.uint16:
            raise UsageError(
                f"column {name} is {column.dtype}, not uint16: build events with make_events"
            )
    if x.shape != y.shape or x.ndim != 1:
        raise UsageError(
            f"event columns have the shapes {x.shape} and {y.shape}: give one value per event in "
            "each"
        )


def _off_sensor(x: Column, y: Column, width: int, height: int) -> EventError:
    return EventError(
        f"event at column {x.max()} or row {y.max()} lies off the {width}x{height} sensor: "
        "name the right sensor, or drop such events when reading"
    )


# Conversion of a stream of events to descriptors; decides which events belong to a window.


class DescriptorStream:
    """Turns a stream of events into descriptors, however the stream is cut into chunks.

    >>> import numpy as np
    >>> from edge_vpr.events import Sensor, make_events
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> stream = DescriptorStream(two, FixedTime(tau_us=10))
    >>> stream.update(make_events(t=[0, 4, 9, 12], x=[1, 2, 1, 1], y=[0, 0, 0, 0])).counts
    array([[2, 1]], dtype=uint8)
    """

    def __init__(self, pixel_map: PixelMap, window: Window) -> None:
        expect(pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels or of a map")
        expect(window, (FixedTime, FixedCount), "window", "FixedTime(tau_us) or FixedCount(events)")
        self._table = pixel_map.table()
        self._window = window
        # if every pixel is its own slot, the counters are an image and no table is needed
        dense = pixel_map == PixelMap.all_of(pixel_map.sensor)
        self._image_shape = self._table.shape if dense else None
        self._counts = np.zeros(len(pixel_map), dtype=np.int64)
        self._counted = 0  # events still missing in a fixed-count window
        self._events = 0  # events of the open window at any pixel
        self._unseen_time = UnseenTime(window)
        self._unseen: list[tuple[int, int]] = []  # known and not taken yet: time, halves
        self._start = 0
        self.last_us = 0

    def update(self, events: Events) -> Descriptors:
        """Feed the next events.

        Parameters
        ----------
        events : Events
            In time order and on the sensor, after all those before (see `check_events`).

        Returns
        -------
        Descriptors
            Of the windows that these events completed; may be none.
        """
        return collect(self.windows(events), self._counts.size)

    def windows(self, events: Events) -> Iterator[WindowCounts]:
        """Feed the next events and yield the completed windows; `update` returns all at once."""
        events = as_events(events)
        if events.size == 0:
            return
        check_after(events, self.last_us)
        self._unseen += self._unseen_time.feed(events.t)
        if isinstance(self._window, FixedTime):
            yield from self._fixed_time(events, int(events.t[-1]), self._window.tau_us)
        else:
            yield from self._fixed_count(events, self._window.events)
        self.last_us = int(events.t[-1])

    def advance(self, until_us: int) -> Iterator[WindowCounts]:
        """Advance the time without events, and yield the windows of fixed time that end by then.

        Parameters
        ----------
        until_us : int
            Not earlier than the last event.
        """
        self._unseen += self._unseen_time.until(until_us)
        if isinstance(self._window, FixedTime):
            yield from self._fixed_time(NO_EVENTS, until_us, self._window.tau_us)

    def finish(self) -> Descriptors:
        """Return the incomplete last window, if it has events."""
        # the end of a fixed-time window does not belong to it
        end = self.last_us + 1 if isinstance(self._window, FixedTime) else self.last_us
        last = [self._take(self._start, end)] if self._events else []
        return collect(iter(last), self._counts.size)

    def _fixed_time(self, events: Events, until: int, tau: int) -> Iterator[WindowCounts]:
        t = events.t
        windows = (until - self._start) // tau
        if until // tau > MAX_WINDOWS:
            raise UsageError(
                f"time runs to {until} us, over more than {MAX_WINDOWS} windows of {tau} us: "
                "check the unit of its times (time_unit= of open_recording) and its clock, or take "
                "longer windows (tau=)"
            )
        ends = self._start + tau * np.arange(1, windows + 1)
        cut = 0
        for end, upto in zip(ends.tolist(), np.searchsorted(t, ends).tolist(), strict=True):
            self._count(events[cut:upto])
            yield self._take(end - tau, end)
            self._start, cut = end, upto
        self._count(events[cut:])

    def _fixed_count(self, events: Events, budget: int) -> Iterator[WindowCounts]:
        t, x, y = events.t, events.x, events.y
        cut = 0
        while cut < events.size:
            if not self._events:
                self._start = int(t[cut])
            consumed, counted = count_until(
                self._table, x[cut:], y[cut:], self._counts, budget - self._counted
            )
            cut += consumed
            self._events += consumed
            self._counted += counted
            if self._counted == budget:
                yield self._take(self._start, int(t[cut - 1]))

    def _count(self, events: Events) -> None:
        if events.size:
            if self._image_shape is not None:
                count_frame(events.x, events.y, self._counts.reshape(self._image_shape))
            else:
                count_until(self._table, events.x, events.y, self._counts, _NO_LIMIT)
            self._events += events.size

    def _take(self, start: int, end: int) -> WindowCounts:
        """Return the finished window and clear the counters."""
        unseen = 0
        while self._unseen and self._unseen[0][0] < end:
            unseen += self._unseen.pop(0)[1]
        taken = WindowCounts(self._counts, start, end, self._events, unseen)
        self._counts = np.zeros_like(self._counts)
        self._counted = self._events = 0
        return taken


# Counts at the selected pixels as a tonic transform; tonic itself is not needed.


@dataclass(frozen=True)
class CountPixels:
    """Count the events at the selected pixels, of a whole array or of each of its windows.

    >>> from edge_vpr.events import Sensor, make_events
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> CountPixels(two)(make_events(t=[0, 4, 9, 12], x=[1, 2, 1, 1], y=[0, 0, 0, 0]))
    array([3, 1])

    It replaces `tonic.transforms.ToFrame`: after the steps of a `tonic.transforms.Compose`, or as
    the transform of a dataset or of a `tonic.SlicedDataset`. Counts are 64 bits wide.

    Parameters
    ----------
    window : FixedTime or FixedCount, optional
        Cut the array into windows, without the incomplete last one. Fixed-time windows start at
        time 0. If absent, all events are one window, which suits the slices of a slicer.
    """

    pixel_map: PixelMap
    window: Window | None = None
    _table: npt.NDArray[np.signedinteger] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        expect(self.pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels or of a map")
        object.__setattr__(self, "_table", self.pixel_map.table())

    def __call__(self, events: Events | npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Count the events of an array.

        Parameters
        ----------
        events : Events, or structured ndarray, shape (n,)
            With the fields x and y of any integer dtype, and t for windows, in any order. The array
            is not changed.

        Returns
        -------
        ndarray of int64, shape (J,)
            With `window`, there is one row for each window, shape (K, J).
        """
        if not isinstance(events, Events):
            events = self._events_of(events)
        if self.window is not None:
            check_events(events, self.pixel_map.sensor, after=0)
            stream = DescriptorStream(self.pixel_map, self.window)
            return stream.update(events).counts.astype(np.int64)
        counts = np.zeros(len(self.pixel_map), dtype=np.int64)
        count_events(self._table, events.x, events.y, counts)
        return counts

    def _events_of(self, array: npt.NDArray[Any]) -> Events:
        """Return the events of a structured array, whose fields are those that are counted by."""
        needed = "xy" + "t" * (self.window is not None)
        if not set(needed) <= set(array.dtype.names or ()):
            raise EventError(
                f"event array has dtype {array.dtype}, without all of the fields "
                f"{', '.join(sorted(needed))}: give a structured array as tonic's datasets do"
            )
        t = array["t"] if "t" in needed else np.zeros(array.shape, np.int64)
        return make_events(t, array["x"], array["y"])


# The events of a recording without bursts, and the number of removed events.


@dataclass
class Removed:
    """Counts of what cleaning removed in the newest pass over a recording; filled while reading.

    Attributes
    ----------
    events : int
        Read in all.
    burst_events : int
        Removed as bursts.
    """

    events: int = 0
    burst_events: int = 0

    @property
    def burst_share(self) -> float:
        """Share of the events that were removed as bursts."""
        return self.burst_events / self.events if self.events else 0.0

    def record(self, hot_pixels: int) -> RemovedEvents:
        """Return what was removed, for `run.json`."""
        return RemovedEvents(self.events, self.burst_events, self.burst_share, hot_pixels)


def cleaned(
    recording: EventSource, settings: Settings, removed: Removed | None = None
) -> Iterator[Events]:
    """Yield the events of a recording, without bursts if the settings ask for it.

    Parameters
    ----------
    removed : Removed, optional
        Is filled with what was left out.
    """
    removed = Removed() if removed is None else removed
    removed.events = removed.burst_events = 0
    bursts = BurstFilter(recording.sensor) if settings.remove_bursts else None
    for events in recording:
        removed.events += int(events.size)
        if bursts is None:
            yield events
        else:
            yield from bursts.pieces(events)
            removed.burst_events = bursts.removed
    if bursts is not None:
        yield bursts.finish()
        removed.burst_events = bursts.removed


def event_windows(
    recording: EventSource, stream: DescriptorStream, settings: Settings, removed: Removed | None
) -> Iterator[WindowCounts]:
    """Yield the windows of a recording's cleaned events.

    Parameters
    ----------
    removed : Removed, optional
        Is filled with what was left out.
    """
    for events in cleaned(recording, settings, removed):
        yield from stream.windows(events)
    if recording.end_us is not None:
        yield from stream.advance(recording.end_us)


# The windows of a drive, counted.


def check_sensor(recording: Sensor, mapped: Sensor) -> None:
    """Check that the recording has the sensor of the map; raise MapError if not."""
    if recording != mapped:
        raise MapError(
            f"the recording is of a {recording} sensor and the map of a {mapped} one: use the map "
            "of this camera, or name the right sensor (sensor=)"
        )


def count_windows(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    removed : Removed, optional
        Is filled with what was left out.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    UsageError
        If the recording is shorter than a window.
    """
    check_sensor(recording.sensor, pixel_map.sensor)
    stream = None
    if isinstance(recording, WindowSource):
        check_counted(recording, pixel_map, settings)
        flat = pixel_map.y.astype(np.int64) * pixel_map.sensor.width + pixel_map.x
        windows: Iterator[WindowCounts] = (
            window._replace(counts=window.counts[flat]) for window in recording.windows()
        )
    else:
        stream = DescriptorStream(pixel_map, window_of(settings))
        windows = event_windows(recording, stream, settings, removed)
    counted = collect(windows, len(pixel_map))
    if len(counted) == 0:
        raise too_short(window_of(settings), stream)
    return replace(counted, selected=counted.selected_events)


def count_places(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the windows of a drive that can be places: as `count_windows`, or overlapping ones.

    With N places per window, a place starts at each N-th part of a window and is one window long.
    Every N-th place is therefore one of the map with one place per window.

    Raises
    ------
    UsageError
        If the recording is shorter than a window, holds no events, or a window has no whole parts.
    """
    number = settings.window_parts
    if number == 1:
        return replace(count_windows(recording, pixel_map, settings, removed), unseen=None)
    check_parts(recording, settings)
    part: dict[str, object] = {"places_per_window": 1, "tau_us": max(settings.tau_us // number, 1)}
    if settings.events_per_pixel is not None:
        part["events_per_pixel"] = settings.events_per_pixel / number
    pieces = count_windows(
        recording, pixel_map, settings.replaced(part, "parts of a window"), removed
    )
    places = overlapping(pieces, number)
    if len(places) == 0:
        raise too_short(window_of(settings))
    return places


def check_parts(recording: EventSource | WindowSource, settings: Settings) -> None:
    """Raise UsageError unless places can start at the parts of a window that the settings say."""
    number = settings.window_parts
    if number == 1:
        return
    where = f"setting places_per_window = {number}"
    if isinstance(recording, WindowSource):
        raise UsageError(
            f"{where} needs events, and published windows hold counts: set places_per_window to 1"
        )
    if settings.window == "time" and settings.tau_us % number:
        raise UsageError(
            f"{where} with windows of {settings.tau_us} us: expected an even number of microseconds"
        )
    by_count = settings.window == "count" and settings.events_per_pixel is not None
    if by_count and settings.events_per_window % number:
        raise UsageError(
            f"{where} with windows of {settings.events_per_window} events: expected an even "
            "number; set events_per_pixel to auto, or to another value"
        )


def too_short(window: Window, stream: DescriptorStream | None = None) -> UsageError:
    """Return the error of a recording without a whole window, whose events `stream` got."""
    last_us = 0 if stream is None else stream.last_us
    end = f", its last event is at {last_us / 1e6:g} s" if last_us else ""
    return UsageError(
        f"the recording is shorter than one window of {window}{end}: "
        "take shorter windows, or a longer drive"
    )
