"""The simulated camera: its lens and noise, the light, the view of the street, and traffic."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, radians, sin, tan
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.events import Sensor
from edge_vpr.simulation.drive import Drive, Light, Motion
from edge_vpr.simulation.pixel_model import NoiseEvents
from edge_vpr.simulation.world import (
    COLUMN_M,
    FAR_M,
    FAR_ROW_M,
    FAR_TOP_M,
    GROUND_ROW_M,
    NEAR_M,
    NEAR_ROW_M,
    NEAR_TOP_M,
    VIEW_M,
    Plane,
    Scene,
    check_range,
    noise_2d,
)

# The simulated camera: its size, its lens, and the imperfections of its pixels.


_THRESHOLDS, _HOT = 1, 2  # one random stream each, so that one setting does not disturb the other


@dataclass(frozen=True)
class Camera:
    """An event camera.

    The defaults lie in the published range for such sensors; they are not those of a certain
    device.

    Parameters
    ----------
    sensor : Sensor
        Size in pixels.
    field_of_view_deg : float
        Horizontal angle that the lens sees, in degrees.
    contrast_on, contrast_off : float
        Change of the natural logarithm of the light that makes an ON or an OFF event.
    contrast_spread : float
        Standard deviation of both from pixel to pixel, in the same unit. It is a property of the
        device: every drive with this camera and seed meets the same thresholds.
    refractory_us : int
        Time after an event during which its pixel is blind, in microseconds.
    dark : float
        Dark current as a share of the light of a white surface: lowers contrast in the dark.
    noise_hz : float
        Background activity of each pixel, in events per second.
    hot_pixels : int
        Number of pixels that fire by themselves.
    hot_hz : float
        Mean rate of a hot pixel, in events per second; theirs spread around it by a factor of 3.
    bursts_per_minute : float
        Mean number of bursts, in which most pixels fire within a few milliseconds, as a DAVIS does
        when sunlight reaches its bias generator.
    burst_us : int
        Length of a burst, in microseconds.
    burst_share : float
        Share of the pixels that fire in a burst.
    """

    sensor: Sensor = field(default=Sensor(128, 128))
    field_of_view_deg: float = 75.0
    contrast_on: float = 0.25
    contrast_off: float = 0.25
    contrast_spread: float = 0.03
    refractory_us: int = 500
    dark: float = 0.01
    noise_hz: float = 0.1
    hot_pixels: int = 6
    hot_hz: float = 150.0
    bursts_per_minute: float = 1.0
    burst_us: int = 3000
    burst_share: float = 0.8

    def __post_init__(self) -> None:
        contrasts = ("contrast_on", "contrast_off")
        check_range(self, contrasts, "name a contrast of at least 0.02, for example 0.25", 0.02)
        check_range(self, ("field_of_view_deg",), "name an angle from 5 to 140", 5, 140)
        most = self.sensor.pixels
        check_range(self, ("hot_pixels",), f"a {self.sensor} sensor has 0 to {most}", 0, most)
        check_range(self, ("burst_share",), "name a share from 0 to 1", 0, 1)
        others = (
            "contrast_spread", "refractory_us", "dark", "noise_hz", "hot_hz", "bursts_per_minute",
            "burst_us",
        )  # fmt: skip
        check_range(self, others, "name 0 or more")

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.sensor.width / 2 / tan(radians(self.field_of_view_deg) / 2)

    def thresholds(self, seed: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Draw the ON and the OFF threshold of each pixel.

        Parameters
        ----------
        seed : int
            Which device of this kind.

        Returns
        -------
        on, off : ndarray of float64, shape (pixels,)
            In row-major order; never below a tenth of the nominal contrast.
        """
        rng = np.random.default_rng((seed, _THRESHOLDS))
        spread = rng.normal(0.0, self.contrast_spread, (2, self.sensor.pixels))
        on, off = (
            np.maximum(nominal + deviation, nominal / 10)
            for nominal, deviation in zip(
                (self.contrast_on, self.contrast_off), spread, strict=True
            )
        )
        return on, off

    def noise_rates(self, seed: int) -> npt.NDArray[np.float64]:
        """Draw the noise rate of each pixel.

        Parameters
        ----------
        seed : int
            Which device of this kind.

        Returns
        -------
        ndarray of float64, shape (pixels,)
            Events per second, in row-major order.
        """
        rng = np.random.default_rng((seed, _HOT))
        rates = np.full(self.sensor.pixels, float(self.noise_hz))
        hot = rng.choice(self.sensor.pixels, self.hot_pixels, replace=False)
        rates[hot] += self.hot_hz * 3.0 ** rng.uniform(-1, 1, self.hot_pixels)
        return rates


#: Cameras by name.
CAMERAS = {
    "default": Camera(),
    "tiny": Camera(sensor=Sensor(32, 32), hot_pixels=1),
    "davis346": Camera(
        sensor=Sensor(346, 260),
        contrast_on=0.22,
        contrast_off=0.22,
        refractory_us=300,
        noise_hz=0.1,
        hot_pixels=25,
        bursts_per_minute=2.0,
    ),
    "speck": Camera(
        field_of_view_deg=70.0,
        contrast_on=0.3,
        contrast_off=0.3,
        contrast_spread=0.05,
        refractory_us=1000,
        noise_hz=0.3,
        hot_pixels=20,
        bursts_per_minute=0.0,
    ),
}


# Noise events: background activity, hot pixels and bursts.


_BURSTS, _BACKGROUND, _BURST = 3, 4, 5  # one random stream each


class Noise:
    """Noise of one camera during one drive.

    The noise of a period of time depends only on the seed and on the number of the period.

    Parameters
    ----------
    seed : int
        Seed of the drive.
    device : int
        Seed of the camera: which of its pixels are hot.
    duration_us : int
        Length of the drive.
    """

    def __init__(self, camera: Camera, *, seed: int, device: int, duration_us: int) -> None:
        self._camera = camera
        self._seed = seed
        self._cumulative = np.cumsum(camera.noise_rates(device))
        rng = np.random.default_rng((seed, _BURSTS))
        bursts = rng.poisson(camera.bursts_per_minute * duration_us / 60e6)
        self.burst_us = np.sort(rng.integers(0, max(duration_us, 1), bursts))

    def between(self, number: int, start_us: int, stop_us: int) -> NoiseEvents:
        """Return the noise of the stretch with this number, ``start_us <= t < stop_us``.

        A burst belongs to the stretch in which it begins, and is cut off at its end.
        """
        seconds = (stop_us - start_us) / 1e6
        rng = np.random.default_rng((self._seed, _BACKGROUND, number))
        total = self._cumulative[-1]
        n = rng.poisson(total * seconds) if total > 0 else 0
        # a rounding error can lift the draw to the total itself, which is past the last pixel
        drawn = np.searchsorted(self._cumulative, rng.random(n) * total, side="right")
        times = [rng.integers(start_us, max(stop_us, start_us + 1), n)]
        pixels = [np.minimum(drawn, self._cumulative.size - 1)]
        polarities = [rng.random(n) < 0.5]
        for index in np.flatnonzero((self.burst_us >= start_us) & (self.burst_us < stop_us)):
            rng = np.random.default_rng((self._seed, _BURST, int(index)))
            fires = np.flatnonzero(rng.random(self._cumulative.size) < self._camera.burst_share)
            when = self.burst_us[index] + rng.integers(0, self._camera.burst_us + 1, fires.size)
            times.append(np.minimum(when, stop_us - 1))
            pixels.append(fires)
            polarities.append(rng.random(fires.size) < 0.5)
        return np.concatenate(times), np.concatenate(pixels), np.concatenate(polarities)


# Lighting of the painted world, and the packed textures for the renderer.


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


# Rendering of the view from a place on the route.
#
# The street is straight and its surfaces are planes along it, so that the ray of one pixel always
# meets a surface at the same height and the same distance ahead: all that changes while the camera
# moves is the column of the texture. These constants are computed once for a drive. A frame then
# takes one linear interpolation for each surface and pixel.


CAMERA_M = 1.4  # height of the camera over the road
LANE_M = -1.3  # the vehicle keeps left, as in Brisbane
BONNET_DEG = 27.0  # what lies further below the horizon is the vehicle's own bonnet
SURFACES = 3  # a ray meets a near wall, a far wall and the ground at most
MARGIN_PX = 4  # of a 128 pixel wide sensor: the shaking image is cut from a larger one


class View:
    """The camera of one drive, looking ahead.

    Parameters
    ----------
    drive : Drive
        Its mounting and its place in the lane.

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
        # the street is drawn some distance under the bonnet, which does not shake with it
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
                aside = np.where(right == 1, wall_m, -wall_m) - self.lane_m
                z = aside / across
                height = CAMERA_M - z * down
                met = seen & (z < VIEW_M) & (height >= 0) & (height < top_m)
                self._add(textures, used, met, number + right, height / row_m, z, np.abs(aside))
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
        """Return the light from behind all surfaces: a sky with clouds, haze at the horizon."""
        cell = max(camera.sensor.width / 6, 2.0)
        clouds = noise_2d(np.random.default_rng(0), self.shape, (cell / 2, cell))
        sky = 0.85 + 0.1 * clouds - 0.25 * np.clip(self.down + 0.05, -0.5, 0.0)
        return np.asarray(sky, np.float32).reshape(-1)


def _rotation(drive: Drive) -> npt.NDArray[np.float64]:
    """Return the rotation from the camera's axes (right, down, ahead) to those of the street."""
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
        Image with room for the shift on each side.
    margin : int
        Pixels of that room.
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


# Moving objects: oncoming cars, cars ahead, cyclists, people who cross the road.


_TRAFFIC = 31
NEAREST_M, FURTHEST_M = 2.5, 60.0


class Mover(NamedTuple):
    """A flat figure that faces the camera and moves at constant velocity."""

    #: Light and cover, shape (rows from below, columns, 2), transparent at its rim.
    picture: npt.NDArray[np.float32]
    width_m: float
    height_m: float
    position_m: float  #: Place on the route at time 0.
    speed_mps: float
    x_m: float  #: Place across the road at time 0; positive is right.
    x_mps: float


def traffic(drive: Drive, motion: Motion, seed: int) -> list[Mover]:
    """Draw the moving objects of a drive at random.

    Parameters
    ----------
    motion : Motion
        When the camera is where: each mover is placed so that it is met.
    """
    rng = np.random.default_rng((seed, _TRAFFIC))
    length_m = float(motion.position_m[-1])
    movers = []
    for at in rng.uniform(0, length_m, rng.poisson(drive.traffic_per_km * length_m / 1000)):
        met_s = float(np.interp(at, motion.position_m, motion.time_us)) / 1e6
        kind = rng.choice(("oncoming", "ahead", "crossing", "cyclist"), p=(0.45, 0.15, 0.25, 0.15))
        x, x_mps = 1.5, 0.0
        if kind == "oncoming":
            picture, width, height = _car(rng), 1.8, 1.5
            speed, ahead = -rng.uniform(5, 12), 0.0
        elif kind == "ahead":  # pulls in before the camera and draws away from it
            picture, width, height = _car(rng), 1.8, 1.5
            speed, ahead, x = drive.speed_mps * rng.uniform(1.0, 1.3), rng.uniform(6, 15), -1.3
        elif kind == "crossing":
            picture, width, height = _figure(rng), 0.6, 1.75
            speed, ahead = 0.0, rng.uniform(4, 12)
            x_mps = rng.uniform(0.9, 1.8) * rng.choice((-1, 1))
            x = 0.0
        else:
            picture, width, height = _figure(rng), 0.7, 1.8
            speed, ahead, x = rng.uniform(2, 5), 5.0, -3.0
        position = at + ahead - speed * met_s
        movers.append(
            Mover(picture, width, height, position, float(speed), x - x_mps * met_s, float(x_mps))
        )
    return movers


def _car(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    body = rng.choice((0.05, 0.1, 0.25, 0.5, 0.8))
    picture = np.zeros((17, 20, 2), np.float32)
    picture[1:11, 1:-1] = body, 1
    picture[11:16, 3:-3] = 0.6 * body, 1
    picture[11:15, 4:-4] = 0.06, 1
    picture[6:8, 2:5] = picture[6:8, -5:-2] = 0.9, 1
    picture[1:3, 1:-1] = 0.03, 1
    picture[4:6, 8:-8] = 0.6, 1
    return _premultiplied(picture)


def _figure(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    picture = np.zeros((20, 9, 2), np.float32)
    picture[1:9, 2:4] = picture[1:9, 5:7] = rng.uniform(0.04, 0.2), 1
    picture[9:16, 1:8] = rng.uniform(0.05, 0.8), 1
    picture[16:19, 3:6] = rng.uniform(0.15, 0.4), 1
    picture[..., 0] *= 1 + 0.3 * noise_2d(rng, (20, 9), (2, 2))
    return _premultiplied(picture)


def _premultiplied(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    picture[..., 0] *= picture[..., 1]
    return picture


def paint_traffic(
    movers: list[Mover], view: View, time_us: int, position_m: float, frame: npt.NDArray[np.float32]
) -> None:
    """Paint the visible objects over a frame of the street, the farthest first.

    Parameters
    ----------
    position_m : float
        Place of the camera.
    frame : ndarray of float32, shape of the view
        Is drawn upon.
    """
    seconds = time_us / 1e6
    seen = []
    for mover in movers:
        ahead = mover.position_m + mover.speed_mps * seconds - position_m
        x = mover.x_m + mover.x_mps * seconds - view.lane_m
        if NEAREST_M < ahead < FURTHEST_M and abs(x) < 5.0:
            seen.append((ahead, x, mover))
    for ahead, x, mover in sorted(seen, key=lambda item: -item[0]):
        corners = np.array(
            [
                (x + side * mover.width_m / 2, CAMERA_M - height, ahead)
                for side in (-1, 1)
                for height in (0.0, mover.height_m)
            ]
        )
        # from the street's axes to the camera's, then through the pinhole
        seen_at = corners @ view.turn
        columns = seen_at[:, 0] / seen_at[:, 2] * view.focal + (view.shape[1] - 1) / 2
        rows = seen_at[:, 1] / seen_at[:, 2] * view.focal + (view.shape[0] - 1) / 2
        top, bottom = max(int(rows.min()) - 1, 0), min(int(rows.max()) + 2, view.shape[0])
        left, right = max(int(columns.min()) - 1, 0), min(int(columns.max()) + 2, view.shape[1])
        if top < bottom and left < right:
            seen_part = np.s_[top:bottom, left:right]
            _paint(
                mover.picture, mover.width_m, mover.height_m, x, ahead,
                view.across[seen_part], view.down[seen_part], frame[seen_part],
            )  # fmt: skip


@kernel
def _paint(
    picture: Any, width: float, height: float, x: float, ahead: float, across: Any, down: Any,
    frame: Any,
) -> None:  # fmt: skip
    rows, columns = picture.shape[0], picture.shape[1]
    for r in range(frame.shape[0]):
        for c in range(frame.shape[1]):
            column = ((ahead * across[r, c] - x) / width + 0.5) * columns - 0.5
            row = (CAMERA_M - ahead * down[r, c]) / height * rows - 0.5
            if not (0 <= column < columns - 1 and 0 <= row < rows - 1):
                continue
            i, j = int(row), int(column)
            u, v = np.float32(row - i), np.float32(column - j)
            one = np.float32(1.0)
            a, b, d, e = (one - u) * (one - v), (one - u) * v, u * (one - v), u * v
            light = (
                a * picture[i, j, 0]
                + b * picture[i, j + 1, 0]
                + d * picture[i + 1, j, 0]
                + e * picture[i + 1, j + 1, 0]
            )
            cover = (
                a * picture[i, j, 1]
                + b * picture[i, j + 1, 1]
                + d * picture[i + 1, j, 1]
                + e * picture[i + 1, j + 1, 1]
            )
            frame[r, c] = light + (one - cover) * frame[r, c]
