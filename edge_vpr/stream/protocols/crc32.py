"""CRC-32 as computed by zlib, for use within kernels."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel

_POLYNOMIAL = 0xEDB88320


def _tables() -> npt.NDArray[np.int64]:
    """Return the remainders of each byte with 0 to 7 zero bytes after it, shape (8, 256)."""
    rows = np.zeros((8, 256), dtype=np.int64)
    rows[0] = np.arange(256)
    for _ in range(8):
        rows[0] = (rows[0] >> 1) ^ np.where(rows[0] & 1, _POLYNOMIAL, 0)
    for before, row in pairwise(rows):
        row[:] = (before >> 8) ^ rows[0][before & 255]
    return rows


_TABLES = _tables()


@kernel
def crc32(data: Any, start: Any, stop: Any) -> Any:
    """Return the checksum of ``data[start:stop]``.

    Parameters
    ----------
    data : ndarray of uint8, shape (n,)
    start, stop : int
        From 0 to n.
    """
    value = np.int64(0xFFFFFFFF)
    i = start
    # eight bytes a step, since their remainders do not depend on each other
    while i + 8 <= stop:
        value = (
            _TABLES[7, (value & 255) ^ data[i]]
            ^ _TABLES[6, ((value >> 8) & 255) ^ data[i + 1]]
            ^ _TABLES[5, ((value >> 16) & 255) ^ data[i + 2]]
            ^ _TABLES[4, (value >> 24) ^ data[i + 3]]
            ^ _TABLES[3, data[i + 4]]
            ^ _TABLES[2, data[i + 5]]
            ^ _TABLES[1, data[i + 6]]
            ^ _TABLES[0, data[i + 7]]
        )
        i += 8
    while i < stop:
        value = (value >> 8) ^ _TABLES[0, (value & 255) ^ data[i]]
        i += 1
    return value ^ 0xFFFFFFFF
