"""The encoding ``libcaer_cmp`` of ``event_camera_msgs/EventPacket``: iniVation events, compressed.

Words of 16 bits, the kind in the upper four (``libcaer_cmp_types.h`` of event_camera_codecs):

====  ==================  ========================================================================
kind  lower 12 bits       meaning
====  ==================  ========================================================================
0     time >> 12          upper half of the microseconds from the packet's time base
1     time                lower half
2     column              of the events that follow
3     row, polarity << 11 one event
4     row, polarity << 11 first row of the vectors that follow
5     bits 0 to 7         an event for each bit that is set, in this row and the seven after it
====  ==================  ========================================================================
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError
from edge_vpr.recordings.columns import Columns

_EVENTS_A_WORD = 8
#: column, row and polarity carry over from packet to packet
STATE_DTYPE = np.dtype([("column", "<i8"), ("row", "<i8"), ("polarity", "?")])


@kernel
def _decode(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode one packet; return the number of events, or -1 - i if word i is of an unknown kind."""
    n = 0
    high, low = np.int64(0), np.int64(0)
    column, row, polarity = state.column, state.row, state.polarity
    for i in range(words.size):
        word = np.int64(words[i])
        kind, value = word >> 12, word & 4095
        if kind == 0:
            high = value << 12
        elif kind == 1:
            low = value
        elif kind == 2:
            column = value & 2047
        elif kind == 3:
            t[n], x[n], y[n], p[n] = high | low, column, value & 2047, value > 2047
            n += 1
        elif kind == 4:
            row, polarity = value & 2047, value > 2047
        elif kind == 5:
            for bit in range(8):
                if value >> bit & 1:
                    t[n], x[n], y[n], p[n] = high | low, column, row + bit, polarity
                    n += 1
            row = min(row + 8, 65535 - 8)
        else:
            return -1 - i
    state.column, state.row, state.polarity = column, row, polarity
    return n


class LibcaerCmpDecoder:
    """Decode packet by packet; column, row and polarity carry over between packets."""

    def __init__(self) -> None:
        self._state = np.rec.array(np.zeros(1, STATE_DTYPE))

    def decode(self, words: npt.NDArray[Any], base_us: int) -> Columns:
        """Decode the words of one packet.

        Parameters
        ----------
        words : ndarray of uint16, shape (n,)
        base_us : int
            The packet's time base in microseconds.

        Raises
        ------
        RecordingError
            If a word is of an unknown kind.
        """
        capacity = words.size * _EVENTS_A_WORD
        t = np.empty(capacity, np.int64)
        x, y = np.empty(capacity, np.uint16), np.empty(capacity, np.uint16)
        p = np.empty(capacity, np.bool_)
        n = _decode(words, self._state[0], t, x, y, p)
        if n < 0:
            kind = int(words[-1 - n]) >> 12
            raise RecordingError(
                f"word {-1 - n:,} of a libcaer_cmp packet is of the unknown kind {kind}: the bag "
                "is damaged, or written by a newer driver"
            )
        return Columns(t[:n] + base_us, x[:n], y[:n], p[:n])
