"""Images that `vpr_open` must accept or refuse: fields at their limits, and kinds of damage."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from firmware_model.image import Word
from firmware_model.vectors.adaptive_images import accepted_adaptive, refused_adaptive
from firmware_model.vectors.image_draft import (
    NOBODY,
    Draft,
    Named,
    base,
    deep_draft,
    each,
    one_pixel_draft,
)
from firmware_model.vectors.image_layouts import refused_layouts


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
    accepted = [*_accepted_words(), *_accepted_tables(), *_at_products(), *accepted_adaptive()]
    refused = [*_refused_words(), *refused_layouts(), *_refused_tables(), *_beyond_products()]
    refused += refused_adaptive()
    return [ImageCase(name, data, True) for name, data in accepted] + [
        ImageCase(name, data, False) for name, data in refused
    ]


def _words(**changes: int) -> tuple[str, bytes]:
    name = "_".join(f"{word}_{value}" for word, value in changes.items())
    return name, base().header(**changes).pack()


def _accepted_words() -> Named:
    yield "unchanged", base().pack()
    yield _words(width=1 << 15)
    yield _words(height=3)
    yield _words(count_max=7)  # the further codes are the table's padding
    yield _words(codes=3)
    yield _words(places=2)
    yield from each(_words, "length", 1, 6)
    yield from each(_words, "exclusion", 0, 0xFFFF)
    yield from each(_words, "window", 1, 0x7FFF)
    yield _words(window_kind=1, window=1)
    yield _words(window_kind=1, window=0xFFFF_FFFF)
    yield _words(timestamp_bits=2, window=1)
    yield _words(timestamp_bits=32, window=0x7FFF_FFFF)
    yield _words(accept=0)
    yield _words(accept=0xFFFF_FFFF, ratio_denominator=0)
    yield _words(accept=0xFFFE, ratio_denominator=0xFFFF)


def _refused_words() -> Named:
    yield _words(magic=0x4952_5057)
    yield from each(_words, "version", 0, 1, 3)
    for word in ("width", "height", "pixels", "slots", "stride", "count_max", "places", "length"):
        yield from each(_words, word, 0, 0x1_0000, 0xFFFF_FFFF)
    yield from each(_words, "width", 8, (1 << 15) + 1)
    yield _words(height=2)
    yield from each(_words, "pixels", 2, 4, 6)
    yield _words(pixels=0x8000_0003)  # twice that is six in 32 bits
    yield from each(_words, "slots", 3, 5, 7)
    yield _words(pixels=2, slots=4)
    yield _words(pixels=4, slots=8)
    yield _words(stride=8)
    yield "stride_32", base().header(stride=32).grow(Word.PLACES_TABLE, 6 * 32).pack()
    yield _words(count_max=8)
    yield from each(_words, "places", 1, 7)
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
    yield from each(_words, "accept", 8, 0xFFFF_FFFF)
    yield _words(ratio_denominator=0x1_0000)
    yield from each(_words, "code_max", 0, 2, 256)
    yield from each(_words, "codes", 0, 1, 5)
    yield "codes_17", base().header(codes=17).grow(Word.CODE_TABLE, 17 * 4).pack()
    yield from each(_words, "lookup_depth", 0, 1, 3, 8, 15, 0x8000_0000)
    # twelve entries hold all pixels, but are not a power of two
    wide = one_pixel_draft(8, lookup_depth=16)
    yield "lookup_depth_12", wide.header(lookup_depth=12).pack()


def _accepted_tables() -> Named:
    yield "gaps_between_tables", base().pack(gap=16)
    yield "displacement_at_its_limit", base().poke(Word.DISPLACEMENT_TABLE, "H", 4, 15).pack()
    yield "nobody_has_any_slots", _nobody(base()).pack()
    yield "largest_height", one_pixel_draft(height=1 << 15).pack()
    yield "largest_width", one_pixel_draft(1 << 15, height=1, lookup_depth=0).pack()
    yield "one_pixel", one_pixel_draft(1, height=1).pack()
    yield "sixteen_slots", one_pixel_draft(pixels=16).pack()
    yield "seventeen_slots", one_pixel_draft(pixels=17, lookup_depth=32).pack()
    yield "shallowest_lookup", deep_draft(1).pack()
    yield "deepest_lookup", deep_draft(1 << 16).pack()
    sixteen = base().header(codes=16).grow(Word.CODE_TABLE, 16 * 4)
    yield "sixteen_code_tables", sixteen.poke(Word.WHICH_CODE_TABLE, "B", 0, 15).pack()
    two = base().header(code_max=1, codes=1, count_max=1)
    for table in (Word.CODE_TABLE, Word.WHICH_CODE_TABLE, Word.PLACES_TABLE):
        two.tables[table][:] = bytes(len(two.tables[table]))
    yield "one_bit", two.poke(Word.CODE_TABLE, "B", 1, 1).pack()


def _nobody(draft: Draft) -> Draft:
    table = draft.tables[Word.LOOKUP_TABLE]
    for at in range(0, len(table), 8):
        if struct.unpack_from("<I", table, at)[0] == NOBODY:
            struct.pack_into("<HH", table, at + 4, 0xFFFF, 0xFFFF)
    return draft


def _refused_tables() -> Named:
    displacement, lookup = Word.DISPLACEMENT_TABLE, Word.LOOKUP_TABLE
    yield "displacement_beyond", base().poke(displacement, "H", 4, 16).pack()
    same = struct.unpack_from("<H", base().tables[displacement])[0] + 16
    yield "displacement_beyond_by_the_depth", base().poke(displacement, "H", 0, same).pack()
    yield "displacement_of_another_row", base().poke(displacement, "H", 2, 5).pack()
    table = base().tables[lookup]
    taken = [i for i in range(16) if struct.unpack_from("<I", table, 8 * i)[0] != NOBODY]
    first, last = taken[0], taken[-1]
    empty = next(i for i in range(16) if i not in taken)
    for which, at in (("first", first), ("last", last)):
        pixel, off, on = struct.unpack_from("<IHH", table, 8 * at)
        for name, entry in {
            "column_beyond": (pixel | 0xFFFF, off, on),
            "row_beyond": (5 << 16 | pixel & 0xFFFF, off, on),
            "polarity_set": (pixel | 1 << 31, off, on),
            "column_of_another": (pixel ^ 1, off, on),
            "on_slot_beyond": (pixel, 6, 3),
            "on_slot_far_beyond": (pixel, 2, 0xFFFF),
            "off_slot_of_on": (pixel, on, on),
            "off_slot_beyond": (pixel, 6, on),
            "missing": (NOBODY, off, on),
        }.items():
            draft = base()
            struct.pack_into("<IHH", draft.tables[lookup], 8 * at, *entry)
            yield f"{which}_entry_{name}", draft.pack()
    # an additional pixel, in the row whose displacement leads to the empty entry
    extra = base().poke(displacement, "H", 4, empty)
    struct.pack_into("<IHH", extra.tables[lookup], 8 * empty, 4 << 16, 3, 0)
    yield "one_pixel_too_many", extra.pack()
    nothing = base().header(code_max=0)
    for zeroed in (Word.CODE_TABLE, Word.PLACES_TABLE):
        nothing.tables[zeroed][:] = bytes(len(nothing.tables[zeroed]))
    yield "no_code_but_zero", nothing.pack()
    yield "code_beyond_the_largest", base().poke(Word.CODE_TABLE, "B", 0, 4).pack()
    yield "last_code_beyond_the_largest", base().poke(Word.CODE_TABLE, "B", 7, 4).pack()
    yield "code_table_beyond", base().poke(Word.WHICH_CODE_TABLE, "B", 0, 2).pack()
    yield "last_code_table_beyond", base().poke(Word.WHICH_CODE_TABLE, "B", 5, 2).pack()
    for name, at in {"first": 0, "last": 5 * 16 + 5}.items():
        yield f"{name}_place_beyond", base().poke(Word.PLACES_TABLE, "B", at, 4).pack()
    for name, at in {"first": 6, "last": 6 * 16 - 1}.items():
        yield f"{name}_padding_not_zero", base().poke(Word.PLACES_TABLE, "B", at, 1).pack()


def _at_products() -> Named:
    yield "largest_distance", _product(pixels=257, code_max=255, length=1, denominator=3)
    yield "largest_sum_times_ratio", _product(4, 192, 128, 43_690)
    yield "ratio_of_a_power_of_two", _product(4, 128, 256, 32_767)
    yield "largest_history", _product(1, 3, 23_170, 0)


def _beyond_products() -> Named:
    yield "distance_beyond", _product(pixels=258, code_max=255, length=1, denominator=3)
    yield "sum_times_ratio_beyond", _product(4, 192, 128, 43_691)
    yield "ratio_beyond_by_a_power_of_two", _product(4, 128, 256, 32_768)
    yield "history_beyond", _product(1, 3, 23_171, 0)
    yield "lookup_too_deep", deep_draft(1 << 17).pack()
    yield (
        "height_beyond",
        one_pixel_draft(height=1 << 15)
        .grow(Word.DISPLACEMENT_TABLE, (1 << 16) + 2)
        .header(height=(1 << 15) + 1)
        .pack(),
    )
    counts = base().grow(Word.CODE_TABLE, 2 * 0x1_0001).header(count_max=0x1_0000)
    yield "counts_beyond", counts.pack()
    places = one_pixel_draft().grow(Word.PLACES_TABLE, 16 * 0x1_0000).header(places=0x1_0000)
    yield "places_beyond", places.pack()


def _product(pixels: int, code_max: int, length: int, denominator: int) -> bytes:
    """Make an image of as many places as the sequence is long, all codes zero."""
    draft = one_pixel_draft(512, pixels=pixels, height=1, lookup_depth=512)
    draft.header(code_max=code_max, length=length, places=length)
    draft.header(accept=denominator // 2, ratio_denominator=denominator)
    return draft.grow(Word.PLACES_TABLE, length * draft.words[Word.STRIDE]).pack()
