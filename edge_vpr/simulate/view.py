"""Rendering of the view from a place on the route.

The street is straight and its surfaces are planes along it, so that the ray of one pixel always
meets a surface at the same height and the same distance ahead: all that changes while the camera
moves is the column of the texture. These constants are computed once for a drive. A frame then
takes one linear interpolation for each surface and pixel.
"""

from __future__ import annotations

from math import cos, radians, sin, tan
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.simulate.camera import Camera
from edge_vpr.simulate.drive import Drive
from edge_vpr.simulate.lighting import LEVELS, Textures
from edge_vpr.simulate.surface import (
    COLUMN_M,
    FAR_M,
    FAR_ROW_M,
    FAR_TOP_M,
    GROUND_ROW_M,
    NEAR_M,
    NEAR_ROW_M,
    NEAR_TOP_M,
    VIEW_M,
)
from edge_vpr.simulate.texture import noise_2d

CAMERA_M = 1.4  # height of the camera over the road
LANE_M = -1.3  # the vehicle keeps left, as in Brisbane
BONNET_DEG = 27.0  # what lies further below the horizon is the vehicle's own bonnet
SURFACES = 3  # a ray meets a near wall, a far wall and the ground at most
MARGIN_PX = 4  # of a 128 pixel wide sensor: the shaking image is cut from a larger one


class View:
    """The camera of one drive, looking ahead.

    Parameters
    ----------
    camera : Camera
    drive : Drive
        Its mounting and its place in the lane.
    textures : Textures

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of a frame: the sensor and a margin on every side.
    margin : int
        Width of that margin in pixels.
    fixed : ndarray of float32, shape (height, width)
        Light of what moves with the camera, its vehicle's bonnet; 0 where one sees past it.
    """

    def __init__(self, camera: Camera, drive: Drive, textures: Textures) -> None:
        self.focal = camera.focal_px
        self.margin = int(np.ceil(MARGIN_PX * camera.sensor.width / 128))
        self.shape = (camera.sensor.height + 2 * self.margin, camera.sensor.width + 2 * self.margin)
        self.lane_m = LANE_M + drive.lateral_m
        self.turn = _rotation(drive)
        rows, columns = np.indices(self.shape)
        ray = np.stack(
            (
                (columns - (self.shape[1] - 1) / 2) / self.focal,
                (rows - (self.shape[0] - 1) / 2) / self.focal,
                np.ones(self.shape),
            ),
            axis=-1,
        )
        ray = ray @ self.turn.T
        # how far to the right and downwards the ray goes for each metre ahead
        self.across = np.ascontiguousarray(ray[..., 0] / ray[..., 2])
        self.down = np.ascontiguousarray(ray[..., 1] / ray[..., 2])
        bonnet = self.down - 0.1 * self.across**2 - tan(radians(BONNET_DEG))
        inner = np.s_[self.margin : -self.margin, self.margin : -self.margin]
        self.fixed = np.where(bonnet > 0, 0.12 + 0.05 * self.down, 0).astype(np.float32)[inner]
        # the street is drawn some way under the bonnet, which does not shake with it
        self._hidden = bonnet > self.margin / self.focal
        self._texels = textures.texels
        self._texel_m = COLUMN_M * 2.0 ** np.arange(LEVELS)
        self._meet(textures)
        self._behind = self._backdrop(camera)

    def render(self, position_m: npt.NDArray[np.float64], frames: npt.NDArray[np.float32]) -> None:
        """Draw the world without its traffic.

        Parameters
        ----------
        position_m : ndarray of float64, shape (n,)
            Places on the route. Several at once are faster: neighbours need the same texels.
        frames : ndarray of float32, shape (n, *shape)
            Is overwritten with the light of each pixel, 1 for white in full light.
        """
        flat = frames.reshape(len(frames), -1)
        flat[:] = self._behind
        columns = position_m[:, None] / self._texel_m
        whole = np.floor(columns)
        _render(
            self._texels, self._pixels, self._start, self._level, self._share,
            2 * whole.astype(np.int64), (columns - whole).astype(np.float32), flat,
        )  # fmt: skip

    def _meet(self, textures: Textures) -> None:
        """Find where each ray meets the surfaces, nearest first."""
        across, down = self.across.reshape(-1), self.down.reshape(-1)
        n = across.size
        # a surface that is not met has start -1 and ends the ray's list
        self._start = np.full((n, SURFACES), -1, np.int64)
        self._level = np.zeros((n, SURFACES), np.uint8)
        self._share = np.zeros((n, SURFACES), np.float32)
        used = np.zeros(n, np.int64)
        seen = ~self._hidden.reshape(-1)
        right = (across > 0).astype(np.int64)
        with np.errstate(divide="ignore", invalid="ignore"):
            ground_z = np.where(down > 0, CAMERA_M / down, np.inf)
            for number, wall_m, top_m, row_m in (
                (0, NEAR_M, NEAR_TOP_M, NEAR_ROW_M),
                (2, FAR_M, FAR_TOP_M, FAR_ROW_M),
            ):
                z = (np.where(right == 1, wall_m, -wall_m) - self.lane_m) / across
                height = CAMERA_M - z * down
                met = seen & (z < VIEW_M) & (height >= 0) & (height < top_m)
                distance = np.abs(np.where(right == 1, wall_m, -wall_m) - self.lane_m)
                self._add(textures, used, met, number + right, height / row_m, z, distance)
            x = self.lane_m + ground_z * across
            met = seen & (ground_z < VIEW_M) & (np.abs(x) < FAR_M)
            self._add(
                textures, used, met, np.full(n, 4), (x + FAR_M) / GROUND_ROW_M, ground_z,
                np.full(n, CAMERA_M),
            )  # fmt: skip
        # rays that meet nothing show the backdrop and are never drawn again
        self._pixels = np.flatnonzero(used)
        self._start = self._start[self._pixels]
        self._level = self._level[self._pixels]
        self._share = self._share[self._pixels]

    def _add(
        self,
        textures: Textures,
        used: npt.NDArray[np.int64],
        met: npt.NDArray[np.bool_],
        surface: npt.NDArray[np.int64],
        row: npt.NDArray[np.float64],
        z: npt.NDArray[np.float64],
        distance: npt.NDArray[np.float64],
    ) -> None:
        """Add a surface to the rays that meet it `z` metres ahead."""
        i = np.flatnonzero(met)
        # the length along the route that one pixel covers, and the level whose texel is as long
        covers = z[i] ** 2 / (self.focal * distance[i])
        level = np.clip(np.rint(np.log2(covers / COLUMN_M)), 0, LEVELS - 1).astype(np.int64)
        # the value of a texel is that of its middle
        column = np.maximum(z[i] / self._texel_m[level] - 0.5, 0.0)
        slot = used[i]
        self._start[i, slot] = textures.start[surface[i], level] + 2 * (
            row[i].astype(np.int64) * textures.columns[level] + column.astype(np.int64)
        )
        self._level[i, slot] = level
        self._share[i, slot] = column % 1
        used[i] += 1

    def _backdrop(self, camera: Camera) -> npt.NDArray[np.float32]:
        """Light from behind all surfaces: a sky with clouds, and haze at the horizon."""
        cell = max(camera.sensor.width / 6, 2.0)
        clouds = noise_2d(np.random.default_rng(0), self.shape, (cell / 2, cell))
        sky = 0.85 + 0.1 * clouds - 0.25 * np.clip(self.down + 0.05, -0.5, 0.0)
        return np.asarray(sky, np.float32).reshape(-1)


def _rotation(drive: Drive) -> npt.NDArray[np.float64]:
    """Rotation from the camera's axes (right, down, ahead) to those of the street."""
    yaw, pitch, roll = (radians(a) for a in (drive.yaw_deg, drive.pitch_deg, drive.roll_deg))
    about_down = np.array([[cos(yaw), 0, sin(yaw)], [0, 1, 0], [-sin(yaw), 0, cos(yaw)]])
    about_right = np.array([[1, 0, 0], [0, cos(pitch), sin(pitch)], [0, -sin(pitch), cos(pitch)]])
    about_ahead = np.array([[cos(roll), -sin(roll), 0], [sin(roll), cos(roll), 0], [0, 0, 1]])
    return np.asarray(about_down @ about_right @ about_ahead)


@kernel
def _render(
    texels: Any, pixels: Any, start: Any, level: Any, share: Any, whole_at: Any, share_at: Any,
    frames: Any,
) -> None:  # fmt: skip
    one, full = np.float32(1.0), np.float32(1 / 255)
    for i in range(pixels.size):
        for n in range(frames.shape[0]):
            light, through = np.float32(0.0), one
            for k in range(start.shape[1]):
                at = start[i, k]
                if at < 0:
                    break
                at += whole_at[n, level[i, k]]
                part = share[i, k] + share_at[n, level[i, k]]
                if part >= one:
                    part -= one
                    at += 2
                here, there = np.float32(texels[at]), np.float32(texels[at + 2])
                light += through * (here + part * (there - here))
                here, there = np.float32(texels[at + 1]), np.float32(texels[at + 3])
                through *= one - (here + part * (there - here)) * full
                if through < np.float32(1e-3):
                    break
            frames[n, pixels[i]] = light * full + through * frames[n, pixels[i]]


@kernel
def cut(
    frame: Any, margin: int, right: float, down: float, fixed: Any, veil: float, image: Any
) -> None:
    """Cut the shaken image out of the frame, and lay over it what moves with the camera.

    Parameters
    ----------
    frame : ndarray of float32, shape (height + 2 * margin, width + 2 * margin)
    margin : int
    right, down : float
        Shift of the image in pixels, less than `margin` in size.
    fixed : ndarray of float32, shape (height, width)
        Light that takes the place of the image where it is not 0.
    veil : float
        Glare and dark current, which add to the light of every pixel.
    image : ndarray of float32, shape (height, width)
        Is overwritten.
    """
    top, left = int(np.floor(margin - down)), int(np.floor(margin - right))
    low, aside = np.float32(margin - down - top), np.float32(margin - right - left)
    high, near = np.float32(1.0) - low, np.float32(1.0) - aside
    a, b, c, d = high * near, high * aside, low * near, low * aside
    offset = np.float32(veil)
    for row in range(image.shape[0]):
        above, below = frame[top + row, left:], frame[top + row + 1, left:]
        front, out = fixed[row], image[row]
        for column in range(out.size):
            street = (
                a * above[column]
                + b * above[column + 1]
                + c * below[column]
                + d * below[column + 1]
            )
            out[column] = (street if front[column] == 0 else front[column]) + offset
