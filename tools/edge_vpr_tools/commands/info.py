"""`edge-vpr info`: show what a recording or a map holds, including faults."""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr_tools.console import print_facts, summary, watched
from edge_vpr_tools.flags import add_reading_arguments, add_track_offset_flag, open_from

if TYPE_CHECKING:
    from edge_vpr.recordings import Faults, Recording


EXAMPLES = """\
  edge-vpr info monday.raw
  edge-vpr info monday.raw --track monday.nmea
  edge-vpr info monday_map.npz
  edge-vpr info monday.csv --sensor 346x260 --time-unit us --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("recording", metavar="FILE", help="recording of any known format, or a map")
    output = parser.add_argument_group("output")
    output.add_argument("--json", action="store_true", help="print one JSON object, for programs")
    track = parser.add_argument_group("positions")
    track.add_argument(
        "--track",
        metavar="FILE",
        help="track of the drive, as for map: show its length, speeds and gaps, and how much of "
        "the recording it covers",
    )
    add_track_offset_flag(track)
    # faults are what this command is asked for: it counts them and goes on
    add_reading_arguments(parser, on_fault=False)


# Summary of a recording: events, duration, polarity, times and faults.


@dataclass(frozen=True)
class RecordingSummary:
    """Result of one pass over a recording."""

    path: str
    format: str
    sensor: str | None  #: None if neither the file nor the user states it.
    #: largest_x, largest_y: of the events.
    largest_x: int
    largest_y: int
    events: int
    duration_us: int
    events_per_s: float | None  #: None if the recording has no duration.
    on_share: float | None  #: Share of ON events; None for a table without their polarity.
    #: first_us, last_us: from the start of the recording.
    first_us: int
    last_us: int
    start_us: int  #: On the file's clock.
    faults: Faults
    stopped_by: str | None  #: Fault of the file as a whole, or of the part that was not read.
    #: Lines on the drive and its track by their headings, where a track is given.
    facts: dict[str, str] = field(default_factory=dict)


def summarise(recording: Recording) -> RecordingSummary:
    """Count a recording in one pass, up to damage that nothing can be read behind."""
    n = on = last = x = y = 0
    first: int | None = None
    stopped_by = None
    try:
        for events in recording:
            first = int(events.t[0]) if first is None else first
            last = int(events.t[-1])
            n += int(events.size)
            on += int(events.p.sum())
            x, y = max(x, int(events.x.max())), max(y, int(events.y.max()))
    except RecordingError as error:
        if not n:
            raise
        stopped_by = str(error)
    first = first or 0
    duration = last - first
    return RecordingSummary(
        path=str(recording.path),
        format=recording.format,
        sensor=str(recording.sensor),
        largest_x=x,
        largest_y=y,
        events=n,
        duration_us=duration,
        events_per_s=n * 1e6 / duration if duration else None,
        on_share=None if recording.without_polarity else on / n,
        first_us=first,
        last_us=last,
        start_us=recording.start_us,
        faults=recording.faults,
        stopped_by=stopped_by,
    )


def run(args: argparse.Namespace) -> None:
    """Read the whole file once and print what it holds."""
    from edge_vpr.archive import archive_kind
    from edge_vpr.events import LONGEST_SIDE
    from edge_vpr.recordings import format_of
    from edge_vpr.recordings.reading import SensorNotStated
    from edge_vpr.records import json_text
    from edge_vpr.reference_map import KIND, ReferenceMap

    if archive_kind(args.recording) == KIND:
        if args.track is not None:
            raise UsageError(
                f"--track is of a recording, and {args.recording} is none: leave it out"
            )
        info = ReferenceMap.load(args.recording).info()
        if args.json:
            print(json_text({"path": args.recording, "format": "map", **asdict(info)}))
        for name, text in {"format": "map (reference map of edge-vpr)", **info.lines}.items():
            summary(f"{name:<9} {text}")
        return

    try:
        recording = open_from(args, args.recording)
        facts = summarise(watched(recording, "reading"))
    except SensorNotStated:
        args.sensor = f"{LONGEST_SIDE}x{LONGEST_SIDE}"  # which holds all events
        recording = open_from(args, args.recording)
        facts = replace(summarise(watched(recording, "reading")), sensor=None)
    if args.track is not None:
        facts = replace(facts, facts=_with_track(args, facts, recording.cropped_us))
    if args.json:
        print(json_text(facts))
    else:
        _show(facts, format_of(facts.format).title)
    if facts.stopped_by is not None:
        raise RecordingError(facts.stopped_by)


def _with_track(
    args: argparse.Namespace, recording: RecordingSummary, cropped_us: int
) -> dict[str, str]:
    """Return the facts of a recording, or a part of it, and of its track."""
    from edge_vpr.evaluation.facts import Drive, facts
    from edge_vpr.evaluation.track_files import load_track

    track = load_track(args.track).shifted(args.track_offset or 0.0)
    drive = Drive(
        recording.events,
        cropped_us,
        cropped_us + recording.last_us,
        recording.sensor or "unstated",
        recording.start_us - cropped_us,
        track,
    )
    return facts({"drive": drive})


def _show(facts: RecordingSummary, title: str) -> None:
    rate = facts.events_per_s
    lines = {
        "format": f"{facts.format} ({title})",
        "sensor": facts.sensor
        or f"not stated: --sensor WxH; largest x {facts.largest_x}, y {facts.largest_y}",
        "events": f"{facts.events:,}",
        "duration": f"{facts.duration_us / 1e6:.6f} s",
        "rate": "-" if rate is None else f"{rate:,.0f} events/s",
        "polarity": "no column of it: all events count as ON"
        if facts.on_share is None
        else f"{facts.on_share:.1%} ON, {1 - facts.on_share:.1%} OFF",
        "times": f"{facts.first_us:,} to {facts.last_us:,} µs from the start",
        "start": f"{facts.start_us:,} µs on the file's clock",
        "faults": str(facts.faults),
    }
    print_facts(lines)
    print_facts(facts.facts)
