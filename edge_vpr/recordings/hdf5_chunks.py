"""Read the compressed chunks of an HDF5 data set, and check the size of each.

libhdf5 and h5py's LZF filter do not compare the size of an expanded chunk with the size that the
data set states: a chunk that is too short is read beyond the end of its buffer, and one that is too
long takes any amount of memory. Here each chunk is expanded or measured first. libhdf5 does not
expand deflated columns again, so that the check costs no time.
"""

from __future__ import annotations

import math
import zlib
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError

_DEFLATE, _SHUFFLE, _FLETCHER32, _LZF = 1, 2, 3, 32_000
#: Filters from this number on, except LZF, are plug-ins, which only the user can install.
_PLUGINS = 256
#: Largest excess of a stored chunk's size over its expanded size, in bytes.
_OVERHEAD = 1 << 16


class CheckedDataset:
    """Rows of one data set, read in consecutive slices.

    Parameters
    ----------
    dataset : h5py.Dataset
        Data set of one dimension or more.
    name : str
        File and data set, for messages.

    Raises
    ------
    RecordingError
        If the data set uses a filter whose sizes cannot be checked. Filters that are plug-ins of
        libhdf5 are trusted, like any installed library.
    """

    def __init__(self, dataset: Any, name: str) -> None:
        from h5py import h5t

        self._dataset, self._name = dataset, name
        pipeline = dataset.id.get_create_plist()
        self._filters = [pipeline.get_filter(i)[0] for i in range(pipeline.get_nfilters())]
        known = {number for number in self._filters if number < _PLUGINS or number == _LZF}
        if known - {_DEFLATE, _SHUFFLE, _FLETCHER32, _LZF} or {_DEFLATE, _LZF} <= known:
            raise RecordingError(
                f"{name} is stored through the HDF5 filters {self._filters}, whose sizes cannot be "
                "checked: write it again with h5repack -f GZIP=4"
            )
        self._bytes = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
        #: whether the bytes in the file are those of the array, apart from the filters
        self._plain = (
            self._filters in ([_DEFLATE], [_SHUFFLE, _DEFLATE])
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
            elif number >= _PLUGINS:
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
