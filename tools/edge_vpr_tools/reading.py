"""The flags by which every command opens a recording, and what it says of its faults."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edge_vpr.descriptors.precounted import PublishedWindows
    from edge_vpr.recordings import Recording


def add_reading_arguments(
    parser: argparse.ArgumentParser, *, on_fault: bool = True
) -> argparse._ArgumentGroup:
    """Add the flags that :func:`open_from` reads, in a group of their own, and return it."""
    group = parser.add_argument_group("reading", "for files that do not say it themselves")
    group.add_argument("--sensor", metavar="WxH", help="size of the sensor, for example 346x260")
    if on_fault:
        group.add_argument(
            "--on-fault",
            choices=("error", "drop"),
            default="error",
            help="stop at faulty events, or leave them out and count them (default: error)",
        )
    group.add_argument(
        "--frame-period", metavar="S", help="seconds a count frame lasts, for example 1/30"
    )
    group.add_argument("--format", metavar="NAME", help="format, if name and content mislead")
    group.add_argument("--topic", metavar="NAME", help="topic or stream, if there are several")
    group.add_argument(
        "--time-unit",
        choices=("s", "ms", "us", "ns"),
        help="unit of the times in a table (default: s if they have fractions, else us)",
    )
    group.add_argument(
        "--columns", metavar="ORDER", help="order of unnamed columns, for example xytp"
    )
    return group


def add_window_argument(group: argparse._ArgumentGroup) -> None:
    """Add the flag that :func:`open_source` reads besides."""
    group.add_argument(
        "--frames-as-windows",
        action="store_true",
        help="take each count frame as one window, instead of expanding it to events",
    )


def open_from(
    args: argparse.Namespace, path: str | Path, *, on_fault: str | None = None
) -> Recording:
    """Open `path` as the flags of :func:`add_reading_arguments` say.

    What is implausible about it is printed on standard error.

    Raises
    ------
    EdgeVprError
        If a flag is wrong or the recording cannot be opened.
    """
    from edge_vpr.events import Sensor
    from edge_vpr.recordings import open_recording, parse_period

    recording = open_recording(
        path,
        format=args.format,
        sensor=None if args.sensor is None else Sensor.parse(args.sensor),
        on_fault=args.on_fault if on_fault is None else on_fault,
        frame_period=None if args.frame_period is None else parse_period(args.frame_period),
        topic=args.topic,
        time_unit=args.time_unit,
        columns=args.columns,
    )
    if recording.remark:
        print(f"edge-vpr: warning: {path}: {recording.remark}", file=sys.stderr)
    return recording


def open_source(args: argparse.Namespace, path: str | Path) -> Recording | PublishedWindows:
    """Open `path` as events, or as published windows where ``--frames-as-windows`` asks for it.

    Raises
    ------
    EdgeVprError
        If a flag is wrong or the file cannot be opened.
    """
    if not args.frames_as_windows:
        return open_from(args, path)
    from edge_vpr.descriptors.precounted import PublishedWindows
    from edge_vpr.events import Sensor
    from edge_vpr.recordings import parse_period

    return PublishedWindows(
        path,
        period=None if args.frame_period is None else parse_period(args.frame_period),
        sensor=None if args.sensor is None else Sensor.parse(args.sensor),
    )


def fault_counts(recording: Recording | PublishedWindows) -> dict[str, int]:
    """Count what the newest pass over a recording dropped, by kind, for programs."""
    from dataclasses import asdict

    return asdict(recording.faults)


def describe_faults(recording: Recording | PublishedWindows) -> str:
    """Say what the newest pass dropped as the end of a sentence; empty if nothing."""
    return f"; dropped as faulty: {recording.faults}" if recording.faults.total else ""
