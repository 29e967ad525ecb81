"""One drive along the route: its speed, light, traffic and mounting of the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tracks import Track
from edge_vpr.odometry import Odometry
from edge_vpr.simulation.world import check_range, noise_1d

_SPEED, _STOPS, _SHAKE = 11, 12, 13  # one random stream each
_GRID_M = 0.1


@dataclass(frozen=True)
class Light:
    """Daylight: a sun with its shadows, the sky's diffuse light, and glare in the lens.

    A logarithmic pixel does not respond to a change of the brightness of the whole scene, but does
    respond to these changes.

    Parameters
    ----------
    sun : float
        Light of the sun on a surface that faces it; white in full light is 1.
    ambient : float
        Light of the sky, in shadow too.
    azimuth_deg : float
        Direction of the sun: 0 straight ahead, 90 to the right.
    elevation_deg : float
        Height of the sun over the horizon.
    glare : float
        Light scattered over the whole image, which lowers contrast.
    """

    sun: float = 0.7
    ambient: float = 0.3
    azimuth_deg: float = 60.0
    elevation_deg: float = 45.0
    glare: float = 0.01

    def __post_init__(self) -> None:
        if self.sun < 0 or self.ambient <= 0 or self.glare < 0:
            raise UsageError(
                f"light with sun {self.sun}, ambient {self.ambient} and glare {self.glare}: "
                "ambient light must be greater than 0, the others 0 or more"
            )
        check_range(self, ("elevation_deg",), "name an angle from 1 to 90", 1, 90)


@dataclass(frozen=True)
class Drive:
    """One traverse of the route.

    Parameters
    ----------
    speed_mps : float
        Typical speed in metres per second.
    speed_range : float
        The speed wanders between ``speed_mps / speed_range`` and ``speed_mps * speed_range``.
    stops : int
        How often the vehicle halts.
    stop_s : float
        Duration of a halt in seconds.
    traffic_per_km : float
        Vehicles and people that move, for each kilometre of route.
    parked_per_km : float
        Parked cars beside the road: others on every drive.
    yaw_deg, pitch_deg, roll_deg : float
        How far the camera's mounting is off: to the right, downwards, clockwise.
    lateral_m : float
        Place in the lane: positive is further right.
    shake_px : float
        Standard deviation of the image's shake, in pixels of a 128 pixel wide sensor.
    """

    speed_mps: float = 6.0
    speed_range: float = 1.08
    stops: int = 0
    stop_s: float = 4.0
    light: Light = field(default_factory=Light)
    traffic_per_km: float = 4.0
    parked_per_km: float = 20.0
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    lateral_m: float = 0.0
    shake_px: float = 0.4

    def __post_init__(self) -> None:
        if self.speed_mps <= 0 or self.speed_range < 1:
            raise UsageError(
                f"speed of {self.speed_mps} m/s within a factor of {self.speed_range}: "
                "name a speed greater than 0 and a factor of at least 1"
            )
        counted = ("stops", "stop_s", "traffic_per_km", "parked_per_km", "shake_px")
        check_range(self, counted, "name 0 or more")
        angles = ("yaw_deg", "pitch_deg", "roll_deg")
        check_range(self, angles, "name an angle from -20 to 20", -20, 20)
        check_range(self, ("shake_px",), "the image is cut with room for 0 to 1.5", most=1.5)
        check_range(self, ("lateral_m",), "the lane allows -1 to 1", -1, 1)


#: A drive at nearly constant speed in the sun.
REFERENCE = Drive()

#: The same route on another day: from half to twice the speed, another light and traffic, a
#: mounting that was touched.
QUERY = Drive(
    speed_range=2.0,
    light=Light(sun=0.5, ambient=0.4, azimuth_deg=-40.0, elevation_deg=30.0, glare=0.03),
    traffic_per_km=12.0,
    yaw_deg=0.8,
    pitch_deg=-0.5,
    roll_deg=0.4,
    lateral_m=0.2,
)


class Motion(NamedTuple):
    """Position of the camera on the route over time, linear between points."""

    time_us: npt.NDArray[np.int64]
    position_m: npt.NDArray[np.float64]


def drive_motion(drive: Drive, length_m: float, seed: int) -> Motion:
    """Drive the route once.

    Parameters
    ----------
    length_m : float
        Length of the route.

    Returns
    -------
    Motion
        ``time_us`` (n,) int64 from 0, strictly increasing; ``position_m`` (n,) float64 from 0 to
        the length, never decreasing.
    """
    position = np.linspace(0.0, length_m, max(round(length_m / _GRID_M), 1) + 1)
    middle = (position[1:] + position[:-1]) / 2
    # knots 30 m apart: a town's changes between slow and fast
    wander = noise_1d(np.random.default_rng((seed, _SPEED)), middle, cell=30.0)
    speed = drive.speed_mps * drive.speed_range**wander
    halts = np.random.default_rng((seed, _STOPS)).uniform(0.05, 0.95, drive.stops) * length_m
    for halt in halts:
        # 1.5 m/s2 of braking and pulling away; never quite 0, so that the drive ends
        speed = np.minimum(speed, np.sqrt(2 * 1.5 * np.abs(middle - halt)) + 0.3)
    seconds = np.concatenate(([0.0], np.cumsum(np.diff(position) / speed)))
    for halt in halts:
        at = int(np.searchsorted(position, halt))
        pause = np.linspace(0, drive.stop_s, int(np.ceil(drive.stop_s)) + 1)[1:]
        after = seconds[at + 1 :] + drive.stop_s
        seconds = np.concatenate((seconds[: at + 1], seconds[at] + pause, after))
        position = np.insert(position, at, np.full(pause.size, position[at]))
    return Motion(np.round(seconds * 1e6).astype(np.int64), position)


def frame_times(motion: Motion, step_m: float, step_us: int) -> Motion:
    """Return the times of frames: at least one in each `step_m` of the path and each `step_us`."""
    effort = np.maximum(np.diff(motion.position_m) / step_m, np.diff(motion.time_us) / step_us)
    done = np.concatenate(([0.0], np.cumsum(effort)))
    at = np.linspace(0.0, done[-1], int(np.ceil(done[-1])) + 1)
    time = np.round(np.interp(at, done, motion.time_us)).astype(np.int64)
    return Motion(time, np.interp(time, motion.time_us, motion.position_m))


def shake(drive: Drive, time_us: npt.NDArray[np.int64], seed: int) -> npt.NDArray[np.float64]:
    """Return the shift of the image by yaw and pitch of the vehicle on its springs.

    Returns
    -------
    ndarray of float64, shape (n, 2)
        Columns and rows, in pixels of a 128 pixel wide sensor, at most two standard deviations.
    """
    rng = np.random.default_rng((seed, _SHAKE))
    seconds = time_us / 1e6
    # slow steering, and pitch at the 1.5 Hz or so of a car's springs
    yaw = noise_1d(rng, seconds, cell=1.0)
    pitch = noise_1d(rng, seconds, cell=0.33)
    # a uniform draw between -1 and 1, interpolated, has a standard deviation of about 0.5
    return np.stack((yaw, pitch), axis=1) * (2.0 * drive.shake_px)


# Wheel odometry of a simulated drive, with an error of the wheel's size and slip.


PERIOD_US = 100_000
#: standard deviation of a wheel's size from drive to drive, and of one reading's step by slip
SCALE_ERROR, SLIP = 0.02, 0.05


def wheel_odometry(track: Track, rng: np.random.Generator) -> Odometry:
    """Return odometer readings of a drive, ten per second.

    Parameters
    ----------
    track : Track
        Metres along the route, one column.
    rng : Generator
        Draws the error of the wheel's size (2 %) and of each step (5 %).
    """
    times = np.arange(0, int(track.time_us[-1]), PERIOD_US, dtype=np.int64)
    metres = np.interp(times, track.time_us, track.position[:, 0])
    steps = np.diff(metres, prepend=metres[0])
    scale = 1 + rng.normal(0, SCALE_ERROR)
    slipped = steps * scale * (1 + rng.normal(0, SLIP, steps.size))
    return Odometry(times, np.rint(np.cumsum(slipped) * 1e3).astype(np.int64))
