"""What a design costs, from its parameters alone: memories, clock cycles, operations."""

from __future__ import annotations

from typing import NamedTuple

from firmware_model.design import Design


class Memory(NamedTuple):
    """A memory of `depth` words of `width` bits."""

    depth: int
    width: int

    @property
    def bits(self) -> int:
        """Bits that are used."""
        return self.depth * self.width

    def tiles(self, depth: int, width: int) -> int:
        """Block memories of this shape that it takes: they cannot be cut."""
        return -(-self.depth // depth) * -(-self.width // width)


def memories(design: Design) -> dict[str, Memory]:
    """Size every memory of the device.

    Parameters
    ----------
    design : Design

    Returns
    -------
    dict of str to Memory
        Row displacements and look-up; counters; code tables, and which each counter uses; the
        descriptor that is compared; the places; the distances of the last L windows; the delay line
        of the search.
    """
    bits = {name: form.width for name, form in design.formats.items()}
    lanes = design.lanes * bits["code"]
    return {
        "displacement": Memory(design.height, bits["address"]),
        "lookup": Memory(design.lookup_depth, bits["owner"] + bits["slot"]),
        "counts": Memory(design.slots, bits["count"]),
        "code": Memory(len(design.full_scales) * (design.count_max + 1), bits["code"]),
        # a single table need not be told
        "table": Memory(design.slots if len(design.full_scales) > 1 else 0, bits["table"]),
        "query": Memory(design.words, lanes),
        "places": Memory(design.places * design.words, lanes),
        "history": Memory(design.length * design.places, bits["distance"]),
        "delay": Memory(design.exclusion + 1, bits["sequence"]),
    }


class Cycles(NamedTuple):
    """Clock cycles: of an event (a new one can begin in each), and of a window's end and match."""

    event: int
    encode: int
    compare: int
    drain: int

    @property
    def match(self) -> int:
        """From the end of a window to its match."""
        return self.encode + self.compare + self.drain


def cycles(design: Design) -> Cycles:
    """Count the clock cycles that `Machine.match_cycles` steps through.

    A place takes ``ceil(slots / P)`` cycles in the distance unit and L in the sequence unit, which
    work at once: the longer of the two decides. After the last distance follow its L terms, the
    search, and the acceptance test.

    Parameters
    ----------
    design : Design

    Returns
    -------
    Cycles
    """
    period = max(design.words, design.length)
    compare = (design.places - 1) * period + design.words
    return Cycles(event=1, encode=design.slots, compare=compare, drain=design.length + 2)


class Operations(NamedTuple):
    """Arithmetic of one match, whatever the number of lanes."""

    absolute_differences: int
    additions: int
    comparisons: int
    multiplications: int


def operations(design: Design) -> Operations:
    """Count the operations of one match with L windows seen.

    Parameters
    ----------
    design : Design

    Returns
    -------
    Operations
        Additions are those of the distances and along the diagonals; comparisons those of the
        search (against the best, the best on the left, and the second) and one to accept.
    """
    sums = design.places - design.length + 1
    return Operations(
        absolute_differences=design.places * design.slots,
        additions=design.places * (design.slots - 1) + sums * (design.length - 1),
        comparisons=3 * sums + 1,
        multiplications=2 if design.accept == "ratio" else 0,
    )
