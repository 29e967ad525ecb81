"""`edge-vpr info`: what a recording holds, faults included."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from edge_vpr.recordings import FORMATS
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.output.progress import tracked


def run(args: argparse.Namespace) -> None:
    """Read the whole recording once and print what it holds.

    Raises
    ------
    EdgeVprError
        If it cannot be opened.
    """
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
