"""Exact counts of a design: operations, memory traffic and sizes, from its parameters alone.

The numbers are those of the device that `firmware_model` states; a test holds them equal to what
its plain oracle does when every operation and every access is counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from firmware_model.cost import Memory, memories, operations
from firmware_model.design import Design
from firmware_model.image import ALIGNMENT, HEADER_WORDS, prices, ram_bytes, stride
from fixedpoint.codes import packed_bytes

Shapes = Sequence[tuple[int, int]]
#: memories that tell which pixels are selected
_LOOKUP = ("displacement", "lookup", "pixel_delay")


class EveryPixel(Design):
    """A design with a counter for every pixel of its sensor, to compare with.

    No device of this kind holds as many. It needs no look-up: a pixel is its own slot.
    """

    def __post_init__(self) -> None:
        pixels = self.width * self.height
        # everything but J is checked, and as in a design
        object.__setattr__(self, "pixels", 1)
        object.__setattr__(self, "lookup_depth", 0)
        super().__post_init__()
        object.__setattr__(self, "pixels", pixels)

    @classmethod
    def beside(cls, design: Design) -> EveryPixel:
        """Count every pixel, all else as in a design."""
        return cls(**design.to_dict())


@dataclass(frozen=True)
class Traffic:
    """Words read from and written to one memory, and bits of a word."""

    reads: int
    writes: int
    width: int

    @property
    def bytes_read(self) -> float:
        """Bytes, packed without gaps."""
        return self.reads * self.width / 8

    @property
    def bytes_written(self) -> float:
        """Bytes, packed without gaps."""
        return self.writes * self.width / 8


@dataclass(frozen=True)
class Work:
    """What one event, one window's end or one match does.

    Attributes
    ----------
    counter_updates, absolute_differences, additions, comparisons, multiplications : int
        An addition has two operands: the first term of a sum is not added to anything. A comparison
        is one use of a comparator: best, best on the left and second for every place, though a
        program may know without looking.
    traffic : mapping of str to Traffic
        By memory, named as by `firmware_model.cost.memories`.
    """

    counter_updates: int = 0
    absolute_differences: int = 0
    additions: int = 0
    comparisons: int = 0
    multiplications: int = 0
    traffic: Mapping[str, Traffic] = field(default_factory=dict)

    @property
    def operations(self) -> dict[str, int]:
        """Numbers of each kind by name."""
        return {
            "counter updates": self.counter_updates,
            "absolute differences": self.absolute_differences,
            "additions": self.additions,
            "comparisons": self.comparisons,
            "multiplications": self.multiplications,
        }

    @property
    def bytes_read(self) -> float:
        """Of all memories."""
        return sum(part.bytes_read for part in self.traffic.values())

    @property
    def bytes_written(self) -> float:
        """Of all memories."""
        return sum(part.bytes_written for part in self.traffic.values())


def event_work(design: Design, selected: bool) -> Work:
    """Count what an event on the sensor does.

    Parameters
    ----------
    design : Design
    selected : bool
        Whether it is at a selected pixel.
    """
    looked_up = 0 if isinstance(design, EveryPixel) else 1
    return Work(
        counter_updates=int(selected),
        traffic=_traffic(
            design,
            displacement=(looked_up, 0),
            lookup=(looked_up, 0),
            counts=(int(selected), int(selected)),
        ),
    )


def window_work(design: Design) -> Work:
    """Count what the end of a window does: code, and clear, every counter.

    Of own-mean codes the difference to the mean and the mean's own step, and both limits.
    """
    own = design.slots if design.own_mean else 0
    return Work(
        additions=3 * own,
        comparisons=2 * own,
        traffic=_traffic(
            design,
            counts=(design.slots, design.slots),
            table=(design.slots if len(design.full_scales) > 1 else 0, 0),
            code=(design.slots, 0),
            query=(0, design.words),
            mean=(own, own),
        ),
    )


def match_work(design: Design) -> Work:
    """Count what a match does when L windows have been seen, in a window that does not pause."""
    traffic = _filter_traffic(design) if design.filters else _sequence_traffic(design)
    return Work(**operations(design)._asdict(), traffic=traffic)


def _sequence_traffic(design: Design) -> dict[str, Traffic]:
    sums = design.places - design.length + 1
    words = design.places * design.words
    return _traffic(
        design,
        query=(words, 0),
        places=(words, 0),
        history=(sums * (design.length - 1), design.places),
        delay=(max(0, sums - design.exclusion - 1), sums),
    )


def _filter_traffic(design: Design) -> dict[str, Traffic]:
    places = design.places
    words = places * design.words * (1 if design.keep_distances else 2)
    kept = places if design.keep_distances else 0
    return _traffic(
        design,
        query=(words, 0),
        places=(words, 0),
        # those of the steps' other places are at hand
        metric=(places, places),
        distance=(kept, kept),
        delay=(max(0, places - design.exclusion - 1), places),
    )


@dataclass(frozen=True)
class Sizes:
    """Memory that a design takes.

    Attributes
    ----------
    place_bytes : int
        One descriptor, its codes packed without gaps.
    packed_bytes : int
        All memories of the device, without gaps.
    flash_bytes, ram_bytes : int
        Image and arrays of the reference firmware in C, which keeps a byte a code; without its
        code, structures and stack.
    """

    place_bytes: int
    packed_bytes: int
    flash_bytes: int
    ram_bytes: int


def sizes(design: Design) -> Sizes:
    """Size a design's memories."""
    sized = memories(design)
    if isinstance(design, EveryPixel):
        sized = {name: memory for name, memory in sized.items() if name not in _LOOKUP}
    bits = sum(memory.bits for memory in sized.values())
    return Sizes(
        place_bytes=packed_bytes(design.slots, design.code_bits),
        packed_bytes=-(-bits // 8),
        flash_bytes=flash_bytes(design),
        ram_bytes=ram_bytes(design),
    )


def flash_bytes(design: Design) -> int:
    """Size the image that `firmware_model.image.image` would lay out, without laying it out."""
    looked_up = 0 if isinstance(design, EveryPixel) else 1
    tables = (
        looked_up * 2 * design.height,
        looked_up * 8 * design.lookup_depth,
        len(design.full_scales) * (design.count_max + 1) * (2 if design.own_mean else 1),
        design.slots,
        design.places * stride(design),
        2 * len(prices(design)),
        2 * design.slots if design.own_mean else 0,
    )
    return HEADER_WORDS * 4 + sum(-(-size // ALIGNMENT) * ALIGNMENT for size in tables)


def block_memories(design: Design, shapes: Shapes) -> int:
    """Count block memories: each memory takes whole ones, in the shape that suits it best.

    Parameters
    ----------
    design : Design
    shapes : sequence of (depth, width)
        In which a block can be used.
    """
    return _blocks(memories(design).values(), shapes)


def large_and_small_blocks(design: Design, large: Shapes, small: Shapes) -> tuple[int, int]:
    """Count large blocks for the places, which are only read, and small ones for the rest."""
    sized = memories(design)
    places = sized.pop("places")
    return _blocks([places], large), _blocks(sized.values(), small)


def _blocks(sized: Iterable[Memory], shapes: Shapes) -> int:
    return sum(min(memory.tiles(*shape) for shape in shapes) for memory in sized if memory.depth)


def _traffic(design: Design, **accesses: tuple[int, int]) -> dict[str, Traffic]:
    sized: dict[str, Memory] = memories(design)
    return {
        name: Traffic(reads, writes, sized[name].width)
        for name, (reads, writes) in accesses.items()
        if reads or writes
    }
