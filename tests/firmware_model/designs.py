"""Random streams for the firmware model's tests, and a case run by the model and by C."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from firmware_model import Design, Event, Memories, ToolError
from firmware_model.image import image
from firmware_model.vectors import Case, in_order, records, to_binary
from firmware_model.vectors.random_cases import (
    random_adaptive_design,
    random_design,
    random_memories,
)


def random_stream(
    rng: np.random.Generator, memories: Memories, n: int, start: int = 0
) -> list[Event]:
    """Events in time order after `start`, most at selected pixels, with pauses of some windows."""
    design = memories.design
    steps = rng.integers(0, max(2, design.tau_us // 4), n)
    longest = (1 << (design.timestamp_bits - 1)) - design.tau_us
    pauses = rng.integers(0, min(4 * design.tau_us, longest) + 1, n)
    times = start + np.cumsum(np.where(rng.random(n) < 0.02, pauses, np.minimum(steps, longest)))
    events = []
    for t in times.tolist():
        x, y = memories.pixels[rng.integers(design.pixels)]
        if rng.random() < 0.3:
            x, y = rng.integers(design.width), rng.integers(design.height)
        events.append(Event(t, int(x), int(y), bool(rng.integers(2))))
    return events


def drawn_drive(seed: int, *, adaptive: bool) -> tuple[Memories, int, list[Event]]:
    """Draw a design of sequences or of the filter and contrast codes, its tables and a stream."""
    rng = np.random.default_rng(seed)
    design = random_adaptive_design(rng, (1, 7)) if adaptive else random_design(rng)
    memories = random_memories(rng, design)
    start = int(rng.integers(0, 1 << design.timestamp_bits))
    return memories, start, random_stream(rng, memories, 150, start)


def wrapped(events: list[Event], design: Design) -> list[Event]:
    """The same events by a clock of `timestamp_bits`."""
    return [event._replace(t=event.t % (1 << design.timestamp_bits)) for event in events]


def told(case: Case) -> bytes:
    """What the model says to a case."""
    return to_binary(records(in_order(case.trace())))


def run_host(program: Path, case: Case, folder: Path) -> bytes:
    """The records of a case by the program of this computer; its message is an error."""
    image_file, events_file, start_file, out = (
        folder / f"{program.stem}.{suffix}" for suffix in ("img", "evt", "mem", "out")
    )
    image_file.write_bytes(image(case.memories))
    events_file.write_bytes(case.event_bytes())
    start_file.write_text(f"{case.start:08x}\n")
    command = [*map(str, (program.absolute(), image_file, events_file, start_file, out))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ToolError(done.stderr.strip())
    return out.read_bytes()
