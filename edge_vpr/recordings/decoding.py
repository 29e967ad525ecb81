"""Parts shared by readers: arrays, records, clocks that wrap, and decompression."""

from __future__ import annotations

import io
import math
import os
import re
import sys
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, BinaryIO, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError, import_extra
from edge_vpr.recordings.reading import FaultLog

# Conversion of times that wrap into times that never wrap.


def clock_step(step: Any, period: int, back: int) -> Any:
    """Return the step of a clock, given modulo its period: at most `back` backwards, else forwards.

    A period of 0 is that of a clock that never wraps. Decoders with kernels compile this for
    themselves; other formats need no compiler.
    """
    return ((step + back) & (period - 1)) - back if period else step


class Unwrapper:
    """Continue a clock of `bits` bits beyond its wraps, chunk by chunk.

    A step between two events goes in the shorter direction, forwards or backwards: slightly late
    events stay late, also across a wrap. So a pause of more than half a period looks like a step
    back, and whole periods of a longer one are lost. EVT 3.0 has a rule of its own (`prophesee`),
    and a live clock goes back less far (`TimestampFilter`).

    Examples
    --------
    >>> Unwrapper(8).unwrap(np.array([250, 3, 254, 5], np.uint8))
    array([250, 259, 254, 261])
    """

    def __init__(self, bits: int) -> None:
        self._period = 1 << bits
        self._last: int | None = None

    def unwrap(self, times: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return the times of one chunk, int64, continued from the chunk before."""
        raw = times.astype(np.int64)
        if raw.size == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = np.diff(raw, prepend=first)
        unwrapped = first + np.cumsum(clock_step(steps, self._period, self._period // 2))
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


Header = TypeVar("Header")


class RecordFile(Generic[Header]):
    """A file of records behind a header, which is opened once for header and records.

    Parameters
    ----------
    read_header : callable
        Takes the open file, and returns the header and its length in bytes.

    Attributes
    ----------
    header : object
        As `read_header` returns it.
    """

    def __init__(self, path: Path, read_header: Callable[[BinaryIO], tuple[Header, int]]) -> None:
        self._path = path
        self._opened = path.open("rb")
        # closed with this object, if no pass takes it
        self._close = weakref.finalize(self, self._opened.close)
        self.header, self._skip = read_header(self._opened)

    def blocks(
        self, dtype: np.dtype[Any], number: int, log: FaultLog, what: str = "an event"
    ) -> Iterator[tuple[npt.NDArray[Any], float]]:
        """Yield the records, up to `number` at a time.

        Beside each part is the share of the file up to its end. `what` names a record in the report
        of a last one that is cut off.
        """
        file = self._opened if self._close.detach() else self._path.open("rb")
        with file:
            size = max(1, os.fstat(file.fileno()).st_size)
            file.seek(self._skip)
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
    numbers = [number for number, name in names.items() if wanted in (None, name, str(number))]
    listed = ", ".join(f"{number} ({name})" for number, name in names.items()) or "none"
    if not numbers:
        raise RecordingError(
            f"{path} has no {wording.one}{f' {wanted!r}' if wanted else ''}; it has: {listed}: "
            f"{wording.remedy}, or choose one of these with topic="
        )
    if len(numbers) > 1:
        raise UsageError(f"{path} has several {wording.several}, {listed}: choose with topic=")
    return numbers[0]


# Decompression with a limit: a few bytes cannot become gigabytes of memory.


#: Most bytes that one packet of a recording may expand to.
LIMIT_BYTES = 1 << 26
#: Bytes that are expanded at a time.
PIECE_BYTES = 1 << 20


class DecompressionError(ValueError):
    """Compressed data is damaged, cut off, or expands to more than the limit."""


def lz4(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses LZ4 frames; errors name `what`."""
    frame = import_extra("lz4.frame", f"{what}, LZ4", "lz4", extra)
    return lambda data: expand(frame.LZ4FrameDecompressor, data, (RuntimeError, EOFError))


def zstd(what: str, extra: str) -> Callable[[bytes], bytes]:
    """Return a function that decompresses Zstandard frames; errors name `what`."""
    package = "compression" if sys.version_info >= (3, 14) else "backports"
    library = import_extra(f"{package}.zstd", f"{what}, ZSTD", "backports.zstd", extra)
    errors = (library.ZstdError, EOFError)
    return lambda data: expand(library.ZstdDecompressor, data, errors)


def expand(new: Callable[[], Any], data: bytes, errors: tuple[type[Exception], ...]) -> bytes:
    """Decompress one or more frames, and stop at `LIMIT_BYTES`.

    Parameters
    ----------
    new : callable
        Function that makes a decompressor with the interface of :class:`bz2.BZ2Decompressor`.
    errors : tuple of exception types
        Exceptions that the decompressor raises for damaged data.

    Raises
    ------
    DecompressionError
        If the data is damaged, cut off, or expands to more than the limit.
    """
    parts, size, rest = list[bytes](), 0, data
    while rest:
        frame = new()
        while not frame.eof:
            if frame.needs_input and not rest:
                raise DecompressionError("the compressed data is cut off")
            try:
                part = frame.decompress(rest, max_length=min(PIECE_BYTES, LIMIT_BYTES + 1 - size))
            except errors as error:
                raise DecompressionError(str(error)) from error
            rest = b""  # the decompressor keeps the bytes that it has not used
            size += len(part)
            if size > LIMIT_BYTES:
                raise DecompressionError(f"it expands to more than {LIMIT_BYTES:,} bytes")
            if not (part or frame.eof or frame.needs_input):
                raise DecompressionError("the compressed data gives nothing")
            parts.append(part)
        rest = frame.unused_data
    return b"".join(parts)
