"""The world: a straight street between painted surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError


def check_range(
    record: object, names: Sequence[str], remedy: str, least: float = 0, most: float = inf
) -> None:
    """Raise UsageError with a remedy unless each of some attributes lies in a range."""
    for name in names:
        value = getattr(record, name)
        if not least <= value <= most:
            raise UsageError(f"{name} is {value}: {remedy}")


# A painted surface along the route, and the sizes that all of them share.


NEAR_M, FAR_M = 3.6, 8.0  # distance of the walls from the middle of the road
NEAR_TOP_M, FAR_TOP_M = 6.0, 14.0
VIEW_M = 100.0  # nothing is visible beyond
COLUMN_M = 0.1
NEAR_ROW_M, FAR_ROW_M, GROUND_ROW_M = 0.08, 0.1, 0.08


Plane = npt.NDArray[np.float32]


class Surface(NamedTuple):
    """One painted wall or ground: rows upwards or to the right, columns along the route."""

    reflectance: Plane  #: Share of the light that comes back, 0 to 1.
    cover: Plane  #: 1 where something stands, 0 where one sees through.


def box(
    wall: Surface, s0: float, s1: float, y0: float, y1: float, value: float, row_m: float
) -> None:
    """Fill a rectangle given in metres."""
    rows = slice(max(round(y0 / row_m), 0), max(round(y1 / row_m), 0))
    columns = slice(max(round(s0 / COLUMN_M), 0), max(round(s1 / COLUMN_M), 0))
    wall.reflectance[rows, columns] = value
    wall.cover[rows, columns] = 1.0


# Value noise: random values on a lattice, smoothly joined.


Floats = npt.NDArray[np.float64]


def _lattice(at: Floats, cell: float) -> tuple[npt.NDArray[np.int64], Floats]:
    scaled = at / cell
    low = np.floor(scaled).astype(np.int64)
    share = scaled - low
    return low, share * share * (3 - 2 * share)


def noise_1d(rng: np.random.Generator, at: Floats, cell: float) -> Floats:
    """Return smooth noise over a line.

    Parameters
    ----------
    at : ndarray of float64, shape (n,)
        Where, 0 or more.
    cell : float
        Distance of the lattice, in the unit of `at`.

    Returns
    -------
    ndarray of float64, shape (n,)
        From -1 to 1.
    """
    low, share = _lattice(at, cell)
    knots = rng.uniform(-1, 1, int(low.max(initial=0)) + 2)
    return knots[low] + share * (knots[low + 1] - knots[low])


def noise_2d(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[float, float]
) -> npt.NDArray[np.float32]:
    """Return smooth noise over an image.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    cells : tuple of float
        Distance of the lattice in rows and in columns, at least 1 each.

    Returns
    -------
    ndarray of float32, shape `shape`
        From -1 to 1.
    """
    row, row_share = _lattice(np.arange(shape[0], dtype=np.float64), cells[0])
    column, column_share = _lattice(np.arange(shape[1], dtype=np.float64), cells[1])
    knots = rng.uniform(-1, 1, (int(row[-1]) + 2, int(column[-1]) + 2)).astype(np.float32)
    across = knots[:, column] + column_share.astype(np.float32) * (
        knots[:, column + 1] - knots[:, column]
    )
    return across[row] + row_share.astype(np.float32)[:, None] * (across[row + 1] - across[row])


# Districts along the route (town, park, open field, works), each with a near and a far wall.


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


# The world: a straight street between painted surfaces, from which five textures are made.
#
# A wall close to the road on each side (trees, hedges, poles, fences, parked cars) stands before
# one further off (buildings, woods, bare sheds), so that the near hides the far and moves faster.
# The ground lies between the far walls. Each side passes through districts of its own, so that the
# amount of texture changes along the route. Nothing is copied from photographs: rectangles, blobs
# and value noise.


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
