"""Noise events: background activity, hot pixels and bursts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.simulate.camera import Camera

_BURSTS, _BACKGROUND, _BURST = 3, 4, 5  # one random stream each

Columns = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.bool_]]
"""Times in microseconds, row-major pixel indices, polarities; shape ``(n,)`` each."""


class Noise:
    """Noise of one camera during one drive.

    The noise of a period of time depends only on the seed and on the number of the period.

    Parameters
    ----------
    camera : Camera
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

    def between(self, number: int, start_us: int, stop_us: int) -> Columns:
        """Noise of the stretch with this number, ``start_us <= t < stop_us``.

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
