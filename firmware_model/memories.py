"""Contents of the tables of a device: selected pixels, the codes of each place, and means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_model.design import (
    ACTIVITY_FRACTION_BITS,
    BIAS_TOP,
    LEVEL_TOP,
    PLACE_ACTIVITY_BITS,
    Design,
)
from firmware_model.errors import DesignError
from fixedpoint.activity import EVENTS_TOP

Pixel = tuple[int, int]
Codes = tuple[int, ...]


@dataclass(frozen=True)
class Lookup:
    """Look-up from pixel to slot by row displacement: rows are interleaved in one table.

    The entry of pixel (x, y) is at ``(x + displacement[y]) % depth``, and belongs to it only if
    ``owner`` at this entry is y.

    Attributes
    ----------
    owner : tuple of int, length `lookup_depth`
        Row, or `height` where there is none.
    """

    displacement: tuple[int, ...]
    owner: tuple[int, ...]
    slot: tuple[int, ...]

    def __call__(self, x: int, y: int) -> int | None:
        """Return the slot of a pixel on the sensor; None if it is not selected."""
        at = (x + self.displacement[y]) % len(self.owner)
        return self.slot[at] if self.owner[at] == y else None

    def taken(self, x: int, y: int) -> bool:
        """Return whether the entry of a pixel is used, by this pixel or by one of another row."""
        return self.owner[(x + self.displacement[y]) % len(self.owner)] < len(self.displacement)


@dataclass(frozen=True)
class Memories:
    """Contents of a design's tables.

    Parameters
    ----------
    pixels : sequence of (x, y), length J
        Slot j counts pixel ``pixels[j]``.
    places : sequence of sequences of int, shape (K, slots)
        Codes.
    mean : sequence of int, length slots, optional
        Of contrast codes, where each counter's running mean starts, in units of 1/256 octave; by
        default 0.
    activity : int
        Mean number of selected events of a window, in units of 1/256 event; 0 if windows never
        pause. Of the filter and of contrast codes.
    place_activity : sequence of int, length K, optional
        Of the filter, the logarithm of each place's events less that of the mean number, in units
        of 1/16 octave, -128 to 127; by default 0.
    """

    design: Design
    pixels: tuple[Pixel, ...]
    places: tuple[Codes, ...]
    mean: tuple[int, ...]
    activity: int
    place_activity: tuple[int, ...]
    place_bias: tuple[int, ...]
    limits: tuple[int, ...]

    def __init__(
        self,
        design: Design,
        pixels: Sequence[Pixel],
        places: Sequence[Sequence[int]],
        mean: Sequence[int] | None = None,
        activity: int = 0,
        place_activity: Sequence[int] | None = None,
        place_bias: Sequence[int] | None = None,
        limits: Sequence[int] | None = None,
    ) -> None:
        object.__setattr__(self, "design", design)
        object.__setattr__(self, "pixels", tuple((int(x), int(y)) for x, y in pixels))
        object.__setattr__(self, "places", tuple(tuple(map(int, place)) for place in places))
        object.__setattr__(self, "activity", int(activity))
        if len(self.pixels) != design.pixels or len(set(self.pixels)) != design.pixels:
            raise DesignError(
                f"{len(set(self.pixels))} different pixels: the design counts {design.pixels}"
            )
        for x, y in self.pixels:
            if not (0 <= x < design.width and 0 <= y < design.height):
                raise DesignError(
                    f"pixel ({x}, {y}) lies off the {design.width} x {design.height} sensor"
                )
        half, full = 1 << (PLACE_ACTIVITY_BITS - 1), design.count_max
        slots = design.slots if design.contrast else 0, "counters of contrast codes"
        of_filter = design.places if design.filters else 0, "places of the filter"
        for name, contents, usual, (length, of), what, least, most in (
            ("mean", mean, 0, slots, "means", 0, LEVEL_TOP),
            ("limits", limits, full, slots, "limits", 0, full),
            ("place_activity", place_activity, 0, of_filter, "activities", -half, half - 1),
            ("place_bias", place_bias, 0, of_filter, "biases", 0, BIAS_TOP),
        ):
            values = (usual,) * length if contents is None else tuple(map(int, contents))
            if len(values) != length or not all(least <= value <= most for value in values):
                raise DesignError(
                    f"{what} of {len(values)} {of}: expected {length} from {least} to {most}"
                )
            object.__setattr__(self, name, values)
        most = EVENTS_TOP << ACTIVITY_FRACTION_BITS if design.pauses else 0
        if not 0 <= self.activity <= most:
            raise DesignError(f"activity = {self.activity}: expected 0 to {most}")
        if len(self.places) != design.places:
            raise DesignError(f"{len(self.places)} places: the design has {design.places}")
        for k, place in enumerate(self.places):
            if len(place) != design.slots or not 0 <= min(place) <= max(place) <= design.code_max:
                raise DesignError(
                    f"place {k} is not {design.slots} codes from 0 to {design.code_max}: encode "
                    "the counts with the design's code first"
                )

    def lookup(self) -> Lookup:
        """Build the look-up: the fullest row first, each at the last position that fits.

        With the last position most addresses wrap, so that a device that cannot wrap fails the
        vectors.

        Raises
        ------
        DesignError
            If a row fits nowhere.
        """
        design, depth = self.design, self.design.lookup_depth
        rows: dict[int, list[tuple[int, int]]] = {}
        for slot, (x, y) in enumerate(self.pixels):
            rows.setdefault(y, []).append((x, slot))
        displacement = [0] * design.height
        owner, slots = [design.height] * depth, [0] * depth
        for y in sorted(rows, key=lambda row: (-len(rows[row]), row)):
            for start in reversed(range(depth)):
                if all(owner[(x + start) % depth] == design.height for x, _ in rows[y]):
                    break
            else:
                raise DesignError(
                    f"row {y} finds no room in a look-up of {depth} entries: set lookup_depth = "
                    f"{2 * depth}"
                )
            displacement[y] = start
            for x, slot in rows[y]:
                owner[(x + start) % depth], slots[(x + start) % depth] = y, slot
        return Lookup(tuple(displacement), tuple(owner), tuple(slots))
