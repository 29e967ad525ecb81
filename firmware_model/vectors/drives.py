"""Drives through a small map: windows that show one place after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from firmware_model.design import Design
from firmware_model.memories import Memories
from firmware_model.vectors.case import Case
from firmware_model.vectors.stimulus import Stream, choose_pixels, shown_codes, unselected_pixel

#: stands for a window without events at selected pixels
PAUSE = -1


def drive(
    name: str,
    design: Design,
    route: Sequence[int],
    mean: Sequence[int] | None = None,
    activity: int = 0,
    alike: bool = False,
) -> Case:
    """Make a drive that shows places one after another; if `alike`, all places equal the first."""
    pixels = choose_pixels(design)
    longest = max(counts_at(design, place)[1] for place in range(design.places))
    if design.window == "count":
        design = replace(design, window_events=longest)
    stream = Stream(design, pixels)
    for place in route:
        if place == PAUSE:
            stream.at(*unselected_pixel(design, pixels))
            stream.end()
        else:
            stream.fill(counts_at(design, place)[0])
    stream.close()
    every = (counts_at(design, place)[0] for place in range(design.places))
    codes = shown_codes(Stream.showing(design, pixels, every), mean=mean)
    places = [codes[0 if alike else place] for place in range(design.places)]
    memories = Memories(design, pixels, places, None, None, mean, activity)
    return Case(name, memories, tuple(stream.events))


def counts_at(design: Design, place: int) -> tuple[list[int], int]:
    """Return the counts of each slot at a place, and their sum; near places have other counts."""
    counts = [(place * (slot + 3) + slot * slot) % 7 for slot in range(design.slots)]
    # one slot always has events, so that no place is empty
    counts[place % design.slots] += 9
    return counts, sum(counts)
