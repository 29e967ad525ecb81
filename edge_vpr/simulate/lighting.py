"""Lighting of the painted world, and the packed textures for the renderer."""

from __future__ import annotations

from math import cos, radians, sin, tan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.simulate.drive import Light
from edge_vpr.simulate.surface import (
    COLUMN_M,
    FAR_M,
    FAR_ROW_M,
    GROUND_ROW_M,
    NEAR_M,
    NEAR_ROW_M,
    Plane,
)
from edge_vpr.simulate.world import Scene

LEVELS = 7  # the coarsest texel is 6.4 m long, about what a pixel sees at 100 m


class Textures(NamedTuple):
    """All surfaces as the camera needs them, coarser and coarser along the route.

    Texel ``(row, column)`` of a surface's level is the pair
    ``texels[start[surface, level] + 2 * (row * columns[level] + column) + (0 or 1)]``: the light
    that it sends out, already multiplied by its cover, and its cover; 255 is full. A texel of
    level k is ``COLUMN_M * 2**k`` long. Surfaces: near left, near right, far left, far right,
    ground.
    """

    texels: npt.NDArray[np.uint8]
    start: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]


def illuminate(scene: Scene, light: Light) -> Textures:
    """Compute the lit textures of a scene."""
    azimuth, elevation = radians(light.azimuth_deg), radians(light.elevation_deg)
    # of a surface: the cosine between its normal and the sun; a wall on the left faces right
    right = sin(azimuth) * cos(elevation)
    on_left, on_right = (light.ambient + light.sun * max(side, 0.0) for side in (right, -right))
    lit = [
        (scene.near[0].reflectance * np.float32(on_left), scene.near[0].cover),
        (scene.near[1].reflectance * np.float32(on_right), scene.near[1].cover),
        (scene.far[0].reflectance * np.float32(on_left), scene.far[0].cover),
        (scene.far[1].reflectance * np.float32(on_right), scene.far[1].cover),
    ]
    sunlit = 1.0 - _shadow(scene, light)
    on_ground = np.float32(light.ambient) + np.float32(light.sun * sin(elevation)) * sunlit
    lit.append((scene.ground.reflectance * on_ground, scene.ground.cover))
    return _pack(lit)


def _shadow(scene: Scene, light: Light) -> Plane:
    """Return the share of the sun that the walls take from each point of the ground."""
    azimuth, elevation = radians(light.azimuth_deg), radians(light.elevation_deg)
    rows, columns = scene.ground.cover.shape
    shadow = np.zeros((rows, columns), np.float32)
    across = sin(azimuth)
    if abs(across) < 0.02 or light.elevation_deg > 89:
        return shadow
    side = int(across > 0)
    sign = 1.0 if side else -1.0
    for row in range(rows):
        x = (row + 0.5) * GROUND_ROW_M - FAR_M
        for wall, wall_m, row_m in (
            (scene.near[side], NEAR_M, NEAR_ROW_M),
            (scene.far[side], FAR_M, FAR_ROW_M),
        ):
            path = (sign * wall_m - x) / across
            if path <= 0:  # the wall stands behind this point
                continue
            height_row = int(path * tan(elevation) / row_m)
            if height_row >= wall.cover.shape[0]:
                continue
            cover = wall.cover[height_row]
            ahead = round(path * cos(azimuth) / COLUMN_M)
            if abs(ahead) >= columns:
                continue
            if ahead >= 0:
                shifted = cover[ahead:]
                shadow[row, : shifted.size] = np.maximum(shadow[row, : shifted.size], shifted)
            else:
                shifted = cover[:ahead]
                shadow[row, -ahead:] = np.maximum(shadow[row, -ahead:], shifted)
    return shadow


def _pack(lit: list[tuple[Plane, Plane]]) -> Textures:
    columns = [lit[0][1].shape[1]]
    for _ in range(1, LEVELS):
        columns.append((columns[-1] + 1) // 2)
    start = np.zeros((len(lit), LEVELS), np.int64)
    parts: list[npt.NDArray[np.uint8]] = []
    at = 0
    for surface, (radiance, cover) in enumerate(lit):
        pair = np.stack((np.minimum(radiance, 1.0) * cover, cover), axis=-1)
        for level in range(LEVELS):
            part = np.rint(pair * 255).astype(np.uint8).reshape(-1)
            start[surface, level] = at
            at += part.size
            parts.append(part)
            if pair.shape[1] % 2:
                pair = np.concatenate((pair, pair[:, -1:]), axis=1)
            pair = (pair[:, 0::2] + pair[:, 1::2]) * np.float32(0.5)
    return Textures(np.concatenate(parts), start, np.array(columns, np.int64))
