"""NumPy's files, read a few rows at a time; events as ``.npy`` or ``.npz``."""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import archive_kind
from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import EVENT_DTYPE, Columns, Events, Sensor
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import Named, array_columns, match_columns, tidy

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


# ``.npy``: a structured array, or four columns.


class NpySource(Source):
    """Source of events in one array: named fields, or columns in the order ``t, x, y, p``."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            _check_array(ArrayStream(file, str(path)), options)
        super().__init__(path, options)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with self.path.open("rb") as file:
            yield from _array_chunks(self, ArrayStream(file, str(self.path)), log, None)


def _check_array(stream: ArrayStream, options: ReadOptions) -> None:
    """Refuse an array that holds no events."""
    array_columns(stream.name, stream.dtype, stream.shape, options.columns)


def _array_chunks(
    source: Source, stream: ArrayStream, log: FaultLog, unit: str | None
) -> Iterator[Columns]:
    """Yield the events of one array of events, and set the position of `source`."""
    named = array_columns(stream.name, stream.dtype, stream.shape, source.options.columns)
    unit = source.options.time_unit or named.unit or unit
    for rows in stream.blocks(source.options.chunk_events, log, "event {:,} of {:,}"):
        source.position = stream.rows_read / stream.shape[0]
        yield tidy(named.of(rows), unit, log, stream.rows_read - len(rows))


# ``.npz``: the project's own event archive, and event archives of other projects.


#: Version of the layout ``events``, ``sensor`` (width, height), ``start_us``, ``schema``.
SCHEMA = 1


_STORED_OR_DEFLATED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
#: Most bytes of the list of members, and of an array that is loaded whole.
_LONGEST_LIST, _LARGEST = 1 << 20, 1 << 26


class _Bounded(io.BufferedReader):
    """File that refuses single reads above a limit, for example of a list of members."""

    limit = _LONGEST_LIST

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            size = self.limit
        if size > self.limit:
            raise zipfile.BadZipFile(f"a list of {size:,} bytes")
        return super().read(size)


class Archive:
    """Archive of a ``.npz`` file, whose arrays are read as streams and never whole.

    Raises
    ------
    RecordingError
        If it is compressed by a method other than Deflate, which NumPy does not write.
    UsageError
        If it is a map or another result, whose arrays have the same names as those of a recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with ExitStack() as stack:
            file = stack.enter_context(_Bounded(path.open("rb", buffering=0)))
            self._zip = stack.enter_context(zipfile.ZipFile(file))
            file.limit = _LARGEST
            if (kind := archive_kind(path)) is not None:
                raise UsageError(f"{path} is a {kind}, and a recording is expected in its place")
            self._opened = stack.pop_all()
        self.names = {Path(name).stem: name for name in self._zip.namelist()}

    @property
    def table(self) -> str | Named | None:
        """Name of the array of events, or names of their columns; None if there are no events."""
        if "events" in self.names:
            return "events"
        if len(self.names) == 1 and not {"frames", "counts"} & set(self.names):
            (name,) = self.names
            only = self.stream(name)
            return name if only.dtype.names or len(only.shape) == 2 else None
        return match_columns(self.names)

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def stream(self, name: str) -> ArrayStream:
        """Open the array `name`, which is closed with the archive."""
        info = self._zip.getinfo(self.names[name])
        if info.compress_type not in _STORED_OR_DEFLATED or info.flag_bits & 1:
            raise RecordingError(
                f"{self.path}: {name} is encrypted, or compressed by method {info.compress_type}: "
                "save it with numpy.savez or numpy.savez_compressed"
            )
        member = self._opened.enter_context(self._zip.open(info))
        array = ArrayStream(member, f"{self.path}:{name}")
        announced = math.prod(array.shape) * array.dtype.itemsize
        held = info.file_size - array.header_bytes
        if announced < held:
            raise RecordingError(
                f"{array.name} announces {array.shape} of {array.dtype} and holds {held:,} bytes: "
                "copy or save it again"
            )
        return array

    def scalar(self, *names: str) -> float | int | None:
        """Return the first of the single numbers `names` that the archive has."""
        for name in names:
            if name in self.names:
                values = self.small(name)
                if values.size == 1 and values.dtype.kind in "iuf":
                    return values.item()
        return None

    def small(self, name: str) -> np.ndarray:
        """Load a whole array that is known to be small."""
        return self.stream(name).load(_LARGEST)

    def sensor(self) -> Sensor | None:
        """Return the size of the sensor; None if the archive does not state it."""
        for name in ("sensor", "sensor_size", "resolution"):
            if name in self.names:
                size = self.small(name)
                if size.shape == (2,) and size.dtype.kind in "iu":
                    return Sensor(int(size[0]), int(size[1]))
        width = self.scalar("sensor_width", "width")
        height = self.scalar("sensor_height", "height")
        return Sensor(int(width), int(height)) if width and height else None


class NpzSource(Source):
    """Source of the array ``events`` (structured), or of the arrays ``t``, ``x``, ``y``, ``p``."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with Archive(path) as archive:
            schema = archive.scalar("schema")
            if schema is not None and schema > SCHEMA:
                raise RecordingError(
                    f"{path} has event schema {schema}, and this edge-vpr knows {SCHEMA}: upgrade "
                    "it"
                )
            table = archive.table
            if table is None:
                raise RecordingError(
                    f"{path} holds {', '.join(sorted(archive.names))}: events need the arrays t, "
                    "x, y (and p), or events"
                )
            if isinstance(table, str):
                _check_array(archive.stream(table), options)
            self._table = table
            start = None if schema is None else archive.scalar("start_us")
            start_us = None if start is None else int(start)
            super().__init__(path, options, archive.sensor(), start_us)
        self._unit = None if schema is None else "us"

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with Archive(self.path) as archive:
            if isinstance(self._table, str):
                yield from _array_chunks(self, archive.stream(self._table), log, self._unit)
            else:
                yield from self._columns(archive, self._table, log)

    def _columns(self, archive: Archive, table: Named, log: FaultLog) -> Iterator[Columns]:
        streams = {column: archive.stream(name) for column, name in table.fields.items()}
        unit = self.options.time_unit or table.unit or self._unit
        shapes = {stream.shape for stream in streams.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            sizes = ", ".join(f"{name} {stream.shape}" for name, stream in streams.items())
            raise RecordingError(
                f"{self.path} has columns of shapes {sizes}: each event needs one of each"
            )
        (total,) = next(iter(shapes))
        entry = 0
        step = min(self.options.chunk_events, *(s.most_rows for s in streams.values()))
        while entry < total:
            read = {name: s.read(step) for name, s in streams.items()}
            n = min(len(rows) for rows, _ in read.values())
            if n:
                self.position = min(1.0, (entry + n) / total)
                columns = {name: rows[:n] for name, (rows, _) in read.items()}
                yield tidy(columns, unit, log, entry)
            expected = min(step, total - entry)
            short = [name for name, (rows, _) in read.items() if len(rows) < expected]
            entry += n
            if short:
                name = short[0]
                begun = len(read[name][0]) * streams[name].row_bytes + read[name][1]
                lost = (total - entry + n) * streams[name].row_bytes - begun
                log.truncated(lost, f"event {entry:,} of {total:,} in column {name}")
                return


class NpzSink:
    """Write ``events``, ``sensor``, ``start_us`` and ``schema``, uncompressed.

    Deflate would halve the size of the file, but reading it would take six times longer than
    matching.
    """

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        self._path = path
        self._facts = {
            "sensor": np.array(sensor, np.int64),
            "start_us": np.array(start_us, np.int64),
            "schema": np.array(SCHEMA, np.int64),
        }
        # the archive needs the size of the array before its first row
        self._rows = path.with_name(path.name + ".rows")
        self._file, self._number = self._rows.open("wb"), 0
        self._write_header()

    def _write_header(self) -> None:
        # numpy pads the header so that the number of rows can grow in place
        np.lib.format.write_array_header_1_0(
            self._file,
            {
                "descr": np.lib.format.dtype_to_descr(EVENT_DTYPE),
                "fortran_order": False,
                "shape": (self._number,),
            },
        )

    def write(self, events: Events) -> None:
        """Append events."""
        self._file.write(np.asarray(events).tobytes())
        self._number += events.size

    def close(self) -> None:
        """Write the archive from its parts."""
        try:
            with self._file:
                self._file.seek(0)
                self._write_header()
            with zipfile.ZipFile(self._path, "w", zipfile.ZIP_STORED) as archive:
                archive.write(self._rows, "events.npy")
                for name, value in self._facts.items():
                    with archive.open(f"{name}.npy", "w") as member:
                        np.lib.format.write_array(member, value, allow_pickle=False)
        finally:
            self._rows.unlink(missing_ok=True)
