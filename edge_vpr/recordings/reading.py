"""Recordings: the events of a reader are checked, cropped and yielded; faulty ones are counted.

A reader of a format is a `Source`, which yields `Columns` of unchecked events. `Recording` checks
them with a `FaultLog`, and yields `Events`.
"""

from __future__ import annotations

import contextlib
import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import (
    EdgeVprError,
    MissingExtraError,
    RecordingError,
    UsageError,
    printable,
)
from edge_vpr.events import (
    LONGEST_SIDE,
    NO_EVENTS,
    TIME_LIMIT_US,
    Columns,
    Events,
    Sensor,
    in_order,
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
    frame_period, counted
        See `EventSource`.
    """

    start_us: int | None = None
    end_us: int | None = None
    frame_period: Fraction | None = None
    counted: npt.NDArray[np.bool_] | None = None
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


@dataclass
class Faults:
    """Number of dropped entries of each kind in a pass over a recording so far.

    Attributes
    ----------
    backwards : int
        Events earlier than an event before them.
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
    """Check raw columns, convert them to events, and count faulty ones.

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
        self.path = path
        self.sensor = sensor
        self.drop = on_fault == "drop"
        self.origin_us = origin_us
        self.faults = Faults()
        self.entries = 0  #: events of the file seen so far, good or bad
        self.first_unreadable = ""  #: the first entry that is not an event, and why
        self.without_polarity = False  #: whether a table has no column of it
        self.last_us: int | None = None  #: time of the last good event so far

    def admit(self, columns: Columns) -> Events:
        """Check one chunk; chunks must come in the order of the file.

        An event is late if any good event before it has a later time.

        Returns
        -------
        Events
            The good ones, in the order of the file, in columns of their own.

        Raises
        ------
        RecordingError
            At the first faulty event, unless faults are dropped.
        """
        entries = columns.t.size
        if entries and not self._clean(columns):
            columns = self._sift(columns)
        self.entries += entries
        t, x, y, p = columns
        if not t.size:
            return NO_EVENTS
        if self.origin_us is None:
            self.origin_us = int(t[0])
        self.last_us = int(t[-1])
        on = p.copy() if p.dtype == np.bool_ else p > 0
        times = np.subtract(t, self.origin_us, dtype=np.int64, casting="unsafe")
        return Events(times, x.astype(np.uint16), y.astype(np.uint16), on)

    def truncated(self, n_bytes: int, where: str) -> None:
        """Report a cut-off end, with `n_bytes` left over at `where`."""
        if not self.drop:
            raise RecordingError(
                f"{self.path} is cut off: {n_bytes:,} bytes too many or too few at {where}: "
                + _REMEDY.format(them="the rest is")
            )
        self.faults.truncated += n_bytes

    def unreadable(self, n: int, where: str) -> None:
        """Report `n` entries that are not events, the first of them at `where`."""
        if not self.drop:
            raise RecordingError(f"{self.path}: {where}: {_REMEDY.format(them='such entries are')}")
        self.first_unreadable = self.first_unreadable or where
        self.faults.unreadable += n

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

    def _sift(self, columns: Columns) -> Columns:
        """Return the good events of a chunk, and count the others."""
        t, x, y, _ = columns
        width, height = self.sensor
        dated = (t >= -TIME_LIMIT_US) & (t <= TIME_LIMIT_US)
        on = (x >= 0) & (x < width) & (y >= 0) & (y < height) & dated
        # latest time before each event, of the events on the sensor
        latest = np.full(t.size + 1, -TIME_LIMIT_US if self.last_us is None else self.last_us)
        latest[1:][on] = t[on]
        latest = np.maximum.accumulate(latest)[:-1]
        good = on & (t >= latest)
        if not self.drop:
            i = int(np.argmin(good))
            if not dated[i]:
                what = f"time {t[i]} us lies beyond 2**60 us: check time_unit= and format="
            elif not on[i]:
                what = (
                    f"pixel ({x[i]}, {y[i]}) at {t[i]} us lies off the {self.sensor} sensor: "
                    "check sensor= and columns="
                )
            else:
                what = (
                    f"time runs backwards, from {latest[i]} to {t[i]} us: sort the events by t, or "
                    "check columns="
                )
            remedy = _REMEDY.format(them="such events are")
            raise RecordingError(f"{self.path}: event {self.entries + i:,}: {what}; or {remedy}")
        self.faults.unreadable += int(np.count_nonzero(~dated))
        self.faults.off_sensor += int(np.count_nonzero(~on & dated))
        self.faults.backwards += int(np.count_nonzero(on & ~good))
        return Columns(*(column[good] for column in columns))


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


def seconds_us(seconds: float | str, name: str) -> int:
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
    text = str(seconds)
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
    chunks : iterator of Events
        In time order. No further chunk is read after one that reaches `end_us`.

    Yields
    ------
    Events
        Copies; never empty.
    """
    for events in chunks:
        times = events.t
        first = int(np.searchsorted(times, start_us))
        end = times.size if end_us is None else int(np.searchsorted(times, end_us))
        if end > first:
            part = events[first:end].copy()
            part.t -= start_us
            yield part
        if end < times.size:
            return


# A recording: an iterable of checked event arrays, for any number of passes.


class EventSource:
    """A recording: its sensor, any number of passes over its events, and what it knows of them.

    Attributes
    ----------
    sensor : Sensor
        Size of the camera in pixels.
    start_us : int
        Time t = 0 on the file's own clock, in microseconds: since the Unix epoch if the file has
        wall-clock time (ROS, AEDAT4), else on the camera's clock.
    cropped_us : int
        Microseconds from the recording's start to time 0, which is that of the part read.
    end_us : int or None
        Where the recording is known to end, after a pass over all of it: count frames end with
        their last frame, and a part of a recording where it was cut. None if only its last event is
        known.
    frame_period : Fraction or None
        Seconds per frame of counts, as the file states or as given; None if the file holds events.
    counted : ndarray of bool, shape (height, width), or None
        Pixels that the file counts, if it names some alone.
    faults : Faults
        Entries that the newest pass has dropped so far.
    """

    start_us: int = 0
    cropped_us: int = 0
    end_us: int | None = None
    frame_period: Fraction | None = None
    counted: npt.NDArray[np.bool_] | None = None

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.faults = sensor, Faults()

    def __iter__(self) -> Iterator[Events]:
        """Yield events from the start: never empty, in time order, on the sensor."""
        raise NotImplementedError


class ForeignRecording(EventSource):
    """A recording of another package, whose events are checked: any object with a sensor."""

    def __init__(self, recording: Any) -> None:
        super().__init__(recording.sensor)
        self._recording = recording

    def __iter__(self) -> Iterator[Events]:
        return in_order(self._recording, self.sensor)


class SensorNotStated(UsageError):  # noqa: N818, what is not there is no error of the file
    """The file does not state its sensor, and nobody named it."""


class Recording(EventSource):
    r"""Iterable of events, chunk by chunk: never empty, in time order, inside the sensor.

    >>> import tempfile, edge_vpr
    >>> path = Path(tempfile.mkdtemp()) / "three.csv"
    >>> _ = path.write_text("t,x,y,p\n100,0,0,1\n150,1,0,0\n150,1,1,1\n")
    >>> recording = edge_vpr.open_recording(path, sensor=(2, 2))
    >>> recording.sensor, [len(events) for events in recording]
    (Sensor(width=2, height=2), [3])

    Each ``iter()`` starts at the first event and resets `faults` and `position`; the first one goes
    on with what was read when the file was opened. Memory does not grow with the length of the
    file. The other attributes are those of an `EventSource`.

    Attributes
    ----------
    format : str
        Short name, as in :data:`edge_vpr.recordings.FORMATS`.
    without_polarity : bool
        Whether this is a table without a column of the polarity, so that all events are ON.
    watch : callable
        Takes the events of each pass and yields them, for example to show how far it is.
    """

    def __init__(self, source: Source, on_fault: str) -> None:
        if source.sensor is None:
            raise SensorNotStated(
                f"{source.path} does not say how large its sensor is: "
                "pass sensor=, for example sensor='346x260'"
            )
        self.path: Path = source.path
        self.format = source.options.format
        super().__init__(source.sensor)
        self.counted, self.frame_period = source.counted, source.frame_period
        self._source = source
        self._on_fault = on_fault
        self.watch: Callable[[Iterator[Events]], Iterator[Events]] = iter
        self._span: tuple[int, int | None] = (0, None)
        begun = self._begin()
        #: The first pass, until it is asked for; parts of this recording share it.
        self._begun = [begun]
        self._origin_us = begun.origin_us
        self.start_us = begun.origin_us if source.start_us is None else source.start_us
        self.without_polarity = begun.log.without_polarity

    @property
    def position(self) -> float | None:
        """Share of the file that the newest pass has read, 0 to 1; None if it is not known."""
        return self._source.position

    def __iter__(self) -> Iterator[Events]:
        if self._begun:
            log, chunks, first, self._source.position, _ = self._begun.pop()
            chunks = chain([first], chunks)
        else:
            log = FaultLog(self.path, self.sensor, self._on_fault, self._origin_us)
            chunks = _walk(self._source, log)
        self.faults, self.end_us = log.faults, None
        whole = self._span == (0, None)
        return self.watch(self._whole(log, chunks) if whole else self._cropped(log, chunks))

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
        part.start_us, part.cropped_us = self.start_us + start, part._span[0]
        part.faults, part.end_us = Faults(), None
        return part

    def __repr__(self) -> str:
        return f"<Recording {self.path} ({self.format}, {self.sensor})>"

    def _whole(self, log: FaultLog, chunks: Iterator[Events]) -> Iterator[Events]:
        yield from chunks
        self.end_us = self._part_end(log)

    def _cropped(self, log: FaultLog, chunks: Iterator[Events]) -> Iterator[Events]:
        start, end = self._span
        empty = True
        for events in cropped_events(chunks, start, end):
            empty = False
            yield events
        if empty:
            until = "its end" if end is None else f"{end / 1e6:g} s"
            raise RecordingError(
                f"{self.path} holds no events from {start / 1e6:g} s to {until}: give another "
                "start= and end= (edge-vpr info shows its times)"
            )
        self.end_us = self._part_end(log)

    def _part_end(self, log: FaultLog) -> int | None:
        """Return where the part that was read ends, if more than its last event says that."""
        start, end = self._span
        of_file, last_us = self._source.end_us, log.last_us
        if end is not None and last_us is not None and last_us >= self._origin_us + end:
            return end - start
        if of_file is None:
            return None
        of_file -= self._origin_us
        return (of_file if end is None else min(end, of_file)) - start

    def _begin(self) -> _Begun:
        """Read up to the first good event, so that an empty file is refused when it is opened."""
        source = self._source
        log = FaultLog(self.path, self.sensor, self._on_fault, 0 if source.relative else None)
        chunks = _walk(self._source, log)
        first = next(chunks, None)
        if first is None:
            lost = f" ({log.faults})" if log.faults.total else ""
            raise RecordingError(
                f"{self.path} holds no events of a {self.sensor} sensor{lost}: "
                + (log.first_unreadable or "check its format, its sensor, and whether it is empty")
            )
        assert log.origin_us is not None
        if source.start_us is not None and abs(source.start_us) > TIME_LIMIT_US:
            chunks.close()
            raise RecordingError(
                f"{self.path} begins at {source.start_us} us, beyond 2**60 us: copy or record it "
                "again"
            )
        position, source.position = source.position, None if source.position is None else 0.0
        return _Begun(log, chunks, first, position, log.origin_us)


def _walk(source: Source, log: FaultLog) -> Generator[Events, None, None]:
    """Yield the good events of a source."""
    with foreign_errors(source.path, lambda: f" after event {log.entries:,}"):
        for columns in source.chunks(log):
            events = log.admit(columns)
            if events.size:
                yield events


class _Begun(NamedTuple):
    """A pass over a recording, of which the first events were read."""

    log: FaultLog
    chunks: Iterator[Events]  #: Those after the first.
    first: Events
    position: float | None  #: Of the source, behind the first.
    origin_us: int
