"""Open recordings with the flags of the command line, and describe their faults."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge_vpr.descriptors.precounted import PublishedWindows
from edge_vpr.events import Sensor
from edge_vpr.recordings import Recording, open_recording, parse_period
from edge_vpr.recordings.time_crop import TimeCrop, seconds_us
from edge_vpr_tools.output.messages import warning


def open_from(
    args: argparse.Namespace, path: str | Path, *, on_fault: str | None = None
) -> Recording:
    """Open a recording with the flags of :func:`add_reading_arguments`.

    Prints a warning if something in the recording is implausible.

    Raises
    ------
    EdgeVprError
        If a flag is wrong or the recording cannot be opened.
    """
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
        warning(f"{path}: {recording.remark}")
    crop = _crop_of(args)
    return recording if crop is None else recording.cropped(crop)


def open_source(args: argparse.Namespace, path: str | Path) -> Recording | PublishedWindows:
    """Open a recording as events, or with ``--frames-as-windows`` as windows of counts.

    Raises
    ------
    EdgeVprError
        If a flag is wrong or the file cannot be opened.
    """
    if not args.frames_as_windows:
        return open_from(args, path)
    return PublishedWindows(
        path,
        period=None if args.frame_period is None else parse_period(args.frame_period),
        sensor=None if args.sensor is None else Sensor.parse(args.sensor),
        crop=_crop_of(args),
    )


def _crop_of(args: argparse.Namespace) -> TimeCrop | None:
    if args.start is args.end is args.start_offset is None:
        return None
    end, offset = args.end, args.start_offset
    return TimeCrop(
        start_us=seconds_us(args.start or "0", "--start"),
        end_us=None if end is None else seconds_us(end, "--end"),
        offset_us=None if offset is None else seconds_us(offset, "--start-offset"),
    )


def describe_faults(recording: Recording | PublishedWindows) -> str:
    """Return the end of a sentence on the events that were dropped; empty if there were none."""
    return f"; dropped as faulty: {recording.faults}" if recording.faults.total else ""
