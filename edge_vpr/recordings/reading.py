"""Common parts of readers: columns, checks and counts of faults, and reading in bounded memory."""

from __future__ import annotations

import bz2
import io
import math
import re
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprError, MissingExtraError, RecordingError, UsageError, printable
from edge_vpr.events import EVENT_DTYPE, LONGEST_SIDE, TIME_LIMIT_US, Events, Sensor


class Columns(NamedTuple):
    """Raw events as four columns of one length, of any integer dtype (``p`` also boolean).

    Times are whole microseconds of the file's own clock without wraps. They may run backwards, and
    coordinates may lie off the sensor (or be negative): `FaultLog` handles such events. A column
    may be a view into a buffer that the next chunk overwrites.
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


# Handling of faulty events: checks, counts and messages.


_REMEDY = "read with --on-fault drop (on_fault='drop') to leave {them} out and count {them}"
#: Share of faulty entries from which on dropping them is no remedy.
_NEARLY_ALL = 0.9
_CHECKS = (
    "check --sensor, --columns, --time-unit and --format, and whether a time before them is far "
    "too late"
)


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
        self.first_unreadable = ""  #: the first entry that is no event, and why
        self.assumed_unit: str | None = None  #: of times whose unit nobody states
        self.remarks: list[str] = []  #: what is implausible
        self._good = 0
        self._last_us: int | None = None

    def admit(self, columns: Columns) -> Events:
        """Check one chunk; chunks must come in the order of the file.

        An event is late if any good event before it has a later time. A single wrong time far in
        the future therefore makes all events after it late, which the count shows.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            The good events, in the order of the file; a new array.

        Raises
        ------
        RecordingError
            At the first faulty event, unless faults are dropped.
        """
        t, x, y, p = columns
        if t.size and not self._clean(columns):
            t, x, y, p = self._sift(columns)
        self.entries += columns.t.size
        self._good += t.size
        events = np.empty(t.size, EVENT_DTYPE)
        if t.size:
            if self.origin_us is None:
                self.origin_us = int(t[0])
            self._last_us = int(t[-1])
            np.subtract(t, self.origin_us, out=events["t"], casting="unsafe")
            events["x"], events["y"] = x, y
            events["p"] = p if p.dtype == np.bool_ else p > 0
        return events

    def finish(self) -> None:
        """End the pass over all of a file.

        Raises
        ------
        RecordingError
            If nearly all entries were dropped, so that those that are left mean nothing.
        """
        faults = self.faults
        bad = faults.backwards + faults.off_sensor + faults.unreadable
        if self._good and bad > _NEARLY_ALL * (bad + self._good):
            raise RecordingError(
                f"{self.path}: nearly all of its entries are faulty ({faults}; {self._good:,} are "
                f"good): {_CHECKS}"
            )

    def remark(self, text: str) -> None:
        """Keep a remark, once."""
        if text not in self.remarks:
            self.remarks.append(text)

    def truncated(self, n_bytes: int, where: str) -> None:
        """Report a cut-off end, with `n_bytes` left over at `where`."""
        if not self.drop:
            raise RecordingError(
                f"{self.path} is cut off: {n_bytes:,} bytes too many or too few at {where}: "
                + _REMEDY.format(them="the rest")
            )
        self.faults.truncated += n_bytes

    def unreadable(self, n: int, where: str, total: int | None = None) -> None:
        """Report `n` of `total` entries that are not events, the first of them at `where`."""
        if not self.drop:
            raise RecordingError(f"{self.path}: {where}: {self._remedy(n, total, 'such entries')}")
        self.first_unreadable = self.first_unreadable or where
        self.faults.unreadable += n

    def _remedy(self, bad: int, total: int | None, them: str) -> str:
        """Return what to do about `bad` of the next `total` entries."""
        if total is not None and bad > _NEARLY_ALL * (self._good + total):
            return f"and so are {bad:,} of {total:,} entries there: {_CHECKS}"
        return _REMEDY.format(them=them)

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
            and t[0] >= (-TIME_LIMIT_US if self._last_us is None else self._last_us)
            and (t[1:] >= t[:-1]).all()
            and t[-1] <= TIME_LIMIT_US
        )

    def _sift(self, columns: Columns) -> Columns:
        t, x, y, _ = columns
        width, height = self.sensor
        known = (t >= -TIME_LIMIT_US) & (t <= TIME_LIMIT_US)
        on = (x >= 0) & (x < width) & (y >= 0) & (y < height) & known
        # latest good time before each event; events outside the sensor do not change it
        floor = np.iinfo(np.int64).min
        times = np.full(t.shape, floor, np.int64)
        times[on] = t[on]
        latest = np.empty_like(times)
        latest[0] = floor if self._last_us is None else self._last_us
        latest[1:] = np.maximum(np.maximum.accumulate(times)[:-1], latest[0])
        late = on & (times < latest)
        good = on & ~late
        i = int(np.flatnonzero(~good)[0])
        if on[i]:
            what = f"time runs backwards, from {latest[i]} to {t[i]} us"
        elif known[i]:
            what = f"pixel ({x[i]}, {y[i]}) at {t[i]} us lies off the {self.sensor} sensor"
        else:
            what = f"time {t[i]} us lies beyond 2**60 us{unit_remedy(int(t[i]))}"
            self.first_unreadable = self.first_unreadable or what
        if not self.drop:
            remedy = self._remedy(int(np.count_nonzero(~good)), good.size, "such events")
            raise RecordingError(f"{self.path}: event {self.entries + i:,}: {what}: {remedy}")
        self.faults.unreadable += int(np.count_nonzero(~known))
        self.faults.off_sensor += int(np.count_nonzero(~on & known))
        self.faults.backwards += int(np.count_nonzero(late))
        return Columns(*(column[good] for column in columns))


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
    '; if times are in ns, pass --time-unit ns'
    """
    for unit, in_a_second in (("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)):
        if abs(time) < in_a_second << 33:
            return f"; if times are in {unit}, pass --time-unit {unit}"
    return ""


def check_policy(on_fault: str) -> None:
    """Raise :class:`UsageError` unless `on_fault` is ``"error"`` or ``"drop"``."""
    if on_fault not in ("error", "drop"):
        raise UsageError(f"on_fault {on_fault!r} is unknown: choose error or drop")


# Interface of readers: unchecked raw columns on the file's own clock.


#: Approximate events of one chunk: 64 Ki events are 850 kB, which stay in a core's second-level
#: cache.
CHUNK_EVENTS = 1 << 16


@dataclass(frozen=True)
class ReadOptions:
    """Format of the file (a name of `FORMATS`), and what the caller states beside the file.

    `frame_period` must not contradict the file; `default_frame_period` is for files that say none.
    """

    format: str
    sensor: Sensor | None = None
    frame_period: Fraction | None = None
    default_frame_period: Fraction | None = None
    chunk_events: int = CHUNK_EVENTS
    topic: str | None = None
    time_unit: str | None = None
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
    position : float or None
        Share of the file that has been read, 0 to 1; None if it is not known.
    """

    start_us: int | None = None
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
        self.sensor = sensor if sensor is not None else options.sensor
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


def import_extra(module: str, what: str, library: str, extra: str) -> Any:
    """Import a module of an optional library, or raise an error that names the extra with it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(what, library, extra) from error


# Conversion of all exceptions of parsing libraries to `EdgeVprError`.
#
# The parsers behind the readers (zip, NumPy's headers, HDF5, Arrow, rosbags, Pillow, Rust) raise
# exceptions of any kind for a damaged file. Readers handle those that they expect; `foreign_errors`
# converts all others to a :class:`RecordingError` that names the file and the place.


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


# Conversion of times that wrap into times that never wrap.


class Unwrapper:
    """Continue a clock of `bits` bits beyond its wraps, chunk by chunk.

    Between two events the shorter direction is taken, so that a step of less than half the clock's
    period can go forwards or backwards. Slightly late events stay late, also across a wrap.

    Examples
    --------
    >>> Unwrapper(8).unwrap(np.array([250, 3, 254, 5], np.uint8))
    array([250, 259, 254, 261])
    """

    def __init__(self, bits: int) -> None:
        self._half = 1 << (bits - 1)
        self._mask = (1 << bits) - 1
        self._last: int | None = None

    def unwrap(self, times: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return the times of one chunk, int64, continued from the chunk before."""
        raw = times.astype(np.int64)
        if raw.size == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = np.diff(raw, prepend=first)
        steps += self._half
        steps &= self._mask
        steps -= self._half
        unwrapped = np.cumsum(steps, out=steps)
        unwrapped += first
        self._last = int(unwrapped[-1])
        return unwrapped


# Arrays in NumPy's file format, read a few rows at a time from any binary stream.


#: Most bytes of one row: a frame of 4 million counts of 8 bytes.
LONGEST_ROW_BYTES = 1 << 25
_READ_BYTES = 1 << 25
_LONGEST_HEADER = 1 << 16
_READERS = {
    (1, 0): (2, np.lib.format.read_array_header_1_0),
    (2, 0): (4, np.lib.format.read_array_header_2_0),
}


class ArrayStream:
    """Read an array in NumPy's file format from any binary stream, a few rows at a time.

    The header's claims are not trusted: no read is larger than 32 MiB, and a larger row is an
    error.

    Parameters
    ----------
    stream : binary file
        At the start of the array.
    name : str
        Name of the array in messages.

    Attributes
    ----------
    header_bytes : int
        Length of the header in bytes.
    most_rows : int
        Largest number of rows that one call of :meth:`read` returns.
    rows_read : int
        Number of rows that :meth:`read` has returned.

    Raises
    ------
    RecordingError
        If the stream holds no such array, or one that cannot be read in pieces.
    """

    def __init__(self, stream: IO[bytes], name: str) -> None:
        self._stream = stream
        self.name = name
        try:
            self.shape, fortran, self.dtype = self._header()
        except Exception as error:  # NumPy evaluates the header as Python text
            raise RecordingError(
                f"{name} is no readable NumPy array ({error}): save it again with numpy.save"
            ) from error
        if self.dtype.hasobject:
            raise RecordingError(
                f"{name} holds Python objects, which are never unpickled: save numbers"
            )
        if not all(type(side) is int and 0 <= side < 1 << 48 for side in self.shape):
            raise RecordingError(f"{name} has the shape {self.shape}: copy or save it again")
        if fortran and sum(side > 1 for side in self.shape) > 1:
            raise RecordingError(
                f"{name} is stored column by column (Fortran order) and cannot be read in "
                "pieces: save numpy.ascontiguousarray of it"
            )
        self.row_bytes = self.dtype.itemsize * math.prod(self.shape[1:])
        if self.row_bytes > LONGEST_ROW_BYTES:
            raise RecordingError(
                f"{name} has rows of {self.row_bytes:,} bytes (shape {self.shape}, dtype "
                f"{self.dtype}), and the most is {LONGEST_ROW_BYTES:,}: save it in smaller pieces"
            )
        self.most_rows = max(1, _READ_BYTES // (self.row_bytes or 1))
        self.rows_read = 0

    def _header(self) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
        version = np.lib.format.read_magic(self._stream)
        if version not in _READERS:
            raise ValueError(f"version {version[0]}.{version[1]}")
        size, read = _READERS[version]
        length = self._stream.read(size)
        n = int.from_bytes(length, "little")
        if n > _LONGEST_HEADER:
            raise ValueError(f"a header of {n:,} bytes")
        text = self._stream.read(n)
        self.header_bytes = np.lib.format.MAGIC_LEN + size + n
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about Python 2, and about texts that are not Python
            return read(io.BytesIO(length + text))

    def read(self, rows: int) -> tuple[npt.NDArray[Any], int]:
        """Read the next rows, up to :attr:`most_rows`.

        Returns
        -------
        array : ndarray, shape (n, ...)
            ``n`` may be less than `rows`; it is 0 at the end only.
        leftover : int
            Number of bytes of a last incomplete row, if the stream is cut off.
        """
        rows = min(rows, self.shape[0] - self.rows_read, self.most_rows)
        data = self._stream.read(rows * self.row_bytes) if self.row_bytes else b""
        whole = len(data) // self.row_bytes if self.row_bytes else 0
        self.rows_read += whole
        array = np.frombuffer(data, self.dtype, whole * math.prod(self.shape[1:]))
        return array.reshape(whole, *self.shape[1:]), len(data) - whole * self.row_bytes

    def blocks(self, rows: int, log: FaultLog, where: str) -> Iterator[npt.NDArray[Any]]:
        """Yield all rows, up to `rows` at a time.

        A cut-off end is reported to `log`; `where` formats how many rows were read of how many.
        """
        total = self.shape[0]
        while self.rows_read < total:
            block, leftover = self.read(rows)
            if len(block):
                yield block
            if leftover or not len(block):
                lost = (total - self.rows_read) * self.row_bytes - leftover
                log.truncated(lost, where.format(self.rows_read, total))
                return

    def load(self, most_bytes: int) -> npt.NDArray[Any]:
        """Read a small array whole.

        Raises
        ------
        RecordingError
            If it is cut off, or larger than `most_bytes`.
        """
        size = math.prod(self.shape) * self.dtype.itemsize
        if size > most_bytes:
            raise RecordingError(
                f"{self.name} claims {size:,} bytes, and the most is {most_bytes:,}: save it again"
            )
        data = self._stream.read(size)
        if len(data) < size:
            raise RecordingError(f"{self.name} is cut off: copy or save it again")
        return np.frombuffer(data, self.dtype).reshape(self.shape)


# Files that are records of one size behind a header.


def is_text(line: bytes) -> bool:
    """Return whether bytes are a line of a header, in ASCII, UTF-8 or Latin-1."""
    return line.endswith(b"\n") and not re.search(rb"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]", line)


def read_records(
    path: Path, start: int, dtype: np.dtype[Any], number: int, log: FaultLog, what: str = "an event"
) -> Iterator[tuple[npt.NDArray[Any], float]]:
    """Yield the records from byte `start` on, up to `number` at a time.

    Beside each part is the share of the file up to its end. `what` names a record in the report of
    a last one that is cut off.
    """
    size = max(1, path.stat().st_size)
    with path.open("rb") as file:
        file.seek(start)
        while data := file.read(number * dtype.itemsize):
            yield np.frombuffer(data, dtype, len(data) // dtype.itemsize), file.tell() / size
            if leftover := len(data) % dtype.itemsize:
                log.truncated(leftover, f"byte {size - leftover:,}, within {what}")


# Choice of one of the streams of a file, by its name or its number.


class Wording(NamedTuple):
    """What messages call the streams."""

    #: one, several: ``"camera"`` and ``"cameras"``, for example.
    one: str
    several: str
    remedy: str  #: What to do if there is none.


def choose_stream(
    path: Path, names: Mapping[int, str], wanted: str | None, wording: Wording
) -> int:
    """Return the number of the one stream, or of that which is wanted.

    Parameters
    ----------
    names : mapping of int to str
        Names of the streams by their numbers.
    wanted : str, optional
        Name or number of the stream.

    Raises
    ------
    RecordingError
        If there is none.
    UsageError
        If there are several.
    """
    found = [number for number, name in names.items() if wanted in (None, name, str(number))]
    listed = ", ".join(f"{number} ({name})" for number, name in names.items()) or "none"
    if not found:
        raise RecordingError(
            f"{path} has no {wording.one}{f' {wanted!r}' if wanted else ''}; it has: {listed}: "
            f"{wording.remedy}, or choose one of these with --topic"
        )
    if len(found) > 1:
        raise UsageError(f"{path} has several {wording.several}, {listed}: choose with --topic")
    return found[0]


# Decompression with a limit: a few bytes cannot become gigabytes of memory.


#: Most bytes that one packet, chunk or message of a recording may expand to.
LIMIT_BYTES = 1 << 26
#: Bytes that are read, and expanded, at a time.
PIECE_BYTES = 1 << 20


class DecompressionError(ValueError):
    """Compressed data is damaged, cut off, or expands to more than the limit."""


def lz4(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses LZ4 frames; errors name `what`."""
    frame = import_extra("lz4.frame", f"{what}, LZ4", "lz4", extra)
    return lambda data: expand(frame.LZ4FrameDecompressor, data, (RuntimeError, EOFError))


def zstd_decompressor(
    what: str, extra: str
) -> tuple[Callable[[], Any], tuple[type[Exception], ...]]:
    """Return a maker of Zstandard decompressors, and its exceptions; errors name `what`."""
    package = "compression" if sys.version_info >= (3, 14) else "backports"
    zstd = import_extra(f"{package}.zstd", f"{what}, ZSTD", "backports.zstd", extra)
    return zstd.ZstdDecompressor, (zstd.ZstdError, EOFError)


def zstd(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses Zstandard frames; errors name `what`."""
    decompressor, errors = zstd_decompressor(what, extra)
    return lambda data: expand(decompressor, data, errors)


def bzip2(data: bytes) -> bytes:
    """Decompress bzip2 streams."""
    return expand(bz2.BZ2Decompressor, data, (OSError, EOFError))


def expand(
    new: Callable[[], Any],
    data: bytes,
    errors: tuple[type[Exception], ...],
    limit: int | None = None,
) -> bytes:
    """Decompress one or more frames, and stop at the limit.

    Parameters
    ----------
    new : callable
        Function that makes a decompressor with the interface of :class:`bz2.BZ2Decompressor`.
    errors : tuple of exception types
        Exceptions that the decompressor raises for damaged data.
    limit : int, optional
        Most bytes of the result; by default :data:`LIMIT_BYTES`.

    Raises
    ------
    DecompressionError
        If the data is damaged, cut off, or expands to more than `limit`.
    """
    limit = LIMIT_BYTES if limit is None else limit
    return b"".join(expand_file(new, io.BytesIO(data), errors, limit))


def expand_file(
    new: Callable[[], Any], file: BinaryIO, errors: tuple[type[Exception], ...], limit: int
) -> Iterator[bytes]:
    """Decompress the frames of a file piece by piece, and stop at the limit.

    Parameters
    ----------
    new, errors, limit
        As for :func:`expand`.
    file : binary file
        Read to its end.

    Yields
    ------
    bytes
        At most :data:`PIECE_BYTES`.

    Raises
    ------
    DecompressionError
        As for :func:`expand`; the pieces yielded before are correct.
    """
    size = 0
    rest = file.read(PIECE_BYTES)
    while rest:
        frame = new()
        while not frame.eof:
            if frame.needs_input and not rest:
                rest = file.read(PIECE_BYTES)
                if not rest:
                    raise DecompressionError("the compressed data is cut off")
            try:
                part = frame.decompress(rest, max_length=min(PIECE_BYTES, limit + 1 - size))
            except errors as error:
                raise DecompressionError(str(error)) from error
            rest = b""  # the decompressor keeps the bytes that it has not used
            size += len(part)
            if size > limit:
                raise DecompressionError(f"it expands to more than {limit:,} bytes")
            if part:
                yield part
            elif not (frame.eof or frame.needs_input):
                raise DecompressionError("the compressed data gives nothing")
        rest = frame.unused_data or file.read(PIECE_BYTES)
