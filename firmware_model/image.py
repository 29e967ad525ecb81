"""The image that the reference firmware reads from flash: a header and the tables."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum

from firmware_model.design import FRACTION_BITS, LEVELS, Design, formats_of
from firmware_model.errors import DesignError
from firmware_model.memories import Memories

MAGIC, VERSION = 0x49525056, 5
HEADER_WORDS = 32


class Word(IntEnum):
    """Words of the header, as in the enumeration at the beginning of ``c/vpr.c``."""

    MAGIC = 0
    VERSION = 1
    BYTES = 2
    WIDTH = 3
    HEIGHT = 4
    PIXELS = 5
    STRIDE = 6
    CODE_BITS = 7
    CONTRAST = 8
    PLACES = 9
    LENGTH = 10
    EXCLUSION = 11
    WINDOW_KIND = 12
    WINDOW = 13
    TIMESTAMP_BITS = 14
    LARGEST_SUM = 15
    LOOKUP_DEPTH = 16
    PLACES_PER_WINDOW = 17
    RESTART = 18
    TRUST = 19
    ACTIVITY = 20
    DISPLACEMENT_TABLE = 21
    LOOKUP_TABLE = 22
    PLACES_TABLE = 23
    LEVEL_TABLE = 24
    MEAN_TABLE = 25
    PLACE_ACTIVITY_TABLE = 26


#: offsets of the tables, in the order in which they lie in the image
TABLES = (
    Word.DISPLACEMENT_TABLE,
    Word.LOOKUP_TABLE,
    Word.PLACES_TABLE,
    Word.LEVEL_TABLE,
    Word.MEAN_TABLE,
    Word.PLACE_ACTIVITY_TABLE,
)
#: rows of codes, and tables, begin at multiples of this number of bytes
ALIGNMENT = 16


def stride(design: Design) -> int:
    """Return the bytes of a row of codes with its padding; a code takes one byte."""
    return _aligned(design.slots)


def image(memories: Memories) -> bytes:
    """Return the image of a design and its tables for the reference firmware.

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
    entries = [struct.pack("<II", 0xFFFF_FFFF, 0)] * design.lookup_depth
    for slot, (x, y) in enumerate(memories.pixels):
        at = (x + lookup.displacement[y]) % design.lookup_depth
        entries[at] = struct.pack("<II", y << 16 | x, slot)
    tables = [
        struct.pack(f"<{design.height}H", *lookup.displacement),
        b"".join(entries),
        b"".join(bytes(place).ljust(row, b"\0") for place in memories.places),
        _words(LEVELS if design.contrast else ()),
        _words(memories.mean),
        struct.pack(f"{len(memories.place_activity)}b", *memories.place_activity),
    ]
    offsets, body = [], b""
    for table in tables:
        offsets.append(HEADER_WORDS * 4 + len(body))
        body += table.ljust(_aligned(len(table)), b"\0")
    by_time = design.window == "time"
    header: dict[int, int] = {
        Word.MAGIC: MAGIC,
        Word.VERSION: VERSION,
        Word.BYTES: HEADER_WORDS * 4 + len(body),
        Word.WIDTH: design.width,
        Word.HEIGHT: design.height,
        Word.PIXELS: design.pixels,
        Word.STRIDE: row,
        Word.CODE_BITS: design.code_bits,
        Word.CONTRAST: int(design.contrast),
        Word.PLACES: design.places,
        Word.LENGTH: design.length,
        Word.EXCLUSION: design.exclusion,
        Word.WINDOW_KIND: 0 if by_time else 1,
        Word.WINDOW: design.tau_us if by_time else design.window_events,
        Word.TIMESTAMP_BITS: design.timestamp_bits,
        Word.LARGEST_SUM: 0 if design.filters else design.largest_sum,
        Word.LOOKUP_DEPTH: design.lookup_depth,
        Word.ACTIVITY: memories.activity,
        **dict(zip(TABLES, offsets, strict=True)),
    }
    if design.filters:
        header |= {
            Word.PLACES_PER_WINDOW: design.places_per_window,
            Word.RESTART: design.restart << FRACTION_BITS,
            Word.TRUST: design.trust,
        }
    words = [header.get(word, 0) for word in range(HEADER_WORDS)]
    return struct.pack(f"<{HEADER_WORDS}I", *words) + body


def _words(values: Sequence[int]) -> bytes:
    return struct.pack(f"<{len(values)}H", *values)


def ram_arrays(design: Design) -> dict[str, int]:
    """Return the firmware's arrays in RAM and their bytes, in the order in which they lie there."""
    return {
        "query": stride(design),
        "counts": _aligned(2 * design.slots),
        "history": _aligned(2 * design.length * design.places),
        "distance": kept_bytes(design),
        "delay": 0 if design.filters else _aligned(4 * (design.exclusion + 1)),
        "mean": _aligned(4 * design.slots) if design.contrast else 0,
    }


def ram_bytes(design: Design) -> int:
    """Return the RAM of the firmware's arrays in bytes, as `vpr_ram_bytes` in ``c/vpr.c``."""
    return sum(ram_arrays(design).values())


def kept_bytes(design: Design) -> int:
    """Return the RAM in which the filter keeps the distances of a window."""
    return _aligned(2 * design.places) if design.filters else 0


def check_limits(design: Design) -> None:
    """Raise DesignError if the numbers of the design exceed limits of the reference firmware."""
    formats = formats_of(design)
    distance = design.slots * design.code_max
    for what, value, bits in (
        ("codes", design.code_max, 8),
        ("timestamps", formats["timestamp"].highest, 32),
        ("a distance", distance, 16),
        ("sums", distance * design.length, 32),
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
