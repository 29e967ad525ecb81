"""Tables of a device with a design but without a map."""

from __future__ import annotations

from firmware_model import Design, Memories
from firmware_model.vectors.stimulus import choose_pixels


def blank_memories(design: Design) -> Memories:
    """Return tables with pixels for tests, and places without events."""
    places = [[0] * design.slots] * design.places
    tables = [slot % len(design.full_scales) for slot in range(design.slots)]
    return Memories(design, choose_pixels(design), places, tables)
