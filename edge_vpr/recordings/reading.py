"""Recordings: the events of a reader are checked, cropped and yielded; faulty ones are counted.

A reader of a format is a `Source`, which yields `Columns` of unchecked events. `Recording` checks
them with a `FaultLog`, and yields arrays of events.
"""

from __future__ import annotations

import contextlib
import copy
import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import (
    EdgeVprError,
    EdgeVprWarning,
    MissingExtraError,
    RecordingError,
    UsageError,
    printable,
)
from edge_vpr.events import EVENT_DTYPE, LONGEST_SIDE, TIME_LIMIT_US, Events, Sensor

# What a reader yields.


class Columns(NamedTuple):
    """Raw events as four columns of one length, of any integer dtype (``p`` also boolean).

    Times are whole microseconds of the file's own clock, without wraps. Faulty events are still
    among them: `FaultLog` handles times that run backwards and pixels off the sensor. A column may
    be a view into a buffer that the next chunk overwrites.
    """

    t: npt.NDArray[Any]
    x: npt.NDArray[Any]
    y: npt.NDArray[Any]
    p: npt.NDArray[Any]


def empty_columns(n: int) -> Columns:
    """Return columns for `n` events, whose values a decoder sets."""
    return Columns(
        np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.bool_)
    )


def in_chunks(columns: Columns, number: int) -> Iterator[Columns]:
    """Yield the events up to `number` at a time."""
    for i in range(0, columns.t.size, number):
        yield Columns(*(column[i : i + number] for column in columns))


# Interface of readers: unchecked raw columns on the file's own clock.


#: What is done with faulty events: an error, or they are left out and counted.
OnFault = Literal["error", "drop"]
#: Units of times in tables.
TimeUnit = Literal["s", "ms", "us", "ns"]
#: Approximate events of one chunk: 64 Ki events are 850 kB, which stay in a core's second-level
#: cache.
CHUNK_EVENTS = 1 << 16


class Camera(NamedTuple):
    """What a recording does not say of its camera, as a map knows it."""

    sensor: Sensor | None = None
    frame_period: Fraction | None = None  #: Seconds a frame of counts.


NO_CAMERA = Camera()


@dataclass(frozen=True)
class ReadOptions:
    """Format of the file (a name of `FORMATS`), and what the caller states about it.

    `sensor` and `frame_period` must not contradict the file; `default` is for files without them.
    """

    format: str
    sensor: Sensor | None = None
    frame_period: Fraction | None = None
    default: Camera = NO_CAMERA
    chunk_events: int = CHUNK_EVENTS
    topic: str | None = None
    time_unit: TimeUnit | None = None
    columns: str | None = None


class Source(ABC):
    """Reader of one file.

    Parameters
    ----------
    sensor : Sensor, optional
        As the file states it.
    start_us : int, optional
        Time t = 0 on an outer clock, where the file states it and its times count from it.

    Attributes
    ----------
    sensor : Sensor or None
        As stated by the file, else by the caller; None if neither states it.
    start_us : int or None
        Time t = 0 on the file's clock in microseconds, if the file itself states it; None if the
        first event is the start.
    relative : bool
        True if the times already count from the start.
    end_us : int or None
        Where the recording ends, in the times of its events; None if that is not known, or no pass
        has come so far. Windows that end by then are complete.
    position : float or None
        Share of the file that has been read, 0 to 1; None if it is not known.
    """

    start_us: int | None = None
    end_us: int | None = None
    relative: bool = False
    position: float | None = 0.0

    def __init__(
        self,
        path: Path,
        options: ReadOptions,
        sensor: Sensor | None = None,
        start_us: int | None = None,
    ) -> None:
        self.path = path
        self.options = options
        self.sensor = sensor or options.sensor or options.default.sensor
        if self.sensor is not None and not self.sensor.possible:
            raise RecordingError(
                f"{path} names a sensor of {self.sensor}: sides are 1 to {LONGEST_SIDE:,} pixels, "
                "so copy or record it again"
            )
        if sensor is not None and options.sensor not in (None, sensor):
            raise UsageError(
                f"{path} was recorded by a {sensor} sensor, and {options.sensor} was named: "
                "leave the sensor out"
            )
        if start_us is not None:
            self.start_us, self.relative = start_us, True

    @abstractmethod
    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events from the first on, in file order, about ``chunk_events`` at a time.

        Entries that cannot be decoded are reported to `log`, which raises or counts.
        """


# Conversion of all exceptions of parsing libraries to `EdgeVprError`.
#
# The parsers behind the readers (zip, NumPy's headers, HDF5, Arrow, rosbags, Pillow, Rust) raise
# exceptions of any kind for a damaged file. A reader handles those of which it can say more;
# `foreign_errors` converts all others to a :class:`RecordingError` that names file and place.


@contextmanager
def foreign_errors(path: Path, place: Callable[[], str] = lambda: "") -> Iterator[None]:
    """Convert any exception of the block to an `EdgeVprError` that names `path`.

    Parameters
    ----------
    place : callable
        Returns the place in the file at the time of the error, as ``" after event 5"``, or "".

    Raises
    ------
    RecordingError
        For every exception that is not an `EdgeVprError`. Interrupts are not converted.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except EdgeVprError as error:
        if printable(str(path)) in str(error):
            raise
        raise RecordingError(f"{path}: {error}") from error  # concerns text within the file
    except OSError as error:
        if error.strerror is None:  # raised by a library, and not by the operating system
            raise _damaged(path, place(), error) from error
        raise RecordingError(
            f"{path} cannot be read{place()}: {error.strerror}: check the path and the disk"
        ) from error
    except MemoryError as error:
        raise RecordingError(
            f"{path} needs more memory{place()} than there is: it is damaged, or give it more"
        ) from error
    except Exception as error:
        raise _damaged(path, place(), error) from error
    except BaseException as error:
        # a library written in Rust raises this when it fails internally
        if type(error).__name__ != "PanicException":
            raise
        raise _damaged(path, place(), error) from error


def _damaged(path: Path, place: str, error: BaseException) -> RecordingError:
    return RecordingError(
        f"{path} is damaged{place} ({type(error).__name__}: {error}): copy or record it again"
    )


# Handling of faulty events: checks, counts and messages.


_REMEDY = "read with on_fault='drop': {them} left out and counted"
#: Share of faulty entries above which dropping them is no remedy.
_NEARLY_ALL = 0.9
#: Share of late events up to which dropping them is a remedy, and number that always is.
_FEW_LATE, _FEW = 0.01, 10
#: An event that lies further than this ahead of those before and after it is the wrong one.
_AHEAD_US = 1_000_000
#: A clock of 32 bits falls by `_WRAP_US` when it wraps, less the time between two events.
_WRAP_US, _LONGEST_PAUSE_US = 1 << 32, 1 << 26
#: Share of events off the sensor above which a camera's faulty words are not their cause.
_MANY_OFF = 0.001
_OFF_CAUSES = (
    "check sensor=, whether x and y are swapped (columns='tyxp'), and whether they count from 1"
)
_CHECKS = (
    "check sensor=, columns=, time_unit= and format=, and whether a time before them is far "
    "too late"
)


@dataclass
class Faults:
    """Number of dropped entries of each kind in a pass over a recording so far.

    Attributes
    ----------
    backwards : int
        Events earlier than an event before them; and single ones that lie more than a second ahead
        of the events before and after them.
    off_sensor : int
        Events whose pixel does not exist.
    unreadable : int
        Entries that are not events: a line without four numbers, or a time that is not a number or
        lies beyond 2**60 us.
    undated : int
        Events before the stream's first time word, of a camera that was already running when the
        recording began. They have no time and are therefore dropped and counted, even when faults
        are errors.
    truncated : int
        Bytes at a cut-off end that do not make up an event, or a packet of events.
    """

    backwards: int = 0
    off_sensor: int = 0
    unreadable: int = 0
    undated: int = 0
    truncated: int = 0

    @property
    def total(self) -> int:
        """Number of dropped entries; a cut-off end counts as one."""
        events = self.backwards + self.off_sensor + self.unreadable + self.undated
        return events + bool(self.truncated)

    def __str__(self) -> str:
        parts = [
            f"{getattr(self, field.name):,} {field.name.replace('_', ' ')}"
            + (" bytes" if field.name == "truncated" else "")
            for field in fields(self)
            if getattr(self, field.name)
        ]
        return ", ".join(parts) or "none"


class FaultLog:
    """Check raw columns, convert them to event arrays, and count faulty events.

    Parameters
    ----------
    path : Path
        Named in messages.
    on_fault : {"error", "drop"}
        Whether a faulty event is an error, or left out and counted.
    origin_us : int or None
        Time that is subtracted from all times; None stands for that of the first good event.
    """

    def __init__(
        self, path: Path, sensor: Sensor, on_fault: str = "error", origin_us: int | None = None
    ) -> None:
        check_policy(on_fault)
        self.path = path
        self.sensor = sensor
        self.drop = on_fault == "drop"
        self.origin_us = origin_us
        self.faults = Faults()
        self.entries = 0  #: events of the file seen so far, good or bad
        self.first_unreadable = ""  #: the first entry that is not an event, and why
        self.assumed_unit: str | None = None  #: unit of times, if neither file nor caller states it
        self.times_are_float32 = False
        self.without_polarity = False  #: whether a table has no column of it
        self.unused: list[str] = []  #: names of further columns of a table
        self.remarks: list[str] = []  #: warnings about implausible values
        self.last_us: int | None = None  #: time of the last good event so far
        self.wrapped = ""  #: where a clock of 32 bits wrapped first
        self._good = 0
        self._turns = 0  # wraps less steps back over them
        self._raw_us: int | None = None  # the file's last time so far
        self._held: Columns | None = None  # a last event far ahead, judged by the next one

    def admit(self, columns: Columns) -> Events:
        """Check one chunk; chunks must come in the order of the file.

        An event is late if any good event before it has a later time. A single event far ahead of
        both its neighbours is faulty itself; several make all events after them late, which the
        count shows.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            The good events, in the order of the file; a new array.

        Raises
        ------
        RecordingError
            At the first faulty event, unless faults are dropped.
        """
        return self._admit(columns._replace(t=self._continued(columns.t)))

    def _admit(self, columns: Columns, *, last: bool = False) -> Events:
        """Check events whose clock is continued; the `last` of them are not held back."""
        if self._held is not None:
            columns = Columns(*map(np.concatenate, zip(self._held, columns, strict=True)))
            self._held = None
        t, x, y, p = columns
        open_end = not last
        if t.size and not self._clean(columns):
            (t, x, y, p), ends = self._sift(columns)
            open_end &= ends
        before = int(t[-2]) if t.size > 1 else self.last_us
        if open_end and t.size and before is not None and int(t[-1]) - before > _AHEAD_US:
            self._held = Columns(*(column[-1:].copy() for column in (t, x, y, p)))
            t, x, y, p = t[:-1], x[:-1], y[:-1], p[:-1]
            self.entries -= 1
        self.entries += columns.t.size
        self._good += t.size
        events = np.empty(t.size, EVENT_DTYPE)
        if t.size:
            if self.origin_us is None:
                self.origin_us = int(t[0])
            self.last_us = int(t[-1])
            np.subtract(t, self.origin_us, out=events["t"], casting="unsafe")
            events["x"], events["y"] = x, y
            events["p"] = p if p.dtype == np.bool_ else p > 0
        return events

    def _continued(self, t: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return times without the wraps of a clock of 32 bits, which tables may have."""
        if not t.size:
            return t
        raw = t.astype(np.int64, copy=False)
        before = int(raw[0]) if self._raw_us is None else self._raw_us
        self._raw_us, least = int(raw[-1]), _WRAP_US - _LONGEST_PAUSE_US
        rises = raw[0] >= before and bool((raw[1:] >= raw[:-1]).all())
        if not self._turns and rises and self._raw_us - before < least:
            return t
        steps = np.diff(raw, prepend=before)
        turned = (np.abs(steps) >= least) & (np.abs(steps) < _WRAP_US)
        turns = self._turns - np.cumsum(np.sign(steps) * turned)
        self._turns = int(turns[-1])
        wraps = np.maximum(turns, 0)  # a step ahead without a wrap before it is a gap
        if not self.wrapped and wraps.any():
            i = int(np.argmax(wraps > 0))
            last = raw[i - 1] if i else before
            self.wrapped = (
                f"the clock fell from {last} to {raw[i]} us at event {self.entries + i:,}"
            )
        return raw + wraps * _WRAP_US

    def finish(self) -> Events:
        """End the pass over all of a file.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            A last good event that :meth:`admit` has not returned, if there is one.

        Raises
        ------
        RecordingError
            If nearly all entries were faulty: the others are then good by chance.
        """
        none = np.empty(0, np.int64)
        rest = self._admit(Columns(none, none, none, none), last=True)
        faults = self.faults
        bad = faults.backwards + faults.off_sensor + faults.unreadable
        if self._good and bad > _NEARLY_ALL * (bad + self._good):
            raise RecordingError(
                f"{self.path}: nearly all of its entries are faulty ({faults}; {self._good:,} are "
                f"good): {_CHECKS}"
            )
        return rest

    def remark(self, text: str) -> None:
        """Keep a remark, once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def truncated(self, n_bytes: int, where: str) -> None:
        """Report a cut-off end, with `n_bytes` left over at `where`."""
        if not self.drop:
            raise RecordingError(
                f"{self.path} is cut off: {n_bytes:,} bytes too many or too few at {where}: "
                + _REMEDY.format(them="the rest is")
            )
        self.faults.truncated += n_bytes

    def unreadable(self, n: int, where: str, total: int | None = None) -> None:
        """Report `n` of `total` entries that are not events, the first of them at `where`."""
        if not self.drop:
            raise RecordingError(self._fault(where, n, total, "such entries"))
        self.first_unreadable = self.first_unreadable or where
        self.faults.unreadable += n

    def _fault(
        self, what: str, bad: int, total: int | None, them: str, remedy: str = "", off: int = 0
    ) -> str:
        """Return the error of the first of `bad` faults among the next `total` entries.

        Parameters
        ----------
        remedy : str
            What to do, if not to drop them.
        off : int
            How many of them lie off the sensor.
        """
        if total is not None and (remedy or bad > _NEARLY_ALL * (self._good + total)):
            what += f", and {bad:,} of {total:,} entries there are faulty"
            remedy = remedy or _CHECKS
        else:
            remedy = _REMEDY.format(them=f"{them} are")
            if total is not None and off > max(1, _MANY_OFF * (self._good + total)):
                what += f", and so do {off / total:.1%} of the events there"
                remedy = f"{_OFF_CAUSES}; if not, {remedy}"
        return f"{self.path}: {what}: {remedy}"

    def undated(self, n: int) -> None:
        """Report `n` events before the first time word; never an error."""
        self.faults.undated += n

    def _clean(self, columns: Columns) -> bool:
        t, x, y, _ = columns
        width, height = self.sensor
        return bool(
            x.max() < width
            and y.max() < height
            and (x.dtype.kind == "u" or x.min() >= 0)
            and (y.dtype.kind == "u" or y.min() >= 0)
            and t[0] >= (-TIME_LIMIT_US if self.last_us is None else self.last_us)
            and (t[1:] >= t[:-1]).all()
            and t[-1] <= TIME_LIMIT_US
        )

    def _sift(self, columns: Columns) -> tuple[Columns, bool]:
        """Return the good events, and whether the last one on the sensor is among them."""
        t, x, y, _ = columns
        width, height = self.sensor
        known = (t >= -TIME_LIMIT_US) & (t <= TIME_LIMIT_US)
        on = (x >= 0) & (x < width) & (y >= 0) & (y < height) & known
        # latest good time before each event; events outside the sensor do not change it
        floor = np.iinfo(np.int64).min
        times = np.full(t.shape, floor, np.int64)
        times[on] = t[on]
        ahead = self._ahead(times, np.flatnonzero(on))
        times[ahead] = floor
        latest = np.empty_like(times)
        latest[0] = floor if self.last_us is None else self.last_us
        latest[1:] = np.maximum(np.maximum.accumulate(times)[:-1], latest[0])
        late = on & (times < latest)
        late[ahead] = False
        good = on & ~late
        good[ahead] = False
        i = int(np.flatnonzero(~good)[0])
        n_late, remedy = int(np.count_nonzero(late)), ""
        if i in ahead:
            what = (
                f"its time, {t[i]} us, is {(t[i] - latest[i]) / 1e6:,.6g} s ahead of the events "
                "before and after it"
            )
        elif on[i]:
            what = f"time runs backwards, from {latest[i]} to {t[i]} us"
        elif known[i]:
            what = f"pixel ({x[i]}, {y[i]}) at {t[i]} us lies off the {self.sensor} sensor"
        else:
            what = f"time {t[i]} us lies beyond 2**60 us{unit_remedy(int(t[i]))}"
            self.first_unreadable = self.first_unreadable or what
        if not self.drop:
            if late[i]:
                lasting = late[on][-1] and latest[i] - t[i] > _AHEAD_US
                if lasting or n_late > max(_FEW, _FEW_LATE * t.size):
                    remedy = self._remedy_of_many(t[late], int(latest[i]), t.size)
            raise RecordingError(
                self._fault(
                    f"event {self.entries + i:,}: {what}", int(np.count_nonzero(~good)), good.size,
                    "such events", remedy, 0 if on[i] else int(np.count_nonzero(~on & known)),
                )
            )  # fmt: skip
        self.faults.unreadable += int(np.count_nonzero(~known))
        self.faults.off_sensor += int(np.count_nonzero(~on & known))
        self.faults.backwards += n_late + len(ahead)
        ends = bool(on.any()) and bool(good[np.flatnonzero(on)[-1]])
        return Columns(*(column[good] for column in columns)), ends

    def _ahead(self, times: npt.NDArray[np.int64], on: npt.NDArray[np.intp]) -> list[int]:
        """Return those of the events `on` that alone lie far ahead of the ones beside them."""
        t, found, begun = times[on], list[int](), 0
        latest = int(t[0] if self.last_us is None and t.size else self.last_us or 0)
        for i in np.flatnonzero(t[:-1] - t[1:] > _AHEAD_US).tolist():
            latest = int(t[begun:i].max(initial=latest))
            if t[i] - latest > _AHEAD_US:
                found.append(int(on[i]))
            begun = i + (t[i] - latest > _AHEAD_US)
        return found

    def _remedy_of_many(self, late: npt.NDArray[Any], latest_us: int, total: int) -> str:
        """Return what to do about more late events among `total` than may be dropped."""
        mixed = bool((np.diff(late) < 0).any())
        if late.size > _NEARLY_ALL * (self._good + total):
            return "sort the events by t, or " * mixed + _CHECKS
        if mixed:
            return "sort the events by t, since on_fault='drop' would lose all of these"
        end = _seconds(latest_us - (self.origin_us or 0) + 1)
        return (
            f"if the clock began anew, read the part before, with end='{end}' and "
            "on_fault='drop'; if the times before are wrong, delete those events"
        )


def unit_remedy(time: float) -> str:
    """Return which unit to pass if a time is too large in the one that was assumed.

    Parameters
    ----------
    time : int or float
        As in the file.

    Returns
    -------
    str
        With the coarsest unit in which the time is before the year 2242; "" if there is none.

    Examples
    --------
    >>> unit_remedy(1_587_452_582_350_000_000)
    "; if times are in ns, pass time_unit='ns'"
    """
    for unit, in_a_second in (("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)):
        if abs(time) < in_a_second << 33:
            return f"; if times are in {unit}, pass time_unit='{unit}'"
    return ""


def _seconds(us: int) -> str:
    """Return microseconds as seconds with all digits."""
    return f"{us // 1_000_000}.{us % 1_000_000:06d}"


def check_policy(on_fault: str) -> None:
    """Raise :class:`UsageError` unless `on_fault` is ``"error"`` or ``"drop"``."""
    if on_fault not in get_args(OnFault):
        raise UsageError(f"on_fault {on_fault!r} is unknown: choose error or drop")


# Part of a recording between two moments.


@dataclass(frozen=True, kw_only=True)
class TimeCrop:
    """Part of a recording to read: from `start_us` (included) to `end_us` (excluded).

    Attributes
    ----------
    start_us : int
        Counted from the recording's first moment, or from `offset_us`.
    end_us : int or None
        Counted likewise; None for the recording's end.
    offset_us : int or None
        Moment on the file's own clock from which the two count; None for the recording's first one.
    """

    start_us: int = 0
    end_us: int | None = None
    offset_us: int | None = None

    def __post_init__(self) -> None:
        for value in (self.start_us, self.end_us, self.offset_us):
            if value is not None and abs(value) > TIME_LIMIT_US:
                raise UsageError(f"{value} us is beyond 2**60 us: give start and end in seconds")
        if self.start_us < 0:
            raise UsageError(
                f"the start {self.start_us / 1e6:g} s is negative: give seconds from the "
                "recording's beginning"
            )
        if self.end_us is not None and self.end_us <= self.start_us:
            raise UsageError(
                f"the end {self.end_us / 1e6:g} s is not after the start "
                f"{self.start_us / 1e6:g} s: give a later end"
            )

    def span(self, recording_start_us: int) -> tuple[int, int | None]:
        """Return start and end in microseconds from the first moment of a recording.

        Parameters
        ----------
        recording_start_us : int
            That moment on the file's own clock.

        Returns
        -------
        start_us : int
            0 if the part begins before the recording.
        end_us : int or None
        """
        shift = 0 if self.offset_us is None else self.offset_us - recording_start_us
        start = max(0, self.start_us + shift)
        if self.end_us is None:
            return start, None
        end = self.end_us + shift
        if end <= start:
            raise UsageError(
                f"the part to read ends {-end / 1e6:g} s before the recording begins "
                f"({recording_start_us / 1e6:.6f} s on its own clock): check start offset and end"
            )
        return start, end


def seconds_us(given: float | str, name: str) -> int:
    """Read seconds exactly, such as ``1587452582.35`` or ``1/30``, as microseconds.

    Parameters
    ----------
    name : str
        Named in the message.

    Returns
    -------
    int
        Rounded to the nearest, halves to even.
    """
    text = str(given)
    # 1e999999999 would fill the memory
    if len(text) <= 40 and "e" not in text.lower():
        with contextlib.suppress(ValueError, ZeroDivisionError):
            return round(Fraction(text) * 1_000_000)
    raise UsageError(f"{name} {text[:40]!r} is no number of seconds: write for example 12.5")


def crop_of(
    start: float | str | None, end: float | str | None, offset: float | str | None = None
) -> TimeCrop | None:
    """Return the part between two times in seconds; None if no time is given."""
    if start is end is offset is None:
        return None
    return TimeCrop(
        start_us=0 if start is None else seconds_us(start, "start"),
        end_us=None if end is None else seconds_us(end, "end"),
        offset_us=None if offset is None else seconds_us(offset, "start_offset"),
    )


def cropped_events(chunks: Iterator[Events], start_us: int, end_us: int | None) -> Iterator[Events]:
    """Yield the events from `start_us` up to `end_us`, with times counted from `start_us`.

    Parameters
    ----------
    chunks : iterator of ndarray of EVENT_DTYPE
        In time order. No further chunk is read after one that reaches `end_us`.

    Yields
    ------
    ndarray of EVENT_DTYPE, shape (n,)
        Copies; never empty.
    """
    for events in chunks:
        times = events["t"]
        first = int(np.searchsorted(times, start_us))
        end = times.size if end_us is None else int(np.searchsorted(times, end_us))
        if end > first:
            part = events[first:end].copy()
            part["t"] -= start_us
            yield part
        if end < times.size:
            return


# A recording: an iterable of checked event arrays, for any number of passes.


class SensorNotStated(UsageError):  # noqa: N818, what is not there is no error of the file
    """The file does not state its sensor, and nobody named it."""


class Recording:
    r"""Iterable of event arrays that are never empty, in time order, and inside the sensor.

    >>> import tempfile, edge_vpr
    >>> path = Path(tempfile.mkdtemp()) / "three.csv"
    >>> _ = path.write_text("t,x,y,p\n100,0,0,1\n150,1,0,0\n150,1,1,1\n")
    >>> recording = edge_vpr.open_recording(path, sensor=(2, 2))
    >>> recording.sensor, [len(events) for events in recording]
    (Sensor(width=2, height=2), [3])

    Each ``iter()`` starts at the first event and resets `faults` and `position`. Memory does not
    grow with the length of the file.

    Attributes
    ----------
    format : str
        Short name, as in :data:`edge_vpr.recordings.FORMATS`.
    start_us : int
        Time t = 0 on the file's own clock, in microseconds: since the Unix epoch if the file has
        wall-clock time (ROS, AEDAT4), else on the camera's clock.
    faults : Faults
        Entries that the newest pass has dropped so far.
    remark : str
        Warning about an implausible unit of times, if the file does not state it, or about
        implausible values of the polarity; else "".
    without_polarity : bool
        Whether this is a table without a column of the polarity, so that all events are ON.
    frame_period : Fraction or None
        Seconds per frame of counts, as the file states or as given; None if the file holds events.
    end_us : int or None
        Where the recording is known to end, after a pass over all of it: count frames end with
        their last frame, and a part of a recording where it was cut. None if only its last event is
        known.
    """

    def __init__(self, source: Source, on_fault: str) -> None:
        if source.sensor is None:
            raise SensorNotStated(
                f"{source.path} does not say how large its sensor is: "
                "pass sensor=, for example sensor='346x260'"
            )
        self.path: Path = source.path
        self.format = source.options.format
        self.sensor: Sensor = source.sensor
        self.faults = Faults()
        self._source = source
        self._on_fault = on_fault
        self.remark = ""
        self.without_polarity = False
        self.end_us: int | None = None
        self.frame_period: Fraction | None = getattr(source, "frame_period", None)
        self._span: tuple[int, int | None] = (0, None)
        self._wrap_told = False
        self._origin_us, self.start_us = self._find_start()

    @property
    def position(self) -> float | None:
        """Share of the file that the newest pass has read, 0 to 1; None if it is not known."""
        return self._source.position

    @property
    def cropped_us(self) -> int:
        """Microseconds from the recording's start to time 0, which is that of the part read."""
        return self._span[0]

    def __iter__(self) -> Iterator[Events]:
        log = FaultLog(self.path, self.sensor, self._on_fault, self._origin_us)
        self.faults, self.end_us = log.faults, None
        return self._whole(log) if self._span == (0, None) else self._cropped(log)

    def cropped(self, crop: TimeCrop) -> Recording:
        """Return the part between two moments; its times count from the part's beginning.

        Returns
        -------
        Recording
            Part of the same file, with `start_us` at its beginning. A pass over a part without
            events raises RecordingError.
        """
        start, end = crop.span(self.start_us)
        part = copy.copy(self)
        first, last = self._span
        part._span = (first + start, last if end is None else min(first + end, last or first + end))
        part.start_us = self.start_us + start
        part.faults, part.end_us = Faults(), None
        return part

    def __repr__(self) -> str:
        return f"<Recording {self.path} ({self.format}, {self.sensor})>"

    def _whole(self, log: FaultLog) -> Iterator[Events]:
        yield from self._walk(log)
        self.end_us = self._known_end(log)

    def _walk(self, log: FaultLog) -> Generator[Events, None, None]:
        with foreign_errors(self.path, lambda: f" after event {log.entries:,}"):
            for columns in self._source.chunks(log):
                events = log.admit(columns)
                if log.wrapped and not self._wrap_told:
                    self._wrap_told = True
                    warnings.warn(
                        f"{self.path}: {log.wrapped}, as one of 32 bits does every 71.6 minutes, "
                        "and is continued; if the camera was restarted, read the part before, with "
                        "end=",
                        EdgeVprWarning,
                        stacklevel=3,
                    )
                if events.size:
                    yield events
            rest = log.finish()
            if rest.size:
                yield rest

    def _cropped(self, log: FaultLog) -> Generator[Events, None, None]:
        start, end = self._span
        found = False
        with contextlib.closing(self._walk(log)) as chunks:
            for events in cropped_events(chunks, start, end):
                found = True
                yield events
        if not found:
            until = "its end" if end is None else f"{end / 1e6:g} s"
            raise RecordingError(
                f"{self.path} holds no events from {start / 1e6:g} s to {until}: give another "
                "start= and end= (edge-vpr info shows its times)"
            )
        self.end_us = self._known_end(log)

    def _known_end(self, log: FaultLog) -> int | None:
        """Return where the part that was read ends, if more than its last event says that."""
        start, end = self._span
        of_file, last_us = self._source.end_us, log.last_us
        if end is not None and last_us is not None and last_us >= self._origin_us + end:
            return end - start
        if of_file is None:
            return None
        of_file -= self._origin_us
        return (of_file if end is None else min(end, of_file)) - start

    def _find_start(self) -> tuple[int, int]:
        """Read up to the first good event, so that an empty file is refused when it is opened."""
        log = FaultLog(
            self.path, self.sensor, "drop", origin_us=0 if self._source.relative else None
        )
        with contextlib.closing(self._walk(log)) as chunks:
            first = next(chunks, None)
        if first is None:
            lost = f" ({log.faults})" if log.faults.total else ""
            raise RecordingError(
                f"{self.path} holds no events of a {self.sensor} sensor{lost}: "
                + (log.first_unreadable or "check its format, its sensor, and whether it is empty")
            )
        assert log.origin_us is not None
        start = self._source.start_us
        if start is not None and abs(start) > TIME_LIMIT_US:
            raise RecordingError(
                f"{self.path} begins at {start} us, beyond 2**60 us: copy or record it again"
            )
        if self._on_fault == "drop" and log.faults.off_sensor > max(1, _MANY_OFF * log.entries):
            log.remark(
                f"{log.faults.off_sensor / log.entries:.1%} of the first {log.entries:,} events "
                f"lie off the {self.sensor} sensor and are left out: {_OFF_CAUSES}"
            )
        self.without_polarity = log.without_polarity
        if log.without_polarity and log.unused and self._source.options.columns is None:
            log.remark(
                f"no column is named as the polarity, and all events are taken for ON: if "
                f"{', '.join(log.unused[:5])} holds it, rename it p, or name all columns in their "
                "order with columns="
            )
        doubt = ""
        if log.assumed_unit is not None:
            position, rounded = self._source.position, log.times_are_float32
            doubt = _doubt(first, position, self.sensor, log.assumed_unit, rounded)
        log.remark(doubt or _misdated(first))
        self.remark = "; ".join(filter(None, log.remarks))
        self._source.position = 0.0 if self._source.position is not None else None
        return log.origin_us, log.origin_us if start is None else start


#: Longest usual time between two of the first events, in microseconds: a day.
_LONGEST_GAP_US = 86_400_000_000


def _misdated(events: Events) -> str:
    """Return that the first events lie long before the others, or have times of whole seconds."""
    gaps = np.diff(events["t"])
    if events.size >= _FEWEST and gaps.any() and not (gaps % 1_000_000).any():
        return (
            f"the times of the first {events.size:,} events are whole seconds: read them with "
            "their fractions, which another column may have"
        )
    if gaps.max(initial=0) < _LONGEST_GAP_US:
        return ""
    i = int(np.argmax(gaps))
    return (
        f"event {i:,} lies {gaps[i] / 1e6:,.0f} s before the next: if times up to there are wrong, "
        f"read without them, with start='{_seconds(int(events['t'][i + 1]))}'"
    )


#: Fewest events for a check of the unit of time, and parts of which the usual rate is taken.
_FEWEST, _PARTS = 1_000, 32
_US_PER_UNIT = {
    "s": Fraction(10**6),
    "ms": Fraction(1000),
    "us": Fraction(1),
    "ns": Fraction(1, 1000),
}
#: Usual rate of a moving camera in events/s a pixel, and lowest one of a camera of any size in
#: events/s; shortest and longest usual recording in s.
_USUAL_RATE, _SLOWEST, _SHORTEST, _LONGEST = 3.0, 5.0, 1.0, 3_600.0
#: A unit is doubted if another one is more usual by `_DOUBTFUL` powers of ten, or if the shortest
#: step between times exceeds `_LONGEST_STEP_US`; of float32, whose steps are of its digits and not
#: of the camera, `_LONGEST_OF_FLOAT32_US`. If each whole number up to the last has several events,
#: `_DOUBTFUL_IF_FULL` powers suffice. A unit that is odd by more than `_IMPOSSIBLE` powers of ten
#: is not proposed.
_DOUBTFUL, _DOUBTFUL_IF_FULL, _IMPOSSIBLE = 2.0, 0.5, 4.0
_LONGEST_STEP_US, _LONGEST_OF_FLOAT32_US = 1_000_000, 2_000


def _doubt(
    events: Events,
    share: float | None,
    sensor: Sensor,
    assumed: str,
    float32: bool = False,
    remedy: str = "pass time_unit='{unit}'",
) -> str:
    """Return why the unit of the times is implausible; "" if it is plausible.

    Parameters
    ----------
    events : ndarray of EVENT_DTYPE, shape (n,)
        The first events.
    share : float or None
        Share of the drive that they are; None if it is not known.
    assumed : str
        Unit in which they were read.
    float32 : bool
        Whether their times are of this type.
    remedy : str
        What to do if they are in a unit that is more likely.
    """
    n, duration_us = events.size, int(events["t"][-1] - events["t"][0])
    if n < _FEWEST:
        return ""
    steps = np.diff(events["t"])
    steps = steps[steps > 0]
    if not steps.size and n < sensor.pixels and share != 1.0 and not float32:
        return ""  # part of the first frame of a simulator
    step_us = int(steps.min(initial=TIME_LIMIT_US))
    longest_us = _LONGEST_OF_FLOAT32_US if float32 else _LONGEST_STEP_US
    # of most parts, since a clock that jumps makes one of them long
    part = n // _PARTS
    of_parts = float(np.median(np.diff(events["t"][::part]))) * (n - 1) / part
    usual_us = max(1.0, of_parts, float(steps.size * step_us))

    def coarse(factor: Fraction) -> bool:
        """Return whether steps are too long; whole numbers have those of one unit in any."""
        return step_us > 1 and step_us * factor > longest_us

    def oddness(factor: Fraction) -> float:
        """Return by how many powers of ten rate and duration are unusual if times are scaled."""
        seconds = usual_us * float(factor) / 1e6
        rate = abs(math.log10(n / seconds / sensor.pixels / _USUAL_RATE))
        if share is None:
            return rate
        total = seconds / min(max(share, 1e-6), 1.0)
        return rate + max(0.0, math.log10(_SHORTEST / total), math.log10(total / _LONGEST))

    factors = {unit: us / _US_PER_UNIT[assumed] for unit, us in _US_PER_UNIT.items()}
    odd = {unit: oddness(factor) for unit, factor in factors.items()}
    rounded = float32 and coarse(factors[assumed]) and odd[assumed] == min(odd.values())
    odd |= {unit: math.inf for unit, factor in factors.items() if coarse(factor)}
    best = min(odd, key=lambda unit: odd[unit])
    if rounded or (odd[best] > _IMPOSSIBLE and odd[assumed] == math.inf):
        return (
            f"among the first {n:,} events there are {np.unique(events['t']).size:,} different "
            "times: save them as whole microseconds or float64, since float32 has too few digits "
            "for such times"
        )
    usual_rate = n * 1e6 / usual_us
    doubtful = _DOUBTFUL_IF_FULL if step_us == 1 and n > 2 * usual_us else _DOUBTFUL
    if best == assumed or (odd[assumed] < odd[best] + doubtful and usual_rate >= _SLOWEST):
        return ""
    rate = n * 1e6 / duration_us
    return (
        f"the first {n:,} events take {duration_us / 1e6:,.6g} s if times are in {assumed}, as "
        f"assumed, which is {rate:,.3g} events/s: if they are in {best}, which is more likely, "
        + remedy.format(unit=best)
    )


class UnitCheck:
    """Check of the unit of times that no reader has checked, by the first events of a drive.

    It warns once, after some thousands of events or at the end of a shorter drive.
    """

    #: so many events are taken
    _ENOUGH = 10_000

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._first: list[Events] = []
        self._missing = self._ENOUGH

    def feed(self, events: Events) -> None:
        """Take the next events."""
        if self._missing > 0:
            self._first.append(events[: self._missing].copy())
            self._missing -= events.size
            if self._missing <= 0:
                self.finish()

    def finish(self) -> None:
        """Judge the events that were taken."""
        self._missing = 0
        if self._first:
            first, self._first = np.concatenate(self._first), []
            doubt = _doubt(first, None, self._sensor, "us", remedy="give whole microseconds")
            if doubt:
                warnings.warn(doubt, EdgeVprWarning, stacklevel=4)
