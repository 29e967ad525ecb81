"""Expansion of counts to events, in integer arithmetic.

Frame f lasts from ``lo = floor(f * period)`` to ``hi = floor((f + 1) * period)`` microseconds,
where the period is a fraction. If pixel j has n events in the frame, its event i is placed at::

    t = lo + floor((i + phase_j) * (hi - lo) / n),   phase_j = (40503 * (j + 1) mod 65536) / 65536

so that the events of each pixel are evenly spread over the frame, and each pixel has its own phase.
The phases are multiples of the golden ratio: pixels with a single event then do not all fire at
once, which would be a burst, nor row after row. Events at the same time are in the order of j. The
count is kept exactly, and ``lo <= t < hi``. Frames have no polarity: all events are ON.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.recordings.columns import Columns

_PHASE_BITS = 16
_GOLDEN = 40503  # 2**16 over the golden ratio, made odd
#: Events that are expanded at a time, and most events within one microsecond.
_MOST_EXPANDED, _MOST_AT_ONCE = 1 << 20, 1 << 16

Counts = npt.NDArray[Any]
Placed = tuple[npt.NDArray[np.int64], npt.NDArray[np.intp]]
"""Times and pixel numbers of events, in order of time."""


def expand(counts: Counts, lo: int, hi: int, path: Path) -> Iterator[Placed]:
    """Place the events of one frame in time.

    A frame of many events is cut into parts of equal duration, which are expanded one by one.

    Parameters
    ----------
    counts : ndarray of integers, shape (J,)
    lo, hi : int
        Begin and end of the frame in microseconds.
    path : Path
        Named in messages.

    Yields
    ------
    t : ndarray of int64, shape (n,)
        In order, from `lo` to below `hi`.
    pixel : ndarray of intp, shape (n,)

    Raises
    ------
    RecordingError
        If there are too many events for the duration of the frame.
    """
    active = np.flatnonzero(counts)
    n = counts[active].astype(np.int64)
    length, total = hi - lo, float(n.sum(dtype=np.float64))
    most = int(n.max(initial=0))
    if total > length * _MOST_AT_ONCE or (most << _PHASE_BITS) * length >= 1 << 62:
        raise RecordingError(
            f"{path}: {total:,.0f} events, up to {most:,} of one pixel, do not fit a frame of "
            f"{length} us: check the frame period (in seconds)"
        )
    phases = (active + 1) * _GOLDEN & ((1 << _PHASE_BITS) - 1)
    pieces = min(length, math.ceil(total / _MOST_EXPANDED))
    begin = np.zeros_like(n)
    for piece in range(1, pieces + 1):
        # the first event of each pixel that lies at or after the piece's end
        bound = -(-((n << _PHASE_BITS) * (length * piece // pieces)) // length)
        end = np.clip(-(-(bound - phases) // (1 << _PHASE_BITS)), 0, n)
        some = end - begin
        pixel = np.repeat(active, some)
        index = np.arange(pixel.size) + np.repeat(begin - (np.cumsum(some) - some), some)
        shifted = (index << _PHASE_BITS) + np.repeat(phases, some)
        offset = shifted * length // (np.repeat(n, some) << _PHASE_BITS)
        # offsets of 16 bits are sorted by radix
        key = offset.astype(np.uint16) if length <= 1 << 16 else offset
        order = np.argsort(key, kind="stable")
        yield lo + offset[order], pixel[order]
        begin = end


def join(frames: list[Placed], x: npt.NDArray[np.uint16], y: npt.NDArray[np.uint16]) -> Columns:
    """Join placed events to columns; pixel j lies at ``x[j]``, ``y[j]``."""
    t = np.concatenate([times for times, _ in frames])
    pixel = np.concatenate([pixels for _, pixels in frames])
    return Columns(t, x[pixel], y[pixel], np.ones(t.size, dtype=bool))
