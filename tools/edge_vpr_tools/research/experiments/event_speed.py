"""How the number of events of one simulated street depends on the speed, and on what of the camera.

The same 40 m are driven at constant speeds, while parts of the camera model are removed one after
another. Sources of events at a constant rate (noise, hot pixels, bursts) give fewer events in a
faster drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.simulation import CAMERAS, Camera, Drive, SimulatedRecording, World
from edge_vpr_tools.report.style import dot_plot, save
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table

LENGTH_M = 40.0
SPEEDS_MPS = (3.0, 6.0, 12.0)
#: number of events of each street at each speed, shape (seeds, speeds)
Events = npt.NDArray[np.int64]
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


def run(data: object, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Drive several streets at each speed, and return a Markdown table."""
    found: dict[str, Events] = {}
    for name, (camera, changes) in cases().items():
        on_start(name)
        found[name] = events_at_speeds(camera, changes, seeds, LENGTH_M)
    if figures:
        save(draw(found), *figures)
    return table(found)


def events_at_speeds(
    camera: Camera, changes: Mapping[str, Any], seeds: int, length_m: float
) -> Events:
    """Count the events of several streets at each of `SPEEDS_MPS`, as an array (seeds, speeds)."""
    return np.array(
        [
            [events_of(camera, changes, speed, seed, length_m) for speed in SPEEDS_MPS]
            for seed in range(seeds)
        ],
        dtype=np.int64,
    )


def table(found: Mapping[str, Events]) -> str:
    """Return the events of each camera as a Markdown table, relative to the lowest speed."""
    rows = [
        [
            name,
            f"{events[:, 0].mean():,.0f}",
            *(str(Summary(values)) for values in _shares(events).values()),
        ]
        for name, events in found.items()
    ]
    header = ("camera", f"events at {SPEEDS_MPS[0]:g} m/s", *_shares(next(iter(found.values()))))
    return markdown_table(header, rows)


def draw(found: Mapping[str, Events]) -> Figure:
    """Draw the events of each camera at the higher speeds, relative to the lowest."""
    shares = {name: _shares(events) for name, events in found.items()}
    speeds = next(iter(shares.values()))
    series = {
        speed: {name: by_speed[speed] for name, by_speed in shares.items()} for speed in speeds
    }
    label = f"events, share of those at {SPEEDS_MPS[0]:g} m/s"
    return dot_plot({label: series}, limits=None)  # the shares lie close together


def _shares(events: Events) -> dict[str, list[float]]:
    """Return the events at the higher speeds as shares of those at the lowest, by speed."""
    shares = (events / events[:, :1]).T.tolist()
    names = (f"share at {speed:g} m/s" for speed in SPEEDS_MPS)
    return dict(list(zip(names, shares, strict=True))[1:])
