"""Wheel odometry of a simulated drive, with an error of the wheel's size and slip."""

from __future__ import annotations

import numpy as np

from edge_vpr.evaluation.tracks import Track
from edge_vpr.odometry import Odometry

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
