"""Recordings: opened by the flags of the command line, read with a progress bar, and described."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edge_vpr.descriptors.counting import Removed, WindowSource
from edge_vpr.descriptors.windows import PublishedWindows
from edge_vpr.events import Events
from edge_vpr.recordings import Recording, open_recording
from edge_vpr.recordings.reading import NO_CAMERA, Camera, crop_of
from edge_vpr.settings import Settings
from edge_vpr_tools.console import is_quiet

if TYPE_CHECKING:
    from rich.console import Console

    from edge_vpr.simulation import SimulatedRecording


def open_from(args: argparse.Namespace, path: str | Path, default: Camera = NO_CAMERA) -> Recording:
    """Open a recording with the flags of :func:`add_reading_arguments`; see `open_recording`."""
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
    crop = crop_of(args.start, args.end, args.start_offset)
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


class Tracked:
    """A recording whose every pass shows a progress bar on standard error.

    Attributes are the recording's own (``sensor``, ``start_us``, ...).
    """

    def __init__(self, recording: Iterable[Events], label: str) -> None:
        self._recording = recording
        self._label = label

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._recording, name)

    def __iter__(self) -> Iterator[Events]:
        from rich.console import Console  # slow to load, as all of rich

        console = Console(stderr=True)
        shown = self._recording
        if not is_quiet() and console.is_terminal:
            shown = self._shown(console)
        yield from shown

    def _shown(self, console: Console) -> Iterator[Events]:
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
            task = progress.add_task(self._label, total=None, events="")
            n = 0
            for events in self._recording:
                yield events
                n += events.size
                position = getattr(self._recording, "position", None)
                progress.update(
                    task,
                    events=f"{n:,} events",
                    total=None if position is None else 1.0,
                    completed=0.0 if position is None else position,
                )


def tracked(recording: Any, label: str) -> Any:
    """Wrap a recording so that each pass over it shows its progress under `label`.

    Published windows, which are not iterated, pass through as they are.

    Returns
    -------
    Tracked
        Typed as `Any`, because it stands in for the recording.
    """
    return recording if isinstance(recording, WindowSource) else Tracked(recording, label)


def describe_faults(recording: Recording | PublishedWindows) -> str:
    """Return the end of a sentence on the events that were dropped; empty if there were none."""
    return f"; dropped as faulty: {recording.faults}" if recording.faults.total else ""


def describe_removed(removed: Removed, settings: Settings) -> str:
    """Return what was removed as bursts, as the end of a sentence."""
    if not settings.remove_bursts:
        return "; bursts kept"
    return f"; {removed.burst_events:,} events ({removed.burst_share:.1%}) removed as bursts"
