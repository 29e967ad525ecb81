"""Feeding of events and odometer readings to a localiser in time order."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser


class OdometryFeed:
    """Feeds events and readings to a localiser in time order; at equal times, events come first.

    Parameters
    ----------
    odometry : Odometry, optional
        Without it, only events are fed.
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
        events : Events
            See `Localiser.update`.

        Returns
        -------
        list of ndarray of MATCH_DTYPE
        """
        if events.size == 0:
            return []
        matches, begin = [], 0
        stop = self._read_by(int(events.t[-1]))
        at = np.searchsorted(events.t, self._times[self._read : stop], side="right").tolist()
        for reading, first in zip(range(self._read, stop), at, strict=True):
            if first > begin:
                matches.append(self._localiser.update(events[begin:first]))
                begin = first
            matches.append(self._reading(reading))
        self._read = stop
        matches.append(self._localiser.update(events[begin:]))
        return matches

    def finish(self, end_us: int | None) -> list[npt.NDArray[np.void]]:
        """Feed the readings up to the end of the drive, if it is known, and return what is left."""
        matches = []
        if end_us is not None:
            stop = self._read_by(end_us)
            matches = [self._reading(reading) for reading in range(self._read, stop)]
            self._read = stop
            matches.append(self._localiser.advance(end_us))
        return matches

    def _read_by(self, time_us: int) -> int:
        """Return how many readings there are up to a time."""
        return int(np.searchsorted(self._times, time_us, side="right"))

    def _reading(self, reading: int) -> npt.NDArray[np.void]:
        return self._localiser.read_odometer(
            int(self._times[reading]), self._metres[reading], checked=False
        )
