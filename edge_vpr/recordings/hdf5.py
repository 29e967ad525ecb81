"""HDF5: Metavision's ``CD/events``, DSEC's ``events/{t,x,y,p}`` with ``t_offset``, and similar.

Slices are read with h5py: eventcv reads such files correctly and in bounded memory too, but guesses
the sensor where none is stated, and takes three times as long.
"""

from __future__ import annotations

import contextlib
import io
import math
import zlib
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import MissingExtraError, RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events, Sensor
from edge_vpr.recordings.reading import Columns, FaultLog, ReadOptions, Source, import_extra
from edge_vpr.recordings.table import match_columns, tidy

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


# Read the compressed chunks of an HDF5 data set, and check the size of each.
#
# libhdf5 and h5py's LZF filter do not compare the size of an expanded chunk with the size that the
# data set states: a chunk that is too short is read beyond the end of its buffer, and one that is
# too long takes any amount of memory. Here each chunk is expanded or measured first. libhdf5 does
# not expand deflated columns again, so that the check costs no time. Reading in a child process
# with limits would not replace it, since the library reports no error: from a chunk that held 16 of
# 1,024 times, it read 1,024, of which 698 came from other memory of the process.


_DEFLATE, _SHUFFLE, _FLETCHER32, _LZF = 1, 2, 3, 32_000
#: Filters from this number on, except LZF, are plug-ins, which only the user can install.
_PLUGINS = 256
#: Largest excess of a stored chunk's size over its expanded size, in bytes.
_OVERHEAD = 1 << 16
#: Most bytes of one expanded chunk, which is kept whole, so that none is read twice: chunks of any
#: data set, and of one that is stored in at least a hundredth of that.
_CHUNK, _LARGEST_CHUNK = _CACHE, 1 << 30
#: Largest ratio of a data set's stated size to its size in the file: Deflate reaches 1,032.
_MOST_EXPANSION = 1_100


def _filters_of(dataset: Any) -> list[int]:
    pipeline = dataset.id.get_create_plist()
    return [pipeline.get_filter(i)[0] for i in range(pipeline.get_nfilters())]


def _chunk_bytes(dataset: Any) -> int:
    return math.prod(dataset.chunks or ()) * int(dataset.dtype.itemsize)


def _is_plugin(number: int) -> bool:
    return number >= _PLUGINS and number != _LZF


class CheckedDataset:
    """Rows of one data set, read in consecutive slices.

    Raises
    ------
    RecordingError
        If its data lie in other files, its stated sizes are impossible for the size of the file, or
        it uses a filter whose sizes cannot be checked. Filters that are plug-ins of libhdf5 are
        trusted, like any installed library.
    """

    def __init__(self, path: Path, dataset: Any) -> None:
        from h5py import h5t

        name = f"{path}: {dataset.name}"
        if dataset.external or dataset.is_virtual:
            raise RecordingError(
                f"{name} lies in other files, which are not read: copy it into one file"
            )
        filters, chunk = _filters_of(dataset), _chunk_bytes(dataset)
        stored, file_size = dataset.id.get_storage_size(), dataset.file.id.get_filesize()
        held = min(stored, path.stat().st_size)
        most = max(_CHUNK, min(100 * held, _LARGEST_CHUNK))
        if chunk > most or len(set(filters)) < len(filters):
            raise RecordingError(
                f"{name} is stored in chunks of {chunk:,} bytes through {len(filters)} filters: "
                f"the most of {held:,} stored bytes is {most:,}, and each filter once; write it "
                "with h5repack -l CHUNK=65536"
            )
        _check_filters(name, filters)
        claimed = dataset.size * dataset.dtype.itemsize
        if any(_is_plugin(number) for number in filters):  # Zstandard expands without a limit
            most = dataset.id.get_num_chunks() * chunk
        else:
            most = held * _MOST_EXPANSION if dataset.chunks and filters else held
        if claimed > most:
            raise RecordingError(
                f"{name} claims {claimed:,} bytes, and the file holds {held:,} of them: it was "
                "not closed when it was written, or is damaged; copy or record it again"
            )
        known = {number for number in filters if not _is_plugin(number)}
        if known - {_DEFLATE, _SHUFFLE, _FLETCHER32, _LZF} or {_DEFLATE, _LZF} <= known:
            raise RecordingError(
                f"{name} is stored through the HDF5 filters {filters}, whose sizes cannot be "
                "checked: write it again with h5repack -f GZIP=4"
            )
        # libhdf5 takes memory for all of a chunk, also for one that is larger than the file
        if dataset.chunks is not None and stored > file_size:
            raise RecordingError(
                f"{name} has chunks of {stored:,} bytes in a file of {file_size:,}: it is damaged; "
                "copy or record it again"
            )
        self._dataset, self._name, self._filters, self._bytes = dataset, name, filters, chunk
        #: whether the bytes in the file are those of the array, apart from the filters
        self._plain = (
            filters in ([_DEFLATE], [_SHUFFLE, _DEFLATE])
            and dataset.ndim == 1
            and dataset.id.get_type().equal(h5t.py_create(dataset.dtype))
        )
        self._kept: tuple[int, npt.NDArray[Any] | None] = (-1, None)

    def read(self, rows: slice) -> npt.NDArray[Any]:
        """Return the rows, at most as many as the data set has.

        Raises
        ------
        RecordingError
            If a chunk does not expand to the size that the data set states.
        """
        if self._dataset.chunks is None or not self._filters or rows.stop <= rows.start:
            return np.asarray(self._dataset[rows])
        height = self._dataset.chunks[0]
        parts = []
        for first in range(rows.start // height * height, rows.stop, height):
            if first != self._kept[0]:
                self._kept = first, self._chunk(first)
            part = slice(max(rows.start, first), min(rows.stop, first + height))
            chunk = self._kept[1]
            if chunk is not None:
                parts.append(chunk[part.start - first : part.stop - first])
            elif self._plain:
                parts.append(np.asarray(self._dataset[part]))
        return np.concatenate(parts) if self._plain else np.asarray(self._dataset[rows])

    def _chunk(self, first: int) -> npt.NDArray[Any] | None:
        """Check the chunks that begin at a row; return the rows if there is one plain chunk."""
        if self._dataset.ndim == 1:
            return self._expand((first,))
        sides = zip(self._dataset.shape[1:], self._dataset.chunks[1:], strict=True)
        for others in product(*(range(0, length, step) for length, step in sides)):
            self._expand((first, *others))
        return None

    def _expand(self, at: tuple[int, ...]) -> npt.NDArray[Any] | None:
        info = self._dataset.id.get_chunk_info_by_coord(at)
        if info.byte_offset is None:
            return None  # not stored: libhdf5 gives the fill value
        size: int | None = -1
        if info.size <= self._bytes + _OVERHEAD:
            mask, data = self._dataset.id.read_direct_chunk(at)
            size, expanded = self._expanded(mask, data)
            if size is None:
                return None
            if size == self._bytes:
                return self._array(mask, expanded) if self._plain else None
        # A chunk beyond the border may be stored unfiltered; if it is not, libhdf5 refuses it
        if size == -1 and info.size == self._bytes and self._at_border(at):
            return None
        raise RecordingError(
            f"{self._name} has a chunk at row {at[0]:,} that does not expand to its "
            f"{self._bytes:,} bytes: it is damaged; copy or record it again"
        )

    def _at_border(self, at: tuple[int, ...]) -> bool:
        sides = zip(at, self._dataset.chunks, self._dataset.shape, strict=True)
        return any(first + n > end for first, n, end in sides)

    def _expanded(self, mask: int, data: bytes) -> tuple[int | None, bytes]:
        """Expand a chunk.

        Returns
        -------
        size : int or None
            Size of the expanded chunk; -1 if it is damaged, None if only a plug-in can expand it.
        data : bytes
            The expanded chunk, or the chunk before LZF.
        """
        more = 0
        for i, number in reversed(list(enumerate(self._filters))):
            if mask >> i & 1:
                continue
            if number == _FLETCHER32:
                more -= 4
            elif number == _DEFLATE:
                inflated = _inflated(data[: len(data) + more], self._bytes + _OVERHEAD)
                if inflated is None:
                    return -1, data
                data, more = inflated, 0
            elif number == _LZF:
                measured = int(lzf_size(np.frombuffer(data[: len(data) + more], np.uint8)))
                if measured < 0:
                    return -1, data
                more = measured - len(data)
            elif _is_plugin(number):
                return None, data
        return len(data) + more, data

    def _array(self, mask: int, data: bytes) -> npt.NDArray[Any]:
        """Return the rows of an expanded chunk, whose bytes may be shuffled."""
        size = self._dataset.dtype.itemsize
        if self._filters[0] == _SHUFFLE and not mask & 1 and size > 1:
            octets = np.empty((len(data) // size, size), np.uint8)
            for i, column in enumerate(np.frombuffer(data, np.uint8).reshape(size, -1)):
                octets[:, i] = column  # three times as fast as a transposed copy
            return octets.reshape(-1).view(self._dataset.dtype)
        return np.frombuffer(data, self._dataset.dtype)


def _inflated(data: bytes, most: int) -> bytes | None:
    """Inflate to at most `most` + 1 bytes; None if the data is damaged or cut off."""
    stream = zlib.decompressobj()
    try:
        expanded = stream.decompress(data, most + 1)
    except zlib.error:
        return None
    return expanded if stream.eof or len(expanded) > most else None


@kernel
def lzf_size(data: npt.NDArray[np.uint8]) -> int:
    """Return the expanded size of LZF data; -1 if it is cut off or refers to before its start.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)
        Compressed.
    """
    at, size = 0, 0
    while at < data.size:
        control = int(data[at])
        if control < 32:  # this number of literal bytes, plus one
            at += control + 2
            size += control + 1
            continue
        length, distance = control >> 5, (control & 31) << 8
        at += 1
        if length == 7 and at < data.size:
            length += int(data[at])
            at += 1
        if at >= data.size or distance + int(data[at]) + 1 > size:
            return -1
        at += 1
        size += length + 2
    return size if at == data.size else -1


# Write HDF5 so that a full disk is an error and not a crash.
#
# When a write of the HDF5 library fails, closing the file fails too, and objects that were not
# closed cause a segmentation fault. Here the library writes to a file object that never fails:
# after the first error of the disk, it keeps further data in memory. This is little data, because
# :meth:`Hdf5Sink.write` raises at the next event, and the library can then close its objects in
# order.


#: Attribute with the time t = 0 on the file's own clock, in microseconds.
START = "edge_vpr_start_us"

_CHUNK_ROWS = 1 << 14
_ROW = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])


class ForgivingFile(io.RawIOBase):
    """File for reading and writing that stores its errors instead of raising them.

    Parameters
    ----------
    path : Path
        The file is created or emptied.

    Attributes
    ----------
    error : OSError or None
        The first error of the disk.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        self._at = 0
        self._kept: list[tuple[int, bytes]] = []  # data that the disk did not take
        self.error: OSError | None = None

    def seekable(self) -> bool:
        """Return True."""
        return True

    readable = writable = seekable

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Move to `offset` bytes from the start, the current place, or the end."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._end()}[whence]
        self._at = base + offset
        return self._at

    def _end(self) -> int:
        ends = [at + len(data) for at, data in self._kept]
        return max([self._file.seek(0, io.SEEK_END), *ends])

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._at

    def write(self, data: Any, /) -> int:
        """Write all of `data`, to the disk or to memory."""
        octets = bytes(data)
        written = 0
        try:
            while self.error is None and written < len(octets):
                self._file.seek(self._at + written)
                written += self._file.write(octets[written:])
        except OSError as error:
            self.error = error
        if written < len(octets):
            self._kept.append((self._at + written, octets[written:]))
        self._at += len(octets)
        return len(octets)

    def readinto(self, buffer: Any, /) -> int:
        """Read from the disk, and from memory the data that the disk did not take."""
        view = memoryview(buffer).cast("B")
        view[:] = bytes(len(view))
        n = 0
        try:
            self._file.seek(self._at)
            n = self._file.readinto(view)
        except OSError as error:
            self.error = self.error or error
        for at, data in self._kept:
            start, end = max(at, self._at), min(at + len(data), self._at + len(view))
            if start < end:
                view[start - self._at : end - self._at] = data[start - at : end - at]
                n = max(n, end - self._at)
        self._at += n
        return n

    def truncate(self, size: int | None = None, /) -> int:
        """Set the length of the file."""
        size = self._at if size is None else size
        with contextlib.suppress(OSError):
            # a longer size takes no space; the library sets a shorter one at the end
            if self.error is None:
                self._file.truncate(size)
        return size

    def close(self) -> None:
        """Close the file; :attr:`error` holds an error of the disk."""
        if not self.closed:
            try:
                self._file.close()
            except OSError as error:
                self.error = self.error or error
            super().close()


class Hdf5Sink:
    """Write Metavision's layout, uncompressed: ``CD/events`` with fields x, y, p, t."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        h5py = load_h5py()
        self._raw = ForgivingFile(path)
        # a cache of only one chunk, so that a full disk is noticed early
        self._file = h5py.File(self._raw, "w", rdcc_nbytes=_CHUNK_ROWS * _ROW.itemsize)
        self._file.attrs["geometry"] = str(sensor)
        self._file.attrs[START] = start_us
        self._rows = self._file.create_dataset(
            "CD/events", (0,), _ROW, maxshape=(None,), chunks=(_CHUNK_ROWS,)
        )

    def write(self, events: Events) -> None:
        """Append events.

        Raises
        ------
        OSError
            If the disk did not take these or earlier events.
        """
        for first in range(0, events.size, _CHUNK_ROWS):
            part = events[first : first + _CHUNK_ROWS]
            rows = np.empty(part.size, _ROW)
            for name in "xypt":
                rows[name] = part[name]
            n = self._rows.shape[0]
            self._rows.resize(n + part.size, axis=0)
            self._rows[n:] = rows
            self._check()

    def close(self) -> None:
        """Finish the file.

        Raises
        ------
        OSError
            If the disk did not take all data.
        """
        self._file.close()
        self._raw.close()
        self._check()

    def _check(self) -> None:
        if self._raw.error is not None:
            raise self._raw.error


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
            ((self._place, (self._fields, stated)),) = places.items()
            sensor = _sensor(file, file[self._place])
            self._offset_us = self._offset(file, file[self._place].parent)
            if abs(self._offset_us) > TIME_LIMIT_US:
                raise RecordingError(
                    f"{path} has a t_offset of {self._offset_us}, beyond 2**60 us: record it again"
                )
            start = file.attrs.get(START)
            self._largest_chunk = max(
                _chunk_bytes(item) for item in self._datasets(file[self._place]).values()
            )
        super().__init__(path, options, sensor, None if start is None else int(start))
        self._unit = options.time_unit or stated or (None if start is None else "us")

    def _places(
        self, file: Any, options: ReadOptions
    ) -> dict[str, tuple[dict[str, Any], str | None]]:
        """Return where t, x, y and p are in each group or dataset of events, and the unit."""
        places: dict[str, tuple[dict[str, Any], str | None]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, self._h5py.Group):
                flat = [key for key in item if (c := self._dataset(item, key)) and c.ndim == 1]
                if fields := match_columns(flat):
                    places[name] = fields
            elif not isinstance(item, self._h5py.Dataset):
                return
            elif item.dtype.names is not None and item.ndim == 1:
                if fields := match_columns(item.dtype.names, options.columns):
                    places[name] = fields
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
            checked = {
                name: CheckedDataset(self.path, item)
                for name, item in self._datasets(place).items()
            }
            total = self._rows(place)
            for first in range(0, total, self.options.chunk_events):
                rows = slice(first, min(first + self.options.chunk_events, total))
                self.position = rows.stop / total
                try:
                    columns = self._slice(checked, rows)
                except OSError as error:
                    raise RecordingError(
                        f"{self.path} cannot be read at event {first:,} ({error}): it is damaged; "
                        "copy or record it again"
                    ) from error
                t, x, y, p = tidy(columns, self._unit, log, first)
                # both are below 2**60, so that the sum does not overflow
                yield Columns(t + self._offset_us if self._offset_us else t, x, y, p)

    def _offset(self, *groups: Any) -> int:
        """Read DSEC's ``t_offset``, which is added to the times, in microseconds."""
        for group in groups:
            offset = self._dataset(group, "t_offset")
            if offset is not None and not offset.shape:
                CheckedDataset(self.path, offset)  # refuses a damaged one
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
