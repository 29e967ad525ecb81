"""A painted surface along the route, and the sizes that all of them share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

NEAR_M, FAR_M = 3.6, 8.0  # distance of the walls from the middle of the road
NEAR_TOP_M, FAR_TOP_M = 6.0, 14.0
VIEW_M = 100.0  # nothing is visible beyond
COLUMN_M = 0.1
NEAR_ROW_M, FAR_ROW_M, GROUND_ROW_M = 0.08, 0.1, 0.08


Plane = npt.NDArray[np.float32]


class Surface(NamedTuple):
    """One painted wall or ground: rows upwards or to the right, columns along the route."""

    reflectance: Plane
    """Share of the light that comes back, 0 to 1."""
    cover: Plane
    """1 where something stands, 0 where one sees through."""


def box(
    wall: Surface, s0: float, s1: float, y0: float, y1: float, value: float, row_m: float
) -> None:
    """Fill a rectangle given in metres."""
    rows = slice(max(round(y0 / row_m), 0), max(round(y1 / row_m), 0))
    columns = slice(max(round(s0 / COLUMN_M), 0), max(round(s1 / COLUMN_M), 0))
    wall.reflectance[rows, columns] = value
    wall.cover[rows, columns] = 1.0
