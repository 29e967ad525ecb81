"""Pauses: windows in which so few events arrive that the camera must be standing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: a window with no event, or less than 1/16 of the usual number, is a pause
PAUSE_SHIFT = 4
#: the usual number moves by 1/64 of the difference in a window; it has 8 fraction bits
ACTIVITY_SHIFT, ACTIVITY_BITS = 6, 8
#: where the number of a window's events saturates, so that the usual number fits 31 bits
EVENTS_TOP = (1 << 23) - 1


class Activity:
    """How many events a window usually has, as a running mean in integers.

    Parameters
    ----------
    usual : int
        Where it starts, in units of 1/256 event: `mean_activity` of the reference.
    """

    def __init__(self, usual: int) -> None:
        self.usual = usual

    def pauses(self, events: int) -> bool:
        """Whether a window with this many selected events is a pause."""
        return events == 0 or events << (ACTIVITY_BITS + PAUSE_SHIFT) < self.usual

    def update(self, events: int) -> None:
        """Take the selected events of a finished window."""
        # Python's integers: the shift rounds down, also what is negative
        self.usual += ((min(events, EVENTS_TOP) << ACTIVITY_BITS) - self.usual) >> ACTIVITY_SHIFT


def mean_activity(events: npt.NDArray[np.integer]) -> int:
    """Return the mean of the windows' selected events, in units of 1/256 event, rounded down.

    It saturates as `Activity` does.

    Parameters
    ----------
    events : ndarray of int, shape (n,)
        n of at least 1.
    """
    return min((int(events.sum()) << ACTIVITY_BITS) // len(events), EVENTS_TOP << ACTIVITY_BITS)


def find_pauses(events: npt.NDArray[np.integer], usual: int) -> npt.NDArray[np.bool_]:
    """Return which windows of a drive are pauses.

    Parameters
    ----------
    events : ndarray of int, shape (n,)
        At the selected pixels.
    usual : int
        See `Activity`.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    activity, paused = Activity(usual), np.zeros(len(events), dtype=np.bool_)
    for i, count in enumerate(events.tolist()):
        paused[i] = activity.pauses(count)
        activity.update(count)
    return paused
