"""Removal of bursts, moments at which most pixels fire at once, from a stream of events."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.events import EVENT_DTYPE, Events, Sensor, join_events

#: a burst: more than half of all pixels fire within two neighbouring slots of this length
BURST_SLOT_US = 2_000
BURST_SHARE = (1, 2)


class BurstFilter:
    """Removes bursts from a stream: moments at which most pixels fire within a few milliseconds.

    Time is divided into slots of 2 ms. If more than half of all pixels fire in two neighbouring
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
        self._sensor = sensor
        self._least = sensor.pixels * BURST_SHARE[0] // BURST_SHARE[1]
        self._hold_nothing()

    def _hold_nothing(self) -> None:
        # The newest two slots with events: the last may get more, and the one before it may still
        # become the first half of a burst. Rows: number and size; size 0 means none yet.
        self._events = np.empty(0, dtype=EVENT_DTYPE)
        self._newest = np.array([[-4, 0], [-2, 0]], dtype=np.int64)
        # whether the first of the two slots is a burst together with the slot before it
        self._first_is_burst = False

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
        """Feed the next events as `update` does, and yield the kept ones without copying.

        Returns
        -------
        list of ndarray of EVENT_DTYPE
            The events that `update` would return, one array after another; they may be views.
        """
        if events.size == 0:
            return []
        held, newest = self._events, self._newest.copy()
        most, cut = _newest_slots(events["t"], held.size, newest)
        keep = None
        if most > self._least or self._first_is_burst:
            slots = _joined(self._slots(), _slots_of(events["t"]))
            burst = self._bursts(slots, held, events)
            decided = max(0, len(slots.number) - 2)
            keep = np.repeat(~burst[:decided], slots.size[:decided])
            if decided:
                self._first_is_burst = bool(burst[decided])
        if keep is None or keep.all():
            pieces = [held[:cut], events[: max(0, cut - held.size)]]
        else:
            self.removed += int(np.count_nonzero(~keep))
            pieces = [np.concatenate([held, events])[:cut][keep]]
        self._events = join_events([held[cut:], events[max(0, cut - held.size) :]])
        self._newest = newest
        return [piece for piece in pieces if piece.size]

    def _slots(self) -> _Slots:
        known = self._newest[self._newest[:, 1] > 0]
        return _Slots(known[:, 0], known[:, 1])

    def advance(self, until_us: int) -> Events:
        """Advance the time without events, to T = `until_us`.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (m,)
            The events known by now to belong to no burst, in order.
        """
        held = self._events
        if held.size and until_us // BURST_SLOT_US > int(held["t"][-1]) // BURST_SLOT_US + 1:
            return self.finish()
        return held[:0]

    @property
    def known_us(self) -> int:
        """Time before which all events have left the filter; the largest time if none is held."""
        if self._events.size == 0:
            return np.iinfo(np.int64).max
        return int(self._events["t"][0]) // BURST_SLOT_US * BURST_SLOT_US

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (m,)
            The remaining events that belong to no burst.
        """
        held = self._events
        slots = self._slots()
        keep = np.repeat(~self._bursts(slots, held, held[:0]), slots.size)
        self.removed += int(np.count_nonzero(~keep))
        self._hold_nothing()
        return held[keep]

    def _bursts(self, slots: _Slots, held: Events, events: Events) -> npt.NDArray[np.bool_]:
        """Return which slots belong to a burst; for the last slot as far as is known."""
        burst = np.zeros(len(slots.number), dtype=np.bool_)
        burst[:1] = self._first_is_burst
        follows = np.diff(slots.number, prepend=-2) == 1
        together = slots.size + np.where(follows, np.concatenate([[0], slots.size[:-1]]), 0)
        # pixels need to be counted only if there are enough events
        candidates = np.flatnonzero(together > self._least)
        if candidates.size == 0:
            return burst
        joined = np.concatenate([held, events])
        flat = joined["y"].astype(np.int64) * self._sensor.width + joined["x"]
        ends = np.cumsum(slots.size)
        for i in candidates.tolist():
            pixels = np.unique(flat[ends[i] - together[i] : ends[i]]).size
            if pixels * BURST_SHARE[1] > BURST_SHARE[0] * self._sensor.pixels:
                burst[i] = True
                burst[i - 1 : i] |= follows[i]
        return burst


@kernel
def _newest_slots(t, held, newest):  # type: ignore[no-untyped-def]
    """Assign events at times `t` to slots, after `held` events in two slots.

    Returns the largest number of events in two neighbouring slots together, and the number of
    events before the newest two slots. Writes the numbers and sizes of these two to `newest`.
    """
    before, before_size, last, last_size = newest[0, 0], newest[0, 1], newest[1, 0], newest[1, 1]
    before_at, last_at = 0, before_size
    most = last_size + (before_size if last == before + 1 else 0)
    for i in range(t.size):
        slot = t[i] // BURST_SLOT_US
        if slot != last:
            before, before_size, before_at = last, last_size, last_at
            last, last_size, last_at = slot, 0, held + i
        last_size += 1
        together = last_size + (before_size if last == before + 1 else 0)
        most = max(most, together)
    newest[0, 0], newest[0, 1], newest[1, 0], newest[1, 1] = before, before_size, last, last_size
    return most, before_at


class _Slots(NamedTuple):
    """Numbers and sizes of the slots that have events."""

    number: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]


def _slots_of(t: npt.NDArray[np.int64]) -> _Slots:
    if t.size == 0:
        return _Slots(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    first, last = int(t[0]) // BURST_SLOT_US, int(t[-1]) // BURST_SLOT_US
    if last - first > t.size:
        number, size = np.unique(t // BURST_SLOT_US, return_counts=True)
        return _Slots(number, size.astype(np.int64))
    number = np.arange(first, last + 1)
    ends = np.searchsorted(t, (number + 1) * BURST_SLOT_US)
    size = np.diff(ends, prepend=0)
    return _Slots(number[size > 0], size[size > 0])


def _joined(older: _Slots, newer: _Slots) -> _Slots:
    """Join the slots of two successive parts of a stream, which may share one slot."""
    if len(older.number) and older.number[-1] == newer.number[0]:
        sizes = [older.size[:-1], older.size[-1:] + newer.size[:1], newer.size[1:]]
        return _Slots(np.concatenate([older.number, newer.number[1:]]), np.concatenate(sizes))
    return _Slots(*map(np.concatenate, zip(older, newer, strict=True)))
