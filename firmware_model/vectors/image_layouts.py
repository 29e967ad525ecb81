"""Images that are cut off, or whose tables are unaligned, overlap, or lie outside."""

from __future__ import annotations

import struct

from firmware_model.image import HEADER_WORDS, TABLES, Word
from firmware_model.vectors.adaptive_images import adaptive
from firmware_model.vectors.image_draft import NOBODY, Named, base, deep_draft


def refused_layouts() -> Named:
    """Yield names and images whose tables lie at forbidden places."""
    whole = base().pack()
    header, end = HEADER_WORDS * 4, len(whole)
    for size in (0, 4, 64, 112, header - 4, header, end - 16, end - 4):
        yield f"cut_to_{size}", whole[:size]
        cut = bytearray(whole[:size])
        if size >= 12:
            struct.pack_into("<I", cut, Word.BYTES * 4, size)
            yield f"cut_to_{size}_and_says_so", bytes(cut)
    yield "longer_than_it_says", whole + bytes(16)
    whole = adaptive().pack()  # an image with all tables
    for i, word in enumerate(TABLES):
        at, end = struct.unpack_from("<I", whole, word * 4)[0], len(whole)
        before = HEADER_WORDS * 4 if i == 0 else struct.unpack_from("<I", whole, word * 4 - 4)[0]
        for wrong in sorted({0, at - 16, at + 1, at + 8, before - 16, end, end + 16, 0xFFFF_FFF0}):
            moved = bytearray(whole)
            struct.pack_into("<I", moved, word * 4, wrong)
            yield f"{word.name.lower()}_at_{wrong}", bytes(moved)
    yield "unaligned", _unaligned()
    yield "overlap", _overlapping()
    yield "table_in_the_header", _in_the_header()
    # a table in the last words of the header, which are zero: a valid displacement
    draft = deep_draft(16)
    body = draft.pack()[HEADER_WORDS * 4 :]
    yield "table_in_the_last_words", draft.header(displacement_table=112).raw(body)
    yield "displacement_reaches_the_lookup", deep_draft(16).header(height=9).pack()
    short = deep_draft(16).header(code_max=255)
    # the bytes that follow would be valid as the last two entries
    del short.tables[Word.LOOKUP_TABLE][14 * 8 :]
    short.tables[Word.CODE_TABLE][:] = b"\xff" * 16
    yield "lookup_reaches_the_codes", short.pack()


def _unaligned() -> bytes:
    """Move the places by eight bytes, and make the image longer by sixteen."""
    draft = base()
    whole = draft.pack()
    at = draft.words[Word.PLACES_TABLE]
    end = len(whole) + 16
    draft.header(places_table=at + 8, price_table=end, mean_table=end, bytes=end)
    return draft.raw(whole[HEADER_WORDS * 4 : at] + bytes(8) + whole[at:] + bytes(8))


def _in_the_header() -> bytes:
    """Put the displacements on the header's offset of the places, so that its low half is read."""
    draft = deep_draft(1 << 16)
    draft.pack()
    address = draft.words[Word.PLACES_TABLE] & 0xFFFF
    draft.poke(Word.LOOKUP_TABLE, "Q", 0, NOBODY).poke(Word.LOOKUP_TABLE, "Q", address, 0)
    whole = draft.pack()
    draft.header(displacement_table=Word.PLACES_TABLE * 4)
    return draft.raw(whole[HEADER_WORDS * 4 :])


def _overlapping() -> bytes:
    """Put the table of code choices on the codes; all bytes are zero, which is valid for both."""
    draft = base()
    draft.tables[Word.WHICH_CODE_TABLE][:] = bytes(16)
    draft.tables[Word.CODE_TABLE][:] = bytes(16)
    whole = draft.pack()
    draft.header(which_code_table=draft.words[Word.CODE_TABLE])
    return draft.raw(whole[HEADER_WORDS * 4 :])
