"""The pixel of an event camera: it fires when the logarithm of its light crosses a threshold.

The model is the usual one of event camera simulators (Lichtsteiner et al., JSSC 2008; Hu et al.,
v2e, CVPRW 2021): a pixel remembers a level and fires each time its input has moved away from it by
its threshold, and the level follows in steps of that threshold. Between two inputs the level is
taken to move in a straight line, which gives each crossing its time.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError
from edge_vpr.events import Events, Sensor, make_events

#: Light relatively this close to a threshold is compared as a logarithm; far above rounding.
SLACK = 1e-9
#: Time of the last event of a pixel that has not fired yet, in microseconds.
NEVER = -(2**62)

NoiseEvents = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.bool_]]
"""Times in microseconds, row-major pixel indices, polarities; shape ``(n,)`` each."""


@kernel
def _cross(
    before: Any, after: Any, memory: Any, t0: int, t1: int, events: Any, n: int, first: int
) -> tuple[int, int]:
    """Write the crossings of one step after the first `n`; return the new n and the next pixel.

    The pixel at which the second value stands did not fit; it is the number of pixels at the end.
    """
    (level, on, off, bright, faint), (times, pixels, polarities) = memory, events
    for i in range(first, after.size):
        # exact where it matters, cheap where nothing happens: most pixels rest in most steps
        if faint[i] < after[i] < bright[i]:
            continue
        # in double precision: the logarithm of a float32 would be a float32
        now = math.log(np.float64(after[i]))
        move = now - level[i]
        if move >= on[i]:
            threshold, polarity = on[i], True
        elif -move >= off[i]:
            threshold, polarity = -off[i], False
        else:
            continue
        crossings = int(move / threshold)
        if n + crossings > times.size:
            return n, i
        was = math.log(np.float64(before[i]))
        for k in range(1, crossings + 1):
            share = 1.0
            if now != was:
                share = min(max((level[i] + k * threshold - was) / (now - was), 0.0), 1.0)
            times[n] = t0 + int((t1 - t0) * share)
            pixels[n] = i
            polarities[n] = polarity
            n += 1
        level[i] += crossings * threshold
        bright[i] = math.exp(level[i] + on[i]) * (1 - SLACK)
        faint[i] = math.exp(level[i] - off[i]) * (1 + SLACK)
    return n, after.size


@kernel
def _rest(times: Any, pixels: Any, last: Any, refractory: int, keep: Any) -> None:
    """Mark the events that find their pixel ready, and note them as its last."""
    for e in range(times.size):
        ready = times[e] - last[pixels[e]] >= refractory
        keep[e] = ready
        if ready:
            last[pixels[e]] = times[e]


class PixelArray:
    """All pixels of one camera during one drive.

    Feed it levels with :meth:`step`, then take the events with :meth:`take`.

    Parameters
    ----------
    on, off : ndarray of float64, shape (pixels,)
        Thresholds in units of the level, greater than 0.
    refractory_us : int
        Time after an event in which its pixel is blind. The remembered level follows nevertheless,
        as that of a pixel held in reset would.
    """

    def __init__(
        self,
        sensor: Sensor,
        on: npt.NDArray[np.float64],
        off: npt.NDArray[np.float64],
        refractory_us: int,
    ) -> None:
        self.sensor = sensor
        self._on, self._off = on, off
        self._refractory = refractory_us
        self._last = np.full(sensor.pixels, NEVER, np.int64)
        self._before: npt.NDArray[np.float32] | None = None
        self._level = np.zeros(sensor.pixels)
        self._bright = np.zeros(sensor.pixels)
        self._faint = np.zeros(sensor.pixels)
        self._time = 0
        self._n = 0
        self._times = np.empty(sensor.pixels, np.int64)
        self._pixels = np.empty(sensor.pixels, np.int64)
        self._polarities = np.empty(sensor.pixels, np.bool_)

    def step(self, light: npt.NDArray[np.float32], time_us: int) -> None:
        """Move the logarithm of every pixel's light in a straight line from its last value.

        Parameters
        ----------
        light : ndarray of float32, shape (pixels,) or (height, width)
            Greater than 0, in any unit. The first one sets the remembered levels.
        time_us : int
            Its time, not before the last one's.
        """
        after = np.ascontiguousarray(light, np.float32).reshape(-1)
        if after.size != self.sensor.pixels:
            raise UsageError(
                f"light of shape {light.shape} for a {self.sensor} sensor: "
                f"give {self.sensor.pixels} values"
            )
        if not after.min() > 0:
            raise UsageError(f"light of {after.min()} has no logarithm: add the dark current to it")
        if self._before is not None and time_us < self._time:
            raise UsageError(
                f"time runs backwards from {self._time} to {time_us} us: feed the light in order"
            )
        if self._before is None:
            self._before = after.copy()
            self._level[:] = [math.log(value) for value in after.tolist()]
            self._bright[:] = np.exp(self._level + self._on) * (1 - SLACK)
            self._faint[:] = np.exp(self._level - self._off) * (1 + SLACK)
        memory = self._level, self._on, self._off, self._bright, self._faint
        first = 0
        while first < after.size:
            self._n, first = _cross(
                self._before, after, memory, self._time, time_us,
                (self._times, self._pixels, self._polarities), self._n, first,
            )  # fmt: skip
            if first < after.size:
                self._grow()
        self._before[:] = after
        self._time = time_us

    def _grow(self) -> None:
        """Double the room for events that were not returned yet."""
        self._times = np.concatenate((self._times, np.empty_like(self._times)))
        self._pixels = np.concatenate((self._pixels, np.empty_like(self._pixels)))
        self._polarities = np.concatenate((self._polarities, np.empty_like(self._polarities)))

    def take(self, noise: NoiseEvents | None = None) -> Events:
        """Return the events since the last call, together with noise events.

        Parameters
        ----------
        noise : NoiseEvents, optional
            In any order. None of it may be earlier than the step before the last call, or later
            than the last step.

        Returns
        -------
        Events
            Ordered by time; those of one microsecond stand in the order in which they were made,
            noise last. Events of a pixel still in its refractory period are gone.
        """
        n, self._n = self._n, 0
        t, i, p = self._times[:n], self._pixels[:n], self._polarities[:n]
        if noise is not None:
            t = np.concatenate((t, noise[0]))
            i = np.concatenate((i, noise[1]))
            p = np.concatenate((p, noise[2]))
        order = np.argsort(t, kind="stable")
        t, i, p = t[order], i[order], p[order]
        keep = np.empty(t.size, np.bool_)
        _rest(t, i, self._last, self._refractory, keep)
        y, x = np.divmod(i[keep], self.sensor.width)
        return make_events(t[keep], x, y, p[keep])
