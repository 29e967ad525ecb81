"""Hot pixels and bursts: events that the scene did not cause (method.md section 1)."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

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
        # The newest two slots that have events: the last may still grow, and the one before it may
        # still turn out to be the first half of a burst.
        self._events = np.empty(0, dtype=EVENT_DTYPE)
        self._slots = _Slots(*(np.empty(0, dtype=np.int64) for _ in range(4)))
        self._before = (-2, 0)  # number of the slot before them, and how many pixels fired in it

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
        return np.concatenate([*self.pieces(events), self._events[:0]])

    def pieces(self, events: Events) -> list[Events]:
        """Feed the next events as `update` does, and take them without copying.

        Returns
        -------
        list of ndarray of EVENT_DTYPE
            The events that `update` would return, one array after another; they may be views.
        """
        if events.size == 0:
            return []
        slots = self._slots_with(events)
        decided = max(0, len(slots.number) - 2)
        burst = self._bursts(slots)[:decided]
        held = self._events
        cut = int(slots.size[:decided].sum())
        if burst.any():
            keep = np.repeat(~burst, slots.size[:decided])
            self.removed += int(np.count_nonzero(~keep))
            pieces = [np.concatenate([held, events])[:cut][keep]]
        elif cut <= held.size:
            pieces = [held[:cut]]
        else:
            pieces = [held, events[: cut - held.size]]
        if cut <= held.size:
            self._events = np.concatenate([held[cut:], events])
        else:
            self._events = events[cut - held.size :].copy()
        self._forget(slots, decided, burst)
        return [piece for piece in pieces if piece.size]

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (m,)
            The remaining events that belong to no burst.
        """
        keep = np.repeat(~self._bursts(self._slots), self._slots.size)
        self.removed += int(np.count_nonzero(~keep))
        rest, self._events = self._events[keep], self._events[:0]
        self._slots = _Slots(*(column[:0] for column in self._slots))
        return rest

    def _slots_with(self, events: Events) -> _Slots:
        """Count who fired in the slots of new events; the first of them may go on."""
        t = events["t"]
        slots = self._slots
        last = len(slots.number) - 1
        going_on = last >= 0 and t[0] // BURST_SLOT_US == slots.number[last]
        room = min(events.size, int(t[-1] // BURST_SLOT_US - t[0] // BURST_SLOT_US) + 1)
        new = _Slots(*np.zeros((4, room), dtype=np.int64))
        used = _count_fired(t, events["x"], events["y"], self._last_slot, *new)
        new = _Slots(*(column[:used] for column in new))
        if going_on:
            for column in ("size", "fired", "fresh"):
                getattr(new, column)[0] += getattr(slots, column)[last]
            slots = _Slots(*(column[:last] for column in slots))
        return _Slots(*map(np.concatenate, zip(slots, new, strict=True)))

    def _bursts(self, slots: _Slots) -> npt.NDArray[np.bool_]:
        """Tell which slots are half of a burst, the last of them as far as it is known."""
        number_before = np.concatenate([[self._before[0]], slots.number[:-1]])
        fired_before = np.concatenate([[self._before[1]], slots.fired[:-1]])
        follows = number_before == slots.number - 1
        together = slots.fresh + np.where(follows, fired_before, 0)
        burst = together * BURST_SHARE[1] > BURST_SHARE[0] * self._pixels
        burst[:-1] |= burst[1:] & follows[1:]
        return burst

    def _forget(self, slots: _Slots, decided: int, burst: npt.NDArray[np.bool_]) -> None:
        if decided:
            self._before = int(slots.number[decided - 1]), int(slots.fired[decided - 1])
        self._slots = _Slots(*(column[decided:] for column in slots))


class _Slots(NamedTuple):
    """Slots that have events: number, events, pixels that fired, those that had not just fired."""

    number: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]
    fired: npt.NDArray[np.int64]
    fresh: npt.NDArray[np.int64]


@nb.njit(cache=True, nogil=True)
def _count_fired(t, x, y, last_slot, number, size, fired, fresh):  # type: ignore[no-untyped-def]
    """Count events and pixels of each slot; `fresh` pixels had not fired in the slot before."""
    used, end, slot = 0, np.int64(-1), np.int64(-2)
    for i in range(t.size):
        if t[i] >= end or used == 0:
            slot = t[i] // BURST_SLOT_US
            end = (slot + 1) * BURST_SLOT_US
            number[used] = slot
            used += 1
        size[used - 1] += 1
        last = last_slot[y[i], x[i]]
        if last != slot:
            last_slot[y[i], x[i]] = slot
            fired[used - 1] += 1
            fresh[used - 1] += last != slot - 1
    return used
