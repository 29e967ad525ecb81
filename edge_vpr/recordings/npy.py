"""``.npy``: a structured array, or four columns; read and written as a stream."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import EVENT_DTYPE, Events, Sensor
from edge_vpr.recordings.array_stream import ArrayStream
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

#: Text that this package writes behind the last row, where NumPy does not read.
_TRAILER = "\n# edge-vpr sensor={sensor} start_us={start_us}\n"
_TRAILER_PATTERN = re.compile(
    rb"\n# edge-vpr sensor=([0-9]{1,5})x([0-9]{1,5}) start_us=(-?[0-9]{1,19})\n"
)
_LONGEST_TRAILER = 80


class NpySource(Source):
    """Source of events in one array: named fields, or columns in the order ``t, x, y, p``."""

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
        If the array has neither fields nor columns of events.
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


def open_source(path: Path, options: ReadOptions) -> Source:
    """Open a ``.npy`` file of events."""
    with path.open("rb") as file:
        stream = ArrayStream(file, str(path))
        column_names(stream, options.columns)
        sensor, start_us = _read_trailer(file, stream)
    source = NpySource(path, options, sensor)
    if start_us is not None:
        source.start_us, source.relative = start_us, True
    source.unit_assumed = sensor is None and options.time_unit is None
    return source


def _read_trailer(file: IO[bytes], stream: ArrayStream) -> tuple[Sensor | None, int | None]:
    """Read sensor and start if they directly follow the last row at the end of the file."""
    end = stream.header_bytes + stream.shape[0] * stream.row_bytes if stream.shape else 0
    file.seek(0, 2)
    if 0 < file.tell() - end <= _LONGEST_TRAILER:
        file.seek(end)
        if match := _TRAILER_PATTERN.fullmatch(file.read()):
            return Sensor(int(match[1]), int(match[2])), int(match[3])
    return None, None


class NpySink:
    """Write events as one structured array of :data:`EVENT_DTYPE`.

    Sensor and start follow the last row as a line of text. NumPy reads as many bytes as the header
    states and ignores the rest.
    """

    def __init__(self, path: Path, sensor: Sensor, start_us: int, *, trailer: bool = True) -> None:
        self._file = path.open("wb")
        self._rows = 0
        self._trailer = _TRAILER.format(sensor=sensor, start_us=start_us) if trailer else ""
        self._write_header()

    def _write_header(self) -> None:
        # numpy pads the header so that the number of rows can grow in place
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
        """Write the trailer and the final row count."""
        with self._file as file:
            file.write(self._trailer.encode("ascii"))
            file.seek(0)
            self._write_header()


open_sink = NpySink
