"""How the number of events of one simulated street depends on the speed, and on what of the camera.

The same 40 m are driven at constant speeds, while parts of the camera model are removed one after
another. Sources of events at a constant rate (noise, hot pixels, bursts) give fewer events in a
faster drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from edge_vpr.simulation import CAMERAS, Camera, Drive, SimulatedRecording, World
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row
from edge_vpr_tools.research.experiments.plots import lines

LENGTH_M = 40.0
SPEEDS_MPS = (3.0, 6.0, 12.0)
_STILL = {"traffic_per_km": 0.0, "shake_px": 0.0}


def cases() -> Mapping[str, tuple[Camera, Mapping[str, Any]]]:
    """Return cameras and changes of the drive, each with one part less than the previous one."""
    camera = CAMERAS["default"]
    quiet = replace(camera, noise_hz=0.0, hot_pixels=0, bursts_per_minute=0.0)
    return {
        "as simulated": (camera, {}),
        "without noise, hot pixels and bursts": (quiet, {}),
        "and without traffic and shake": (quiet, _STILL),
        "and without refractory period": (replace(quiet, refractory_us=0), _STILL),
    }


def events_of(
    camera: Camera, changes: Mapping[str, Any], speed_mps: float, seed: int, length_m: float
) -> int:
    """Count the events of a street driven at a constant speed."""
    drive = Drive(speed_mps=speed_mps, speed_range=1.0, **changes)
    world = World(length_m=length_m, seed=seed)
    street = SimulatedRecording(world, camera, drive, seed=2 * seed, device=seed)
    return sum(int(events.size) for events in street)


def measure(draw: Draw) -> Iterator[Row]:
    """Drive a street at each speed with each camera."""
    for name, (camera, changes) in cases().items():
        slowest = None
        for speed in SPEEDS_MPS:
            events = events_of(camera, changes, speed, draw.seed, LENGTH_M)
            slowest = slowest or events
            row = {"camera": name, "speed (m/s)": speed}
            yield {**row, "events": events, SHARE: events / slowest}


#: events, compared with the same street and camera at the lowest speed
SHARE = f"share of those at {SPEEDS_MPS[0]:g} m/s"
EXPERIMENT = Experiment(
    drives=lambda data: [Drives(f"streets of {LENGTH_M:g} m", lambda seed: None, varied=True)],
    names=("camera", "speed (m/s)"),
    measure=measure,
    figure=partial(lines, x="speed (m/s)", y=SHARE, line="camera"),
    reads_data=False,
)
