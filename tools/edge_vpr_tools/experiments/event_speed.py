"""How the number of events of one simulated street depends on the speed, and on what of the camera.

The same 40 m are driven at constant speeds, while parts of the camera model are removed one after
another. Sources of events at a constant rate (noise, hot pixels, bursts) give fewer events in a
faster drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from edge_vpr.simulate import CAMERAS, Camera, Drive, SimulatedRecording, World
from edge_vpr_tools.experiments.trial import Summary, markdown_table

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


def run(data: object, seeds: int, on_start: Callable[[str], None]) -> str:
    """Drive several streets at each speed, and return a Markdown table.

    Parameters
    ----------
    data : object
        Not used: nothing is read.
    seeds : int
        Number of streets.
    on_start : callable
        Called with a description before each part begins.
    """
    return table(cases(), seeds, on_start, LENGTH_M)


def table(
    cameras: Mapping[str, tuple[Camera, Mapping[str, Any]]],
    seeds: int,
    on_start: Callable[[str], None],
    length_m: float,
) -> str:
    """Return the events at each speed as a Markdown table, relative to the lowest speed."""
    rows = []
    for name, (camera, changes) in cameras.items():
        on_start(name)
        events = np.array(
            [
                [events_of(camera, changes, speed, seed, length_m) for speed in SPEEDS_MPS]
                for seed in range(seeds)
            ]
        )
        shares = events / events[:, :1]
        rows.append(
            [
                name,
                f"{events[:, 0].mean():,.0f}",
                *(str(Summary(column.tolist())) for column in shares.T[1:]),
            ]
        )
    slow, *faster = SPEEDS_MPS
    header = ("camera", f"events at {slow:g} m/s", *(f"share at {v:g} m/s" for v in faster))
    return markdown_table(header, rows)
