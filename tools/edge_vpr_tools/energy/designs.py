"""Designs to compare: maps of one drive with other numbers of pixels or fewer bits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from edge_vpr.baselines import map_all_pixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.pipeline import EventSource, map_traverse
from edge_vpr.reference_map import ReferenceMap

#: numbers of pixels (J) of the designs, and codes of their counters
PIXELS = (10, 25, 50, 150)
FEW_BITS = {"counter_code": "log", "counter_bits": 3}


@dataclass(frozen=True, eq=False)
class Compared:
    """A design: its name in tables and figures, and its map."""

    name: str
    reference: ReferenceMap


def of_pair(drive: EventSource, main: ReferenceMap) -> Iterator[Compared]:
    """Yield maps of a drive: with several numbers of pixels, with fewer bits, and with all pixels.

    Fixed-count windows hold the average number of events in tau at the same pixels. A match
    therefore covers the same length of the drive in all designs.
    """
    settings = main.settings.replaced({"events_per_pixel": None}, "designs")
    for pixels in PIXELS:
        mapped = main
        if pixels != settings.pixels:
            mapped = map_traverse(drive, settings.replaced({"pixels": pixels}, "designs"))
        yield Compared(f"{pixels} px", mapped)
    coded = map_traverse(drive, settings.replaced(FEW_BITS, "designs"))
    yield Compared(f"{settings.pixels} px, 3-bit log", coded)
    every = map_all_pixels(drive, settings, main.hot)
    yield Compared(f"all {len(every.pixel_map):,} px", every)


def of_map(reference: ReferenceMap) -> Iterator[Compared]:
    """Yield maps with the first pixels of a map, and the map itself.

    Pixels are stored in the order in which they were drawn, so that the first ones are a smaller
    draw. Windows by count end by the events of all pixels; only the map itself is then yielded.
    """
    drawn, counts = reference.pixel_map, reference.places.counts
    whole = len(drawn)
    if reference.settings.window == "time":
        for pixels in (p for p in PIXELS if p < whole):
            kept = np.concatenate(
                [np.arange(start, start + pixels) for start in range(0, counts.shape[1], whole)]
            )
            scale, mean = reference.full_scale, reference.mean
            yield Compared(
                f"{pixels} px",
                replace(
                    reference,
                    settings=reference.settings.replaced({"pixels": pixels}, "designs"),
                    pixel_map=PixelMap(drawn.sensor, drawn.x[:pixels], drawn.y[:pixels]),
                    places=replace(
                        reference.places,
                        counts=np.ascontiguousarray(counts[:, kept]),
                        # the number of events at these pixels cannot be computed from codes
                        selected=reference.places.activity * pixels // whole,
                    ),
                    full_scale=None if scale is None else scale[kept],
                    mean=None if mean is None else mean[kept],
                ),
            )
    yield Compared(f"{whole} px", reference)
