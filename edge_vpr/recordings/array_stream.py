"""Arrays in NumPy's file format, read a few rows at a time from any binary stream."""

from __future__ import annotations

import io
import math
import warnings
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError

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
    dtype : dtype
    shape : tuple of int
    header_bytes : int
    row_bytes : int
    most_rows : int
        Largest number of rows that one call of :meth:`read` returns.
    rows_read : int

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
