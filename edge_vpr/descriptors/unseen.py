"""Time in which nothing was seen: no event of the whole sensor for a quarter of a window or more.

A camera that sees has noise at least. So lost frames, a restart of the camera, bytes that the host
dropped and a cut in a recording are one fact, which needs no report of the loss.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import FixedTime, Window

_NEVER_US = 1 << 62
#: Events of which the times are compared first: only a long step between two holds a short one.
_STRIDE = 64


class UnseenTime:
    """Follows the times of all events, and says when time is known to be unseen.

    It is counted in halves of a window, rounded up. Of a gap, the first half is known as soon as a
    quarter has passed, and the others at its end: the same however the stream is cut.

    >>> unseen = UnseenTime(FixedTime(tau_us=100))
    >>> unseen.until(40)  # the first event is still to come
    [(25, 1)]
    >>> unseen.feed(np.array([60, 70, 130]))
    [(60, 1), (95, 1), (130, 1)]

    Parameters
    ----------
    window : FixedTime or FixedCount
        In windows of a fixed number of events, no time is unseen.
    """

    def __init__(self, window: Window) -> None:
        tau_us = window.tau_us if isinstance(window, FixedTime) else _NEVER_US
        self.half_us, self.quarter_us = max(tau_us // 2, 1), max(tau_us // 4, 1)
        self.seen_us = 0  #: Time of the newest event.
        self.told = False  #: Whether the first half since then has been returned.

    def is_near(self, time_us: int) -> bool:
        """Return whether there is no gap from the newest event to this time."""
        return time_us - self.seen_us < self.quarter_us

    def until(self, time_us: int) -> list[tuple[int, int]]:
        """Return (time, halves) if they are known once there is no event before `time_us`."""
        if self.told or self.is_near(time_us):
            return []
        self.told = True
        return [(self.seen_us + self.quarter_us, 1)]

    def feed(self, t: npt.NDArray[Any]) -> list[tuple[int, int]]:
        """Return the times at which halves become known, and how many, up to the last event.

        Parameters
        ----------
        t : ndarray of int64, shape (n,)
            Times of the next events, rising.
        """
        pauses: list[tuple[int, int]] = []
        if not t.size:
            return pauses
        if self.is_near(int(t[-1])):
            self.seen_us, self.told = int(t[-1]), False
            return pauses
        for i in self._steps(t):
            self.seen_us, self.told = (int(t[i - 1]), False) if i else (self.seen_us, self.told)
            pauses += self.until(int(t[i]))
            if more := -((self.seen_us - int(t[i])) // self.half_us) - 1:  # rounded up
                pauses.append((int(t[i]), more))
        self.seen_us, self.told = int(t[-1]), False
        return pauses

    def _steps(self, t: npt.NDArray[Any]) -> list[int]:
        """Return which events come a quarter or more after the one before."""
        marks = np.append(t[::_STRIDE], t[-1:])
        far = np.flatnonzero(np.diff(marks) >= self.quarter_us)
        steps = [] if self.is_near(int(t[0])) else [0]
        for begin in (far * _STRIDE).tolist():
            part = np.diff(t[begin : begin + _STRIDE + 1])
            steps += (begin + 1 + np.flatnonzero(part >= self.quarter_us)).tolist()
        return steps
