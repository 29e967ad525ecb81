"""HDF5: Metavision's ``CD/events``, DSEC's ``events/{t,x,y,p}`` with ``t_offset``, and similar.

Slices are read with h5py: eventcv reads such files correctly and in bounded memory too, but guesses
the sensor where none is stated, and takes three times as long.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_vpr.errors import MissingExtraError, RecordingError, UsageError, import_extra
from edge_vpr.events import TIME_LIMIT_US, Columns, Sensor
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source
from edge_vpr.recordings.table import UNITS, match_columns, tidy

# Open HDF5 files, and the filters that their data sets are stored through.


#: Bytes of expanded chunks that libhdf5 keeps, unless one chunk is larger.
_CACHE = 1 << 25


#: Registered filters of published files: https://github.com/HDFGroup/hdf5_plugins
_FILTER_NAMES = {
    305: "LZO",
    307: "bzip2",
    32_001: "Blosc",
    32_004: "LZ4",
    32_008: "bitshuffle",
    32_013: "ZFP",
    32_015: "Zstandard",
    32_026: "Blosc2",
    36_559: "ECF, of Metavision",
}
#: Those that hdf5plugin has.
_IN_HDF5PLUGIN = {307, 32_001, 32_004, 32_008, 32_013, 32_015, 32_026}


def load_h5py() -> Any:
    """Import h5py, or raise an error that names the extra with it."""
    return import_extra("h5py", "an HDF5 file", "h5py", "hdf5")


def _check_filters(name: str, filters: list[int]) -> None:
    """Refuse a data set whose filter libhdf5 does not find; hdf5plugin registers what it has."""
    from h5py import h5z

    if all(h5z.filter_avail(number) for number in filters):
        return
    with contextlib.suppress(ImportError):
        import hdf5plugin  # noqa: F401  # its import registers the filters
    for number in filters:
        if h5z.filter_avail(number):
            continue
        called = _FILTER_NAMES.get(number, "not in our list")
        if number in _IN_HDF5PLUGIN:
            what = f"{name}, stored through the HDF5 filter {number} ({called}),"
            raise MissingExtraError(what, "hdf5plugin", "hdf5-filters")
        raise RecordingError(
            f"{name} is stored through the HDF5 filter {number} ({called}), which is not "
            "installed: install its plug-in and name its folder in HDF5_PLUGIN_PATH, or write the "
            "file again with h5repack -f GZIP=4 where it is installed"
        )


def open_hdf5(path: Path, largest_chunk: int = 0) -> Any:
    """Open a file for reading.

    Parameters
    ----------
    largest_chunk : int
        Bytes of the largest chunk that is read, for which there must be space.

    Raises
    ------
    RecordingError
        If it is damaged.
    """
    try:
        return load_h5py().File(path, "r", rdcc_nbytes=max(_CACHE, largest_chunk), locking=False)
    except OSError as error:
        raise RecordingError(
            f"{path} is damaged, cut off or no HDF5 file ({error}): copy it again"
        ) from error


# Check what a data set claims before libhdf5 takes memory for it.


#: Filters from this number on, except LZF, are plug-ins, which only the user can install.
_PLUGINS, _LZF = 256, 32_000
#: Most bytes of one expanded chunk, which libhdf5 keeps whole, so that none is read twice: chunks
#: of any data set, and of one that is stored in at least a hundredth of that.
_CHUNK, _LARGEST_CHUNK = _CACHE, 1 << 30
#: Largest ratio of a data set's stated size to its size in the file: Deflate reaches 1,032.
_MOST_EXPANSION = 1_100


def _chunk_bytes(dataset: Any) -> int:
    return math.prod(dataset.chunks or ()) * int(dataset.dtype.itemsize)


def checked(path: Path, dataset: Any) -> Any:
    """Return a data set of a file, if what it claims is possible.

    Raises
    ------
    RecordingError
        If its data lie in other files, or its stated sizes are impossible for the size of the file.
    """
    name = f"{path}: {dataset.name}"
    if dataset.external or dataset.is_virtual:
        raise RecordingError(
            f"{name} lies in other files, which are not read: copy it into one file"
        )
    pipeline, chunk = dataset.id.get_create_plist(), _chunk_bytes(dataset)
    filters = [pipeline.get_filter(i)[0] for i in range(pipeline.get_nfilters())]
    stored, file_size = dataset.id.get_storage_size(), path.stat().st_size
    held = min(stored, file_size)
    most = max(_CHUNK, min(100 * held, _LARGEST_CHUNK))
    if chunk > most or (dataset.chunks is not None and stored > file_size):
        raise RecordingError(
            f"{name} has chunks of {stored:,} bytes in a file of {file_size:,}, each of {chunk:,} "
            f"expanded, of which the most is {most:,}: copy or record it again, or write it with "
            "h5repack -l CHUNK=65536"
        )
    _check_filters(name, filters)
    claimed = dataset.size * dataset.dtype.itemsize
    if any(number >= _PLUGINS and number != _LZF for number in filters):
        most = dataset.id.get_num_chunks() * chunk  # Zstandard expands without a limit
    else:
        most = held * _MOST_EXPANSION if dataset.chunks and filters else held
    if claimed > most:
        raise RecordingError(
            f"{name} claims {claimed:,} bytes, and the file holds {held:,} of them: it was not "
            "closed when it was written, or is damaged; copy or record it again"
        )
    return dataset


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
                    + ": name their group with topic=, or the order of an array's columns "
                    "with columns="
                )
            if len(places) > 1:
                raise UsageError(
                    f"{path} holds events in {', '.join(places)}: choose one with topic="
                )
            ((self._place, (self._fields, stated)),) = places.items()
            stated = stated or _unit_of(file[self._place], self._fields["t"])
            sensor = _sensor(file, file[self._place])
            self._offset_us = self._offset(file, file[self._place].parent)
            if abs(self._offset_us) > TIME_LIMIT_US:
                raise RecordingError(
                    f"{path} has a t_offset of {self._offset_us}, beyond 2**60 us: record it again"
                )
            self._largest_chunk = max(
                _chunk_bytes(item) for item in self._datasets(file[self._place]).values()
            )
        super().__init__(path, options, sensor)
        self._unit = options.time_unit or stated

    def _places(
        self, file: Any, options: ReadOptions
    ) -> dict[str, tuple[dict[str, Any], str | None]]:
        """Return where t, x, y and p are in each group or dataset of events, and the unit."""
        places: dict[str, tuple[dict[str, Any], str | None]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, self._h5py.Group):
                flat = [key for key in item if (c := self._dataset(item, key)) and c.ndim == 1]
                if matched := match_columns(flat):
                    places[name] = dict(matched.fields), matched.unit
            elif not isinstance(item, self._h5py.Dataset):
                return
            elif item.dtype.names is not None and item.ndim == 1:
                if matched := match_columns(item.dtype.names, options.columns):
                    places[name] = dict(matched.fields), matched.unit
            elif item.ndim == 2 and options.columns and item.shape[1] == len(options.columns):
                places[name] = {c: i for i, c in enumerate(options.columns) if c != "-"}, None

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
        with open_hdf5(self.path, min(self._largest_chunk, _LARGEST_CHUNK)) as file:
            place = file[self._place]
            datasets = {
                name: checked(self.path, item) for name, item in self._datasets(place).items()
            }
            total = self._rows(place)
            for first in range(0, total, self.options.chunk_events):
                rows = slice(first, min(first + self.options.chunk_events, total))
                self.position = rows.stop / total
                t, x, y, p = tidy(self._slice(datasets, rows), self._unit, log, first)
                # both are below 2**60, so that the sum does not overflow
                yield Columns(t + self._offset_us if self._offset_us else t, x, y, p)

    def _offset(self, *groups: Any) -> int:
        """Read DSEC's ``t_offset``, which is added to the times, in microseconds."""
        for group in groups:
            offset = self._dataset(group, "t_offset")
            if offset is not None and not offset.shape:
                return int(checked(self.path, offset)[()])
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

    def _slice(self, datasets: dict[str, Any], rows: slice) -> dict[str, Any]:
        if "" not in datasets:
            return {name: dataset[rows] for name, dataset in datasets.items()}
        block = datasets[""][rows]
        if block.dtype.names is None:
            return {name: block[:, column] for name, column in self._fields.items()}
        return {name: block[field] for name, field in self._fields.items()}


def _unit_of(place: Any, times: object) -> str | None:
    """Read the unit of the times from the attribute ``units`` of their dataset."""
    item = place[times] if isinstance(times, str) and hasattr(place, "keys") else place
    units = item.attrs.get("units", "")
    word = units.decode(errors="replace") if isinstance(units, bytes) else str(units)
    return UNITS.get(word.strip().lower())


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
