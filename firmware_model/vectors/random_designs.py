"""Small random designs of every kind, and their tables."""

from __future__ import annotations

import numpy as np

from firmware_model.design import Design
from firmware_model.memories import Memories


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
    denominator = int(rng.integers(2, 40))
    return Design(
        width=width,
        height=height,
        pixels=pixels,
        polarity=bool(rng.integers(2)),
        code=("linear", "sqrt", "log")[rng.integers(3)],
        code_bits=int(rng.integers(1, 9)),
        full_scales=tuple(rng.integers(1, 12, int(rng.integers(1, 4))).tolist()),
        window=("time", "count")[rng.integers(2)],
        tau_us=int(rng.integers(1, 200)),
        window_events=int(rng.integers(1, 3 * pixels + 1)),
        timestamp_bits=timestamp_bits,
        places=int(rng.integers(length, length + 12)),
        length=length,
        lanes=int(rng.integers(1, 10)),
        exclusion=int(rng.integers(0, 5)),
        accept=("margin", "ratio")[rng.integers(2)],
        margin=int(rng.integers(0, 30)),
        ratio=(int(rng.integers(1, denominator)), denominator),
        lookup_depth=1 << int(max(width, 4 * pixels)).bit_length(),
    )


def random_adaptive_design(rng: np.random.Generator) -> Design:
    """Draw a small design with the place filter, own-mean codes, or both.

    Returns
    -------
    Design
        Within the reference firmware's limits.
    """
    values = random_design(rng).to_dict()
    kind = rng.integers(3)
    if kind != 0:
        values |= {"code": "own-mean", "full_scales": [int(rng.integers(1, 40))]}
    if kind != 1:
        most = int(rng.choice([4, 40, 254]))
        values |= {
            "matching": "filter",
            "length": 1,
            "steps": rng.integers(0, most + 1, int(rng.integers(1, 6))).tolist(),
            "back": rng.integers(0, most + 1, int(rng.integers(0, 4))).tolist(),
            "restart": int(rng.integers(0, most + 1)),
            "keep_distances": bool(rng.integers(2)),
            "trust": int(rng.choice([0, int(rng.integers(1, 8000))])),
        }
    return Design(**values)


def random_memories(rng: np.random.Generator, design: Design) -> Memories:
    """Draw distinct pixels, and places with codes that the design has; some places are equal."""
    flat = rng.choice(design.width * design.height, design.pixels, replace=False)
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots))
    for k in range(1, design.places):
        if rng.random() < 0.3:
            places[k] = places[rng.integers(k)]
    pixels = [(f % design.width, f // design.width) for f in flat]
    tables = rng.integers(0, len(design.full_scales), design.slots)
    if not (design.filters or design.own_mean):
        return Memories(design, pixels, places.tolist(), tables.tolist())
    mean = rng.integers(0, design.entry_max + 1, design.slots).tolist() if design.own_mean else None
    # with some values every window pauses at first, and with others none does
    activity = int(rng.integers(0, 1 << int(rng.integers(1, 20))))
    return Memories(design, pixels, places.tolist(), tables.tolist(), mean=mean, activity=activity)
