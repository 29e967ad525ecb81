"""Events, their sensor, and the checks of events that come from outside."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EventError, UsageError, expect, kind_of

#: An event as a record, for files and for tonic, whose transforms accept arrays of this type.
EVENT_DTYPE = np.dtype([("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "?")])

_COLUMNS = tuple(np.dtype(kind) for kind in (np.int64, np.uint16, np.uint16, np.bool_))


class Events:
    """Events of a camera: four columns of one length, all checked. `make_events` makes them.

    >>> events = make_events(t=[0, 4, 9], x=[1, 2, 1], y=[0, 0, 3])
    >>> len(events), events.t, events[1:].x, events[events.y == 0].tolist()
    (3, array([0, 4, 9]), array([2, 1], dtype=uint16), [(0, 1, 0, True), (4, 2, 0, True)])

    ``events["t"]`` is ``events.t``, and ``np.asarray(events)`` a structured array of `EVENT_DTYPE`.

    Attributes
    ----------
    t : ndarray of int64, shape (n,)
        Times in microseconds from the recording's start.
    x, y : ndarray of uint16, shape (n,)
        Columns and rows.
    p : ndarray of bool, shape (n,)
        Polarities; True is ON.
    """

    __slots__ = ("p", "t", "x", "y")
    __iter__ = None  # its columns have the values

    def __init__(
        self,
        t: npt.NDArray[np.int64],
        x: npt.NDArray[np.uint16],
        y: npt.NDArray[np.uint16],
        p: npt.NDArray[np.bool_],
    ) -> None:
        self.t, self.x, self.y, self.p = t, x, y, p

    @property
    def columns(
        self,
    ) -> tuple[
        npt.NDArray[np.int64], npt.NDArray[np.uint16], npt.NDArray[np.uint16], npt.NDArray[np.bool_]
    ]:
        """The columns t, x, y, p."""
        return self.t, self.x, self.y, self.p

    @property
    def size(self) -> int:
        """Number of events."""
        return self.t.size

    def __len__(self) -> int:
        return self.t.size

    @overload
    def __getitem__(self, part: str) -> npt.NDArray[Any]: ...
    @overload
    def __getitem__(self, part: slice | npt.NDArray[Any]) -> Events: ...
    def __getitem__(self, part: Any) -> Any:
        """Return a column by its name, or some of the events: a slice, a mask or their numbers."""
        if isinstance(part, str):
            return getattr(self, part)
        return Events(self.t[part], self.x[part], self.y[part], self.p[part])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        records = np.empty(self.t.size, EVENT_DTYPE)
        for name, column in zip("txyp", self.columns, strict=True):
            records[name] = column
        return records if dtype is None else records.astype(dtype)

    def __repr__(self) -> str:
        span = f", {self.t[0]} to {self.t[-1]} us" if self.t.size else ""
        return f"<{self.t.size} events{span}>"

    def tolist(self) -> list[tuple[int, int, int, bool]]:
        """Return an event a tuple."""
        return list(zip(*(column.tolist() for column in self.columns), strict=True))

    def copy(self) -> Events:
        """Return events in memory of their own."""
        return Events(self.t.copy(), self.x.copy(), self.y.copy(), self.p.copy())

    @property
    def packed(self) -> bool:
        """Whether the columns have their types, are contiguous and can be written, for kernels."""
        t, x, y, p = self.t, self.x, self.y, self.p
        # not in a loop, which takes as long as a kernel's work on a few events
        return (
            (t.dtype, x.dtype, y.dtype, p.dtype) == _COLUMNS
            and t.flags.carray
            and x.flags.carray
            and y.flags.carray
            and p.flags.carray
        )


def empty_events(n: int) -> Events:
    """Return `n` events, whose values a decoder sets."""
    # not in a loop: a piece of a serial line has so few events that its time would show
    t, x, y, p = _COLUMNS
    return Events(np.empty(n, t), np.empty(n, x), np.empty(n, y), np.empty(n, p))


NO_EVENTS = empty_events(0)


class Columns(NamedTuple):
    """Unchecked events as four columns of one length, of any integer dtype (``p`` also boolean).

    Times are whole microseconds of the file's or the camera's own clock, without wraps. Times may
    run backwards, and pixels lie off the sensor: `FaultLog` handles both in a file, and
    `TimestampFilter` in a stream. A column may be a view into a buffer that the next chunk
    overwrites.
    """

    t: npt.NDArray[Any]
    x: npt.NDArray[Any]
    y: npt.NDArray[Any]
    p: npt.NDArray[Any]


def empty_columns(n: int) -> Columns:
    """Return columns for `n` events, whose values a decoder sets."""
    return Columns(*empty_events(n).columns)


#: Longest side of a sensor in pixels: columns and rows are 16 bits.
LONGEST_SIDE = 1 << 16
#: Times lie between minus and plus this, in microseconds: differences of two cannot overflow.
TIME_LIMIT_US = 1 << 60
#: Times after this one, in 1973, count from 1970 and not from a recording's start.
UNIX_US = 10**14


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
    def of(cls, size: SensorSize) -> Sensor:
        """Return a sensor from its width and height, or from a text such as ``"346x260"``.

        A third number, of polarities, may follow as in ``sensor_size`` of tonic.
        """
        if isinstance(size, str):
            return cls.parse(size)
        if isinstance(size, tuple | list) and len(size) == 3:
            size = size[0], size[1]
        if not isinstance(size, tuple | list) or len(size) != 2:
            raise UsageError(
                f"sensor {size!r} is no width and height: give for example Sensor(346, 260) or "
                "'346x260'"
            )
        sensor = cls(*size)
        whole = all(
            isinstance(side, int | np.integer) and not isinstance(side, bool) for side in sensor
        )
        if not whole or not sensor.possible:
            raise UsageError(f"sensor {size!r} has a side that is no number from 1 to 65536")
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
    """Make events of columns, which are copied.

    Parameters
    ----------
    t, x, y, p : array_like, shape (n,)
        Times in whole microseconds, columns, rows, polarities (greater than 0 is ON; all ON if
        absent).

    Raises
    ------
    EventError
        If a column holds anything else, or another number of values.
    """
    for name, values in (("t", t), ("x", x), ("y", y), ("p", 0 if p is None else p)):
        _check_numbers(name, np.asarray(values))
    times = np.array(t, np.int64)
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
    on = np.ones(times.shape, np.bool_) if p is None else np.array(np.asarray(p) > 0)
    return Events(times, np.array(x, np.uint16), np.array(y, np.uint16), on)


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


def as_events(events: object) -> Events:
    """Return events, or an array with the fields t, x, y and perhaps p of any types, as events."""
    if isinstance(events, Events):
        return events if events.packed else make_events(*events.columns)
    if not isinstance(events, np.ndarray):
        raise EventError(f"events are {kind_of(events)}: make them with edge_vpr.make_events")
    names = events.dtype.names or ()
    if not {"t", "x", "y"} <= set(names):
        raise EventError(
            f"event array has dtype {events.dtype}, without the fields t, x, y: "
            "make events with edge_vpr.make_events"
        )
    return make_events(*(events[name] for name in "txyp" if name in names))


def in_order(chunks: Iterable[Events], sensor: Sensor) -> Iterator[Events]:
    """Yield the events of a source outside of this package, chunk by chunk, none of them empty.

    Raises
    ------
    EventError
        If time runs backwards, also between two chunks, or a pixel lies off the sensor.
    """
    last = None
    for chunk in chunks:
        events = as_events(chunk)
        check_events(events, sensor, after=last)
        if events.size:
            last = int(events.t[-1])
            yield events


def check_events(events: Events, sensor: Sensor, *, after: int | None = None) -> None:
    """Check that events are in the order of time and on this sensor.

    Parameters
    ----------
    after : int, optional
        Time of the last event before these, in microseconds; none of these may be earlier.
    """
    if len(events) == 0:
        return
    x_max, y_max = int(events.x.max()), int(events.y.max())
    if x_max >= sensor.width or y_max >= sensor.height:
        raise EventError(
            f"pixel at column {x_max} or row {y_max} lies off the {sensor} sensor: "
            "name the right sensor, or drop such events when reading"
        )
    t = events.t
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
    first = int(events.t[0])
    if first < floor_us:
        raise EventError(
            f"time runs backwards, from {floor_us} to {first} us: sort the events, or drop the "
            "late ones; times count from 0, the start of the recording"
        )


def join_events(parts: Sequence[Events]) -> Events:
    """Return events one after another; one part alone as it is."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return NO_EVENTS
    columns = zip(*(part.columns for part in parts), strict=True)
    return Events(*map(np.concatenate, columns))


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
    Events
        A copy.
    """
    events = as_events(events)
    inside = (events.x >= x) & (events.x < x + width) & (events.y >= y) & (events.y < y + height)
    cropped = events[inside]
    cropped.x -= np.uint16(x)
    cropped.y -= np.uint16(y)
    return cropped
