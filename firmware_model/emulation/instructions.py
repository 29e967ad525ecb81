"""Measure the cost of the firmware on each processor: instructions, code, RAM and stack.

``python -m firmware_model.emulation.instructions`` writes the table next to the
C sources, which a test compares with a new count.
"""

from __future__ import annotations

import argparse
import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from firmware_model.design import Design
from firmware_model.emulation.build import COUNTED, FIRMWARE, SOURCES, Target, build, compiler
from firmware_model.emulation.emulator import Emulator
from firmware_model.image import image, ram_bytes, stride
from firmware_model.memories import Memories
from firmware_model.vectors.case import choose_pixels
from firmware_model.vectors.formats import csv_text

TABLE = SOURCES / "instructions.csv"

#: the measured design: 150 pixels of a DAVIS346, codes of 4 bits, sequences of 5
DESIGN = Design(width=346, height=260, pixels=150, places=40, length=5, code_bits=4)
#: the same with contrast codes and the place filter
FILTER = Design(
    width=346, height=260, pixels=150, places=40, code="contrast", code_bits=4, matching="filter"
)  # fmt: skip
#: the same with seven gains, at half places
GAINS = replace(FILTER, places_per_window=2, gains=7)

# addresses are not needed inside: the structures are opaque here
_STRUCT_BYTES = 512

#: windows of a filter before the counted one, because the first one takes longer
_WINDOWS = 3

_Event = tuple[int, int, int, bool]


@dataclass(frozen=True)
class Instructions:
    """Cost of the firmware on one processor, for `DESIGN`."""

    target: str
    sad: str  #: How distances are computed on this processor.
    compiler: str  #: With another version of it or other flags, the figures are others.
    #: Instructions that an event at a selected pixel adds to a batch: the most of all of them, with
    #: full counters too.
    event_selected: int
    #: What one elsewhere adds: the most of those whose look-up entry is empty, or another's, and of
    #: those off the sensor.
    event_unselected: int
    events_call: int  #: What a call of `vpr_events` adds to its events.
    window_end: int  #: Of `vpr_window_end`.
    match: int  #: Of `vpr_match_places` with L windows seen.
    match_per_place: int  #: What a further place adds to a match.
    contrast_window_end: int  #: Of `vpr_window_end` with contrast codes.
    filter_match: int  #: Of a match by the place filter, for `FILTER`.
    filter_per_place: int
    half_per_place: int  #: Of a place at half windows.
    gains_window_end: int  #: Of `vpr_window_end` with seven gains.
    gains_match: int  #: Of a match by the place filter with seven gains, for `GAINS`.
    gains_per_place: int  #: Of a place at half windows, with two sums in use.
    sad_per_byte: float  #: Of a distance with call and return, over the slots (not their padding).
    code_bytes: int  #: Functions and constants of ``vpr.c``.
    ram_bytes: int  #: Arrays and structures, beside the stack.
    filter_ram_bytes: int
    gains_ram_bytes: int
    stack_bytes: int  #: The most of all functions.


class FirmwareRun:
    """The firmware with an opened design, and the instructions of its calls so far."""

    def __init__(self, emulator: Emulator, memories: Memories) -> None:
        self.emulator, self.pixels = emulator, memories.pixels
        emulator.release()
        flash = image(memories)
        self.image = emulator.put(flash)
        self.design, self.state, self.result = (
            emulator.put(bytes(_STRUCT_BYTES)) for _ in range(3)
        )
        self.ram = emulator.put(bytes(ram_bytes(memories.design)))
        if not emulator.call("vpr_open", self.design, self.image, len(flash)) & 1:
            raise AssertionError("the firmware refuses its own design")
        self.reset()

    def reset(self) -> None:
        """Start again, without counting."""
        self.emulator.call("vpr_reset", self.design, self.state, self.ram, 0)

    def count(self, function: str, *arguments: int) -> tuple[int, int]:
        """Call a function; return its result and number of instructions."""
        return self.emulator.call(function, *arguments, count=True), self.emulator.instructions

    def take(self, events: Sequence[_Event], before: int = 0) -> int:
        """Count the instructions of a batch, in a window with the first event `before` times."""
        call = self.emulator.call
        self.reset()
        if before:
            call("vpr_events", self.design, self.state, *self._put([events[0]] * before))
        return self.count("vpr_events", self.design, self.state, *self._put(events))[1]

    def _put(self, events: Sequence[_Event]) -> tuple[int, int]:
        """Return the addresses of a pointer to the first event and after the last event."""
        packed = b"".join(struct.pack("<IHH", t, x, y | on << 15) for t, x, y, on in events)
        first = self.emulator.put(packed)
        return self.emulator.put(first.to_bytes(8, "little")), first + len(packed)

    def see(self) -> None:
        """Process an event at a selected pixel, without counting."""
        x, y = self.pixels[0]
        self.emulator.call("vpr_events", self.design, self.state, *self._put([(1, x, y, True)]))

    def each(self, events: Sequence[_Event], before: int = 0) -> int:
        """Return the largest number of instructions that one more event adds to a batch."""
        return max(self.take([e] * 2, before) - self.take([e], before) for e in events)

    def match(self, length: int) -> tuple[int, int]:
        """Count the instructions of a window's end, and of its match with `length` windows seen.

        All windows have an event at a selected pixel, so that none pauses.
        """
        end = "vpr_window_end", self.design, self.state
        match = "vpr_match_places", self.design, self.state, self.result
        for _ in range(length - 1):
            self.see()
            self.emulator.call(*end)
            self.emulator.call(*match)
        self.see()
        return self.count(*end)[1], self.count(*match)[1]


def measure(target: Target, folder: str | Path) -> Instructions:
    """Count instructions and sizes on one processor; `folder` is for what is compiled.

    Raises
    ------
    ToolError
        If compiler or emulator are not installed.
    """
    emulator = Emulator(target, build(target, folder, files=(*FIRMWARE, "probe.c"), name="probed"))
    run = FirmwareRun(emulator, _memories(DESIGN))
    structures = run.count("probe_struct_bytes")[0]
    pixels = choose_pixels(DESIGN)
    selected = [(1, x, y, on) for x, y in pixels for on in (True, False)]
    chosen = set(pixels)
    around = [(x, y) for y in range(0, 260, 26) for x in range(0, 346, 23)]
    around += [(346, 0), (0, 260), (345, 259)]
    elsewhere = [(1, x, y, True) for x, y in around if (x, y) not in chosen]
    nearly_full = DESIGN.count_max - 1
    per_selected = max(
        run.each(selected), *(run.each(selected[:1], nearly_full + i) for i in (0, 1))
    )
    per_other = run.each(elsewhere)
    call = 2 * run.take(selected[:1]) - run.take(selected[:1] * 2)
    row = stride(DESIGN)
    rows = (emulator.put(bytes(range(row))), emulator.put(bytes(reversed(range(row)))))
    distance = run.count("probe_sad", *rows, row)[1]
    ended, matched, per_place = _match_of(emulator, DESIGN)
    contrast, filtered, filter_per_place = _match_of(emulator, FILTER)
    _, _, half_per_place = _match_of(emulator, replace(FILTER, places_per_window=2))
    gains, matched_gains, gains_per_place = _match_of(emulator, GAINS)
    alone = Emulator(target, build(target, folder, files=("vpr.c",), name="alone"))
    return Instructions(
        target=target.name,
        sad=target.sad,
        compiler=compiler(target),
        event_selected=per_selected,
        event_unselected=per_other,
        events_call=call,
        window_end=ended,
        match=matched,
        match_per_place=per_place,
        contrast_window_end=contrast,
        filter_match=filtered,
        filter_per_place=filter_per_place,
        half_per_place=half_per_place,
        gains_window_end=gains,
        gains_match=matched_gains,
        gains_per_place=gains_per_place,
        sad_per_byte=round(distance / DESIGN.slots, 2),
        code_bytes=alone.code_bytes,
        ram_bytes=ram_bytes(DESIGN) + structures,
        filter_ram_bytes=ram_bytes(FILTER) + structures,
        gains_ram_bytes=ram_bytes(GAINS) + structures,
        stack_bytes=emulator.stack,
    )


def _match_of(emulator: Emulator, design: Design) -> tuple[int, int, int]:
    """Count a window's end and its match, and what a further place adds to a match."""
    half = replace(design, places=design.places // 2)
    windows = _WINDOWS if design.filters else design.length
    (ended, whole), (_, fewer) = (
        FirmwareRun(emulator, _memories(one)).match(windows) for one in (design, half)
    )
    return ended, whole, -(-(whole - fewer) // (design.places - half.places))


def _memories(design: Design) -> Memories:
    """Return places for which the search replaces the best one several times, its worst case."""
    top = design.code_max
    places = [[(k * 7 + slot) % (top + 1) for slot in range(design.slots)] for k in range(97)]
    return Memories(design, choose_pixels(design), [places[k % 97] for k in range(design.places)])


def table(rows: Sequence[Any]) -> str:
    """Write measurements, dataclasses of one kind and at least one, as CSV."""
    return csv_text(asdict(rows[0]), [list(asdict(row).values()) for row in rows])


def write_table(measured: Callable[[Target, str], Any], to: Path) -> None:
    """Measure all processors, and write the table beside the C sources."""
    argparse.ArgumentParser(description=write_table.__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        text = table([measured(target, folder) for target in COUNTED])
    to.write_text(text, encoding="ascii")


if __name__ == "__main__":
    write_table(measure, TABLE)
