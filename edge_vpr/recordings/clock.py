"""Conversion of times that wrap into times that never wrap."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


class Unwrapper:
    """Continue a clock of `bits` bits beyond its wraps, chunk by chunk.

    Between two events the shorter direction is taken, so that a step of less than half the clock's
    period can go forwards or backwards. Slightly late events stay late, also across a wrap.

    Examples
    --------
    >>> Unwrapper(8).unwrap(np.array([250, 3, 254, 5], np.uint8))
    array([250, 259, 254, 261])
    """

    def __init__(self, bits: int) -> None:
        self._half = 1 << (bits - 1)
        self._mask = (1 << bits) - 1
        self._last: int | None = None

    def unwrap(self, times: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return the times of one chunk, int64, continued from the chunk before."""
        raw = times.astype(np.int64)
        if raw.size == 0:
            return raw
        first = int(raw[0]) if self._last is None else self._last
        steps = np.diff(raw, prepend=first)
        steps += self._half
        steps &= self._mask
        steps -= self._half
        unwrapped = np.cumsum(steps, out=steps)
        unwrapped += first
        self._last = int(unwrapped[-1])
        return unwrapped
