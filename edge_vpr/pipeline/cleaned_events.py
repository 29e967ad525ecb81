"""The events of a recording without bursts, and the number of removed events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from edge_vpr.descriptors.bursts import BurstFilter
from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.events import Events
from edge_vpr.pipeline.sources import EventSource
from edge_vpr.settings import Settings


@dataclass
class Removed:
    """Counts of what cleaning removed in the newest pass over a recording; filled while reading.

    Attributes
    ----------
    events : int
        Read in all.
    burst_events : int
        Removed as bursts.
    """

    events: int = 0
    burst_events: int = 0

    @property
    def burst_share(self) -> float:
        """Share of the events that were removed as bursts."""
        return self.burst_events / self.events if self.events else 0.0


def cleaned(
    recording: EventSource, settings: Settings, removed: Removed | None = None
) -> Iterator[Events]:
    """Yield the events of a recording, without bursts if the settings ask for it.

    Parameters
    ----------
    recording : EventSource
    settings : Settings
    removed : Removed, optional
        Is filled with what was left out.
    """
    removed = Removed() if removed is None else removed
    removed.events = removed.burst_events = 0
    bursts = BurstFilter(recording.sensor) if settings.remove_bursts else None
    for events in recording:
        removed.events += int(events.size)
        if bursts is None:
            yield events
        else:
            yield from bursts.pieces(events)
            removed.burst_events = bursts.removed
    if bursts is not None:
        yield bursts.finish()
        removed.burst_events = bursts.removed


def event_windows(
    recording: EventSource, stream: DescriptorStream, settings: Settings, removed: Removed | None
) -> Iterator[WindowCounts]:
    """Yield the windows of a recording's cleaned events.

    Parameters
    ----------
    recording : EventSource
    stream : DescriptorStream
    settings : Settings
    removed : Removed, optional
        Is filled with what was left out.
    """
    for events in cleaned(recording, settings, removed):
        yield from stream.windows(events)
    if settings.keep_incomplete:
        yield from stream.last()
