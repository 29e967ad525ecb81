"""`edge-vpr info`: show what a recording holds, including its faults."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edge_vpr_tools.console import summary
from edge_vpr_tools.flags import add_reading_arguments

if TYPE_CHECKING:
    from edge_vpr.recordings import Faults, Recording


EXAMPLES = """\
  edge-vpr info monday.raw
  edge-vpr info monday.csv --sensor 346x260 --time-unit us --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="FILE", help="recording of any known format")
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    # faults are what this command is asked for: it counts them and goes on
    add_reading_arguments(parser, on_fault=False)


# Summary of a recording: events, duration, polarity, times and faults.


@dataclass(frozen=True)
class RecordingSummary:
    """Result of one pass over a recording."""

    path: str
    format: str
    sensor: str
    events: int
    duration_us: int
    events_per_s: float | None  #: None if the recording has no duration.
    on_share: float  #: Share of ON events.
    #: first_us, last_us: from the start of the recording.
    first_us: int
    last_us: int
    start_us: int  #: On the file's clock.
    faults: Faults


def summarise(recording: Recording) -> RecordingSummary:
    """Count a recording in one pass."""
    n = on = last = 0
    first: int | None = None
    for events in recording:
        first = int(events["t"][0]) if first is None else first
        last = int(events["t"][-1])
        n += int(events.size)
        on += int(events["p"].sum())
    first = first or 0
    duration = last - first
    return RecordingSummary(
        path=str(recording.path),
        format=recording.format,
        sensor=str(recording.sensor),
        events=n,
        duration_us=duration,
        events_per_s=n * 1e6 / duration if duration else None,
        on_share=on / n,
        first_us=first,
        last_us=last,
        start_us=recording.start_us,
        faults=recording.faults,
    )


def run(args: argparse.Namespace) -> None:
    """Read the whole recording once and print what it holds."""
    from edge_vpr.recordings import format_of
    from edge_vpr.results import json_text
    from edge_vpr_tools.inputs import open_from, tracked

    recording = open_from(args, args.recording)
    facts = summarise(tracked(recording, "reading"))
    if args.json:
        print(json_text(facts))
        return
    rate = facts.events_per_s
    lines = {
        "format": f"{facts.format} ({format_of(facts.format).title})",
        "sensor": facts.sensor,
        "events": f"{facts.events:,}",
        "duration": f"{facts.duration_us / 1e6:.6f} s",
        "rate": "-" if rate is None else f"{rate:,.0f} events/s",
        "polarity": f"{facts.on_share:.1%} ON, {1 - facts.on_share:.1%} OFF",
        "times": f"{facts.first_us:,} to {facts.last_us:,} µs from the start",
        "start": f"{facts.start_us:,} µs on the file's clock",
        "faults": str(recording.faults),
    }
    for name, text in lines.items():
        summary(f"{name:<9} {text}")
