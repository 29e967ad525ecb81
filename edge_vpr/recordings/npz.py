"""``.npz``: the project's own event archive, and others' archives of events."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.npy import ArrayStream, NpySink, array_chunks, column_names
from edge_vpr.recordings.source import Columns, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

#: Version of the layout ``events``, ``sensor`` (width, height), ``start_us``, ``schema``.
SCHEMA = 1


class Archive:
    """A ``.npz`` file whose arrays are read as streams, never whole."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._zip = zipfile.ZipFile(path)
        except zipfile.BadZipFile as error:
            raise RecordingError(
                f"{path} is a damaged or cut-off .npz archive ({error}): copy it again"
            ) from error
        self.names = {Path(name).stem: name for name in self._zip.namelist()}

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def stream(self, name: str, stack: ExitStack) -> ArrayStream:
        """Open the array `name`; `stack` closes it."""
        member = stack.enter_context(self._zip.open(self.names[name]))
        return ArrayStream(member, f"{self.path}:{name}")

    def scalar(self, *names: str) -> float | int | None:
        """First of the single numbers `names` that is there."""
        for name in names:
            if name in self.names:
                values = self.small(name)
                if values.size == 1:
                    return values.item()
        return None

    def small(self, name: str) -> np.ndarray:
        """Load a whole array that is known to be small."""
        with self._zip.open(self.names[name]) as member:
            return _load(member, f"{self.path}:{name}")

    def sensor(self) -> Sensor | None:
        """Size of the sensor, if the archive says it."""
        for name in ("sensor", "sensor_size", "resolution"):
            if name in self.names:
                size = self.small(name)
                if size.shape == (2,) and size.dtype.kind in "iu":
                    return Sensor(int(size[0]), int(size[1]))
        width = self.scalar("sensor_width", "width")
        height = self.scalar("sensor_height", "height")
        return Sensor(int(width), int(height)) if width and height else None


def _load(member: IO[bytes], name: str) -> np.ndarray:
    stream = ArrayStream(member, name)
    data = member.read()
    return np.frombuffer(data, stream.dtype).reshape(stream.shape)


class NpzSource(Source):
    """Events in ``events`` (structured), or in ``t``, ``x``, ``y``, ``p``, one array each."""

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with Archive(self.path) as archive, ExitStack() as stack:
            try:
                if "events" in archive.names:
                    yield from array_chunks(self, archive.stream("events", stack), log)
                else:
                    yield from self._columns(archive, stack, log)
            except (zipfile.BadZipFile, zlib.error, EOFError) as error:
                raise RecordingError(
                    f"{self.path} is damaged after event {log.entries:,} ({error}): copy it again"
                ) from error

    def _columns(self, archive: Archive, stack: ExitStack, log: FaultLog) -> Iterator[Columns]:
        names = match_columns(archive.names)
        assert names is not None  # the registry has seen t, x and y
        streams = {column: archive.stream(name, stack) for column, name in names.items()}
        shapes = {stream.shape for stream in streams.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            sizes = ", ".join(f"{name} {stream.shape}" for name, stream in streams.items())
            raise RecordingError(
                f"{self.path} has columns of shapes {sizes}: each event needs one of each"
            )
        (total,) = next(iter(shapes))
        for entry in range(0, total, self.options.chunk_events):
            rows = {
                name: stream.read(self.options.chunk_events)[0] for name, stream in streams.items()
            }
            self.position = min(1.0, (entry + self.options.chunk_events) / total)
            yield tidy(rows, self.options.time_unit, log, entry)


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open a ``.npz`` file of events."""
    with Archive(path) as archive, ExitStack() as stack:
        schema = archive.scalar("schema")
        if schema is not None and schema > SCHEMA:
            raise RecordingError(
                f"{path} has event schema {schema}, and this edge-vpr knows {SCHEMA}: upgrade it"
            )
        if "events" in archive.names:
            column_names(archive.stream("events", stack), options.columns)
        elif match_columns(archive.names) is None:
            raise RecordingError(
                f"{path} holds {', '.join(sorted(archive.names))}: events need the arrays t, x, y "
                "(and p), or events"
            )
        source = NpzSource(path, options, archive.sensor())
        start = archive.scalar("start_us")
        if schema is not None and start is not None:
            source.start_us, source.relative = int(start), True
    source.position = 0.0
    return source


class NpzSink:
    """Write ``events``, ``sensor``, ``start_us`` and ``schema``, uncompressed.

    Deflate would halve the file and read six times slower than it is matched.
    """

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        self._path = path
        self._facts = {
            "sensor": np.array(sensor, np.int64),
            "start_us": np.array(start_us, np.int64),
            "schema": np.array(SCHEMA, np.int64),
        }
        # the archive wants the array's size before its first row
        self._rows = path.with_name(path.name + ".rows")
        self._sink = NpySink(self._rows, sensor, start_us)

    def write(self, events: Events) -> None:
        """Append events."""
        self._sink.write(events)

    def close(self) -> None:
        """Put the archive together."""
        try:
            self._sink.close()
            with zipfile.ZipFile(self._path, "w", zipfile.ZIP_STORED) as archive:
                archive.write(self._rows, "events.npy")
                for name, value in self._facts.items():
                    with archive.open(f"{name}.npy", "w") as member:
                        np.lib.format.write_array(member, value, allow_pickle=False)
        finally:
            self._rows.unlink(missing_ok=True)


open_sink = NpzSink
