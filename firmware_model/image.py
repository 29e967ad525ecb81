"""The image that the reference firmware reads from flash: a header and the tables.

`Word` and `Table` are its layout. ``c/tables.h`` is written from them by
`firmware_model.emulation.tables`, and the tables of docs/firmware.md by ``python -m
firmware_model.image``.
"""

from __future__ import annotations

import argparse
import struct
import zlib
from collections.abc import Mapping
from enum import Enum, IntEnum
from itertools import chain
from math import prod
from typing import Self

from firmware_model.design import (
    ACTIVITY_FRACTION_BITS,
    BIAS_TOP,
    FRACTION_BITS,
    LARGEST_SUM,
    LEVEL_TOP,
    LEVELS,
    MAX_COST,
    MAX_SIDE,
    TRUST_TOP,
    Design,
    formats_of,
)
from firmware_model.errors import DesignError
from firmware_model.memories import Memories
from fixedpoint.activity import EVENTS_TOP, GAINS
from fixedpoint.own_mean import FULL_SCALE

MAGIC, VERSION = 0x49525056, 7
HEADER_WORDS = 32
#: rows of codes, and tables, begin at multiples of this number of bytes
ALIGNMENT = 16
_SHORT, _LONG = (1 << 16) - 1, (1 << 32) - 1


class Word(IntEnum):
    """Words of the header in their order, 32 bits each; those that follow are 0.

    Attributes
    ----------
    least, most : int
        Its range; that of some words is narrower in some designs, as `text` says.
    text : str
        What it is, for the page.
    """

    least: int
    most: int
    text: str

    def __new__(cls, least: int, most: int, text: str) -> Self:
        """Make a word, numbered by its place."""
        word = int.__new__(cls, len(cls.__members__))
        word._value_ = len(cls.__members__)
        word.least, word.most, word.text = least, most, text
        return word

    MAGIC = MAGIC, MAGIC, "0x49525056, the bytes `VPRI`"
    VERSION = VERSION, VERSION, "of the layout"
    BYTES = HEADER_WORDS * 4, _LONG, "of the image"
    CRC = 0, _LONG, "CRC-32 of zlib, of all later bytes"
    WIDTH = 1, MAX_SIDE, "of the sensor"
    HEIGHT = 1, MAX_SIDE, "of the sensor"
    PIXELS = 1, _SHORT, "J; times the largest code, at most 65,535"
    STRIDE = ALIGNMENT, _SHORT + 1, "bytes per place: `PIXELS` rounded up to a multiple of 16"
    CODE_BITS = 1, 8, "bits per code"
    CONTRAST = 0, 1, "1: contrast codes"
    PLACES = 1, _SHORT, "K; `8 * PLACES * LENGTH` below 2^32"
    LENGTH = 1, _SHORT, "L, at most `PLACES`; filter: 1"
    EXCLUSION = 0, _SHORT, "z"
    WINDOW_KIND = 0, 1, "0: time, 1: count"
    WINDOW = 1, _LONG, "tau in µs, below half the clock's period; or N"
    TIMESTAMP_BITS = 2, 32, "bits of the clock"
    LARGEST_SUM = 0, LARGEST_SUM, "largest that is accepted"
    LOOKUP_DEPTH = 1, _SHORT + 1, "a power of two"
    PLACES_PER_WINDOW = 0, 2, "0: sequences"
    RESTART = 0, MAX_COST << FRACTION_BITS, "4 r"
    TRUST = 0, TRUST_TOP, "least that is accepted"
    ACTIVITY = 0, EVENTS_TOP << ACTIVITY_FRACTION_BITS, "first `mean_activity`"
    GAINS = 0, len(GAINS), "1, or 7 with contrast codes and windows by time"


class Table(Enum):
    """Tables in their order; each begins at a multiple of 16 bytes, behind zeros.

    Attributes
    ----------
    entry : str
        Type of an entry, as of `struct`.
    factors : tuple of Word or int
        Their product is the number of entries.
    where : Word or None
        Without this word, which is 0 then, the design has no such table.
    text : str
        What it is, for the page.
    """

    entry: str
    factors: tuple[Word | int, ...]
    where: Word | None
    text: str

    def __init__(
        self, entry: str, factors: tuple[Word | int, ...], where: Word | None, text: str
    ) -> None:
        self.entry, self.factors, self.where, self.text = entry, factors, where, text

    DISPLACEMENT = "H", (Word.HEIGHT,), None, "0 to `LOOKUP_DEPTH` - 1"
    LOOKUP = (
        "II", (Word.LOOKUP_DEPTH,), None,
        "row (bits 17 to 31) and column (1 to 16), or 0xFFFFFFFF for no pixel; then the slot. "
        "Pixel (x, y) is at `(x + displacement[y]) mod LOOKUP_DEPTH`",
    )  # fmt: skip
    PLACES = "B", (Word.PLACES, Word.STRIDE), None, "codes, padded with zeros"
    LEVEL = "H", (len(LEVELS),), Word.CONTRAST, f"T, 0 to {LEVEL_TOP}"
    MEAN = "H", (Word.PIXELS,), Word.CONTRAST, f"initial means, 0 to {LEVEL_TOP}"
    LIMITS = "H", (Word.PIXELS,), Word.CONTRAST, f"most events that count, 0 to {FULL_SCALE}"
    PLACE_ACTIVITY = "b", (Word.PLACES,), Word.PLACES_PER_WINDOW, "A, -128 to 127"
    PLACE_BIAS = "B", (Word.PLACES,), Word.PLACES_PER_WINDOW, "B, 0 to 255"

    def size(self, header: Mapping[int, int]) -> int:
        """Return its bytes, without padding, in an image of this header."""
        if self.where is not None and not header.get(self.where, 0):
            return 0
        entries = prod(header[f] if isinstance(f, Word) else f for f in self.factors)
        return struct.calcsize(f"<{self.entry}") * entries


def stride(design: Design) -> int:
    """Return the bytes of a row of codes with its padding; a code takes one byte."""
    return _aligned(design.slots)


def image_bytes(design: Design) -> int:
    """Return the bytes of the image of a design."""
    header = _header(design)
    return HEADER_WORDS * 4 + sum(_aligned(table.size(header)) for table in Table)


def image(memories: Memories) -> bytes:
    """Return the image of a design and its tables for the reference firmware.

    Returns
    -------
    bytes
        Little-endian: the words of `Word`, and the tables of `Table`.
    """
    design = memories.design
    check_limits(design)
    lookup, row = memories.lookup(), stride(design)
    entries = [(0xFFFF_FFFF, 0)] * design.lookup_depth
    for slot, (x, y) in enumerate(memories.pixels):
        entries[(x + lookup.displacement[y]) % design.lookup_depth] = (y << 16 | x) << 1, slot
    values = {
        Table.DISPLACEMENT: lookup.displacement,
        Table.LOOKUP: tuple(chain.from_iterable(entries)),
        Table.PLACES: b"".join(bytes(place).ljust(row, b"\0") for place in memories.places),
        Table.LEVEL: LEVELS if design.contrast else (),
        Table.MEAN: memories.mean,
        Table.LIMITS: memories.limits,
        Table.PLACE_ACTIVITY: memories.place_activity,
        Table.PLACE_BIAS: memories.place_bias,
    }
    tables = {
        table: struct.pack(f"<{len(values[table])}{table.entry[0]}", *values[table])
        for table in Table
    }
    return pack(_header(design) | {Word.ACTIVITY: memories.activity}, tables)


def pack(header: Mapping[int, int], tables: Mapping[Table, bytes | bytearray]) -> bytes:
    """Lay tables out behind a header, of which `Word.BYTES` and `Word.CRC` are filled in."""
    parts = (tables[table].ljust(_aligned(len(tables[table])), b"\0") for table in Table)
    body = b"".join(parts)
    words = [header.get(word, 0) for word in range(HEADER_WORDS)]
    words[Word.BYTES] = HEADER_WORDS * 4 + len(body)
    return sealed(struct.pack(f"<{HEADER_WORDS}I", *words) + body)


def sealed(data: bytes) -> bytes:
    """Return an image with the checksum of its contents."""
    behind = Word.CRC * 4 + 4
    return data[: Word.CRC * 4] + struct.pack("<I", zlib.crc32(data[behind:])) + data[behind:]


def _header(design: Design) -> dict[int, int]:
    """Return the words of a design, without those that depend on the tables' contents."""
    by_time, numbers = design.window == "time", design.numbers
    header: dict[int, int] = {
        word: numbers[word.name.lower()] for word in Word if word.name.lower() in numbers
    }
    header |= {
        Word.MAGIC: MAGIC,
        Word.VERSION: VERSION,
        Word.STRIDE: stride(design),
        Word.CONTRAST: int(design.contrast),
        Word.WINDOW_KIND: 0 if by_time else 1,
        Word.WINDOW: design.tau_us if by_time else design.window_events,
        Word.RESTART: design.restart << FRACTION_BITS,
    }
    of_others = (Word.PLACES_PER_WINDOW, Word.RESTART, Word.TRUST, Word.GAINS)
    return header | dict.fromkeys((Word.LARGEST_SUM,) if design.filters else of_others, 0)


def page() -> str:
    """Return the words and the tables in Markdown."""
    names = {"b": "int8", "B": "uint8", "H": "uint16", "II": "2 uint32"}
    lines = ["| word | name | range | |", "| --- | --- | --- | --- |"]
    for word in Word:
        span = f"{word.least:,}" + (f" to {word.most:,}" if word.most > word.least else "")
        lines.append(f"| {word:d} | `{word.name}` | {span} | {word.text} |")
    lines += ["", "| table | entries | type | |", "| --- | --- | --- | --- |"]
    for table in Table:
        factors = (f"`{f.name}`" if isinstance(f, Word) else f"{f:,}" for f in table.factors)
        number = " * ".join(factors)
        if table.where is not None:
            number += f" if `{table.where.name}`"
        lines.append(f"| {table.name.lower()} | {number} | {names[table.entry]} | {table.text} |")
    return "\n".join(lines)


def ram_arrays(design: Design) -> dict[str, int]:
    """Return the firmware's arrays in RAM and their bytes, in the order in which they lie there."""
    filters, several = design.filters, design.gains > 1
    return {
        "query": design.sums * stride(design),
        "counts": _aligned(2 * design.slots),
        "before": _aligned(2 * 3 * design.slots) if several else 0,
        "history": 0 if filters else _aligned(2 * design.length * design.places),
        "metric": _aligned((8 if several else 1) * design.places) if filters else 0,
        "distance": kept_bytes(design),
        "delay": 0 if filters else _aligned(4 * (design.exclusion + 1)),
        "mean": _aligned(4 * design.sums * design.slots) if design.contrast else 0,
    }


def ram_bytes(design: Design) -> int:
    """Return the RAM of the firmware's arrays in bytes, as `vpr_ram_bytes` in ``c/vpr.c``."""
    return sum(ram_arrays(design).values())


#: `vpr_design_t` and `vpr_state_t` on a processor of 32 bits, which are not in `ram_bytes`
STRUCT_BYTES = 252


def kept_bytes(design: Design) -> int:
    """Return the RAM in which the filter keeps the distances of a window."""
    return _aligned(2 * design.places) if design.filters else 0


def check_limits(design: Design) -> None:
    """Raise DesignError if the numbers of the design exceed limits of the reference firmware."""
    formats = formats_of(design)
    distance = design.slots * design.code_max + (BIAS_TOP if design.filters else 0)
    for what, value, bits in (
        ("codes", design.code_max, 8),
        ("timestamps", formats["timestamp"].highest, 32),
        ("a distance", distance, 16),
        ("sums", design.slots * design.code_max * design.length, 32),
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


if __name__ == "__main__":
    argparse.ArgumentParser(description="Print the layout in Markdown.").parse_args()
    print(page())
