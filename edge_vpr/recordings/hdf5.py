"""HDF5: Metavision's ``CD/events``, DSEC's ``events/{t,x,y,p}`` with ``t_offset``, and similar.

Slices are read with h5py: eventcv reads such files correctly and in bounded memory too, but guesses
the sensor where none is stated, and takes three times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.hdf5_chunks import CheckedDataset
from edge_vpr.recordings.hdf5_files import checked_dataset, load_h5py, open_hdf5
from edge_vpr.recordings.hdf5_writing import START, Hdf5Sink
from edge_vpr.recordings.source import ReadOptions, Source
from edge_vpr.recordings.table import match_columns, tidy


class Hdf5Source(Source):
    """Source of a group of columns, a compound dataset, or a dataset of columns, at any place."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._h5py = load_h5py()
        self.path = path
        with open_hdf5(path) as file:
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
            self._offset_us = self._offset(file, file[self._place].parent)
            if abs(self._offset_us) > TIME_LIMIT_US:
                raise RecordingError(
                    f"{path} has a t_offset of {self._offset_us}, beyond 2**60 us: record it again"
                )
            start = file.attrs.get(START)
        super().__init__(path, options, sensor)
        if start is not None:
            self.start_us, self.relative = int(start), True
        self.unit_assumed = start is None and options.time_unit is None

    def _places(self, file: Any, options: ReadOptions) -> dict[str, dict[str, Any]]:
        """Return the place of t, x, y and p in each group or dataset of events."""
        places: dict[str, dict[str, Any]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, self._h5py.Group):
                flat = [key for key in item if (c := self._dataset(item, key)) and c.ndim == 1]
                if fields := match_columns(flat):
                    places[name] = fields
            elif not isinstance(item, self._h5py.Dataset):
                return
            elif item.dtype.names is not None and item.ndim == 1:
                if fields := match_columns(item.dtype.names):
                    places[name] = fields
            elif item.ndim == 2 and options.columns and item.shape[1] == len(options.columns):
                places[name] = {c: i for i, c in enumerate(options.columns) if c != "-"}

        visit("/", file)
        file.visititems(visit)  # does not follow links
        return places

    def _dataset(self, group: Any, name: str) -> Any:
        """Return the dataset `name` if it lies in the group itself and is not a link."""
        if isinstance(group.get(name, getlink=True), self._h5py.HardLink):
            item = group[name]
            if isinstance(item, self._h5py.Dataset):
                return item
        return None

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        with open_hdf5(self.path) as file:
            place = file[self._place]
            checked = {
                name: checked_dataset(self.path, item)
                for name, item in self._datasets(place).items()
            }
            total = self._rows(place)
            for begin in range(0, total, self.options.chunk_events):
                rows = slice(begin, min(begin + self.options.chunk_events, total))
                self.position = rows.stop / total
                try:
                    columns = self._slice(checked, rows)
                except OSError as error:
                    raise RecordingError(
                        f"{self.path} cannot be read at event {begin:,} ({error}): it is damaged, "
                        "or compressed by a filter (Metavision's ECF) that is not installed"
                    ) from error
                t, x, y, p = tidy(columns, self.options.time_unit, log, begin)
                # both are below 2**60, so that the sum does not overflow
                yield Columns(t + self._offset_us if self._offset_us else t, x, y, p)

    def _offset(self, *groups: Any) -> int:
        """Read DSEC's ``t_offset``, which is added to the times, in microseconds."""
        for group in groups:
            offset = self._dataset(group, "t_offset")
            if offset is not None and not offset.shape:
                checked_dataset(self.path, offset)
                return int(offset[()])
        return 0

    def _datasets(self, place: Any) -> dict[str, Any]:
        """Return the dataset of each column; a dataset with all columns has the name ""."""
        if isinstance(place, self._h5py.Dataset):
            return {"": place}
        return {name: place[field] for name, field in self._fields.items()}

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

    def _slice(self, checked: dict[str, CheckedDataset], rows: slice) -> dict[str, Any]:
        if "" not in checked:
            return {name: dataset.read(rows) for name, dataset in checked.items()}
        block = checked[""].read(rows)
        if block.dtype.names is None:
            return {name: block[:, column] for name, column in self._fields.items()}
        return {name: block[field] for name, field in self._fields.items()}


def _sensor(file: Any, place: Any) -> Sensor | None:
    """Read the size of the sensor from ``geometry``, or from ``width`` and ``height``."""
    for item in (place, place.parent, file):
        geometry = item.attrs.get("geometry")
        if geometry is not None:
            return Sensor.parse(geometry.decode() if isinstance(geometry, bytes) else str(geometry))
        width, height = item.attrs.get("width"), item.attrs.get("height")
        if width is not None and height is not None:
            return Sensor(int(width), int(height))
    return None


open_source = Hdf5Source
open_sink = Hdf5Sink
