"""`edge-vpr info`: show what a recording holds, including its faults."""

from __future__ import annotations

import argparse
import json

from edge_vpr.recordings import FORMATS
from edge_vpr_tools.arguments.reading import open_from
from edge_vpr_tools.output.json_records import to_json
from edge_vpr_tools.output.messages import answer
from edge_vpr_tools.output.progress import tracked
from edge_vpr_tools.runs.recording_summary import summarise


def run(args: argparse.Namespace) -> None:
    """Read the whole recording once and print what it holds."""
    recording = open_from(args, args.recording, on_fault="drop")
    facts = summarise(tracked(recording, "reading"))
    if args.json:
        print(json.dumps(to_json(facts)))
        return
    rate = facts.events_per_s
    lines = {
        "format": f"{facts.format} ({FORMATS[facts.format].title})",
        "sensor": facts.sensor,
        "events": f"{facts.events:,}",
        "duration": f"{facts.duration_us / 1e6:.6f} s",
        "rate": "-" if rate is None else f"{rate:,.0f} events/s",
        "polarity": f"{facts.on_share:.1%} ON, {1 - facts.on_share:.1%} OFF",
        "times": f"{facts.first_us:,} to {facts.last_us:,} us from the start",
        "start": f"{facts.start_us:,} us on the file's clock",
        "faults": str(recording.faults),
    }
    for name, text in lines.items():
        answer(f"{name:<9} {text}")
