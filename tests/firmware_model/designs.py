"""Random streams for the firmware model's tests."""

from __future__ import annotations

import numpy as np

from firmware_model import Design, Event, Memories


def random_stream(
    rng: np.random.Generator, memories: Memories, n: int, start: int = 0
) -> list[Event]:
    """Events in time order after `start`, most at selected pixels, with pauses of some windows."""
    design = memories.design
    steps = rng.integers(0, max(2, design.tau_us // 4), n)
    longest = (1 << (design.timestamp_bits - 1)) - design.tau_us
    pauses = rng.integers(0, min(4 * design.tau_us, longest) + 1, n)
    times = start + np.cumsum(np.where(rng.random(n) < 0.02, pauses, np.minimum(steps, longest)))
    events = []
    for t in times.tolist():
        x, y = memories.pixels[rng.integers(design.pixels)]
        if rng.random() < 0.3:
            x, y = rng.integers(design.width), rng.integers(design.height)
        events.append(Event(t, int(x), int(y), bool(rng.integers(2))))
    return events


def wrapped(events: list[Event], design: Design) -> list[Event]:
    """The same events by a clock of `timestamp_bits`."""
    return [event._replace(t=event.t % (1 << design.timestamp_bits)) for event in events]
