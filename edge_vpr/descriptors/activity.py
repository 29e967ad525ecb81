"""Activity of a window: its number of events against the mean number, and whether it is a pause."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, plain
from fixedpoint.activity import (
    EVENTS_TOP,
    LOG_TOP,
    PAUSE_SHIFT,
    PLACE_HIGH,
    PLACE_LOW,
    least_events,
)

#: the mean number moves by 1/64 of the difference in each window; it has 8 fraction bits
ACTIVITY_SHIFT, ACTIVITY_FRACTION_BITS = 6, 8
#: it falls by 1/1024 in a pause: a stop of minutes leaves it, yet it follows a drive in the dark
PAUSE_DECAY_SHIFT = 10
_LEAST_EVENTS = least_events()


@kernel
def log_activity(events: int) -> int:
    """Return ``floor(16 log2(1 + events))``, at most `LOG_TOP`."""
    # NumPy's search takes 0.6 s to compile
    least, most = 0, LOG_TOP
    while least < most:
        middle = (least + most) // 2
        if events < _LEAST_EVENTS[middle]:
            most = middle
        else:
            least = middle + 1
    return least


@kernel(inline="always")
def activity_of(events: int, mean_activity: int) -> int:
    """Return the logarithm of a window's events less that of the mean number, in 1/16 octave.

    A window without events has the lowest activity: in a long stop, the mean number falls to 0.
    """
    if events == 0:
        return -LOG_TOP
    return log_activity(events) - log_activity(mean_activity >> ACTIVITY_FRACTION_BITS)


def log_of_mean(mean_activity: int) -> int:
    """Return the logarithm of a mean number of events, in 1/16 octave."""
    return int(plain(log_activity)(mean_activity >> ACTIVITY_FRACTION_BITS))


def place_activity(
    events: npt.NDArray[np.integer], places_per_window: int = 1
) -> npt.NDArray[np.int32]:
    """Return the activity of each place: the logarithm of its events less that of the mean.

    Parameters
    ----------
    events : ndarray of int, shape (K,)
        At the selected pixels in the window of each place.
    places_per_window : int
        The mean is that of the windows that do not overlap, which are every so many places.

    Returns
    -------
    ndarray of int32, shape (K,)
        In units of 1/16 octave, of 8 bits with sign.
    """
    logs = np.searchsorted(_LEAST_EVENTS, events, side="right")
    relative = logs - log_of_mean(activity_of_drive(events[::places_per_window]))
    return np.clip(relative, PLACE_LOW, PLACE_HIGH).astype(np.int32)


@kernel(inline="always")
def is_pause(events: int, mean_activity: int) -> bool:
    """Return whether a window of `events` selected events is a pause."""
    return events == 0 or events << (ACTIVITY_FRACTION_BITS + PAUSE_SHIFT) < mean_activity


@kernel(inline="always")
def mean_activity_after(mean_activity: int, events: int) -> int:
    """Return the mean number of events after a window, in units of 1/256 event."""
    # the shift rounds down, negative numbers too
    if is_pause(events, mean_activity):
        return mean_activity + (-mean_activity >> PAUSE_DECAY_SHIFT)
    return mean_activity + (
        ((min(events, EVENTS_TOP) << ACTIVITY_FRACTION_BITS) - mean_activity) >> ACTIVITY_SHIFT
    )


def activity_of_drive(events: npt.NDArray[np.integer]) -> int:
    """Return the mean of the windows' selected events, in units of 1/256 event, rounded down.

    It saturates as `mean_activity_after` does.

    Parameters
    ----------
    events : ndarray of int, shape (n,)
        n of at least 1.
    """
    return min(
        (int(events.sum()) << ACTIVITY_FRACTION_BITS) // len(events),
        EVENTS_TOP << ACTIVITY_FRACTION_BITS,
    )


def mean_of_query(events: npt.NDArray[np.integer], mean_activity: int) -> int:
    """Return where the mean number of events of a whole recorded drive starts.

    Other light or another camera shows fewer or more events than the reference at the same speed.

    Parameters
    ----------
    events : ndarray of int, shape (n,)
        That count in each window of the drive; n of at least 1.
    mean_activity : int
        Of the reference, see `activity_of_drive`.

    Returns
    -------
    int
        That of the reference, or that of the drive if it is at most half or at least twice.
    """
    own = activity_of_drive(events)
    return own if 2 * own <= mean_activity or own >= 2 * mean_activity else mean_activity


def find_pauses(events: npt.NDArray[np.integer], mean_activity: int) -> npt.NDArray[np.bool_]:
    """Return which windows of a drive are pauses, by the running mean of those before each.

    Parameters
    ----------
    events : ndarray of int, shape (n,)
        At the selected pixels.
    mean_activity : int
        Where the mean starts: `activity_of_drive` of the reference.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    # without the compiler, which takes longer than the windows of a drive
    pauses, mean_after = plain(is_pause), plain(mean_activity_after)
    paused = np.zeros(len(events), dtype=np.bool_)
    for i, count in enumerate(events.tolist()):
        paused[i] = pauses(count, mean_activity)
        mean_activity = mean_after(mean_activity, count)
    return paused
