"""Quiet windows and pauses: so few events that the camera hardly moves, or stands still."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel

#: a window with no event, or less than 1/8 of the usual number, is quiet: standing costs nothing
QUIET_SHIFT = 3
#: a window with no event, or less than 1/16 of the usual number, is a pause: it has no evidence
PAUSE_SHIFT = 4
#: the usual number moves by 1/64 of the difference in each window; it has 8 fraction bits
ACTIVITY_SHIFT, ACTIVITY_BITS = 6, 8
#: largest number of events of a window; larger ones saturate, so that the usual number has 31 bits
EVENTS_TOP = (1 << 23) - 1


@kernel
def is_quiet(events: int, usual: int) -> bool:
    """Return whether a window of `events` selected events is quiet (`usual`: see `Activity`)."""
    return events == 0 or events << (ACTIVITY_BITS + QUIET_SHIFT) < usual


@kernel
def is_pause(events: int, usual: int) -> bool:
    """Return whether a window of `events` selected events is a pause, which is quiet too."""
    return events == 0 or events << (ACTIVITY_BITS + PAUSE_SHIFT) < usual


@kernel
def usual_after(usual: int, events: int) -> int:
    """Return the usual number of events after a window, in units of 1/256 event."""
    # the shift rounds down, negative numbers too
    return usual + (((min(events, EVENTS_TOP) << ACTIVITY_BITS) - usual) >> ACTIVITY_SHIFT)


class Activity:
    """Usual number of events in a window, as a running mean in integers.

    Parameters
    ----------
    usual : int
        Where it starts, in units of 1/256 event: `mean_activity` of the reference.
    """

    def __init__(self, usual: int) -> None:
        self.usual = usual

    def pauses(self, events: int) -> bool:
        """Return whether a window with `events` selected events is a pause."""
        return bool(is_pause(events, self.usual))

    def update(self, events: int) -> None:
        """Update the mean by the number of selected events of a finished window."""
        self.usual = usual_after(self.usual, events)


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
