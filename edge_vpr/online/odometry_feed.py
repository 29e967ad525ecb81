"""Feeding of events and odometer readings to a localiser in time order."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser


class OdometryFeed:
    """Feeds a localiser in time order; at the same time, events come before readings.

    Parameters
    ----------
    localiser : Localiser
    odometry : Odometry, optional
        Without it, only the events are fed.
    """

    def __init__(self, localiser: Localiser, odometry: Odometry | None = None) -> None:
        self._localiser, self._read = localiser, 0
        empty = np.empty(0, dtype=np.int64)
        self._times = empty if odometry is None else np.maximum(odometry.time_us, 0)
        self._metres = [] if odometry is None else (odometry.distance_mm / 1e3).tolist()

    def update(self, events: Events) -> list[npt.NDArray[np.void]]:
        """Feed the next events, and the readings up to the last of them.

        Parameters
        ----------
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
            See `Localiser.update`.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        if events.size == 0:
            return []
        found, begin = [], 0
        stop = int(np.searchsorted(self._times, events["t"][-1], side="right"))
        at = np.searchsorted(events["t"], self._times[self._read : stop], side="right").tolist()
        for reading, first in zip(range(self._read, stop), at, strict=True):
            if first > begin:
                found.append(self._localiser.update(events[begin:first]))
                begin = first
            time_us = int(self._times[reading])
            found.append(self._localiser.read_odometer(time_us, self._metres[reading]))
        self._read = stop
        found.append(self._localiser.update(events[begin:]))
        return found
