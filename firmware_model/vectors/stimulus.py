"""Stimuli under construction: pixels to select, and events and windows on a design's clock."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Self

from firmware_model.descriptor import DescriptorModel, Event, WindowResult
from firmware_model.design import Design
from firmware_model.memories import Codes, Memories, Pixel


class Stream:
    """Stimulus under construction, on the clock of the design."""

    def __init__(self, design: Design, pixels: Sequence[Pixel], start: int = 0) -> None:
        self.design = design
        self.pixels = pixels
        self.start = start
        self.events: list[Event] = []
        self._chosen = frozenset(pixels)
        self._window = 0  # number of the open window
        self._counted = 0

    def at(self, x: int, y: int, offset: int = 0, on: bool = True) -> None:
        """Add an event, `offset` microseconds after the start of the open window."""
        t = self.start + self._window * self.design.tau_us + offset
        self.events.append(Event(t % (1 << self.design.timestamp_bits), x, y, on))
        if (x, y) in self._chosen:
            self._counted = (self._counted + 1) % self.design.window_events

    def slot(self, slot: int, times: int = 1, offset: int = 0) -> None:
        """Add events that are counted by a slot."""
        pixel, on = self.pixels[slot % self.design.pixels], slot < self.design.pixels
        for _ in range(times):
            self.at(*pixel, offset, on)

    def fill(self, counts: Sequence[int]) -> None:
        """Add the events of one window, `counts[slot]` for each slot, and end it.

        A window by count is ended by additional events at the last slot.
        """
        for slot, count in enumerate(counts):
            self.slot(slot, count)
        self.end()

    def end(self) -> None:
        """End the open window."""
        if self.design.window == "count" and self._counted:
            self.slot(self.design.slots - 1, self.design.window_events - self._counted)
        # time also advances in windows by count, where it has no effect
        self._window += 1

    def skip(self, windows: int) -> None:
        """Let the time of some windows pass without events."""
        self._window += windows

    @classmethod
    def showing(
        cls, design: Design, pixels: Sequence[Pixel], windows: Iterable[Sequence[int]]
    ) -> Self:
        """Make the stimulus of windows with these counts of each slot."""
        stream = cls(design, pixels)
        for counts in windows:
            stream.fill(counts)
        stream.close()
        return stream

    def close(self) -> None:
        """Add an event after the last window by time, so that a device ends this window."""
        if self.design.window == "time":
            self.at(*self.pixels[0])


def choose_pixels(design: Design) -> list[Pixel]:
    """Choose pixels in the sensor's corners, two in a column and two in a row, and elsewhere.

    The last pixel of the last row is left out, unless all pixels are selected.
    """
    right, bottom = design.width - 1, design.height - 1
    first = [(0, 0), (right, 0), (0, bottom), (right // 2, bottom // 2), (right // 2, 0)]
    number = design.width * design.height
    # steps of a prime number visit every pixel, unless the prime divides their number
    step = next(p for p in (7919, 104_729, 1) if number % p or p == 1)
    visited = (i * step % number for i in range(number))
    elsewhere = ((flat % design.width, flat // design.width) for flat in visited)
    chosen: dict[Pixel, None] = {}
    for pixel in chain(first, elsewhere):
        if len(chosen) == design.pixels:
            break
        if pixel != (right, bottom) or design.pixels == number:
            chosen[pixel] = None
    return list(chosen)


def unselected_pixel(design: Design, pixels: Sequence[Pixel]) -> Pixel:
    """Return the first pixel that is not selected, or one beside the sensor if all are."""
    chosen = set(pixels)
    for i in range(design.width * design.height):
        if (i % design.width, i // design.width) not in chosen:
            return i % design.width, i // design.width
    return design.width, 0


def shown_codes(
    stream: Stream,
    tables: Sequence[int] | None = None,
    codes: Sequence[Codes] | None = None,
    mean: Sequence[int] | None = None,
) -> list[Codes]:
    """Return the codes of each window that a stimulus ends; see `Memories` for the arguments."""
    no_places = [[0] * stream.design.slots] * stream.design.places
    memories = Memories(stream.design, stream.pixels, no_places, tables, codes, mean)
    model = DescriptorModel(memories, stream.start)
    results = [result for event in stream.events for result in model.take(event)]
    return [result.codes for result in results if isinstance(result, WindowResult)]
