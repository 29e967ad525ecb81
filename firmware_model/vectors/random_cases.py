"""Random designs and random stimuli: bursts and pauses, with maps made of their windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from firmware_model.design import LARGEST_SUM, LEVEL_TOP, Design
from firmware_model.memories import Memories
from firmware_model.specification import Event
from firmware_model.vectors.case import Case, window_codes

#: number of events of one stream
EVENTS = 2000


def random_cases(
    design: Design, rng: np.random.Generator, number: int = 3, events: int = EVENTS
) -> list[Case]:
    """Make the cases of the suite ``random``.

    Parameters
    ----------
    number : int
        Number of cases, each with pixels, places and a stimulus of its own.
    events : int
        Number of events of a stimulus.
    """
    return [_case(f"random_{i}", design, rng, events) for i in range(number)]


def window_cases(design: Design, rng: np.random.Generator, number: int = 2) -> list[Case]:
    """Make the cases of the suite ``random`` that have some 40 windows, whatever the design.

    Windows by time have from no events to 120, so that some have few and some pause. Windows by
    count have 48 at most: the case's design has another `window_events`, if necessary.
    """
    if design.window == "count":
        design = replace(design, window_events=min(design.window_events, 48))
    return [_case(f"windows_{i}", design, rng, 0) for i in range(number)]


def _case(name: str, design: Design, rng: np.random.Generator, number: int) -> Case:
    flat = rng.choice(design.width * design.height, design.pixels, replace=False)
    pixels = [(f % design.width, f // design.width) for f in flat.tolist()]
    start = int(rng.integers(0, 1 << min(design.timestamp_bits, 62)))
    if number:
        events = _stream(design, pixels, start, rng, number)
    else:
        events = _windows(design, pixels, start, rng)
    blank = replace(design, places=design.length)
    # mean activities comparable with the windows', so that some windows pause
    mean, activity = _learnt(design, rng, 512 * (EVENTS // 30) if number else 256 * 1000)
    no_places = [[0] * design.slots] * design.length
    without = Memories(blank, pixels, no_places, mean=mean, activity=activity)
    seen = window_codes(without, events, start)
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots))
    # most places are windows of the stream; some of their codes are changed by one
    for k in range(design.places if seen else 0):
        if rng.random() < 0.8:
            noise = rng.integers(-1, 2, design.slots) * (rng.random(design.slots) < 0.2)
            places[k] = np.clip(np.array(seen[k % len(seen)]) + noise, 0, design.code_max)
    memories = Memories(
        design, pixels, places.tolist(), mean=mean, activity=activity,
        place_activity=_place_activity(design, rng), place_bias=_place_bias(design, rng),
        limits=_limits(design, rng),
    )  # fmt: skip
    return Case(name, memories, tuple(events), start)


def _place_activity(design: Design, rng: np.random.Generator) -> list[int] | None:
    """Draw activities of places about those of windows; the first and the last of all extremes."""
    if not design.filters:
        return None
    drawn = np.clip(np.rint(rng.normal(-8, 40, design.places)), -128, 127).astype(int).tolist()
    return [-128, *drawn[1:-1], 127][: design.places]


def _place_bias(design: Design, rng: np.random.Generator) -> list[int] | None:
    """Draw biases of places, small ones or any."""
    if not design.filters:
        return None
    return [int(bias) for bias in rng.integers(0, int(rng.choice([1, 8, 256])), design.places)]


def _limits(design: Design, rng: np.random.Generator) -> list[int] | None:
    """Draw the most events of each pixel that count, of which few windows have more."""
    if not design.contrast:
        return None
    return [int(limit) for limit in rng.integers(0, int(rng.choice([3, 30, 1024])), design.slots)]


def _learnt(
    design: Design, rng: np.random.Generator, most_activity: int
) -> tuple[list[int] | None, int]:
    """Draw initial running means and an initial mean activity."""
    mean, activity = None, 0
    if design.contrast:
        mean = rng.integers(0, 4 * 256 + 1, design.slots).tolist()
    if design.pauses:
        # of as many events as a window at times has, and of many more
        activity = int(2048 * (most_activity / 2048) ** rng.random())
    return mean, activity


def _windows(
    design: Design, pixels: list[tuple[int, int]], start: int, rng: np.random.Generator
) -> list[Event]:
    """Draw 40 windows by time, of log-uniform numbers of events, each with its busy pixels."""
    events = []
    for window in range(40):
        favourites = rng.integers(0, design.pixels, 4)
        offsets = rng.integers(0, design.tau_us, int(121 ** rng.random()) - 1)
        for offset in sorted(offsets.tolist()):
            x, y = pixels[favourites[rng.integers(4)]]
            if rng.random() < 0.4:
                x, y = pixels[rng.integers(design.pixels)]
            t = start + window * design.tau_us + offset
            events.append(Event(t % (1 << design.timestamp_bits), x, y, bool(rng.integers(2))))
        # a clock may be too narrow for a silence of two windows
        x, y = int(rng.integers(design.width)), int(rng.integers(design.height))
        t = start + window * design.tau_us + design.tau_us - 1
        events.append(Event(t % (1 << design.timestamp_bits), x, y, True))
    return events


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


# Small random designs of every kind, and their tables.


def random_design(rng: np.random.Generator) -> Design:
    """Draw a design that is small enough to be run in milliseconds.

    Returns
    -------
    Design
        Within the reference firmware's limits.
    """
    width, height = (int(side) for side in rng.integers(1, 13, 2))
    pixels = int(rng.integers(1, min(width * height, 20) + 1))
    length = int(rng.integers(1, 5))
    timestamp_bits = int(rng.integers(9, 33))
    return Design(
        width=width,
        height=height,
        pixels=pixels,
        code_bits=int(rng.integers(1, 9)),
        window=("time", "count")[rng.integers(2)],
        tau_us=int(rng.integers(1, 200)),
        window_events=int(rng.integers(1, 3 * pixels + 1)),
        timestamp_bits=timestamp_bits,
        places=int(rng.integers(length, length + 12)),
        length=length,
        lanes=int(rng.integers(1, 10)),
        exclusion=int(rng.integers(0, 5)),
        largest_sum=int(rng.integers(0, 4 * pixels)),
        lookup_depth=1 << int(max(width, 4 * pixels)).bit_length(),
    )


def random_adaptive_design(rng: np.random.Generator, gains: Sequence[int] = (1,)) -> Design:
    """Draw a small design with the place filter, contrast codes, or both.

    Parameters
    ----------
    gains : sequence of int
        To choose from, where a design can have seven.

    Returns
    -------
    Design
        Within the reference firmware's limits.
    """
    values = random_design(rng).to_dict()
    kind = rng.integers(3)
    if kind != 0:
        values |= {"code": "contrast"}
    if kind != 1:
        values |= {
            "matching": "filter",
            "length": 1,
            "largest_sum": LARGEST_SUM,
            "places_per_window": int(rng.integers(1, 3)),
            "restart": int(rng.integers(0, int(rng.choice([4, 30])) + 1)),
            "trust": int(rng.choice([0, int(rng.integers(1, 300))])),
        }
    if kind == 2 and values["window"] == "time":
        values |= {"gains": int(rng.choice(gains))}
    return Design(**values)


def random_memories(rng: np.random.Generator, design: Design) -> Memories:
    """Draw distinct pixels, and places with codes that the design has; some places are equal."""
    flat = rng.choice(design.width * design.height, design.pixels, replace=False)
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots))
    for k in range(1, design.places):
        if rng.random() < 0.3:
            places[k] = places[rng.integers(k)]
    pixels = [(f % design.width, f // design.width) for f in flat]
    if not design.pauses:
        return Memories(design, pixels, places.tolist())
    mean = rng.integers(0, LEVEL_TOP + 1, design.slots).tolist() if design.contrast else None
    # with some values every window pauses at first, and with others none does
    activity = int(rng.integers(0, 1 << int(rng.integers(1, 20))))
    return Memories(
        design, pixels, places.tolist(), mean=mean, activity=activity,
        place_activity=_place_activity(design, rng), place_bias=_place_bias(design, rng),
        limits=_limits(design, rng),
    )  # fmt: skip
