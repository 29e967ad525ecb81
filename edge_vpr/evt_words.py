"""Prophesee's words: which kinds there are, and how an event becomes one of EVT 2.0."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.events import Events

#: Kinds of EVT 2.0 and 2.1: an event that is OFF or ON, the time's high bits, a trigger's edge,
#: and two that say something else.
EVT2_KINDS = (0, 1, 8, 10, 14, 15)
#: Kinds of EVT 3.0: the row; an event; vectors' first column, 12 and 8 of their columns, and those
#: that go on; the time's low and high bits; a trigger's edge; and two that say something else.
EVT3_KINDS = (0, 2, 3, 4, 5, 6, 7, 8, 10, 14, 15)
_TIME_HIGH = 8
#: Of the time, the lowest six bits are in an event's word, and the others, 28, in a word before it.
EVT2_LOW_BITS, EVT2_HIGH_BITS = 6, 28


def evt2_event_words(events: Events) -> npt.NDArray[np.uint32]:
    """Make the words of events, without those of their times' high bits.

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
    """Make the words of the high bits of times in microseconds, shape (n,)."""
    high = t >> EVT2_LOW_BITS & ((1 << EVT2_HIGH_BITS) - 1)
    return (_TIME_HIGH << EVT2_HIGH_BITS | high).astype("<u4")
