"""Hot pixels and bursts: events that the scene did not cause (method.md section 1)."""

from __future__ import annotations

from pathlib import Path

import numba as nb
import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import EVENT_DTYPE, Events, Sensor

#: a pixel is hot above this many times its neighbourhood's events
HOT_FACTOR = 5
#: a burst: more than half of all pixels fire within two neighbouring slots of this length
BURST_SLOT_US = 2_000
BURST_SHARE = (1, 2)


def find_hot_pixels(
    totals: npt.NDArray[np.integer], *, factor: int = HOT_FACTOR
) -> npt.NDArray[np.bool_]:
    """Find the pixels whose number of events stands out far above their neighbours'.

    A pixel is hot if it has more than `factor` times the events of its 5 x 5 neighbourhood (the
    upper median of the others, plus one) and more than `factor` times the sensor's mean.

    Parameters
    ----------
    totals : ndarray of int, shape (height, width)
        Events of each pixel over the whole traverse.
    factor : int
        1 or more.

    Returns
    -------
    ndarray of bool, shape (height, width)

    Raises
    ------
    UsageError
        If `factor` is below 1 or `totals` is not an image.
    """
    if totals.ndim != 2:
        raise UsageError(f"totals have shape {totals.shape}: expected (height, width)")
    if factor < 1:
        raise UsageError(f"hot-pixel factor {factor} is below 1: every pixel would be hot")
    totals = np.ascontiguousarray(totals, dtype=np.int64)
    # above the mean, in integers: n * size > factor * sum
    candidates = totals * totals.size > factor * int(totals.sum())
    return candidates & _above_neighbours(totals, factor)


@nb.njit(cache=True)
def _above_neighbours(totals, factor):  # type: ignore[no-untyped-def]
    height, width = totals.shape
    above = np.zeros((height, width), dtype=np.bool_)
    around = np.empty(24, dtype=np.int64)
    for y in range(height):
        for x in range(width):
            n = 0
            for v in range(max(0, y - 2), min(height, y + 3)):
                for u in range(max(0, x - 2), min(width, x + 3)):
                    if u != x or v != y:
                        around[n] = totals[v, u]
                        n += 1
            median = np.sort(around[:n])[n // 2] if n > 0 else 0
            above[y, x] = totals[y, x] > factor * (median + 1)
    return above


def load_hot_pixels(path: str | Path, sensor: Sensor) -> npt.NDArray[np.bool_]:
    """Read a list of hot pixels: ``x, y`` a line, as the Brisbane-Event-VPR data set has them.

    Parameters
    ----------
    path : path
        Text file; empty lines, lines that start with ``#``, and a header are skipped.
    sensor : Sensor

    Returns
    -------
    ndarray of bool, shape (height, width)

    Raises
    ------
    RecordingError
        If the file cannot be read, or a line is not a pixel of the sensor.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"cannot read hot pixels from {path}: {error}") from error
    hot = np.zeros((sensor.height, sensor.width), dtype=np.bool_)
    for number, line in enumerate(lines, 1):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#") or (number == 1 and fields[0].isalpha()):
            continue
        try:
            x, y = (int(float(field)) for field in fields)
        except ValueError as error:
            raise RecordingError(
                f"line {number} of {path} is {line!r}: expected the column and row of a hot pixel"
            ) from error
        if not (0 <= x < sensor.width and 0 <= y < sensor.height):
            raise RecordingError(
                f"line {number} of {path} names the pixel ({x}, {y}), off the {sensor} sensor: "
                "give the list that belongs to this camera"
            )
        hot[y, x] = True
    return hot


class BurstFilter:
    """Removes bursts from a stream: moments at which most pixels fire within a few milliseconds.

    Time is cut into slots of 2 ms. Where more than half of all pixels fire in two neighbouring
    slots together, the events of both are removed. Events leave the filter up to two slots late;
    `finish` returns the rest.

    Parameters
    ----------
    sensor : Sensor

    Attributes
    ----------
    removed : int
        Events removed so far.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.removed = 0
        self._pixels = sensor.pixels
        self._last_slot = np.full((sensor.height, sensor.width), -2, dtype=np.int64)
        nothing = np.empty(0, dtype=EVENT_DTYPE)
        self._open = nothing  # the newest slot, which may still grow
        self._held = nothing  # the slot before it: the next one may still make it a burst
        self._held_slot, self._held_fired, self._held_is_burst = -2, 0, False

    def update(self, events: Events) -> Events:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray of EVENT_DTYPE, shape (n,)
            In time order and on the sensor, after all those before.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (m,)
            The events known by now to belong to no burst, in order.
        """
        if self._open.size:
            events = np.concatenate([self._open, events])
        slots = events["t"] // BURST_SLOT_US
        ended = int(np.searchsorted(slots, slots[-1])) if events.size else 0
        self._open = events[ended:].copy()
        return self._close(events[:ended], slots[:ended])

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (m,)
            The remaining events that belong to no burst.
        """
        last, self._open = self._open, self._open[:0]
        rest = [self._close(last, last["t"] // BURST_SLOT_US)]
        if not self._held_is_burst:
            rest.append(self._held)
        else:
            self.removed += self._held.size
        self._held = self._held[:0]
        return np.concatenate(rest)

    def _close(self, events: Events, slots: npt.NDArray[np.int64]) -> Events:
        """Judge slots that have ended; hold the last of them back."""
        if events.size == 0:
            return events
        starts = np.concatenate([[0], np.flatnonzero(slots[1:] != slots[:-1]) + 1])
        ids = slots[starts]
        fired, fresh = _count_fired(events["x"], events["y"], starts, ids, self._last_slot)

        follows = np.concatenate([[self._held_slot], ids[:-1]]) == ids - 1
        fired_before = np.concatenate([[self._held_fired], fired[:-1]])
        together = fresh + np.where(follows, fired_before, 0)
        is_burst = together * BURST_SHARE[1] > BURST_SHARE[0] * self._pixels
        spreads_back = is_burst & follows
        held_is_burst = self._held_is_burst or bool(spreads_back[0])
        is_burst[:-1] |= spreads_back[1:]

        pieces = [] if held_is_burst else [self._held]
        self.removed += self._held.size if held_is_burst else 0
        last = int(starts[-1])
        if is_burst[:-1].any():
            keep = np.repeat(~is_burst[:-1], np.diff(starts))
            self.removed += int(np.count_nonzero(~keep))
            pieces.append(events[:last][keep])
        else:
            pieces.append(events[:last])
        self._held, self._held_slot = events[last:].copy(), int(ids[-1])
        self._held_fired, self._held_is_burst = int(fired[-1]), bool(is_burst[-1])
        return np.concatenate(pieces) if pieces[0].size else pieces[-1]


@nb.njit(cache=True, nogil=True)
def _count_fired(x, y, starts, ids, last_slot):  # type: ignore[no-untyped-def]
    """Count the pixels that fired in each slot, and those that had not fired in the slot before."""
    fired = np.zeros(starts.size, dtype=np.int64)
    fresh = np.zeros(starts.size, dtype=np.int64)
    for i in range(starts.size):
        slot = ids[i]
        end = starts[i + 1] if i + 1 < starts.size else x.size
        for k in range(starts[i], end):
            last = last_slot[y[k], x[k]]
            if last != slot:
                last_slot[y[k], x[k]] = slot
                fired[i] += 1
                fresh[i] += last != slot - 1
    return fired, fresh
