"""Contents of a device's memories, word by word, and the meaning of the bits of a word."""

from __future__ import annotations

from itertools import chain

from firmware_model.memories import Memories
from firmware_model.vectors import formats
from firmware_model.vectors.formats import Packing, Table
from firmware_model.widths import widths_of

#: names of the memories, which are also the names of their files
MEMORIES = ("displacement", "lookup", "codes", "code_tables", "places")


def memory_words(memories: Memories) -> dict[str, tuple[Packing, Table]]:
    """Pack the contents of every memory.

    Returns
    -------
    dict of str to (Packing, Table)
        By the names of `MEMORIES`, in that order.
    """
    design, lookup = memories.design, memories.lookup()
    bits = widths_of(design)
    entry = Packing((("slot", bits["slot"]), ("owner", bits["owner"])))
    entries = zip(lookup.slot, lookup.owner, strict=True)
    words = {
        "displacement": _single("address", bits["address"], lookup.displacement),
        "lookup": (entry, formats.pack(entry, entries)),
        "codes": _single("code", bits["entry"], tuple(chain(*memories.codes))),
        "code_tables": _single("table", bits["table"], memories.tables),
        "places": descriptor_words(memories, memories.places),
    }
    if design.own_mean:
        words["means"] = _single("mean", bits["entry"], memories.mean)
    return words


def descriptor_words(
    memories: Memories, descriptors: tuple[tuple[int, ...], ...]
) -> tuple[Packing, Table]:
    """Pack descriptors, as many codes a word as the design has lanes.

    Parameters
    ----------
    memories : Memories
    descriptors : tuple of tuple of int, shape (n, slots)

    Returns
    -------
    Packing, Table
        Lane 0 is in the least significant bits; zeros fill up the last word of each descriptor.
    """
    lanes, bits = memories.design.lanes, memories.design.code_bits
    rows = (formats.lanes(codes, lanes, bits) for codes in descriptors)
    packing = Packing(tuple((f"lane_{lane}", bits) for lane in range(lanes)))
    return packing, Table(lanes * bits, tuple(chain.from_iterable(rows)))


def _single(name: str, bits: int, values: tuple[int, ...]) -> tuple[Packing, Table]:
    packing = Packing(((name, bits),))
    return packing, formats.pack(packing, ((value,) for value in values))
