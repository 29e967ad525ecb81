"""Write HDF5 so that a full disk is an error and not a crash.

When a write of the HDF5 library fails, closing the file fails too, and objects that were not closed
cause a segmentation fault. Here the library writes to a file object that never fails: after the
first error of the disk, it keeps further data in memory. This is little data, because
:meth:`Hdf5Sink.write` raises at the next event, and the library can then close its objects in
order.
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.hdf5_files import load_h5py

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
            begin, end = max(at, self._at), min(at + len(data), self._at + len(view))
            if begin < end:
                view[begin - self._at : end - self._at] = data[begin - at : end - at]
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
        for begin in range(0, events.size, _CHUNK_ROWS):
            part = events[begin : begin + _CHUNK_ROWS]
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
