"""``.npy``: a structured array, or four columns; read and written as a stream."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import EVENT_DTYPE, Events, Sensor
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import Columns, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy


class ArrayStream:
    """Rows of an array in NumPy's file format, from any binary stream, a few at a time.

    Parameters
    ----------
    stream : binary file
        At the start of the array.
    name : str
        Named in messages.

    Attributes
    ----------
    dtype : dtype
    shape : tuple of int
    """

    def __init__(self, stream: IO[bytes], name: str) -> None:
        self._stream = stream
        self.name = name
        try:
            version = np.lib.format.read_magic(stream)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            self.shape, fortran, self.dtype = read(stream)
        except (ValueError, KeyError) as error:
            raise RecordingError(
                f"{name} is no readable NumPy array ({error}): save it again with numpy.save"
            ) from error
        if self.dtype.hasobject:
            raise RecordingError(
                f"{name} holds Python objects, which are never unpickled: save numbers"
            )
        if fortran and sum(side > 1 for side in self.shape) > 1:
            raise RecordingError(
                f"{name} is stored column by column (Fortran order) and cannot be read in "
                "pieces: save numpy.ascontiguousarray of it"
            )
        self.row_bytes = self.dtype.itemsize * math.prod(self.shape[1:])
        self.rows_read = 0

    def read(self, rows: int) -> tuple[npt.NDArray[Any], int]:
        """Read the next rows.

        Returns
        -------
        array : ndarray, shape (n, ...)
            ``n`` is less than `rows` at the end only.
        leftover : int
            Bytes of a last incomplete row, where the stream is cut off.
        """
        rows = min(rows, self.shape[0] - self.rows_read)
        data = self._stream.read(rows * self.row_bytes) if self.row_bytes else b""
        whole = len(data) // self.row_bytes if self.row_bytes else 0
        self.rows_read += whole
        array = np.frombuffer(data, self.dtype, whole * math.prod(self.shape[1:]))
        return array.reshape(whole, *self.shape[1:]), len(data) - whole * self.row_bytes


class NpySource(Source):
    """Events in one array: named fields, or columns in the order ``t, x, y, p``."""

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with self.path.open("rb") as file:
            yield from array_chunks(self, ArrayStream(file, str(self.path)), log)


def array_chunks(source: Source, stream: ArrayStream, log: FaultLog) -> Iterator[Columns]:
    """Yield the events of one array of events, and set the position of `source`."""
    names = column_names(stream, source.options.columns)
    total, entry = stream.shape[0], 0
    while entry < total:
        rows, leftover = stream.read(source.options.chunk_events)
        source.position = min(1.0, (entry + len(rows)) / total)
        if len(rows):
            columns = {
                name: rows[field] if isinstance(field, str) else rows[:, field]
                for name, field in names.items()
            }
            yield tidy(columns, source.options.time_unit, log, entry)
        entry += len(rows)
        if leftover or not len(rows):
            missing = (total - entry) * stream.row_bytes - leftover
            log.truncated(missing, f"event {entry:,} of {total:,}")
            return


def column_names(stream: ArrayStream, order: str | None) -> dict[str, str | int]:
    """Map t, x, y, p to fields or column numbers of an array of events.

    Raises
    ------
    RecordingError
        If the array has neither.
    """
    if stream.dtype.names is not None and len(stream.shape) == 1:
        fields = match_columns(stream.dtype.names)
        if fields is None:
            raise RecordingError(
                f"{stream.name} has the fields {', '.join(stream.dtype.names)}, and not "
                "t, x, y, p: rename them"
            )
        return dict(fields)
    if len(stream.shape) == 2 and stream.dtype.kind in "iuf":
        wanted = order or "txyp"
        if stream.shape[1] == len(wanted):
            return {name: i for i, name in enumerate(wanted) if name != "-"}
    raise RecordingError(
        f"{stream.name} has shape {stream.shape} and dtype {stream.dtype}, which are no events: "
        "save a structured array with fields t, x, y, p, or columns in that order (or --columns)"
    )


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open a ``.npy`` file of events."""
    source = NpySource(path, options)
    with path.open("rb") as file:
        column_names(ArrayStream(file, str(path)), options.columns)
    source.position = 0.0
    return source


class NpySink:
    """Write events as one structured array of :data:`EVENT_DTYPE`; the sensor is not stored."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        self._file = path.open("wb")
        self._rows = 0
        self._write_header()

    def _write_header(self) -> None:
        # numpy pads the header so that the row count may grow in place
        np.lib.format.write_array_header_1_0(
            self._file,
            {
                "descr": np.lib.format.dtype_to_descr(EVENT_DTYPE),
                "fortran_order": False,
                "shape": (self._rows,),
            },
        )

    def write(self, events: Events) -> None:
        """Append events."""
        self._file.write(np.ascontiguousarray(events, EVENT_DTYPE).tobytes())
        self._rows += events.size

    def close(self) -> None:
        """Write the final row count."""
        with self._file as file:
            file.seek(0)
            self._write_header()


open_sink = NpySink
