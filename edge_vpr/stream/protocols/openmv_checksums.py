"""Both checksums of OpenMV's packets."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel


def _tables(polynomial: int, bits: int, count: int) -> npt.NDArray[np.int64]:
    """Return the remainders of each byte with 0, 1, ... zero bytes after it."""
    mask = (1 << bits) - 1
    rows = np.zeros((count, 256), dtype=np.int64)
    for byte in range(256):
        value = byte << (bits - 8)
        for _ in range(8):
            value = ((value << 1) ^ (polynomial if value >> (bits - 1) else 0)) & mask
        rows[0, byte] = value
    for k in range(1, count):
        before = rows[k - 1]
        rows[k] = ((before << 8) & mask) ^ rows[0][before >> (bits - 8)]
    return rows


TABLE16 = _tables(0xF94F, 16, 1)
TABLES32 = _tables(0xFA567D89, 32, 8)


def crc(data: bytes, bits: int) -> int:
    """Return the checksum of 16 or 32 bits: not reflected, initially all ones, no final step.

    Examples
    --------
    >>> hex(crc(b"123456789", 16)), hex(crc(b"123456789", 32))
    ('0xe541', '0x41b403d3')
    """
    raw = np.frombuffer(data, dtype=np.uint8)
    if bits == 16:
        return int(crc16(raw, 0, raw.size, TABLE16))
    return int(crc32(raw, 0, raw.size, TABLES32))


@kernel
def crc16(data: Any, start: Any, stop: Any, tables: Any) -> Any:
    """Process one byte a step, since headers are short."""
    value = np.int64(0xFFFF)
    for i in range(start, stop):
        value = ((value << 8) & 0xFFFF) ^ tables[0, (value >> 8) ^ data[i]]
    return value


@kernel
def crc32(data: Any, start: Any, stop: Any, tables: Any) -> Any:
    """Process eight bytes a step, since their remainders do not depend on each other."""
    value = np.int64(0xFFFFFFFF)
    i = start
    while i + 8 <= stop:
        value = (
            tables[7, (value >> 24) ^ data[i]]
            ^ tables[6, ((value >> 16) & 255) ^ data[i + 1]]
            ^ tables[5, ((value >> 8) & 255) ^ data[i + 2]]
            ^ tables[4, (value & 255) ^ data[i + 3]]
            ^ tables[3, data[i + 4]]
            ^ tables[2, data[i + 5]]
            ^ tables[1, data[i + 6]]
            ^ tables[0, data[i + 7]]
        )
        i += 8
    while i < stop:
        value = ((value << 8) & 0xFFFFFFFF) ^ tables[0, (value >> 24) ^ data[i]]
        i += 1
    return value
