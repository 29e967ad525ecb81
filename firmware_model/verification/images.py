"""Images that `vpr_open` must accept or refuse: fields at their limits, and kinds of damage."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from firmware_model.design import LEVEL_TOP, LEVELS, Design
from firmware_model.errors import DesignError, VectorError
from firmware_model.image import (
    ALIGNMENT,
    HEADER_WORDS,
    VERSION,
    Table,
    Word,
    image,
    pack,
    ram_bytes,
    sealed,
)
from firmware_model.memories import Memories
from firmware_model.specification import Machine, MatchResult, WindowResult
from firmware_model.vectors.case import Case, in_order, records, to_binary

# Drafts of images, whose header and tables can be changed before they are packed.


#: owner of an unused entry of the look-up
NOBODY = 0xFFFF_FFFF

#: pairs of a name and an image
Named = Iterator[tuple[str, bytes]]


class Draft:
    """Image under construction: header words and tables, which are laid out when it is packed."""

    def __init__(self, data: bytes) -> None:
        self.words = dict(enumerate(struct.unpack_from(f"<{HEADER_WORDS}I", data)))
        self.tables: dict[Table, bytearray] = {}
        at = HEADER_WORDS * 4
        for table in Table:
            size = table.size(self.words)
            self.tables[table] = bytearray(data[at : at + size])
            at += -(-size // ALIGNMENT) * ALIGNMENT

    def header(self, **changes: int) -> Self:
        """Change words of the header; the tables stay as they are."""
        for name, value in changes.items():
            self.words[Word[name.upper()]] = value
        return self

    def poke(self, table: Table, form: str, index: int, value: int) -> Self:
        """Change an entry of a table, or what lies behind its end."""
        size = struct.calcsize(form)
        self.grow(table, (index + 1) * size)
        struct.pack_into(f"<{form}", self.tables[table], index * size, value)
        return self

    def grow(self, table: Table, size: int) -> Self:
        """Extend a table with zeros to a number of bytes."""
        self.tables[table] = self.tables[table].ljust(size, b"\0")
        return self

    def clear(self, table: Table) -> Self:
        """Set all of a table to zero, at the size that the header gives it."""
        self.tables[table] = bytearray(table.size(self.words))
        return self

    def pack(self) -> bytes:
        """Lay the tables out behind the header, and return the image with its checksum."""
        return pack(self.words, self.tables)


#: six pixels, counts up to 3, and six places
BASE = Design(
    width=9, height=5, pixels=6, code="counts", code_bits=2,
    places=6, length=2, exclusion=1, timestamp_bits=16, tau_us=1000, lookup_depth=16,
)  # fmt: skip
PIXELS = ((8, 0), (3, 2), (4, 2), (0, 0), (1, 2), (6, 0))  # in no pixel of the last two rows


def base() -> Draft:
    """Draft an image of `BASE`."""
    places = [[(k + slot) % 4 for slot in range(BASE.slots)] for k in range(BASE.places)]
    return Draft(image(Memories(BASE, PIXELS, places)))


def _named(changes: Mapping[str, int]) -> str:
    return "_".join(f"{word}_{value}" for word, value in changes.items())


def each(words: Callable[..., tuple[str, bytes]], word: str, *values: int) -> Named:
    """Yield an image for each of some values of one word of the header."""
    for value in values:
        yield words(**{word: value})


def one_pixel_draft(width: int = 9, **changes: object) -> Draft:
    """Draft an image of a design of one pixel at the origin; `changes` go to the design."""
    values = {"pixels": 1, "places": 1, "length": 1}
    design = Design(**(BASE.to_dict() | values | {"width": width} | changes))
    count = design.pixels
    pixels = [(i % design.width, i // design.width) for i in range(count)]
    return Draft(image(Memories(design, pixels, [[0] * design.slots] * design.places)))


def deep_draft(depth: int) -> Draft:
    """Draft an image whose look-up has `depth` entries, with its pixel at the first one."""
    draft = one_pixel_draft(1, height=1).header(lookup_depth=depth)
    draft.tables[Table.LOOKUP][:] = struct.pack("<II", NOBODY, 0) * depth
    draft.poke(Table.LOOKUP, "Q", 0, 0)
    return draft.poke(Table.DISPLACEMENT, "H", 0, 0)


# Images with the place filter and contrast codes: each field at its limits and beyond.


#: number of logarithms in an image
_LEVELS = len(LEVELS)
#: words whose range is the same in every design that has them, and 0 in others
_OF_FILTER = (Word.RESTART, Word.TRUST, Word.ACTIVITY)


def adaptive(**changes: object) -> Draft:
    """Draft an image of `BASE` with the filter and contrast codes; `changes` go to the design."""
    values = {"matching": "filter", "length": 1, "code": "contrast"}
    if changes.get("matching") != "sequence":
        values |= {"restart": 9, "trust": 5}
    design = Design(**(BASE.to_dict() | values | changes))
    places = [[(k + slot) % 4 for slot in range(design.slots)] for k in range(design.places)]
    mean = [256 * (slot % 2) for slot in range(design.slots)] if design.contrast else None
    activity = [-128, 127, -1, 0, 1, 40] if design.filters else None
    pixels = (*PIXELS, *((x, 1) for x in range(8)))[: design.pixels]
    return Draft(
        image(Memories(design, pixels, places, mean=mean, activity=99, place_activity=activity))
    )


_SEQUENCES: dict[str, object] = {"matching": "sequence", "length": 2, "trust": 0}


def _adaptive_words(**changes: int) -> tuple[str, bytes]:
    return f"adaptive_{_named(changes)}", adaptive().header(**changes).pack()


def accepted_adaptive() -> Named:
    """Yield the names and bytes of images that must open."""
    yield "filter_and_contrast", adaptive().pack()
    yield "filter_at_half_windows", adaptive(places_per_window=2).pack()
    yield "filter_alone", adaptive(code="counts").pack()
    yield "contrast_of_sequences", adaptive(**_SEQUENCES).pack()
    for word in _OF_FILTER:
        yield from each(_adaptive_words, word.name.lower(), word.least, word.most)
    yield "level_at_its_limit", adaptive().poke(Table.LEVEL, "H", 3, LEVEL_TOP).pack()
    yield "padding_behind_the_means", adaptive().poke(Table.MEAN, "H", 6, 0xFFFF).pack()
    yield "padding_behind_the_limits", adaptive().poke(Table.LIMITS, "H", 6, 0xFFFF).pack()
    yield "limit_at_its_limit", adaptive().poke(Table.LIMITS, "H", 5, 1023).pack()
    yield "any_bias", adaptive().poke(Table.PLACE_BIAS, "B", 5, 255).pack()
    yield "seven_gains", adaptive(gains=7).pack()
    yield "seven_gains_at_half_places", adaptive(gains=7, places_per_window=2).pack()
    yield "largest_biased_distance", _filter_of(256).pack()
    yield "mean_at_its_limit", adaptive().poke(Table.MEAN, "H", 5, LEVEL_TOP).pack()
    wide = adaptive(code_bits=8)
    yield "eight_bits_of_contrast", wide.pack()
    yield "one_bit_of_contrast", adaptive().header(code_bits=1).clear(Table.PLACES).pack()


def _filter_of(pixels: int) -> Draft:
    """Draft an image of the filter with codes of 8 bits of so many pixels."""
    design = replace(
        BASE, width=512, pixels=pixels, height=1, lookup_depth=512, matching="filter", length=1,
        code_bits=8,
    )  # fmt: skip
    if pixels > 256:
        draft = _filter_of(256).header(pixels=pixels, stride=-(-pixels // ALIGNMENT) * ALIGNMENT)
        last = pixels - 1
        return draft.clear(Table.PLACES).poke(Table.LOOKUP, "Q", last, last << 1 | last << 32)
    every = [(x, 0) for x in range(pixels)]
    return Draft(image(Memories(design, every, [[0] * pixels] * design.places)))


def refused_adaptive() -> Named:
    """Yield the names and bytes of images that must not open."""
    yield from each(_adaptive_words, "gains", 0, 2, 6, 8, 0x107)
    yield "seven_gains_of_counts", adaptive(code="counts").header(gains=7).pack()
    by_count = adaptive(window="count").header(gains=7)
    yield "seven_gains_of_windows_by_count", by_count.pack()
    yield "biased_distance_beyond", _filter_of(257).pack()
    yield from each(_adaptive_words, "places_per_window", 3, 0xFFFF_FFFF, 0)
    yield from each(_adaptive_words, "length", 2, 6)
    for word in _OF_FILTER:
        yield from each(_adaptive_words, word.name.lower(), word.most + 1, 0xFFFF_FFFF)
    yield from each(_adaptive_words, "contrast", 2, 0x100)
    plain = adaptive(code="counts")
    yield "contrast_of_counts", plain.header(contrast=1).pack()
    yield "contrast_of_sequences_of_counts", base().header(contrast=1).pack()
    yield from each(_adaptive_words, "code_bits", 0, 1, 9, 33)
    # header words of parts that the design does not have must be zero
    for word in (*_OF_FILTER, Word.GAINS):
        name = word.name.lower()
        yield f"sequences_with_{name}", base().header(**{name: 1}).pack()
    for name, table, count, most in (
        ("level", Table.LEVEL, _LEVELS, LEVEL_TOP),
        ("mean", Table.MEAN, 6, LEVEL_TOP),
        ("limit", Table.LIMITS, 6, 1023),
    ):
        for which, at in (("first", 0), ("last", count - 1)):
            yield f"{which}_{name}_beyond", adaptive().poke(table, "H", at, most + 1).pack()
    yield "place_of_a_filter_beyond", adaptive().poke(Table.PLACES, "B", 0, 4).pack()


# Images that are cut off, whose tables are too short or too long, and damaged ones.


def refused_layouts() -> Named:
    """Yield names and images whose tables do not fill them, or that are not as they were made."""
    whole = adaptive().pack()  # an image with all tables
    header, end = HEADER_WORDS * 4, len(whole)
    for size in (0, 4, 12, 16, 64, 112, header - 32, header - 4, header, end - 16, end - 4):
        yield f"cut_to_{size}", whole[:size]
        if size >= 16:
            yield f"cut_to_{size}_and_says_so", _of_bytes(whole[:size], size)
    yield "longer_than_its_tables", _of_bytes(whole + bytes(16), end + 16)
    for size in (0, 1, end - 1, end + 1, 0xFFFF_FFF0, 0xFFFF_FFFF):
        yield f"of_{size}_bytes", _of_bytes(whole, size)
    for table in Table:
        draft = adaptive()
        del draft.tables[table][-ALIGNMENT:]
        yield f"{table.name.lower()}_too_short", draft.pack()
        draft = adaptive()
        longer = -(-len(draft.tables[table]) // ALIGNMENT) * ALIGNMENT + ALIGNMENT
        yield f"{table.name.lower()}_too_long", draft.grow(table, longer).pack()
    yield "displacement_reaches_the_lookup", deep_draft(16).header(height=9).pack()
    yield "sizes_beyond_32_bits", _wrapped()
    # a bit of each word of the header, and some of the tables', without the checksum for it
    for at in (*range(0, header, 4), header - 1, header, end // 2, end - 17, end - 1):
        damaged = bytearray(whole)
        damaged[at] ^= 1
        yield f"bit_of_byte_{at}", bytes(damaged)


def _wrapped() -> bytes:
    """Make an image as long as its tables modulo 2^32, which ends within its look-up."""
    draft = one_pixel_draft(height=1).header(
        pixels=0xFFFF, stride=1 << 16, places=0xFFFF, code_bits=1, lookup_depth=1 << 16
    )
    size = sum(-(-table.size(draft.words) // ALIGNMENT) * ALIGNMENT for table in Table)
    draft.tables = {table: bytearray() for table in Table}
    draft.grow(Table.DISPLACEMENT, ALIGNMENT)
    draft.tables[Table.LOOKUP][:] = b"\xff" * (size % (1 << 32) - ALIGNMENT)
    return draft.pack()


def _of_bytes(data: bytes, size: int) -> bytes:
    """Write a number of bytes into the header, and the checksum for it."""
    changed = bytearray(data)
    struct.pack_into("<I", changed, Word.BYTES * 4, size)
    return sealed(bytes(changed))


# All images, and those of sequences: words of the header, tables and products at their limits.


@dataclass(frozen=True)
class ImageCase:
    """An image, and whether the reference firmware must open it."""

    name: str
    image: bytes
    opens: bool


def image_cases() -> list[ImageCase]:
    """Make the images; they do not depend on the design under test.

    Returns
    -------
    list of ImageCase
        Their names differ.
    """
    accepted = _accepted_words, _accepted_tables, _at_products, accepted_adaptive
    refused = _refused_words, refused_layouts, _refused_tables, _beyond_products, refused_adaptive
    return [
        ImageCase(name, data, opens)
        for kinds, opens in ((accepted, True), (refused, False))
        for kind in kinds
        for name, data in kind()
    ]


def _words(**changes: int) -> tuple[str, bytes]:
    return _named(changes), base().header(**changes).pack()


def _accepted_words() -> Named:
    yield "unchanged", base().pack()
    yield _words(width=1 << 15)
    yield _words(height=3)
    yield _words(code_bits=8)
    fewer = base().header(places=2)
    del fewer.tables[Table.PLACES][2 * ALIGNMENT :]
    yield "fewer_places", fewer.pack()
    yield from each(_words, "length", 1, 6)
    yield from each(_words, "exclusion", 0, 0xFFFF)
    yield from each(_words, "window", 1, 0x7FFF)
    yield _words(window_kind=1, window=1)
    yield _words(window_kind=1, window=0xFFFF_FFFF)
    yield _words(timestamp_bits=2, window=1)
    yield _words(timestamp_bits=32, window=0x7FFF_FFFF)
    yield from each(_words, "largest_sum", 0, 0xFFFF_FFFF)


def _refused_words() -> Named:
    yield _words(magic=0x4952_5057)
    yield from each(_words, "version", 0, VERSION - 1, VERSION + 1)
    for word in ("width", "height", "pixels", "stride", "places", "length"):
        yield from each(_words, word, 0, 0x1_0000, 0xFFFF_FFFF)
    yield from each(_words, "width", 8, (1 << 15) + 1)
    yield _words(height=2)
    yield from each(_words, "pixels", 5, 7, 16)
    yield _words(stride=8)
    yield "stride_32", base().header(stride=32).clear(Table.PLACES).pack()
    yield from each(_words, "places", 1, 2, 7)
    yield _words(length=7)
    yield _words(exclusion=0x1_0000)
    yield _words(window_kind=2)
    yield _words(window=0)
    yield _words(window_kind=1, window=0)
    yield _words(window=0x8000)
    yield _words(timestamp_bits=0)
    yield _words(timestamp_bits=1, window=1)
    yield _words(timestamp_bits=2, window=2)
    yield from each(_words, "timestamp_bits", 33, 64)
    # windows by count do not use the width of the clock
    yield _words(timestamp_bits=1, window_kind=1)
    yield _words(timestamp_bits=33, window_kind=1)
    yield from each(_words, "code_bits", 0, 1, 9, 32, 34)
    yield from each(_words, "lookup_depth", 0, 1, 3, 8, 15, 0x8000_0000)
    yield "lookup_depth_12_of_one_pixel", deep_draft(12).pack()
    # twelve entries hold all pixels, but are not a power of two
    wide = one_pixel_draft(8, lookup_depth=16)
    yield "lookup_depth_12", wide.header(lookup_depth=12).pack()


def _accepted_tables() -> Named:
    yield "in_more_memory", base().pack() + bytes(16)
    yield "displacement_at_its_limit", base().poke(Table.DISPLACEMENT, "H", 4, 15).pack()
    yield "nobody_has_any_slots", _nobody(base()).pack()
    yield "largest_height", one_pixel_draft(height=1 << 15).pack()
    yield "largest_width", one_pixel_draft(1 << 15, height=1, lookup_depth=0).pack()
    yield "one_pixel", one_pixel_draft(1, height=1).pack()
    most = one_pixel_draft().grow(Table.PLACES, ALIGNMENT * 0xFFFF)
    yield "most_places", most.header(places=0xFFFF).pack()
    yield "sixteen_slots", one_pixel_draft(pixels=16).pack()
    yield "seventeen_slots", one_pixel_draft(pixels=17, lookup_depth=32).pack()
    yield "shallowest_lookup", deep_draft(1).pack()
    yield "deepest_lookup", deep_draft(1 << 16).pack()
    yield "one_bit", base().header(code_bits=1).clear(Table.PLACES).pack()


def _nobody(draft: Draft) -> Draft:
    table = draft.tables[Table.LOOKUP]
    for at in range(0, len(table), 8):
        if struct.unpack_from("<I", table, at)[0] == NOBODY:
            struct.pack_into("<I", table, at + 4, 0xFFFF_FFFF)
    return draft


def _refused_tables() -> Named:
    displacement, lookup = Table.DISPLACEMENT, Table.LOOKUP
    yield "displacement_beyond", base().poke(displacement, "H", 4, 16).pack()
    same = struct.unpack_from("<H", base().tables[displacement])[0] + 16
    yield "displacement_beyond_by_the_depth", base().poke(displacement, "H", 0, same).pack()
    yield "displacement_of_another_row", base().poke(displacement, "H", 2, 5).pack()
    table = base().tables[lookup]
    taken = [i for i in range(16) if struct.unpack_from("<I", table, 8 * i)[0] != NOBODY]
    first, last = taken[0], taken[-1]
    empty = next(i for i in range(16) if i not in taken)
    for which, at in (("first", first), ("last", last)):
        pixel, slot = struct.unpack_from("<II", table, 8 * at)
        for name, entry in {
            "column_beyond": (pixel | 0x1_FFFE, slot),
            "row_beyond": (5 << 17 | pixel & 0x1_FFFF, slot),
            "lowest_bit_set": (pixel | 1, slot),
            "column_of_another": (pixel ^ 2, slot),
            "slot_beyond": (pixel, 6),
            "slot_far_beyond": (pixel, 0x1_0000),
            "missing": (NOBODY, slot),
        }.items():
            draft = base()
            struct.pack_into("<II", draft.tables[lookup], 8 * at, *entry)
            yield f"{which}_entry_{name}", draft.pack()
    # an additional pixel, in the row whose displacement leads to the empty entry
    extra = base().poke(displacement, "H", 4, empty)
    struct.pack_into("<II", extra.tables[lookup], 8 * empty, 4 << 17, 3)
    yield "one_pixel_too_many", extra.pack()
    yield "no_code_but_zero", base().header(code_bits=0).clear(Table.PLACES).pack()
    for name, at in {"first": 0, "last": 5 * 16 + 5}.items():
        yield f"{name}_place_beyond", base().poke(Table.PLACES, "B", at, 4).pack()
    for name, at in {"first": 6, "last": 6 * 16 - 1}.items():
        yield f"{name}_padding_not_zero", base().poke(Table.PLACES, "B", at, 1).pack()


def _at_products() -> Named:
    yield "largest_distance", _product(pixels=257, code_bits=8, length=1)
    yield "largest_history", _product(1, 2, 23_170)


def _beyond_products() -> Named:
    yield "distance_beyond", _product(pixels=258, code_bits=8, length=1)
    yield "history_beyond", _product(1, 2, 23_171)
    yield "lookup_too_deep", deep_draft(1 << 17).pack()
    yield (
        "height_beyond",
        one_pixel_draft(height=1 << 15)
        .grow(Table.DISPLACEMENT, (1 << 16) + 2)
        .header(height=(1 << 15) + 1)
        .pack(),
    )
    places = one_pixel_draft().grow(Table.PLACES, 16 * 0x1_0000).header(places=0x1_0000)
    yield "places_beyond", places.pack()
    # wrong only where an index has more than 16 bits
    cut = deep_draft(1 << 14)
    del cut.tables[Table.LOOKUP][64:]
    yield "lookup_of_128_kib_cut", cut.pack()


def _product(pixels: int, code_bits: int, length: int) -> bytes:
    """Make an image of as many places as the sequence is long, all codes zero."""
    draft = one_pixel_draft(512, pixels=pixels, height=1, lookup_depth=512)
    draft.header(code_bits=code_bits, length=length, places=length)
    return draft.grow(Table.PLACES, length * draft.words[Word.STRIDE]).pack()


# One file of all cases, which ``c/vectors_main.c`` runs in one process.


class LongWindow(NamedTuple):
    """A case, and how often its first event is repeated: more events than a file should have."""

    case: Case
    repeats: int

    def records(self) -> bytes:
        """Return the records of its windows and matches."""
        machine, (first, *_) = Machine(self.case.memories, self.case.start), self.case.events
        design = self.case.design
        if design.window == "count" and design.window_events <= self.repeats:
            raise VectorError(f"{self.repeats} events: the window ends with {design.window_events}")
        slot = machine.slot(first)
        if slot is None:
            raise VectorError("the first event is at a pixel that is not selected")
        results = list(machine.take(first))
        # what the further events would do, at once
        machine.counts[slot] = min(self.repeats, design.count_max)
        machine.counted = machine.events = self.repeats
        results += [result for event in self.case.events for result in machine.take(event)]
        shown = [result for result in results if isinstance(result, (WindowResult, MatchResult))]
        return to_binary(records(shown))


def bundle(
    images: Sequence[ImageCase], cases: Iterable[Case], long_windows: Sequence[LongWindow] = ()
) -> bytes:
    """Pack images and cases for the program ``vectors_main.c``.

    Parameters
    ----------
    cases : iterable of Case
        Cases beyond the reference firmware's limits are left out.
    long_windows : sequence of LongWindow
        Within these limits.
    """
    parts = [struct.pack("<I", len(images))]
    for one in images:
        parts += [struct.pack("<I", one.opens), packed_block(one.image)]
    packed = [data for case in cases if (data := _case(case)) is not None]
    parts += [struct.pack("<I", len(packed)), *packed, struct.pack("<I", len(long_windows))]
    for window in long_windows:
        parts.append(struct.pack("<I", window.repeats))
        parts.append(_packed(window.case, image(window.case.memories), window.records()))
    return b"".join(parts)


def _case(case: Case) -> bytes | None:
    try:
        flash = image(case.memories)
    except DesignError:
        return None
    return _packed(case, flash, to_binary(records(in_order(case.trace()))))


def _packed(case: Case, flash: bytes, expected: bytes) -> bytes:
    head = struct.pack("<II", case.start % (1 << 32), ram_bytes(case.design))
    return head + b"".join(map(packed_block, (flash, case.event_bytes(), expected)))


def packed_block(data: bytes) -> bytes:
    """Return the length of the data, the data, and zeros up to a whole word."""
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)
