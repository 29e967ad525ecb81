"""Removal of bursts without delay, for live matching."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.boxed import Box
from edge_vpr.compiling import kernel
from edge_vpr.descriptors.bursts import BURST_SHARE, BURST_SLOT_US
from edge_vpr.events import EVENT_DTYPE, Events, Sensor

_STATE = np.dtype(
    [("slot", "<i8"), ("pixels", "<i8"), ("pixels_before", "<i8"), ("removed", "<i8")]
)
#: Initial room for events.
_ROOM = 256


class _Fired(NamedTuple):
    """State of the kernel: the slot in which each pixel last fired, and room for events."""

    fired: npt.NDArray[np.int64]
    width: int
    state: npt.NDArray[np.void]
    room: Events


class CausalBurstFilter:
    """Removes the events of a burst from the moment at which it is recognised.

    Like `BurstFilter`, it checks whether more than half of all pixels have fired in a slot of 2 ms
    and the one before it, but it counts only the events so far. No event is delayed. The events of
    a burst before that moment pass: up to one of half of the pixels, and repeated events of these.

    Parameters
    ----------
    sensor : Sensor
        Without pixels: nothing is removed.

    Attributes
    ----------
    box : Box
        State for `keep`; call `make_room` before it.
    """

    #: Time before which all events have left the filter: the largest one, as no event is held.
    known_us = np.iinfo(np.int64).max

    def __init__(self, sensor: Sensor) -> None:
        state = np.zeros(1, dtype=_STATE)
        state["slot"] = -2
        fired = np.full(sensor.pixels, -2, dtype=np.int64)
        self._fired = _Fired(fired, sensor.width, state, np.empty(_ROOM, dtype=EVENT_DTYPE))
        self.box = Box(self._fired)

    @property
    def removed(self) -> int:
        """Events removed so far."""
        return int(self._fired.state["removed"][0])

    def make_room(self, n: int) -> None:
        """Make room for `n` events."""
        if n > self._fired.room.size:
            self._fired = self._fired._replace(room=np.empty(n, dtype=EVENT_DTYPE))
            self.box = Box(self._fired)

    def update(self, events: Events) -> Events:
        """Feed the next events; see `BurstFilter.update`."""
        if not events.size:
            return events
        self.make_room(events.size)
        return self.kept(events, keep(self.box.boxed, events))

    def kept(self, events: Events, n: int) -> Events:
        """Return the `n` of these events that `keep` has kept."""
        return events if n == events.size else self._fired.room[:n].copy()

    def pieces(self, events: Events) -> list[Events]:
        """See `BurstFilter.pieces`."""
        kept = self.update(events)
        return [kept] if kept.size else []

    def advance(self, until_us: int) -> Events:
        """See `BurstFilter.advance`; nothing is held."""
        return self._fired.room[:0]

    def finish(self) -> Events:
        """See `BurstFilter.finish`; nothing is held."""
        return self._fired.room[:0]


@kernel
def keep(box, events):  # type: ignore[no-untyped-def]
    """Copy the events outside of bursts known so far to `_Fired.room`; return their number."""
    fired, width, states, room = box.value
    if fired.size == 0:
        room[: events.size] = events
        return events.size
    s = states[0]
    slot, pixels, before, n = s["slot"], s["pixels"], s["pixels_before"], 0
    for i in range(events.size):
        event = events[i]
        now = event["t"] // BURST_SLOT_US
        if now != slot:
            before = pixels if now == slot + 1 else 0
            slot, pixels = now, 0
        at = np.int64(event["y"]) * width + np.int64(event["x"])
        last = fired[at]
        if last != now:
            # a pixel that fired in both slots is counted once
            before -= last == now - 1
            pixels += 1
            fired[at] = now
        if (pixels + before) * BURST_SHARE[1] <= fired.size * BURST_SHARE[0]:
            room[n] = event
            n += 1
    s["slot"], s["pixels"], s["pixels_before"] = slot, pixels, before
    s["removed"] += events.size - n
    return n
