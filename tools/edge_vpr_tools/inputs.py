"""Recordings: opened by the flags of the command line, and read with a progress bar."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from edge_vpr.descriptors.published import PublishedWindows
from edge_vpr.events import Events
from edge_vpr.recordings import Recording, open_recording
from edge_vpr.recordings.reading import NO_CAMERA, Camera, crop_of
from edge_vpr_tools.console import is_quiet

if TYPE_CHECKING:
    from rich.console import Console

    from edge_vpr.simulation import SimulatedRecording


def open_from(args: argparse.Namespace, path: str | Path, default: Camera = NO_CAMERA) -> Recording:
    """Open a recording with the flags of :func:`add_reading_arguments`; see `open_recording`."""
    crop = crop_of(args.start, args.end, args.start_offset)
    recording = open_recording(
        path,
        format=args.format,
        sensor=args.sensor,
        on_fault=args.on_fault,
        frame_period=args.frame_period,
        default=default,
        topic=args.topic,
        time_unit=args.time_unit,
        columns=args.columns,
    )
    return recording if crop is None else recording.cropped(crop)


def open_source(
    args: argparse.Namespace, path: str | Path, default: Camera = NO_CAMERA
) -> Recording | PublishedWindows:
    """Open events as `open_from`, or with ``--frames-as-windows`` windows of counts."""
    if not args.frames_as_windows:
        return open_from(args, path, default)
    return PublishedWindows(
        path,
        frame_period=args.frame_period or default.frame_period,
        sensor=args.sensor or default.sensor,
        crop=crop_of(args.start, args.end, args.start_offset),
    )


def demo_drives() -> tuple[SimulatedRecording, SimulatedRecording]:
    """Return the two drives of the demo, which are the same each time."""
    from edge_vpr.simulation import simulate_pair

    return simulate_pair(0)


AnyDrive = TypeVar("AnyDrive", Recording, "Recording | PublishedWindows")


def watched(recording: AnyDrive, label: str) -> AnyDrive:
    """Show the progress of each pass over the events of a recording under `label`."""
    if isinstance(recording, Recording) and _console().is_terminal:
        recording.watch = lambda events: with_progress(recording, label, events)
    return recording


def _console() -> Console:
    """Return the console of the progress bar: no terminal, if nothing is to be printed."""
    from rich.console import Console  # slow to load, as all of rich

    return Console(stderr=True, force_terminal=False if is_quiet() else None)


def with_progress(
    recording: Recording | SimulatedRecording, label: str, events: Iterable[Events] | None = None
) -> Iterator[Events]:
    """Yield the events, and show a progress bar on standard error if it is a terminal.

    Parameters
    ----------
    events : iterable of Events, optional
        A pass over the recording; by default a new one.
    """
    events = recording if events is None else events
    console = _console()
    if not console.is_terminal:
        yield from events
        return
    from rich import progress as rich

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.TextColumn("{task.fields[events]}"),
        rich.TimeElapsedColumn(),
        rich.TextColumn("left:"),
        rich.TimeRemainingColumn(),
    )
    # transient: the bar disappears when the pass ends, and the lines of the command stay
    with rich.Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(label, total=None, events="")
        n = 0
        for some in events:
            yield some
            n += some.size
            share = recording.position
            progress.update(
                task,
                events=f"{n:,} events",
                total=None if share is None else 1.0,
                completed=share or 0.0,
            )
