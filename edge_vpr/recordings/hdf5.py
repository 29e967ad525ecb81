"""HDF5: Metavision's ``CD/events``, DSEC's ``events/{t,x,y,p}`` with ``t_offset``, and their kin.

Read with h5py in slices: eventcv reads such files right and in bounded memory too, but guesses the
sensor where none is stated, and takes three times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import MissingExtraError, RecordingError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import Columns, ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy

_CHUNK_ROWS = 1 << 14
_START = "edge_vpr_start_us"


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("an HDF5 file", "h5py", "hdf5") from error
    return h5py


class Hdf5Source(Source):
    """A group of columns, a compound dataset, or a dataset of columns, wherever it lies."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._h5py = _h5py()
        with self._open(path) as file:
            places = self._places(file, options)
            if options.topic is not None:
                wanted = options.topic.strip("/")
                places = {name: fields for name, fields in places.items() if name == wanted}
            if not places:
                raise RecordingError(
                    f"{path} holds no datasets t, x, y, p"
                    + (f" under {options.topic}" if options.topic else "")
                    + ": name their group with --topic, or the order of an array's columns "
                    "with --columns"
                )
            if len(places) > 1:
                raise UsageError(
                    f"{path} holds events in {', '.join(places)}: choose one with --topic"
                )
            ((self._place, self._fields),) = places.items()
            sensor = _sensor(file, file[self._place])
            self._offset_us = _offset(file, file[self._place].parent)
            start = file.attrs.get(_START)
        super().__init__(path, options, sensor)
        if start is not None:
            self.start_us, self.relative = int(start), True
        self.position = 0.0

    def _open(self, path: Path) -> Any:
        try:
            return self._h5py.File(path, "r")
        except OSError as error:
            raise RecordingError(
                f"{path} is damaged, cut off or no HDF5 file ({error}): copy it again"
            ) from error

    def _places(self, file: Any, options: ReadOptions) -> dict[str, dict[str, Any]]:
        """Where events lie: for each group or dataset, where its t, x, y, p are."""
        places: dict[str, dict[str, Any]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, self._h5py.Group):
                columns = {
                    key: item[key] for key in item if isinstance(item[key], self._h5py.Dataset)
                }
                flat = [key for key, column in columns.items() if column.ndim == 1]
                if fields := match_columns(flat):
                    places[name] = fields
            elif item.dtype.names is not None and item.ndim == 1:
                if fields := match_columns(item.dtype.names):
                    places[name] = fields
            elif item.ndim == 2 and options.columns and item.shape[1] == len(options.columns):
                places[name] = {c: i for i, c in enumerate(options.columns) if c != "-"}

        visit("/", file)
        file.visititems(visit)
        return places

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with self._open(self.path) as file:
            place = file[self._place]
            total = self._rows(place)
            for begin in range(0, total, self.options.chunk_events):
                rows = slice(begin, min(begin + self.options.chunk_events, total))
                self.position = rows.stop / total
                try:
                    columns = self._slice(place, rows)
                except OSError as error:
                    raise RecordingError(
                        f"{self.path} cannot be read at event {begin:,} ({error}): it is damaged, "
                        "or compressed by a filter (Metavision's ECF) that is not installed"
                    ) from error
                t, x, y, p = tidy(columns, self.options.time_unit, log, begin)
                yield Columns(t + self._offset_us if self._offset_us else t, x, y, p)

    def _rows(self, place: Any) -> int:
        if isinstance(place, self._h5py.Dataset):
            return int(place.shape[0])
        lengths = {name: place[field].shape[0] for name, field in self._fields.items()}
        if len(set(lengths.values())) != 1:
            sizes = ", ".join(f"{name} {n:,}" for name, n in lengths.items())
            raise RecordingError(
                f"{self.path} has columns of different lengths ({sizes}): it was not closed when "
                "it was written, so record or convert it again"
            )
        return int(next(iter(lengths.values())))

    def _slice(self, place: Any, rows: slice) -> dict[str, Any]:
        if isinstance(place, self._h5py.Dataset):
            block = place[rows]
            if block.dtype.names is None:
                return {name: block[:, column] for name, column in self._fields.items()}
            return {name: block[field] for name, field in self._fields.items()}
        return {name: place[field][rows] for name, field in self._fields.items()}


def _sensor(file: Any, place: Any) -> Sensor | None:
    """Size of the sensor out of ``geometry`` or ``width`` and ``height`` attributes."""
    for item in (place, place.parent, file):
        geometry = item.attrs.get("geometry")
        if geometry is not None:
            return Sensor.parse(geometry.decode() if isinstance(geometry, bytes) else str(geometry))
        width, height = item.attrs.get("width"), item.attrs.get("height")
        if width is not None and height is not None:
            return Sensor(int(width), int(height))
    return None


def _offset(*groups: Any) -> int:
    """Read DSEC's ``t_offset``: what its times are to be raised by, in microseconds."""
    for group in groups:
        if "t_offset" in group and not group["t_offset"].shape:
            return int(group["t_offset"][()])
    return 0


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open an HDF5 file of events."""
    return Hdf5Source(path, options)


class Hdf5Sink:
    """Write Metavision's layout, uncompressed: ``CD/events`` with fields x, y, p, t."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        self._file = _h5py().File(path, "w")
        self._file.attrs["geometry"] = str(sensor)
        self._file.attrs[_START] = start_us
        self._rows = self._file.create_dataset(
            "CD/events",
            (0,),
            np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]),
            maxshape=(None,),
            chunks=(_CHUNK_ROWS,),
        )

    def write(self, events: Events) -> None:
        """Append events."""
        rows = np.empty(events.size, self._rows.dtype)
        for name in "xypt":
            rows[name] = events[name]
        n = self._rows.shape[0]
        self._rows.resize(n + events.size, axis=0)
        self._rows[n:] = rows

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


open_sink = Hdf5Sink
