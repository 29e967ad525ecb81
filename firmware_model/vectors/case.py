"""Cases: a design with its tables and a stimulus, and the records that a device returns."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Self

from firmware_model.design import Design
from firmware_model.errors import VectorError
from firmware_model.memories import Codes, Memories, Pixel
from firmware_model.specification import (
    Event,
    EventResult,
    MatchResult,
    Result,
    Trace,
    WindowResult,
    trace,
)

#: value that stands for an absent one
NONE = 0xFFFF_FFFF
#: kinds of records; binary files hold the index of the kind
KINDS = ("case", "event", "window", "match")

#: kind and values, all of them integers
Record = tuple[str, tuple[int, ...]]


@dataclass(frozen=True)
class Case:
    """Stimulus for a device of one design.

    Attributes
    ----------
    name : str
        Unique within its suite.
    events : tuple of Event
        Times are on the device's clock, which may wrap.
    start : int
        Time at which the first window opens.
    """

    name: str
    memories: Memories
    events: tuple[Event, ...]
    start: int = 0

    @property
    def design(self) -> Design:
        """Design of the device."""
        return self.memories.design

    def trace(self) -> Trace:
        """Run the model over the stimulus."""
        return trace(self.memories, self.events, self.start)

    def event_bytes(self) -> bytes:
        """Pack the events as the reference firmware takes them, eight bytes each."""
        if self.design.timestamp_bits > 32:
            raise VectorError(f"times of {self.design.timestamp_bits} bits: the firmware has 32")
        packed = (struct.pack("<IHH", e.t, e.x, e.y | e.on << 15) for e in self.events)
        return b"".join(packed)


def in_order(done: Trace) -> Iterator[Result]:
    """Yield all results in the order in which they happened.

    A window that ended after n events comes before event n, and its match follows the window.
    """
    matches = {match.window: match for match in done.matches}
    ended = iter(done.windows)
    window = next(ended, None)
    for number in range(len(done.events) + 1):
        while window is not None and window.events == number:
            yield window
            if window.number in matches:
                yield matches[window.number]
            window = next(ended, None)
        if number < len(done.events):
            yield done.events[number]


def records(results: Iterable[Result]) -> Iterator[Record]:
    """Convert results to the records of a device: integers, `NONE` for an absent value.

    The trust of a filter's match is the last value of its record.
    """
    for result in results:
        if isinstance(result, EventResult):
            yield "event", (result.number, _or_none(result.slot), result.counted)
        elif isinstance(result, WindowResult):
            yield "window", (result.number, result.events, *result.codes)
        elif isinstance(result, MatchResult):
            shown = result if result.trust is not None else result[:-1]
            yield "match", tuple(_or_none(value) for value in shown)


def to_binary(records: Iterable[Record]) -> bytes:
    """Write records as 32-bit little-endian words: kind, number of values, values."""
    parts = []
    for kind, values in records:
        parts.append(struct.pack(f"<{len(values) + 2}I", KINDS.index(kind), len(values), *values))
    return b"".join(parts)


def from_binary(data: bytes, source: str = "results") -> Iterator[Record]:
    """Read the records that `to_binary` or ``c/replay.c`` wrote.

    Raises
    ------
    VectorError
        If a record is of an unknown kind, or cut off.
    """
    if len(data) % 4:
        raise VectorError(f"{source} has {len(data)} bytes: expected 32-bit words")
    words = struct.unpack(f"<{len(data) // 4}I", data)
    at = 0
    while at < len(words):
        if at + 2 > len(words) or words[at] >= len(KINDS) or at + 2 + words[at + 1] > len(words):
            raise VectorError(
                f"{source}: word {at} begins no whole record: expected a kind below {len(KINDS)}, "
                "the number of values, and the values"
            )
        yield KINDS[words[at]], words[at + 2 : at + 2 + words[at + 1]]
        at += 2 + words[at + 1]


def _or_none(value: int | None) -> int:
    return NONE if value is None else int(value)


# Stimuli under construction: pixels to select, and events and windows on a design's clock.


class Stream:
    """Stimulus under construction, on the clock of the design, with `choose_pixels` selected."""

    def __init__(self, design: Design, start: int = 0) -> None:
        self.design = design
        self.pixels = choose_pixels(design)
        self.start = start
        self.events: list[Event] = []
        self._chosen = frozenset(self.pixels)
        self._window = 0  # number of the open window
        self._counted = 0

    def at(self, x: int, y: int, offset: int = 0, on: bool = True) -> None:
        """Add an event, `offset` microseconds after the start of the open window."""
        t = self.start + self._window * self.design.tau_us + offset
        self.events.append(Event(t % (1 << self.design.timestamp_bits), x, y, on))
        if (x, y) in self._chosen:
            self._counted = (self._counted + 1) % self.design.window_events

    def unselected(self) -> None:
        """Add an event at the first pixel that is not selected; beside the sensor if all are."""
        width, height = self.design.width, self.design.height
        every = ((i % width, i // width) for i in range(width * height))
        self.at(*next((pixel for pixel in every if pixel not in self._chosen), (width, 0)))

    def slot(self, slot: int, times: int = 1, offset: int = 0) -> None:
        """Add events that are counted by a slot."""
        for _ in range(times):
            self.at(*self.pixels[slot], offset)

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
    def showing(cls, design: Design, windows: Iterable[Sequence[int]]) -> Self:
        """Make the stimulus of windows with these counts of each slot."""
        stream = cls(design)
        for counts in windows:
            stream.fill(counts)
        stream.close()
        return stream

    def close(self) -> None:
        """Add an event after the last window by time, so that a device ends this window."""
        if self.design.window == "time":
            self.at(*self.pixels[0])

    def shown_codes(self, mean: Sequence[int] | None = None) -> list[Codes]:
        """Return the codes of each window that it ends, with means that begin at `mean`."""
        no_places = [[0] * self.design.slots] * self.design.places
        memories = Memories(self.design, self.pixels, no_places, mean)
        return window_codes(memories, self.events, self.start)

    def case(self, name: str, places: Sequence[Sequence[int]], **tables: Any) -> Case:
        """Make the case of a map of these places; `tables` that it has go to `Memories`."""
        design = self.design
        has = {"activity": design.pauses, "mean": design.contrast, "limits": design.contrast}
        tables = {what: table for what, table in tables.items() if has.get(what, design.filters)}
        memories = Memories(design, self.pixels, places, **tables)
        return Case(name, memories, tuple(self.events), self.start)


def window_codes(memories: Memories, events: Iterable[Event], start: int) -> list[Codes]:
    """Return the codes of each window that events end."""
    # matching is the quickest by sequences of one window, to one place
    design = replace(
        memories.design, matching="sequence", length=1, places=1, trust=0, places_per_window=1,
        gains=1,
    )  # fmt: skip
    memories = replace(
        memories, design=design, places=memories.places[:1], place_activity=(), place_bias=(),
        activity=memories.activity if design.contrast else 0,
    )  # fmt: skip
    return [window.codes for window in trace(memories, events, start).windows]


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
