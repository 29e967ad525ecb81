"""Cases: a design with its tables and a stimulus, and the records that a device returns."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from firmware_model.comparator import MatchResult
from firmware_model.descriptor import Event, EventResult, WindowResult
from firmware_model.design import Design
from firmware_model.errors import VectorError
from firmware_model.machine import Result, Trace, trace
from firmware_model.memories import Memories

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
    memories : Memories
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
        """Pack the events as the reference firmware takes them, eight bytes each.

        Raises
        ------
        VectorError
            If the clock has more than 32 bits.
        """
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
            told = result if result.trust is not None else result[:-1]
            yield "match", tuple(_or_none(value) for value in told)


def to_binary(found: Iterable[Record]) -> bytes:
    """Write records as 32-bit little-endian words: kind, number of values, values."""
    parts = []
    for kind, values in found:
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
