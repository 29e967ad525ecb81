"""Removal of events that the scene did not cause: bursts and hot pixels."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import RecordingError, UsageError, as_path, expect, number_in
from edge_vpr.events import NO_EVENTS, Events, Sensor, as_events, join_events
from edge_vpr.files import open_input

# Removal of bursts, moments at which most pixels fire at once, from a stream of events.


#: a burst: more than half of all pixels fire within two neighbouring slots of this length
BURST_SLOT_US = 2_000
BURST_SHARE = (1, 2)


class BurstFilter:
    """Removes bursts from a stream: moments at which most pixels fire within a few milliseconds.

    >>> from edge_vpr.events import make_events
    >>> bursts = BurstFilter(Sensor(4, 4))
    >>> kept = bursts.update(make_events(t=[0, 3_000, 9_000], x=[0, 1, 2], y=[0, 0, 0]))
    >>> len(kept) + len(bursts.finish()), bursts.removed
    (3, 0)

    Time is divided into slots of 2 ms. If more than half of all pixels fire in two neighbouring
    slots together, the events of both are removed. Events leave the filter up to two slots late;
    `finish` returns the rest.

    Attributes
    ----------
    removed : int
        Events removed so far.
    """

    def __init__(self, sensor: Sensor) -> None:
        expect(sensor, Sensor, "sensor", "the size of the camera, as Sensor(346, 260)")
        self.removed = 0
        self._sensor = sensor
        self._least = sensor.pixels * BURST_SHARE[0] // BURST_SHARE[1]
        self._hold_nothing()

    def _hold_nothing(self) -> None:
        # The newest two slots with events: the last may get more, and the one before it may still
        # become the first half of a burst. Rows: number and size; size 0 means none yet.
        self._events = NO_EVENTS
        self._newest = np.array([[-4, 0], [-2, 0]], dtype=np.int64)
        # whether the first of the two slots is a burst together with the slot before it
        self._first_is_burst = False

    def update(self, events: Events) -> Events:
        """Feed the next events.

        Parameters
        ----------
        events : Events
            In time order and on the sensor, after all those before.

        Returns
        -------
        Events
            The events known by now to belong to no burst, in order.
        """
        return join_events(self.pieces(events))

    def pieces(self, events: Events) -> list[Events]:
        """Feed the next events as `update` does, and yield the kept ones without copying.

        Returns
        -------
        list of Events
            The events that `update` would return, one array after another; they may be views.
        """
        events = as_events(events)
        if events.size == 0:
            return []
        held, newest = self._events, self._newest.copy()
        most, cut = _newest_slots(events.t, held.size, newest)
        keep = None
        if most > self._least or self._first_is_burst:
            slots = _joined(self._slots(), _slots_of(events.t))
            burst = self._bursts(slots, held, events)
            decided = max(0, len(slots.number) - 2)
            keep = np.repeat(~burst[:decided], slots.size[:decided])
            if decided:
                self._first_is_burst = bool(burst[decided])
        if keep is None or keep.all():
            pieces = [held[:cut], events[: max(0, cut - held.size)]]
        else:
            self.removed += int(np.count_nonzero(~keep))
            pieces = [join_events([held, events])[:cut][keep]]
        self._events = join_events([held[cut:], events[max(0, cut - held.size) :]])
        self._newest = newest
        return [piece for piece in pieces if piece.size]

    def _slots(self) -> _Slots:
        held = self._newest[self._newest[:, 1] > 0]
        return _Slots(held[:, 0], held[:, 1])

    def advance(self, until_us: int) -> Events:
        """Advance the time without events, to T = `until_us`.

        Returns
        -------
        Events
            The events known by now to belong to no burst, in order.
        """
        held = self._events
        if held.size and until_us // BURST_SLOT_US > int(held.t[-1]) // BURST_SLOT_US + 1:
            return self.finish()
        return held[:0]

    @property
    def complete_us(self) -> int:
        """Time before which all events have left the filter; the largest time if none is held."""
        if self._events.size == 0:
            return np.iinfo(np.int64).max
        return int(self._events.t[0]) // BURST_SLOT_US * BURST_SLOT_US

    def finish(self) -> Events:
        """End the stream.

        Returns
        -------
        Events
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
        joined = join_events([held, events])
        flat = joined.y.astype(np.int64) * self._sensor.width + joined.x
        ends = np.cumsum(slots.size)
        for i in candidates.tolist():
            pixels = np.unique(flat[ends[i] - together[i] : ends[i]]).size
            if pixels * BURST_SHARE[1] > BURST_SHARE[0] * self._sensor.pixels:
                burst[i] = True
                burst[i - 1 : i] |= follows[i]
        return burst


@kernel
def _newest_slots(t, held, newest):  # type: ignore[no-untyped-def]
    """Assign events to slots by their times, after `held` events in two slots.

    Returns the largest number of events in two neighbouring slots together, or in a slot without
    neighbours, and the number of events before the newest two slots. Writes the numbers and sizes
    of these two to `newest`.
    """
    before, before_size, last, last_size = newest[0, 0], newest[0, 1], newest[1, 0], newest[1, 1]
    before_at, last_at = 0, before_size
    most = max(before_size, last_size + (before_size if last == before + 1 else 0))
    i = 0
    while i < t.size:
        slot = t[i] // BURST_SLOT_US
        if slot != last:
            before, before_size, before_at = last, last_size, last_at
            last, last_size, last_at = slot, 0, held + i
        # the end of the slot, by growing steps and then by halves
        until, first, step = (slot + 1) * BURST_SLOT_US, i, 1
        while i + step < t.size and t[i + step] < until:
            i += step
            step *= 2
        end = min(i + step, t.size)
        i += 1
        while i < end:
            middle = (i + end) // 2
            if t[middle] < until:
                i = middle + 1
            else:
                end = middle
        last_size += i - first
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


# Hot pixels, which fire without a cause: found by counts, or read from a list.


#: a pixel is hot if it has more than this many times the events of its neighbourhood
HOT_FACTOR = 5
#: largest size of a list of hot pixels, in bytes
_LONGEST_LIST = 1 << 26


def find_hot_pixels(totals: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
    """Find the pixels with far more events than their neighbours (method.md section 1).

    A pixel is hot if it has more than 5 times the events of its 5 x 5 neighbourhood (the upper
    median of the others, plus one) and more than 5 times the sensor's mean.

    Parameters
    ----------
    totals : ndarray of int, shape (height, width)
        Events of each pixel over the whole traverse.

    Returns
    -------
    ndarray of bool, shape (height, width)
    """
    totals = np.asarray(totals)
    if totals.dtype.kind not in "iu":
        raise UsageError(f"totals are {totals.dtype}: give the number of events of each pixel")
    if totals.ndim != 2:
        raise UsageError(f"totals have shape {totals.shape}: expected (height, width)")
    totals = np.ascontiguousarray(totals, dtype=np.int64)
    # above the mean, in integers: n * size > 5 * sum
    candidates = totals * totals.size > HOT_FACTOR * int(totals.sum())
    return candidates & _above_neighbours(totals)


def can_be_searched(totals: npt.NDArray[np.integer]) -> bool:
    """Return whether hot pixels can be detected: at least half of the pixels have fired.

    Where most pixels never fire, the mean of the sensor and of most neighbourhoods is about 0, and
    every pixel that does fire would be hot.

    Parameters
    ----------
    totals : ndarray of int, shape (height, width)
        Events of each pixel over the whole traverse.
    """
    return 2 * int(np.count_nonzero(totals)) >= totals.size


@kernel
def _above_neighbours(totals):  # type: ignore[no-untyped-def]
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
            # NumPy's sort of these few numbers takes 2 s to compile
            for i in range(1, n):
                total, j = around[i], i
                while j > 0 and around[j - 1] > total:
                    around[j] = around[j - 1]
                    j -= 1
                around[j] = total
            median = around[n // 2] if n > 0 else 0
            above[y, x] = totals[y, x] > HOT_FACTOR * (median + 1)
    return above


def load_hot_pixels(path: str | Path, sensor: Sensor) -> npt.NDArray[np.bool_]:
    """Read a list of hot pixels, ``x, y`` in each line, as in the data set Brisbane-Event-VPR.

    Parameters
    ----------
    path : path
        Text file; empty lines, lines that start with ``#``, and a header are skipped.

    Returns
    -------
    ndarray of bool, shape (height, width)

    Raises
    ------
    RecordingError
        If the file cannot be read or is larger than 64 MiB, or a line is not a pixel of the sensor.
    """
    x, y = load_pixels(path, sensor, "list of hot pixels").T
    width, height = Sensor.of(sensor)
    hot = np.zeros((height, width), dtype=np.bool_)
    hot[y, x] = True
    return hot


def load_pixels(path: str | Path, sensor: Sensor, what: str) -> npt.NDArray[np.int64]:
    """Read a list of pixels, ``x, y`` in each line.

    Parameters
    ----------
    path : path
        Text file; empty lines, lines that start with ``#``, and a header are skipped.
    what : str
        What the file is, for messages.

    Returns
    -------
    ndarray of int64, shape (n, 2)
        Column and row of each, in the order of the file.
    """
    sensor, path = Sensor.of(sensor), as_path(path, f"a {what}")
    try:
        with open_input(path) as file:
            raw = file.read(_LONGEST_LIST + 1)
        if len(raw) > _LONGEST_LIST:
            raise RecordingError(
                f"{path} has more than {_LONGEST_LIST:,} bytes: name a file with a line x, y for "
                "each pixel"
            )
        lines = raw.decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"cannot read the {what} {path}: {getattr(error, 'strerror', None) or error}: name a "
            "file with a line x, y for each"
        ) from error
    pixels = []
    for number, line in enumerate(lines, 1):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#") or (number == 1 and fields[0].isalpha()):
            continue
        try:
            x, y = (_whole(field) for field in fields)
        except (ValueError, OverflowError) as error:
            raise RecordingError(
                f"line {number} of {path} is {line!r}: expected the column and row of a pixel"
            ) from error
        if not (0 <= x < sensor.width and 0 <= y < sensor.height):
            raise RecordingError(
                f"line {number} of {path} names the pixel ({x}, {y}), off the {sensor} sensor: "
                "give the list that belongs to this camera"
            )
        pixels.append((x, y))
    return np.array(pixels, dtype=np.int64).reshape(-1, 2)


def _whole(text: str) -> int:
    number = number_in(text)
    if not number.is_integer():  # infinity too
        raise ValueError(text)
    return int(number)
