"""Measure the cost of the encoder of frames on each processor: instructions, code, RAM, stack.

``python -m firmware_model.emulation.evpr_instructions`` writes the table next to the
C sources, which a test compares with a new count.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_model.emulation.build import SOURCES, Target, build, compiler
from firmware_model.emulation.emulator import Emulator
from firmware_model.emulation.instructions import write_table

TABLE = SOURCES / "evpr_instructions.csv"

#: bytes of a frame before stuffing, and of the ring
FRAME_BYTES, BUFFER_BYTES = 512, 2_048
#: bits of x and y by bytes of an event: 128 x 128, and 346 x 260
BITS = {3: (7, 7), 4: (9, 9)}
#: number of events for averages: steps of 0 to 7 us, random pixels and polarities
EVENTS = 175


@dataclass(frozen=True)
class EvprInstructions:
    """Cost of the encoder on one processor."""

    target: str
    compiler: str  #: With another version of it or other flags, the figures are others.
    #: Instructions of `evpr_push` for an event of 3 or 4 bytes, without a pause, within a frame:
    #: the mean, and the most.
    event_3: float
    event_4: float
    event_most: int
    pause: int  #: What a pause adds to an event, at most.
    frame: int  #: What a frame's beginning and end add to its first and its last event, at most.
    empty_frame: int  #: Of `evpr_poll` when it makes one.
    poll: int  #: Of `evpr_poll` when there is nothing to do.
    dropped: int  #: Of `evpr_push` without room.
    send: int  #: Of `evpr_out` and `evpr_sent`, however many bytes.
    code_bytes: int  #: Functions and constants of ``evpr.c``.
    ram_bytes: int  #: Of `evpr_t`, beside the ring.
    stack_bytes: int  #: The most of all functions.


class _Run:
    """An encoder, and the instructions of its calls."""

    def __init__(self, emulator: Emulator, event_bytes: int) -> None:
        self.emulator, self.now = emulator, 0
        emulator.release()
        self.state = emulator.put(bytes(emulator.call("evpr_struct_bytes")))
        self._first = emulator.put(bytes(8))
        ring = emulator.put(bytes(BUFFER_BYTES))
        pointer = "Q" if emulator.target.triple.startswith("aarch64") else "I"
        config = struct.pack(
            f"<{pointer}IIHBBB", ring, BUFFER_BYTES, FRAME_BYTES, 1, event_bytes, *BITS[event_bytes]
        )
        if not self.count("evpr_init", emulator.put(config), 0) & 1:
            raise AssertionError("the encoder refuses its configuration")
        self.send()

    def count(self, function: str, *arguments: int) -> int:
        """Call a function, and store its number of instructions."""
        result = self.emulator.call(function, self.state, *arguments, count=True)
        self.instructions = self.emulator.instructions
        return result

    def push(self, step: int, x: int, y: int, on: int) -> bool:
        """Push an event."""
        self.now += step
        return bool(self.count("evpr_push", self.now, x, y, on) & 1)

    def poll(self, step: int) -> int:
        """Poll, and return the number of instructions."""
        self.now += step
        self.count("evpr_poll", self.now)
        return self.instructions

    def ready(self) -> int:
        """Return the bytes that can be sent, without counting."""
        return self.emulator.call("evpr_out", self.state, self._first)

    def send(self) -> tuple[int, int]:
        """Send all waiting bytes; return the bytes and the number of instructions."""
        ready = self.count("evpr_out", self._first)
        instructions = self.instructions
        self.count("evpr_sent", ready)
        return ready, instructions + self.instructions


def _events(event_bytes: int) -> list[tuple[int, int, int, int]]:
    """Return steps, columns, rows and polarities, always the same ones."""
    rng = random.Random(event_bytes)
    x_bits, y_bits = BITS[event_bytes]
    draws = (3, x_bits, y_bits, 1)
    return [tuple(rng.getrandbits(b) for b in draws) for _ in range(EVENTS)]  # type: ignore[misc]


def _stream(run: _Run, event_bytes: int) -> tuple[list[int], list[int]]:
    """Return the instructions of events within frames, and of the first and last ones of frames."""
    within: list[int] = []
    first: list[int] = []
    last: list[int] = []
    begins = True
    for event in _events(event_bytes):
        taken = run.push(*event)
        assert taken, "there is room"
        cost = run.instructions
        ends = run.ready() > 0
        if ends:
            run.send()
        (first if begins else last if ends else within).append(cost)
        begins = ends
    mean = round(sum(within) / len(within))
    return within, [a + b - 2 * mean for a, b in zip(first, last, strict=False)]


def measure(target: Target, folder: str | Path) -> EvprInstructions:
    """Count instructions and sizes on one processor; `folder` is for what is compiled.

    Raises
    ------
    ToolError
        If compiler or emulator are not installed.
    """
    driven = build(target, folder, files=("evpr.c", "evpr_drive.c"), name="evpr-driven")
    emulator = Emulator(target, driven)
    within, frames = {}, []
    for event_bytes in BITS:
        run = _Run(emulator, event_bytes)
        within[event_bytes], more = _stream(run, event_bytes)
        frames += more
    run = _Run(emulator, 3)
    pixels = [(x, y, on) for x in (0, 127) for y in (0, 127) for on in (0, 1)]
    costs = []
    for pixel in pixels:
        run.push(1, *pixel)  # begins a frame
        run.push(1, *pixel)
        without = run.instructions
        run.push(600, *pixel)  # more than 510 us
        costs.append(run.instructions - without)
        run.count("evpr_flush", run.now)
        run.send()
    idle = run.poll(1)
    empty = run.poll(100_000)
    ready, send = run.send()
    assert ready, "an empty frame"
    # the ring fills up, uncounted
    while emulator.call("evpr_push", run.state, run.now, 1, 1, 1) & 1:
        pass
    taken = run.push(0, 1, 1, 1)
    assert not taken, "the ring is full"
    dropped = run.instructions
    alone = Emulator(target, build(target, folder, files=("evpr.c",), name="evpr-alone"))
    return EvprInstructions(
        target=target.name,
        compiler=compiler(target),
        event_3=_mean(within[3]),
        event_4=_mean(within[4]),
        event_most=max(map(max, within.values())),
        pause=max(costs),
        frame=max(frames),
        empty_frame=empty,
        poll=idle,
        dropped=dropped,
        send=send,
        code_bytes=alone.code_bytes,
        ram_bytes=emulator.call("evpr_struct_bytes"),
        stack_bytes=emulator.stack,
    )


def _mean(values: Sequence[int]) -> float:
    return round(sum(values) / len(values), 1)


if __name__ == "__main__":
    write_table(measure, TABLE)
