"""The event array, its sensor, and the checks of events that come from outside."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EventError, UsageError, expect, kind_of

#: One event: time in microseconds from the recording's start, column, row, polarity (True = ON).
#: The field names are those of tonic, so that its transforms accept these arrays.
EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "?")])

Events = npt.NDArray[Any]
"""A structured array of :data:`EVENT_DTYPE`, shape ``(n,)``."""
_PLAIN = np.dtype(f"V{EVENT_DTYPE.itemsize}")
NO_EVENTS = np.empty(0, dtype=EVENT_DTYPE)

#: Longest side of a sensor in pixels: columns and rows are 16 bits.
LONGEST_SIDE = 1 << 16
#: Times lie between minus and plus this, in microseconds: differences of two cannot overflow.
TIME_LIMIT_US = 1 << 60


class Sensor(NamedTuple):
    """Size in pixels; a pixel is ``(x, y)``, ``0 <= x < width``, ``0 <= y < height``.

    >>> Sensor(346, 260).pixels
    89960
    >>> Sensor.parse("346x260")
    Sensor(width=346, height=260)
    """

    width: int
    height: int

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width * self.height

    @property
    def possible(self) -> bool:
        """Whether both sides have 1 to 65,536 pixels, the range of coordinates of an event."""
        return 0 < self.width <= LONGEST_SIDE and 0 < self.height <= LONGEST_SIDE

    @classmethod
    def of(cls, given: SensorSize) -> Sensor:
        """Return a sensor from its width and height, or from a text such as ``"346x260"``.

        A third number, of polarities, may follow as in ``sensor_size`` of tonic.
        """
        if isinstance(given, str):
            return cls.parse(given)
        if isinstance(given, tuple | list) and len(given) == 3:
            given = given[0], given[1]
        if not isinstance(given, tuple | list) or len(given) != 2:
            raise UsageError(
                f"sensor {given!r} is no width and height: give for example Sensor(346, 260) or "
                "'346x260'"
            )
        sensor = cls(*given)
        whole = all(isinstance(side, int | np.integer) for side in sensor)
        if not whole or not sensor.possible:
            raise UsageError(f"sensor {given!r} has a side that is no number from 1 to 65536")
        return sensor

    @classmethod
    def parse(cls, text: str) -> Sensor:
        """Read ``"346x260"``."""
        expect(text, str, "sensor", "text such as '346x260'")
        sides = re.fullmatch(r"\s*([0-9]{1,9})\s*[xX]\s*([0-9]{1,9})\s*", text)
        if sides is None:
            raise UsageError(f"sensor {text!r} is not WIDTHxHEIGHT: write for example 346x260")
        sensor = cls(int(sides[1]), int(sides[2]))
        if not sensor.possible:
            raise UsageError(f"sensor {text!r} has a side outside 1 to 65536: check the numbers")
        return sensor

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


#: How a caller can write the size of a sensor: see `Sensor.of`.
SensorSize: TypeAlias = Sensor | tuple[int, int] | tuple[int, int, int] | str


def make_events(
    t: npt.ArrayLike, x: npt.ArrayLike, y: npt.ArrayLike, p: npt.ArrayLike | None = None
) -> Events:
    """Make an event array from columns.

    Parameters
    ----------
    t, x, y, p : array_like, shape (n,)
        Times in whole microseconds, columns, rows, polarities (greater than 0 is ON; all ON if
        absent).

    Returns
    -------
    ndarray of EVENT_DTYPE, shape (n,)
    """
    for name, values in (("t", t), ("x", x), ("y", y), ("p", 0 if p is None else p)):
        _check_numbers(name, np.asarray(values))
    times = np.asarray(t)
    events = np.empty(times.shape, dtype=EVENT_DTYPE)
    for name, column in (("x", np.asarray(x)), ("y", np.asarray(y))):
        if column.shape != times.shape:
            raise EventError(
                f"column {name} has {column.size} values and t has {times.size}: "
                "each event needs one of each"
            )
        if column.size and (column.min() < 0 or column.max() > 0xFFFF):
            raise EventError(
                f"column {name} spans {column.min()} to {column.max()}, outside 0 to 65535: "
                "check the order of the columns"
            )
        events[name] = column
    events["t"] = times
    events["p"] = True if p is None else np.asarray(p) > 0
    return events


def _check_numbers(name: str, column: npt.NDArray[Any]) -> None:
    """Raise EventError unless the values of a column are numbers, whole ones but of polarity."""
    if column.dtype.kind not in "biuf":
        raise EventError(
            f"column {name} holds {column.dtype}: give numbers ({name}.astype(int), if they are)"
        )
    if column.dtype.kind == "f":
        whole = (column == np.floor(column)) & (np.abs(column) <= TIME_LIMIT_US)
        good = np.isfinite(column) if name == "p" else whole
        if not good.all():
            give = {"t": "whole microseconds, of seconds np.rint(t * 1e6)", "p": "numbers"}
            raise EventError(
                f"column {name} holds {column[~good][0]}: give {give.get(name, 'whole numbers')}"
            )


def as_events(given: object) -> Events:
    """Return an array with the fields t, x, y and perhaps p, of any types, as an event array."""
    check_event_array(given)
    assert isinstance(given, np.ndarray)
    if given.dtype == EVENT_DTYPE:
        return given
    return make_events(*(given[name] for name in "txyp" if name in given.dtype.names))


def in_order(chunks: Iterable[Events], sensor: Sensor) -> Iterator[Events]:
    """Yield the event arrays of a source outside of this package, none of them empty.

    Raises
    ------
    EventError
        If time runs backwards, also between two arrays, or a pixel lies off the sensor.
    """
    last = None
    for chunk in chunks:
        events = as_events(chunk)
        check_events(events, sensor, after=last)
        if events.size:
            last = int(events["t"][-1])
            yield events


def check_events(events: Events, sensor: Sensor, *, after: int | None = None) -> None:
    """Check that `events` is a time-ordered event array of this sensor.

    Parameters
    ----------
    after : int, optional
        Time of the last event before these, in microseconds; none of these may be earlier.
    """
    check_event_array(events)
    if events.size == 0:
        return
    x_max, y_max = int(events["x"].max()), int(events["y"].max())
    if x_max >= sensor.width or y_max >= sensor.height:
        raise EventError(
            f"pixel at column {x_max} or row {y_max} lies off the {sensor} sensor: "
            "name the right sensor, or drop such events when reading"
        )
    t = events["t"]
    back = np.flatnonzero(t[1:] < t[:-1])
    if back.size:
        i = int(back[0])
        raise EventError(
            f"time runs backwards at event {i + 1}, from {t[i]} to {t[i + 1]} us: "
            "sort the events, or drop the late ones when reading"
        )
    if after is not None:
        check_after(events, after)


def check_after(events: Events, floor_us: int) -> None:
    """Check that the first event is not earlier than a time: the last one before it, or 0."""
    first = int(events["t"][0])
    if first < floor_us:
        raise EventError(
            f"time runs backwards, from {floor_us} to {first} us: sort the events, or drop the "
            "late ones; times count from 0, the start of the recording"
        )


def check_event_array(events: object) -> None:
    """Raise EventError unless this is an array with the fields of events."""
    if not isinstance(events, np.ndarray):
        raise EventError(f"events are {kind_of(events)}: build an array with edge_vpr.make_events")
    if events.dtype.names is None or not {"t", "x", "y"} <= set(events.dtype.names):
        raise EventError(
            f"event array has dtype {events.dtype}, without the fields t, x, y: "
            "build it with edge_vpr.make_events"
        )


def join_events(parts: Sequence[Events]) -> Events:
    """Concatenate event arrays.

    Parameters
    ----------
    parts : sequence of ndarray of EVENT_DTYPE
        Each without gaps in memory; one alone is returned as it is.

    Returns
    -------
    ndarray of EVENT_DTYPE, shape (n,)
    """
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return NO_EVENTS
    # as bytes: NumPy concatenates records field by field, which takes 17 times as long
    return np.concatenate([part.view(_PLAIN) for part in parts]).view(EVENT_DTYPE)


def crop(events: Events, x: int, y: int, width: int, height: int) -> Events:
    """Keep the events of a rectangle and shift them so that its corner becomes ``(0, 0)``.

    Parameters
    ----------
    x, y : int
        Upper left corner, in pixels.
    width, height : int
        Size of the rectangle, in pixels.

    Returns
    -------
    ndarray of EVENT_DTYPE, shape (m,)
        A copy.
    """
    check_event_array(events)
    inside = (
        (events["x"] >= x)
        & (events["x"] < x + width)
        & (events["y"] >= y)
        & (events["y"] < y + height)
    )
    cropped = events[inside]
    cropped["x"] -= x
    cropped["y"] -= y
    return cropped
