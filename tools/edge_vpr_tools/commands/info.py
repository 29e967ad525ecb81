"""`edge-vpr info`: what a recording holds, faults included."""

from __future__ import annotations

import argparse
from typing import Any

from edge_vpr_tools.arguments.reading import add_reading_arguments

HELP = "say what a recording holds: sensor, events, duration, rate, polarity, faults"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="FILE", help="recording of any known format")
    parser.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    # faults are what this command is asked for: it counts them and goes on
    add_reading_arguments(parser, on_fault=False)


def run(args: argparse.Namespace) -> None:
    """Read the whole recording once and print what it holds.

    Raises
    ------
    EdgeVprError
        If it cannot be opened.
    """
    import json

    from edge_vpr.recordings import FORMATS
    from edge_vpr_tools.arguments.reading import open_from
    from edge_vpr_tools.output.progress import tracked

    recording = open_from(args, args.recording, on_fault="drop")
    facts = summary(tracked(recording, "reading"))
    if args.json:
        print(json.dumps(facts))
        return
    rate = facts["events_per_s"]
    lines = {
        "format": f"{facts['format']} ({FORMATS[facts['format']].title})",
        "sensor": facts["sensor"],
        "events": f"{facts['events']:,}",
        "duration": f"{facts['duration_us'] / 1e6:.6f} s",
        "rate": "-" if rate is None else f"{rate:,.0f} events/s",
        "polarity": f"{facts['on_share']:.1%} ON, {1 - facts['on_share']:.1%} OFF",
        "times": f"{facts['first_us']:,} to {facts['last_us']:,} us from the start",
        "start": f"{facts['start_us']:,} us on the file's clock",
        "faults": str(recording.faults),
    }
    for name, text in lines.items():
        print(f"{name:<9} {text}")


def summary(recording: Any) -> dict[str, Any]:
    """Count a recording in one pass.

    Returns
    -------
    dict
        Plain values; ``events_per_s`` is None if the recording has no duration.
    """
    from dataclasses import asdict

    n = on = last = 0
    first: int | None = None
    for events in recording:
        first = int(events["t"][0]) if first is None else first
        last = int(events["t"][-1])
        n += int(events.size)
        on += int(events["p"].sum())
    first = first or 0
    duration = last - first
    return {
        "path": str(recording.path),
        "format": recording.format,
        "sensor": str(recording.sensor),
        "events": n,
        "duration_us": duration,
        "events_per_s": n * 1e6 / duration if duration else None,
        "on_share": on / n,
        "first_us": first,
        "last_us": last,
        "start_us": recording.start_us,
        "faults": asdict(recording.faults),
    }
