"""The world: a straight street between painted surfaces, from which five textures are made.

A wall close to the road on each side (trees, hedges, poles, fences, parked cars) stands before one
further off (buildings, woods, bare sheds), so that the near hides the far and moves faster. The
ground lies between the far walls. Each side passes through districts of its own, so that the amount
of texture changes along the route. Nothing is copied from photographs: rectangles, blobs and
value noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.simulate.districts import FAR_PAINTERS, GREEN, NEAR_PAINTERS
from edge_vpr.simulate.ranges import check_range
from edge_vpr.simulate.surface import (
    COLUMN_M,
    FAR_M,
    FAR_ROW_M,
    FAR_TOP_M,
    GROUND_ROW_M,
    NEAR_ROW_M,
    NEAR_TOP_M,
    VIEW_M,
    Surface,
    box,
)
from edge_vpr.simulate.texture import noise_2d

_GROUND, _SIDE = 21, 22  # one random stream each


@dataclass(frozen=True)
class World:
    """Parameters of the world along the route.

    Parameters
    ----------
    length_m : float
        Length of the route in metres. Its textures take about 25 kB a metre, and some 200 kB
        while they are painted.
    seed : int
        Which world.
    """

    length_m: float = 900.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_range(self, ("length_m",), "name a route of 10 to 20000 metres", 10, 20_000)
        check_range(self, ("seed",), "name a seed of 0 or more")

    @property
    def columns(self) -> int:
        """Columns of each texture: the route and what is seen from its end."""
        return round((self.length_m + VIEW_M + 20) / COLUMN_M)


class Scene(NamedTuple):
    """The painted world before any light falls on it; walls are (left, right)."""

    near: tuple[Surface, Surface]
    far: tuple[Surface, Surface]
    ground: Surface


def paint(world: World) -> Scene:
    """Paint the world.

    Returns
    -------
    Scene
        The same for the same world.
    """
    sides = [_side(world, np.random.default_rng((world.seed, _SIDE, number))) for number in (0, 1)]
    (near_left, far_left, green_left), (near_right, far_right, green_right) = sides
    rng = np.random.default_rng((world.seed, _GROUND))
    ground = _ground(world, rng, np.stack((green_left, green_right)))
    return Scene((near_left, near_right), (far_left, far_right), ground)


def park_cars(near: Surface, per_km: float, rng: np.random.Generator) -> Surface:
    """Put parked cars along a near wall; the wall itself stays as it was."""
    wall = Surface(near.reflectance.copy(), near.cover.copy())
    length_m = wall.cover.shape[1] * COLUMN_M
    for start in rng.uniform(0, length_m - 5, rng.poisson(per_km * length_m / 1000)):
        body, length = rng.choice((0.05, 0.12, 0.3, 0.6, 0.8)), rng.uniform(3.6, 4.8)
        roof = rng.uniform(1.35, 1.6)
        box(wall, start, start + length, 0.25, 0.9, body, NEAR_ROW_M)
        box(wall, start + 0.9, start + length - 0.7, 0.9, roof, body, NEAR_ROW_M)
        box(wall, start + 1.1, start + length / 2 - 0.1, 0.95, roof - 0.12, 0.06, NEAR_ROW_M)
        box(wall, start + length / 2, start + length - 0.9, 0.95, roof - 0.12, 0.06, NEAR_ROW_M)
        for wheel in (start + 0.5, start + length - 1.1):
            box(wall, wheel, wheel + 0.6, 0.0, 0.55, 0.03, NEAR_ROW_M)
    return wall


Mask = npt.NDArray[np.bool_]


def _side(world: World, rng: np.random.Generator) -> tuple[Surface, Surface, Mask]:
    """Paint both walls of one side, district by district; return the columns with grass."""
    green = np.zeros(world.columns, np.bool_)
    near, far = (
        Surface(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
        for shape in (
            (int(NEAR_TOP_M / NEAR_ROW_M), world.columns),
            (int(FAR_TOP_M / FAR_ROW_M), world.columns),
        )
    )
    grain = noise_2d(rng, far.cover.shape, (2, 2)), noise_2d(rng, far.cover.shape, (8, 9))
    leaves = noise_2d(rng, near.cover.shape, (3, 3)), noise_2d(rng, near.cover.shape, (9, 8))
    start, end, kind = 0.0, world.columns * COLUMN_M, ""
    while start < end:
        kind = str(rng.choice([name for name in FAR_PAINTERS if name != kind]))
        stop = min(start + rng.uniform(50, 130), end)
        FAR_PAINTERS[kind](far, start, stop, rng, grain)
        NEAR_PAINTERS[kind](near, start, stop, rng, leaves)
        green[int(start / COLUMN_M) : int(stop / COLUMN_M)] = kind in GREEN
        start = stop
    return near, far, green


def _ground(world: World, rng: np.random.Generator, green: Mask) -> Surface:
    """Paint asphalt with lane marks, patches, kerbs and crossings; slabs or grass beside it.

    `green` has the shape (2, columns): left and right.
    """
    rows = int(2 * FAR_M / GROUND_ROW_M)
    shape = (rows, world.columns)
    x = (np.arange(rows) + 0.5) * GROUND_ROW_M - FAR_M
    s = np.arange(world.columns) * COLUMN_M
    value = np.full(shape, 0.2, np.float32)
    fine = noise_2d(rng, shape, (2, 2))
    value *= np.exp(0.1 * fine + 0.1 * noise_2d(rng, shape, (12, 60)))
    beside = np.abs(x) > 3.0
    slabs = np.where((s % 1.5 < 0.1)[None, :] | (np.abs(x) % 1.2 < 0.08)[:, None], 0.22, 0.38)
    grass = 0.25 * np.exp(0.25 * fine + 0.3 * noise_2d(rng, shape, (6, 9)))
    strip = np.where(green[(x > 0).astype(np.int64)], grass, slabs * np.exp(0.05 * fine))
    value[beside] = strip[beside]
    for at in rng.uniform(0, s[-1], rng.poisson(s[-1] / 25)):  # mended places
        columns = slice(int(at / COLUMN_M), int((at + rng.uniform(1, 6)) / COLUMN_M))
        left = int(rng.integers(0, rows - 30))
        inside = np.zeros(rows, bool)
        inside[left : left + int(rng.integers(8, 30))] = True
        value[np.flatnonzero(inside & ~beside), columns] *= rng.uniform(0.6, 1.4)
    value[np.ix_(np.abs(x) < 0.08, s % 9 < 3)] = 0.7
    value[np.abs(np.abs(x) - 3.05) < 0.07] = 0.5
    for at in rng.uniform(0, s[-1], rng.poisson(s[-1] / 150)):  # zebra crossings
        columns = slice(int(at / COLUMN_M), int((at + 3) / COLUMN_M))
        value[np.flatnonzero((np.abs(x) < 3) & (x % 1.0 < 0.5)), columns] = 0.7
    return Surface(value, np.ones(shape, np.float32))
