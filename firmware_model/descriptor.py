"""Model of the descriptor unit: look-up, saturating counters, end of window, codes, clearing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from firmware_model.memories import Codes, Memories
from firmware_model.running import ActivityModel, MeanModel


class Event(NamedTuple):
    """One event as the sensor sends it."""

    t: int
    x: int
    y: int
    on: bool


class EventResult(NamedTuple):
    """Result of one event; slot None and count 0 if its pixel is not selected."""

    number: int
    slot: int | None
    counted: int


class WindowResult(NamedTuple):
    """A window that ended, and the number of events processed before its end.

    It is quiet if it has so few events at selected pixels that the camera hardly moves, and a pause
    too if it has so few that the camera must be standing.
    """

    number: int
    events: int
    codes: Codes
    quiet: bool = False
    paused: bool = False


class DescriptorModel:
    """Counts events at selected pixels, window by window.

    Parameters
    ----------
    memories : Memories
    start : int
        Time at which the first window opens, microseconds. Only its lower `timestamp_bits` matter,
        here and in every event.

    Attributes
    ----------
    memories : Memories
    lookup : Lookup
    counts : list of int, length slots
        Of the open window.
    start : int
        Of the open window, modulo 2 to the power `timestamp_bits`; of no meaning for windows by
        count.
    counted : int
        Events at selected pixels in the open window.
    events, windows : int
        Taken, and ended, so far.
    activity : ActivityModel
    mean : MeanModel
        Of own-mean codes.
    """

    def __init__(self, memories: Memories, start: int = 0) -> None:
        self.design = memories.design
        self.memories = memories
        self.lookup = memories.lookup()
        self._count_max = self.design.count_max
        self._period = 1 << self.design.timestamp_bits
        self.counts = [0] * self.design.slots
        self.start = start % self._period
        self.counted = 0
        self.events = 0
        self.windows = 0
        self.activity = ActivityModel(memories.activity)
        self.mean = MeanModel(self.design, memories.mean)

    @property
    def codes(self) -> Codes:
        """Codes of the present counts."""
        return tuple(
            self.mean.code(slot, entry) if self.design.own_mean else entry
            for slot, entry in enumerate(self._entries())
        )

    def _entries(self) -> list[int]:
        return [self.memories.entry(slot, count) for slot, count in enumerate(self.counts)]

    def elapsed(self, t: int) -> int:
        """Return the time since the start of the open window; negative for an earlier event.

        The rest of the window is a signed number of the width of the clock: any time is taken as at
        most half a period of the clock before or after the end of the window.
        """
        end, half = self.start + self.design.tau_us, self._period // 2
        left = (end - t + half) % self._period - half
        return self.design.tau_us - left

    def take(self, event: Event) -> Iterator[EventResult | WindowResult]:
        """Process an event: first close all windows that end before it, then count it.

        Yields
        ------
        WindowResult or EventResult
            In the order in which they happen. The counters are cleared when the window's result
            has been taken.
        """
        design = self.design
        if design.window == "time":
            while self.elapsed(event.t) >= design.tau_us:
                yield from self._end_window()
        slot = self.slot(event)
        if slot is not None:
            self.counts[slot] = min(self.counts[slot] + 1, self._count_max)
            self.counted += 1
        count = 0 if slot is None else self.counts[slot]
        self.events += 1
        yield EventResult(self.events - 1, slot, count)
        if design.window == "count" and self.counted == design.window_events:
            yield from self._end_window()

    def slot(self, event: Event) -> int | None:
        """Return the counter of an event; None if not selected or off the sensor."""
        design = self.design
        if event.x >= design.width or event.y >= design.height:
            return None
        slot = self.lookup(event.x, event.y)
        if slot is not None and design.polarity and not event.on:
            return slot + design.pixels
        return slot

    def _end_window(self) -> Iterator[WindowResult]:
        paused = self.activity.pauses(self.counted)
        quiet = self.activity.is_quiet(self.counted)
        yield WindowResult(self.windows, self.events, self.codes, quiet, paused)
        if self.design.own_mean and not paused:
            self.mean.update(self._entries())
        self.activity.update(self.counted)
        self.counts = [0] * self.design.slots
        self.counted = 0
        self.windows += 1
        if self.design.window == "time":
            self.start = (self.start + self.design.tau_us) % self._period
