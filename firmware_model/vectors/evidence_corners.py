"""Corner cases of the place filter's evidence: large and small distances, and their spread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from firmware_model.design import Design
from firmware_model.memories import Memories
from firmware_model.vectors.case import Case
from firmware_model.vectors.stimulus import Stream, choose_pixels, shown_codes


def evidence_cases(design: Design) -> list[Case]:
    """Make the corner cases of the evidence.

    Parameters
    ----------
    design : Design
        With the place filter, and with logarithmic or linear codes.
    """
    return [_far(design), _beyond_a_byte(design), *_small_spreads(design)]


def _far(design: Design) -> Case:
    """Show a count that is equally far from all places, then the places' own counts."""
    design = replace(design, code="linear", code_bits=8, full_scales=(0,), window_events=210)
    pixels = choose_pixels(design)
    rest = [0] * (design.slots - 1)
    stream = Stream.showing(design, pixels, [[count, *rest] for count in (101, 1, 201, 1)])
    shown = shown_codes(stream)
    # only one place is near, so that the second best is a far one
    places = [shown[1 if k == design.places // 2 else 2] for k in range(design.places)]
    return Case("far", Memories(design, pixels, places), tuple(stream.events))


def _beyond_a_byte(design: Design) -> Case:
    """Show places whose distances need more than eight bits, if the design has two slots.

    Truncated to eight bits, the largest distance would be smaller than the others.
    """
    design = replace(design, code="linear", code_bits=8, full_scales=(0,))
    # the exclusion zone is as wide as a block of equal places
    design = replace(design, exclusion=design.places // 4 - 1)
    design = replace(design, window_events=411, steps=(0,), back=(), restart=0)
    pixels = choose_pixels(design)
    rest = [0] * max(0, design.slots - 2)
    kinds = [[counts, counts][: design.slots] + rest for counts in (1, 101, 181, 201)]
    stream = Stream.showing(design, pixels, kinds * 2)
    shown = shown_codes(stream)
    places = [shown[(0, 2, 1, 3)[place * 4 // design.places]] for place in range(design.places)]
    return Case("distances_beyond_a_byte", Memories(design, pixels, places), tuple(stream.events))


def _small_spreads(design: Design) -> list[Case]:
    """Show windows a few units of code from all places, so that the spread is 1 or 0.

    The reciprocal of both is 2^16, which has one bit more than any other. A place takes two words
    of memory, if the design has enough slots.
    """
    lanes = -(-design.slots // 2)
    near = replace(design, full_scales=(0,), lanes=lanes, exclusion=1)
    near = replace(near, window_events=max(near.window_events, 20 + 3 * near.slots))
    pixels = choose_pixels(near)
    rest = [3] * (near.slots - 1)
    stream = Stream.showing(near, pixels, [[first, *rest] for first in (20, 20, 20, 1, 20, 20)])
    shown = shown_codes(stream)[0]
    memories = Memories(near, pixels, _at_distances(near, shown, lambda place: 1 + place * 5 % 4))
    alike = Memories(near, pixels, _at_distances(near, shown, lambda _: 1))
    kept, events = replace(near, keep_distances=True), tuple(stream.events)
    return [
        Case("spread_of_one", memories, events),
        Case("spread_of_one_of_kept_distances", replace(memories, design=kept), events),
        Case("spread_of_none", alike, events),
    ]


def _at_distances(
    design: Design, shown: Sequence[int], distance_of: Callable[[int], int]
) -> list[list[int]]:
    """Make places at these distances, in units of code; the middle place equals `shown`."""
    places = []
    for place in range(design.places):
        # only one place is nearest, so that the second best has evidence against it
        distance = 0 if place == design.places // 2 else distance_of(place)
        codes = list(shown)
        for slot in range(min(distance, design.slots)):
            codes[-1 - slot] += 1 if codes[-1 - slot] < design.code_max else -1
        places.append(codes)
    return places
