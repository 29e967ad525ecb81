"""Words of Prophesee's EVT formats: their kinds, and encoding in EVT 2.0."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events

#: Kinds in EVT 2.0 and 2.1: OFF event, ON event, high bits of the time, edge of a trigger, and two
#: kinds without events.
EVT2_KINDS = (0, 1, 8, 10, 14, 15)
#: Kinds in EVT 3.0: row; single event; first column of a vector; 12 and 8 columns of a vector;
#: continuations; low and high bits of the time; edge of a trigger; and two kinds without events.
EVT3_KINDS = (0, 2, 3, 4, 5, 6, 7, 8, 10, 14, 15)
_TIME_HIGH = 8
#: Six low bits of the time are in the word of an event, and 28 high bits in a word before it.
EVT2_LOW_BITS, EVT2_HIGH_BITS = 6, 28


def evt2_event_words(events: Events) -> npt.NDArray[np.uint32]:
    """Encode events as words, without the words for the high bits of their times.

    Parameters
    ----------
    events : ndarray of EVENT_DTYPE, shape (n,)

    Returns
    -------
    ndarray of uint32, shape (n,)
        4 bits kind, 6 bits time, 11 bits column, 11 bits row.
    """
    low = events["t"] & ((1 << EVT2_LOW_BITS) - 1)
    return np.asarray(
        events["p"].astype(np.uint32) << 28
        | low.astype(np.uint32) << 22
        | events["x"].astype(np.uint32) << 11
        | events["y"],
        dtype="<u4",
    )


def evt2_time_words(t: npt.NDArray[np.int64]) -> npt.NDArray[np.uint32]:
    """Encode the high bits of times in microseconds as words, shape (n,)."""
    high = t >> EVT2_LOW_BITS & ((1 << EVT2_HIGH_BITS) - 1)
    return (_TIME_HIGH << EVT2_HIGH_BITS | high).astype("<u4")
