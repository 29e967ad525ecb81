"""Districts along the route (town, park, open field, works), each with a near and a far wall."""

from __future__ import annotations

import numpy as np

from edge_vpr.simulate.surface import (
    COLUMN_M,
    FAR_ROW_M,
    NEAR_ROW_M,
    NEAR_TOP_M,
    Plane,
    Surface,
    box,
)

Noises = tuple[Plane, Plane]
Random = np.random.Generator


def _buildings(far: Surface, start: float, stop: float, rng: Random, grain: Noises) -> None:
    """Paint houses wall to wall or with gaps, each with its height, plaster and rows of windows."""
    at = start
    while at < stop - 4:
        width = min(rng.uniform(7, 22), stop - at)
        storeys, storey = int(rng.integers(1, 5)), rng.uniform(2.7, 3.3)
        height = storeys * storey + rng.uniform(0.3, 1.0)
        wall = rng.uniform(0.15, 0.75)
        box(far, at, at + width, 0, height, wall, FAR_ROW_M)
        box(far, at, at + width, 0, 0.6, wall * 0.6, FAR_ROW_M)
        box(far, at, at + width, height - 0.3, height, wall * 0.5, FAR_ROW_M)
        pitch, glass = rng.uniform(1.8, 4.0), rng.uniform(0.04, 0.12)
        size, tall = pitch * rng.uniform(0.35, 0.6), rng.uniform(1.1, 1.8)
        for storey_number in range(storeys):
            sill = storey_number * storey + 0.9
            for window in np.arange(at + 0.8, at + width - size - 0.4, pitch):
                box(far, window - 0.1, window + size + 0.1, sill - 0.1, sill + tall + 0.1,
                     min(wall * 1.5, 0.9), FAR_ROW_M)  # fmt: skip
                box(far, window, window + size, sill, sill + tall,
                     glass * rng.uniform(0.6, 2.5), FAR_ROW_M)  # fmt: skip
        door = at + rng.uniform(0.5, max(width - 2, 0.6))
        box(far, door, door + 1.1, 0, 2.1, rng.uniform(0.05, 0.4), FAR_ROW_M)
        _roughen(far, at, at + width, grain[0], 0.08)
        at += width + (rng.uniform(2, 8) if rng.random() < 0.3 else 0.0)


def _woods(far: Surface, start: float, stop: float, rng: Random, grain: Noises) -> None:
    """Paint a wood's edge: a ragged top and leaves at two scales."""
    columns = slice(int(start / COLUMN_M), int(stop / COLUMN_M))
    top = rng.uniform(5, 9) + 2.5 * grain[1][0, columns] + 0.8 * grain[0][0, columns]
    height = np.arange(far.cover.shape[0], dtype=np.float32)[:, None] * np.float32(FAR_ROW_M)
    solid = height + 0.9 * grain[1][:, columns] + 0.4 * grain[0][:, columns] < top
    leaf = 0.16 * np.exp(0.7 * grain[1][:, columns] + 0.7 * grain[0][:, columns])
    far.reflectance[:, columns] = np.where(solid, leaf, far.reflectance[:, columns])
    far.cover[:, columns] = np.maximum(far.cover[:, columns], solid)


def _meadow(far: Surface, start: float, stop: float, rng: Random, grain: Noises) -> None:
    """Paint a low bank of grass under an open sky."""
    columns = slice(int(start / COLUMN_M), int(stop / COLUMN_M))
    rows = slice(0, int(rng.uniform(1.0, 2.5) / FAR_ROW_M))
    far.reflectance[rows, columns] = 0.22 * np.exp(
        0.15 * grain[1][rows, columns] + 0.2 * grain[0][rows, columns]
    )
    far.cover[rows, columns] = 1.0


def _sheds(far: Surface, start: float, stop: float, rng: Random, grain: Noises) -> None:
    """Paint long sheds with next to no texture, a gate here and there."""
    at = start
    while at < stop - 4:
        width = min(rng.uniform(25, 50), stop - at)
        wall, height = rng.uniform(0.3, 0.7), rng.uniform(5, 9)
        box(far, at, at + width, 0, height, wall, FAR_ROW_M)
        box(far, at, at + width, height - 0.2, height, wall * 0.6, FAR_ROW_M)
        for gate in rng.uniform(at, max(at + width - 5, at + 0.1), int(rng.integers(0, 3))):
            box(far, gate, gate + rng.uniform(2.5, 4.5), 0, 3.5, wall * 0.5, FAR_ROW_M)
        _roughen(far, at, at + width, grain[1], 0.04)
        at += width + rng.uniform(0, 6)


def _roughen(wall: Surface, s0: float, s1: float, noise: Plane, strength: float) -> None:
    columns = slice(int(s0 / COLUMN_M), int(s1 / COLUMN_M))
    wall.reflectance[:, columns] *= np.exp(np.float32(strength) * noise[:, columns])


def _tree(near: Surface, at: float, rng: Random, leaves: Noises) -> None:
    """Paint a trunk and a crown that is open at its rim."""
    crown, middle = rng.uniform(1.0, 2.0), rng.uniform(3.2, 4.4)
    box(near, at - 0.15, at + 0.15, 0, middle, rng.uniform(0.05, 0.15), NEAR_ROW_M)
    first = max(int((at - crown) / COLUMN_M), 0)
    columns = slice(first, max(int((at + crown) / COLUMN_M), first))
    s = np.arange(first, columns.stop)[None, : near.cover[:, columns].shape[1]] * COLUMN_M - at
    y = np.arange(near.cover.shape[0])[:, None] * NEAR_ROW_M - middle
    inside = 1 - (s / crown) ** 2 - (y / 1.6) ** 2
    ragged = 0.6 * leaves[0][:, columns] + 0.6 * leaves[1][:, columns]
    solid = inside + ragged > 0.35
    leaf = 0.13 * np.exp(0.8 * leaves[0][:, columns] + 0.3 * leaves[1][:, columns])
    near.reflectance[:, columns] = np.where(solid, leaf, near.reflectance[:, columns])
    near.cover[:, columns] = np.maximum(near.cover[:, columns], solid)


def _hedge(near: Surface, start: float, stop: float, rng: Random, leaves: Noises) -> None:
    columns = slice(int(start / COLUMN_M), int(stop / COLUMN_M))
    rows = slice(0, int(rng.uniform(0.7, 1.3) / NEAR_ROW_M))
    near.reflectance[rows, columns] = 0.12 * np.exp(0.8 * leaves[0][rows, columns])
    near.cover[rows, columns] = 1.0


def _pole(near: Surface, at: float, value: float) -> None:
    box(near, at - 0.1, at + 0.1, 0, NEAR_TOP_M, value, NEAR_ROW_M)


def _street(near: Surface, start: float, stop: float, rng: Random, leaves: Noises) -> None:
    """Paint lamp posts at a fixed distance, signs, a tree now and then."""
    for at in np.arange(start + rng.uniform(2, 12), stop, rng.uniform(24, 32)):
        _pole(near, at, 0.25)
    for at in rng.uniform(start, stop, rng.poisson((stop - start) / 30)):
        box(near, at - 0.05, at + 0.05, 0, 2.2, 0.3, NEAR_ROW_M)
        box(near, at - 0.3, at + 0.3, 2.2, 2.9, rng.choice((0.1, 0.4, 0.85)), NEAR_ROW_M)
    for at in rng.uniform(start, stop, rng.poisson((stop - start) / 40)):
        _tree(near, at, rng, leaves)


def _avenue(near: Surface, start: float, stop: float, rng: Random, leaves: Noises) -> None:
    """Paint trees close together, and a hedge under some of them."""
    if rng.random() < 0.5:
        _hedge(near, start, start + (stop - start) * rng.uniform(0.3, 1.0), rng, leaves)
    at = start + rng.uniform(1, 5)
    while at < stop:
        _tree(near, at, rng, leaves)
        at += rng.uniform(4, 12)


def _fence(near: Surface, start: float, stop: float, rng: Random, leaves: Noises) -> None:
    """Paint posts and two rails: the same every few metres."""
    value = rng.uniform(0.1, 0.5)
    for at in np.arange(start, stop, 2.5):
        box(near, at, at + 0.15, 0, 1.2, value, NEAR_ROW_M)
    for rail in (0.5, 1.0):
        box(near, start, stop, rail, rail + 0.1, value, NEAR_ROW_M)
    for at in rng.uniform(start, stop, rng.poisson((stop - start) / 60)):
        _tree(near, at, rng, leaves)


def _bare(near: Surface, start: float, stop: float, rng: Random, leaves: Noises) -> None:
    """Paint poles only, far between."""
    for at in np.arange(start + rng.uniform(5, 30), stop, rng.uniform(30, 45)):
        _pole(near, at, 0.15)


FAR_PAINTERS = {"town": _buildings, "park": _woods, "field": _meadow, "works": _sheds}
NEAR_PAINTERS = {"town": _street, "park": _avenue, "field": _fence, "works": _bare}

#: districts where grass grows beside the road, in place of slabs
GREEN = ("park", "field")
