"""Simulation of an event camera that is driven twice through a small deterministic world."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Events
from edge_vpr.recordings.reading import EventSource
from edge_vpr.simulation.drive import (
    QUERY,
    REFERENCE,
    Drive,
    Light,
    Motion,
    drive_motion,
    frame_times,
    shake,
)
from edge_vpr.simulation.pixel_model import PixelArray
from edge_vpr.simulation.view import (
    CAMERAS,
    Camera,
    Noise,
    View,
    cut,
    illuminate,
    paint_traffic,
    traffic,
)
from edge_vpr.simulation.world import COLUMN_M, Scene, World, paint, park_cars

__all__ = [
    "CAMERAS",
    "QUERY",
    "REFERENCE",
    "Camera",
    "Drive",
    "Light",
    "PixelArray",
    "SimulatedRecording",
    "World",
    "simulate_pair",
]

STEP_M = 0.8 * COLUMN_M  # distance between two frames: no texel of the street is passed over
STEP_US = 20_000  # time between two frames while the camera stands
BLOCK = 64  # frames that are simulated together

_PARKED = 41


class SimulatedRecording(EventSource):
    """One drive through a world, seen by one camera.

    Iterating yields event arrays, again from the start each time. The events depend on the
    arguments alone.

    Parameters
    ----------
    seed : int
        Seed of what differs from drive to drive: speed, traffic, shake, noise.
    device : int
        Seed of what belongs to the camera: thresholds and hot pixels.
    scene : Scene, optional
        The painted `world`, for several drives through it; by default it is painted when needed.

    Attributes
    ----------
    track : Track
        Ground truth: ``time_us`` (n,) int64, and ``position`` (n, 1) in metres along the route.
    position : float
        Share of the drive that the latest iteration has covered, 0 to 1.
    format, start_us, faults
        As every recording has them: ``"simulated"``, 0 and no fault.

    Examples
    --------
    >>> from edge_vpr.simulation import CAMERAS, REFERENCE, SimulatedRecording, World
    >>> drive = SimulatedRecording(World(length_m=20), CAMERAS["tiny"], REFERENCE, seed=1)
    >>> sum(len(events) for events in drive) == sum(len(events) for events in drive)
    True
    """

    format = "simulated"

    def __init__(
        self,
        world: World,
        camera: Camera,
        drive: Drive,
        *,
        seed: int,
        device: int = 0,
        scene: Scene | None = None,
    ) -> None:
        if seed < 0 or device < 0:
            raise UsageError(f"seed {min(seed, device)} is negative: name a seed of 0 or more")
        super().__init__(camera.sensor)
        self.world, self.camera, self.drive = world, camera, drive
        self.seed, self.device = seed, device
        self._motion = drive_motion(drive, world.length_m, seed)
        self.track = Track(self._motion.time_us, self._motion.position_m[:, None])
        self.position = 0.0
        self._scene = scene
        self._view: View | None = None
        self._kept: list[Events] | None = None

    @property
    def duration_us(self) -> int:
        """Length of the drive in microseconds."""
        return int(self._motion.time_us[-1])

    def __iter__(self) -> Iterator[Events]:
        self.position = 0.0
        if self._kept is not None:
            for number, events in enumerate(self._kept, 1):
                self.position = number / len(self._kept)
                yield events
        else:
            yield from self._blocks()
        self.position = 1.0

    def keep(
        self, shown: Callable[[SimulatedRecording], Iterable[Events]] | None = None
    ) -> SimulatedRecording:
        """Simulate now and store the events in memory, at 13 bytes each, for later iterations.

        Parameters
        ----------
        shown : callable, optional
            Wraps the recording while it is simulated, for a progress bar.

        Returns
        -------
        SimulatedRecording
            This one.
        """
        if self._kept is None:
            self._kept = list(self if shown is None else shown(self))
        return self

    def view(self) -> View:
        """Return the lit scene with the camera in it."""
        if self._view is None:
            scene = self._scene if self._scene is not None else paint(self.world)
            rng = np.random.default_rng((self.seed, _PARKED))
            left, right = (park_cars(wall, self.drive.parked_per_km, rng) for wall in scene.near)
            lit = illuminate(scene._replace(near=(left, right)), self.drive.light)
            self._view = View(self.camera, self.drive, lit)
        return self._view

    def light_at(self, time_us: npt.NDArray[np.int64]) -> Iterator[npt.NDArray[np.float32]]:
        """Yield the light that reaches each pixel at each moment.

        Parameters
        ----------
        time_us : ndarray of int64, shape (n,)
            Ascending, within the drive.

        Yields
        ------
        ndarray of float32, shape (height, width)
            1 for white in full light, with the glare and the dark current; the same array is
            overwritten each time.
        """
        time_us = np.asarray(time_us, dtype=np.int64)
        if time_us.size and not 0 <= time_us.min() <= time_us.max() <= self.duration_us:
            raise UsageError(
                f"moments from {time_us.min()} to {time_us.max()} us: the drive lasts from 0 to "
                f"{self.duration_us} us"
            )
        position_m = np.interp(time_us, *self._motion)
        yield from self._light(Motion(time_us, position_m))

    def _light(self, at: Motion) -> Iterator[npt.NDArray[np.float32]]:
        view, sensor = self.view(), self.sensor
        times, places = at.time_us.tolist(), at.position_m.tolist()
        # shaken as in the whole drive, whichever moments are asked for
        moments = np.append(at.time_us, self.duration_us)
        shifts = (shake(self.drive, moments, self.seed) * (sensor.width / 128)).tolist()
        movers = traffic(self.drive, self._motion, self.seed)
        frames = np.empty((BLOCK, *view.shape), np.float32)
        image = np.empty((sensor.height, sensor.width), np.float32)
        veil = self.camera.dark + self.drive.light.glare
        for start in range(0, len(times), BLOCK):
            stop = min(start + BLOCK, len(times))
            view.render(at.position_m[start:stop], frames[: stop - start])
            for i, frame in zip(range(start, stop), frames, strict=False):
                paint_traffic(movers, view, times[i], places[i], frame)
                right, down = shifts[i]
                cut(frame, view.margin, right, down, view.fixed, veil, image)
                yield image

    def _blocks(self) -> Iterator[Events]:
        """Simulate, a block of frames at a time."""
        camera = self.camera
        at = frame_times(self._motion, STEP_M, STEP_US)
        times = at.time_us.tolist()
        noise = Noise(camera, seed=self.seed, device=self.device, duration_us=self.duration_us)
        pixels = PixelArray(self.sensor, *camera.thresholds(self.device), camera.refractory_us)
        before = 0
        for number, image in enumerate(self._light(at), 1):
            now = times[number - 1]
            pixels.step(image, now)
            if number % BLOCK == 0 or number == len(times):
                self.position = now / times[-1]
                events = pixels.take(noise.between((number - 1) // BLOCK, before, now))
                if events.size:
                    yield events
                before = now


def simulate_pair(
    seed: int = 0,
    sensor: str = "default",
    *,
    length_m: float = 900.0,
    reference: Drive = REFERENCE,
    query: Drive = QUERY,
) -> tuple[SimulatedRecording, SimulatedRecording]:
    """Drive one route twice with one camera.

    Parameters
    ----------
    seed : int
        Another seed is another world, another camera of the same kind, and other drives.
    sensor : str
        Name of a camera in :data:`CAMERAS`.
    length_m : float
        Length of the route.
    reference, query : Drive
        The two drives; by default nearly constant speed in the sun, and half to double the speed
        in another light, with more traffic and a shifted mounting.

    Returns
    -------
    reference, query : SimulatedRecording
        Their ``track`` is the ground truth.
    """
    if sensor not in CAMERAS:
        raise UsageError(f"sensor {sensor!r} is unknown: choose from {', '.join(CAMERAS)}")
    world = World(length_m=length_m, seed=seed)
    scene = paint(world)
    camera = CAMERAS[sensor]
    first, second = (
        SimulatedRecording(world, camera, drive, seed=2 * seed + i, device=seed, scene=scene)
        for i, drive in enumerate((reference, query))
    )
    return first, second
