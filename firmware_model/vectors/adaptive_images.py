"""Images with the place filter and own-mean codes: each field at its limits and beyond."""

from __future__ import annotations

from firmware_model.design import Design
from firmware_model.image import HEADER_WORDS, Word, image
from firmware_model.memories import Memories
from firmware_model.vectors.image_draft import BASE, PIXELS, Draft, Named, base, each

#: largest activity, price and logarithm that an image may have
_ACTIVITY, _PRICE, _LEVEL = 0x7FFF_FF00, 1016, 4096


def adaptive(**changes: object) -> Draft:
    """Draft an image of `BASE` with the filter and own-mean codes; `changes` go to the design."""
    values = {"matching": "filter", "length": 1, "code": "own-mean", "full_scales": [3]}
    values |= {"steps": [1, 0, 2], "back": [3], "restart": 9, "trust": 5}
    design = Design(**(BASE.to_dict() | values | changes))
    places = [[(k + slot) % 4 for slot in range(design.slots)] for k in range(design.places)]
    mean = [256 * (slot % 2) for slot in range(design.slots)] if design.own_mean else None
    pixels = (*PIXELS, *((x, 1) for x in range(8)))[: design.pixels]
    return Draft(image(Memories(design, pixels, places, mean=mean, activity=99)))


def _words(**changes: int) -> tuple[str, bytes]:
    name = "_".join(f"{word}_{value}" for word, value in changes.items())
    return f"adaptive_{name}", adaptive().header(**changes).pack()


def accepted_adaptive() -> Named:
    """Yield the names and bytes of images that must open."""
    yield "filter_and_own_mean", adaptive().pack()
    yield "filter_alone", adaptive(code="linear", full_scales=[3, 2]).pack()
    own = {"matching": "sequence", "length": 2, "trust": 0}
    yield "own_mean_alone", adaptive(**own).pack()
    yield _words(steps=1)
    yield _words(back=0)
    yield from each(_words, "restart", 0, _PRICE)
    yield _words(keep_distances=1)
    yield from each(_words, "trust", 0, 0x3FF0)
    yield from each(_words, "activity", 0, _ACTIVITY)
    # a metric has 10 bits, so that its product with any ratio fits
    yield _words(accept=1, ratio_denominator=0xFFFF)
    yield "sixteen_steps", _many(16, 16).pack()
    yield "price_at_its_limit", adaptive().poke(Word.PRICE_TABLE, "H", 3, _PRICE).pack()
    yield "level_at_its_limit", adaptive().poke(Word.CODE_TABLE, "H", 3, _LEVEL).pack()
    padded = adaptive().grow(Word.CODE_TABLE, 16).poke(Word.CODE_TABLE, "H", 4, 0xFFFF)
    yield "padding_behind_the_levels", padded.pack()
    yield "mean_at_its_limit", adaptive().poke(Word.MEAN_TABLE, "H", 5, _LEVEL).pack()
    wide = adaptive(code_bits=8, accept="ratio", ratio=(65_534, 65_535))
    yield "eight_bits_of_own_mean", wide.pack()
    one = adaptive().header(own_mean=1, code_max=1)
    one.tables[Word.PLACES_TABLE][:] = bytes(len(one.tables[Word.PLACES_TABLE]))
    yield "one_bit_of_own_mean", one.pack()


def _many(steps: int, back: int) -> Draft:
    return adaptive().header(steps=steps, back=back).grow(Word.PRICE_TABLE, 2 * (steps + back))


def _cut_means() -> bytes:
    """Cut the image off after the first 32 bytes of its means."""
    draft = adaptive(pixels=11, code_bits=2, lookup_depth=32)
    whole = draft.pack()
    cut = draft.words[Word.MEAN_TABLE] + 32
    draft.header(bytes=cut)
    return draft.raw(whole[HEADER_WORDS * 4 : cut])


def refused_adaptive() -> Named:
    """Yield the names and bytes of images that must not open."""
    yield "seventeen_steps", _many(17, 1).pack()
    yield "seventeen_back", _many(1, 17).pack()
    yield from each(_words, "steps", 0xFFFF_FFFF, 0)
    yield from each(_words, "length", 2, 6)
    yield _words(restart=_PRICE + 1)
    yield _words(keep_distances=2)
    yield _words(trust=0x3FF1)
    yield from each(_words, "own_mean", 9, 3, 1)
    yield _words(own_mean=33, code_max=1)
    yield _words(own_mean=3, code_max=6)
    yield from each(_words, "activity", _ACTIVITY + 1, 0xFFFF_FFFF)
    two = adaptive().header(codes=2).grow(Word.CODE_TABLE, 2 * 2 * 4)
    yield "two_tables_of_own_means", two.pack()
    # header words of parts that the design does not have must be zero
    for word in ("back", "restart", "keep_distances", "trust", "activity"):
        changed = base().grow(Word.PRICE_TABLE, 16).header(**{word: 1})
        yield f"sequences_with_{word}", changed.pack()
    for name, table, count, most in (
        ("price", Word.PRICE_TABLE, 4, _PRICE),
        ("level", Word.CODE_TABLE, 4, _LEVEL),
        ("mean", Word.MEAN_TABLE, 6, _LEVEL),
    ):
        for which, at in (("first", 0), ("last", count - 1)):
            yield f"{which}_{name}_beyond", adaptive().poke(table, "H", at, most + 1).pack()
    code = adaptive(code="linear", full_scales=[3, 2]).poke(Word.CODE_TABLE, "B", 7, 4)
    yield "code_of_a_filter_beyond", code.pack()
    yield "place_of_a_filter_beyond", adaptive().poke(Word.PLACES_TABLE, "B", 0, 4).pack()
    # tables that begin at the end of the image, so that their entries lie behind it
    for name, table in (("prices", Word.PRICE_TABLE), ("means", Word.MEAN_TABLE)):
        draft = adaptive()
        whole = draft.pack()
        draft.header(**{table.name.lower(): len(whole)})
        yield f"{name}_behind_the_image", draft.raw(whole[HEADER_WORDS * 4 :])
    # nine prices reach into the means, whose values would be valid prices
    yield "prices_reach_the_means", adaptive().header(steps=5, back=4).pack()
    yield "means_end_behind_the_image", _cut_means()
    levels = adaptive().header(count_max=8)
    yield "levels_reach_the_next_table", levels.pack()
