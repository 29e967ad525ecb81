"""The descriptor unit: look-up, saturating counters, end of window, codes, running mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from firmware_model.model.design import ACTIVITY_BITS, Design, ilog
from firmware_model.model.memories import Codes, Memories
from fixedpoint.activity import EVENTS_TOP
from fixedpoint.own_mean import FIRST_SHIFT, LAST_SHIFT, LEVEL_BITS, MEAN_BITS

# Running means of a device: events of a window, and the logarithm of each counter.


#: a window is a pause if it has no events, or less than 1/16 of the usual number
PAUSE_SHIFT = 4
#: the usual number moves by 1/64 of the difference in a window
ACTIVITY_SHIFT = 6


def moved(value: int, target: int, shift: int) -> int:
    """Move a value by ``1 / 2**shift`` of its difference to a target, rounded down.

    It stays between 0 and a limit if the target does. Downwards it moves by at least 1.
    """
    return value + ((target - value) >> shift)


class ActivityModel:
    """Usual number of events in a window, and that of a window against it.

    Parameters
    ----------
    usual : int
        Where it starts, in units of 1/256 event.
    """

    def __init__(self, usual: int) -> None:
        self.usual = usual

    def relative(self, events: int) -> int:
        """Return the logarithm of a window's events less that of the usual number, 1/16 octave.

        Without events it is the least that there is, however far the usual number has fallen.
        """
        if events == 0:
            return -ilog(EVENTS_TOP)
        return ilog(min(events, EVENTS_TOP)) - ilog(self.usual >> ACTIVITY_BITS)

    def pauses(self, events: int) -> bool:
        """Return whether a window with this many events at selected pixels is a pause."""
        return events == 0 or events << (ACTIVITY_BITS + PAUSE_SHIFT) < self.usual

    def update(self, events: int) -> None:
        """Update by the number of events of a window, which saturates at 23 bits."""
        self.usual = moved(self.usual, min(events, EVENTS_TOP) << ACTIVITY_BITS, ACTIVITY_SHIFT)


class MeanModel:
    """Running mean of each counter's logarithm, and the codes of logarithms against it.

    Parameters
    ----------
    start : sequence of int, length slots
        In units of 1/256 octave.

    Attributes
    ----------
    total : list of int, length slots
        In units of 1/65,536 octave.
    windows : int
        How many it has taken; saturates where the shift is the last.
    """

    def __init__(self, design: Design, start: Sequence[int]) -> None:
        self._half, self._contrast = 1 << (design.code_bits - 1), design.contrast
        self.total = [mean << MEAN_BITS for mean in start]
        self.windows = 0

    @property
    def shift(self) -> int:
        """Shift of the difference in the next window: 4 at first, 8 in the end."""
        return ((1 << FIRST_SHIFT) + self.windows).bit_length() - 1

    def differences(self, levels: Sequence[int]) -> list[int]:
        """Return the logarithm of each counter less its rounded mean."""
        half = 1 << (MEAN_BITS - 1)
        pairs = zip(levels, self.total, strict=True)
        return [level - ((total + half) >> MEAN_BITS) for level, total in pairs]

    def window_mean(self, levels: Sequence[int]) -> int:
        """Return the mean of a window's differences, halves up; 0 but of contrast codes."""
        if not self._contrast:
            return 0
        total, number = sum(self.differences(levels)), len(levels)
        return (2 * total + number) // (2 * number)

    def codes(self, levels: Sequence[int]) -> Codes:
        """Return codes: octaves above the counter's and the window's mean, rounded, saturated."""
        window, half = self.window_mean(levels), 1 << (LEVEL_BITS - 1)
        octaves = ((one - window + half) >> LEVEL_BITS for one in self.differences(levels))
        return tuple(min(max(one, -self._half), self._half - 1) + self._half for one in octaves)

    def update(self, levels: Sequence[int]) -> None:
        """Update by the logarithms of a window."""
        shift = self.shift
        self.total = [
            moved(total, level << MEAN_BITS, shift)
            for total, level in zip(self.total, levels, strict=True)
        ]
        self.windows = min(self.windows + 1, (1 << LAST_SHIFT) - (1 << FIRST_SHIFT))


# Model of the descriptor unit: look-up, saturating counters, end of window, codes, clearing.


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

    Its activity is the logarithm of its events at selected pixels, less that of the usual number.
    It is a pause if it has so few that the camera must be standing.
    """

    number: int
    events: int
    codes: Codes
    activity: int = 0
    paused: bool = False


class DescriptorModel:
    """Counts events at selected pixels, window by window.

    Parameters
    ----------
    start : int
        Time at which the first window opens, microseconds. Only its lower `timestamp_bits` matter,
        here and in every event.

    Attributes
    ----------
    counts : list of int, length slots
        Of the open window.
    start : int
        Of the open window, modulo 2 to the power `timestamp_bits`; of no meaning for windows by
        count.
    counted : int
        Events at selected pixels in the open window.
    events, windows : int
        Taken, and ended, so far.
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
        entries = self.entries()
        return self.mean.codes(entries) if self.design.own_mean else tuple(entries)

    def entries(self) -> list[int]:
        """Return the entries of the present counts in their tables: codes, or logarithms."""
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
        activity = self.activity.relative(self.counted)
        yield WindowResult(self.windows, self.events, self.codes, activity, paused)
        if self.design.own_mean and not paused:
            self.mean.update(self.entries())
        self.activity.update(self.counted)
        self.counts = [0] * self.design.slots
        self.counted = 0
        self.windows += 1
        if self.design.window == "time":
            self.start = (self.start + self.design.tau_us) % self._period
