"""Random stimuli: bursts and pauses at random pixels, with maps made of their windows."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from firmware_model.descriptor import DescriptorModel, Event, WindowResult
from firmware_model.design import Design
from firmware_model.memories import Memories
from firmware_model.vectors.case import Case

#: number of events of one stream
EVENTS = 2000


def random_cases(
    design: Design, rng: np.random.Generator, number: int = 3, events: int = EVENTS
) -> list[Case]:
    """Make the cases of the suite ``random``.

    Parameters
    ----------
    design : Design
    rng : numpy.random.Generator
    number : int
        Number of cases, each with pixels, places and a stimulus of its own.
    events : int
        Number of events of a stimulus.
    """
    return [_case(f"random_{i}", design, rng, events) for i in range(number)]


def _case(name: str, design: Design, rng: np.random.Generator, number: int) -> Case:
    flat = rng.choice(design.width * design.height, design.pixels, replace=False)
    pixels = [(f % design.width, f // design.width) for f in flat.tolist()]
    tables = rng.integers(0, len(design.full_scales), design.slots).tolist()
    start = int(rng.integers(0, 1 << min(design.timestamp_bits, 62)))
    events = _stream(design, pixels, start, rng, number)
    blank = replace(design, places=design.length)
    mean, activity = _learnt(design, rng)
    no_places = [[0] * design.slots] * design.length
    model = DescriptorModel(
        Memories(blank, pixels, no_places, tables, mean=mean, activity=activity), start
    )
    results = [result for event in events for result in model.take(event)]
    seen = [result.codes for result in results if isinstance(result, WindowResult)]
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots))
    # most places are windows of the stream; some of their codes are changed by one
    for k in range(design.places if seen else 0):
        if rng.random() < 0.8:
            noise = rng.integers(-1, 2, design.slots) * (rng.random(design.slots) < 0.2)
            places[k] = np.clip(np.array(seen[k % len(seen)]) + noise, 0, design.code_max)
    memories = Memories(design, pixels, places.tolist(), tables, mean=mean, activity=activity)
    return Case(name, memories, tuple(events), start)


class _Learnt(NamedTuple):
    """Initial running means and initial usual activity."""

    mean: list[int] | None
    activity: int


def _learnt(design: Design, rng: np.random.Generator) -> _Learnt:
    mean, activity = None, 0
    if design.own_mean:
        most = min(design.entry_max, 4 * 256)
        mean = rng.integers(0, most + 1, design.slots).tolist()
    if design.own_mean or design.filters:
        # comparable with the events of a window, so that some of the windows pause
        activity = int(rng.integers(0, 512 * (EVENTS // 30)))
    return _Learnt(mean, activity)


def _stream(
    design: Design, pixels: list[tuple[int, int]], start: int, rng: np.random.Generator, number: int
) -> list[Event]:
    longest = (1 << (design.timestamp_bits - 1)) - design.tau_us
    # about thirty windows by time in EVENTS events, with rare pauses of up to three windows
    step = max(1, design.tau_us * 30 // EVENTS)
    steps = rng.integers(0, 2 * step + 1, number)
    pauses = rng.random(number) < 0.002
    steps = np.where(pauses, rng.integers(0, 3 * design.tau_us + 1, number), steps)
    times = start + np.cumsum(np.minimum(steps, longest).astype(object))
    # a few pixels are busy, as on a real sensor
    busy = rng.integers(0, design.pixels, number) * rng.integers(0, 2, number)
    events = []
    for t, choice in zip(times.tolist(), busy.tolist(), strict=True):
        x, y = pixels[choice]
        if rng.random() < 0.3:
            x, y = int(rng.integers(design.width)), int(rng.integers(design.height))
        events.append(Event(t % (1 << design.timestamp_bits), x, y, bool(rng.integers(2))))
    return events
