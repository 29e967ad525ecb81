"""Drafts of images, whose header and tables can be changed before they are packed."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Self

from firmware_model.design import Design
from firmware_model.image import ALIGNMENT, HEADER_WORDS, TABLES, Word, image
from firmware_model.memories import Memories

#: owner of an unused entry of the look-up
NOBODY = 0xFFFF_FFFF

#: pairs of a name and an image
Named = Iterator[tuple[str, bytes]]


class Draft:
    """Image under construction: header words and tables, which are laid out when it is packed."""

    def __init__(self, data: bytes) -> None:
        self.words = list(struct.unpack_from(f"<{HEADER_WORDS}I", data))
        offsets = [self.words[word] for word in TABLES]
        ends = [*offsets[1:], len(data)]
        self.tables = {
            word: bytearray(data[at:end])
            for word, at, end in zip(TABLES, offsets, ends, strict=True)
        }

    def header(self, **changes: int) -> Self:
        """Change words of the header; the tables stay as they are."""
        for name, value in changes.items():
            self.words[Word[name.upper()]] = value
        return self

    def poke(self, table: Word, form: str, index: int, value: int) -> Self:
        """Change an entry of a table; a negative index counts from its end."""
        size = struct.calcsize(form)
        at = index * size if index >= 0 else len(self.tables[table]) + index * size
        struct.pack_into(f"<{form}", self.tables[table], at, value)
        return self

    def grow(self, table: Word, size: int) -> Self:
        """Extend a table with zeros to a number of bytes."""
        self.tables[table] = self.tables[table].ljust(size, b"\0")
        return self

    def pack(self, gap: int = 0) -> bytes:
        """Lay the tables out with `gap` unneeded bytes before each, and return the image."""
        body = b""
        for word in TABLES:
            body += bytes(gap)
            self.words[word] = HEADER_WORDS * 4 + len(body)
            table = bytes(self.tables[word])
            body += table.ljust(-(-len(table) // ALIGNMENT) * ALIGNMENT, b"\0")
        self.words[Word.BYTES] = HEADER_WORDS * 4 + len(body)
        return self.raw(body)

    def raw(self, body: bytes) -> bytes:
        """Return the header as it is, followed by a body."""
        return struct.pack(f"<{HEADER_WORDS}I", *self.words) + body


#: three pixels of both polarities, two code tables for counts up to 3, and six places; every table
#: except that of the places has padding
BASE = Design(
    width=9, height=5, pixels=3, polarity=True, code="linear", code_bits=2, full_scales=(3, 2),
    places=6, length=2, exclusion=1, timestamp_bits=16, tau_us=1000, lookup_depth=16,
)  # fmt: skip
PIXELS = ((8, 0), (3, 2), (4, 2))  # in no pixel of the last two rows


def base() -> Draft:
    """Draft an image of `BASE`."""
    places = [[(k + slot) % 4 for slot in range(BASE.slots)] for k in range(BASE.places)]
    return Draft(image(Memories(BASE, PIXELS, places, [0, 1, 0, 1, 0, 1])))


def each(words: Callable[..., tuple[str, bytes]], word: str, *values: int) -> Named:
    """Yield an image for each of some values of one word of the header."""
    for value in values:
        yield words(**{word: value})


def one_pixel_draft(width: int = 9, **changes: object) -> Draft:
    """Draft an image of a design of one pixel at the origin; `changes` go to the design."""
    values = {"pixels": 1, "places": 1, "length": 1, "polarity": False}
    design = Design(**(BASE.to_dict() | values | {"width": width} | changes))
    count = design.pixels
    pixels = [(i % design.width, i // design.width) for i in range(count)]
    return Draft(image(Memories(design, pixels, [[0] * design.slots] * design.places)))


def deep_draft(depth: int) -> Draft:
    """Draft an image whose look-up has `depth` entries, with its pixel at the first one."""
    draft = one_pixel_draft(1, height=1).header(lookup_depth=depth)
    draft.tables[Word.LOOKUP_TABLE][:] = struct.pack("<IHH", NOBODY, 0, 0) * depth
    draft.poke(Word.LOOKUP_TABLE, "Q", 0, 0)
    return draft.poke(Word.DISPLACEMENT_TABLE, "H", 0, 0)
