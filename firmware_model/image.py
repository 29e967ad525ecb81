"""The image that the reference firmware reads from flash: a header and the tables."""

from __future__ import annotations

import struct

from firmware_model.design import Design
from firmware_model.errors import DesignError
from firmware_model.memories import Memories

MAGIC, VERSION = 0x49525056, 1
HEADER_WORDS = 28
#: rows of codes, and tables, begin at multiples of so many bytes
ALIGNMENT = 16


def stride(design: Design) -> int:
    """Bytes of a row of codes, a byte each, with its padding."""
    return _aligned(design.slots)


def image(memories: Memories) -> bytes:
    """Lay a design and its tables out for the reference firmware.

    Parameters
    ----------
    memories : Memories

    Returns
    -------
    bytes
        Little-endian; the header is described by the enumeration at the head of ``c/vpr.c``.

    Raises
    ------
    DesignError
        If the design is beyond the firmware's limits.
    """
    design = memories.design
    check_limits(design)
    lookup, row = memories.lookup(), stride(design)
    entries = [struct.pack("<IHH", 0xFFFF_FFFF, 0, 0)] * design.lookup_depth
    off = design.slots - design.pixels
    for slot, (x, y) in enumerate(memories.pixels):
        at = (x + lookup.displacement[y]) % design.lookup_depth
        entries[at] = struct.pack("<IHH", y << 16 | x, slot + off, slot)
    tables = [
        struct.pack(f"<{design.height}H", *lookup.displacement),
        b"".join(entries),
        b"".join(map(bytes, design.tables)),
        bytes(memories.tables),
        b"".join(bytes(place).ljust(row, b"\0") for place in memories.places),
    ]
    offsets, body = [], b""
    for table in tables:
        offsets.append(HEADER_WORDS * 4 + len(body))
        body += table.ljust(_aligned(len(table)), b"\0")
    by_time = design.window == "time"
    by_ratio = design.accept == "ratio"
    header = [
        MAGIC,
        VERSION,
        HEADER_WORDS * 4 + len(body),
        design.width,
        design.height,
        design.pixels,
        design.slots,
        row,
        design.count_max,
        design.places,
        design.length,
        design.exclusion,
        0 if by_time else 1,
        design.tau_us if by_time else design.window_events,
        design.timestamp_bits,
        design.ratio[0] if by_ratio else design.margin,
        design.ratio[1] if by_ratio else 0,
        design.lookup_depth,
        design.code_max,
        len(design.full_scales),
        *offsets,
    ]
    return struct.pack(f"<{HEADER_WORDS}I", *header, *[0] * (HEADER_WORDS - len(header))) + body


def ram_bytes(design: Design) -> int:
    """RAM that the firmware's arrays take, as `vpr_ram_bytes` in ``c/vpr.c`` counts it."""
    return (
        stride(design)
        + _aligned(2 * design.slots)
        + _aligned(2 * design.length * design.places)
        + _aligned(4 * (design.exclusion + 1))
    )


def check_limits(design: Design) -> None:
    """Raise DesignError unless the reference firmware can hold the design's numbers."""
    formats = design.formats
    distance = design.slots * design.code_max
    product = distance * design.length * (design.ratio[1] if design.accept == "ratio" else 1)
    for what, value, bits in (
        ("codes", design.code_max, 8),
        ("timestamps", formats["timestamp"].highest, 32),
        ("counts", design.count_max, 16),
        ("a distance", distance, 16),
        ("sums times the ratio's denominator", product, 32),
        ("places", design.places, 16),
        ("look-up addresses", design.lookup_depth - 1, 16),
        ("distances held", design.places * design.length * 8, 32),
    ):
        if value >= 1 << bits:
            raise DesignError(
                f"{what} up to {value}: the reference firmware holds {bits} bits: take a narrower "
                "code, fewer pixels or a shorter sequence"
            )


def _aligned(size: int) -> int:
    return -(-size // ALIGNMENT) * ALIGNMENT
