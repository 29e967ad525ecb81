"""Summary of a recording: events, duration, polarity, times and faults."""

from __future__ import annotations

from dataclasses import dataclass

from edge_vpr.recordings import Recording
from edge_vpr.recordings.faults import Faults


@dataclass(frozen=True)
class RecordingSummary:
    """Result of one pass over a recording.

    Attributes
    ----------
    path, format, sensor : str
    events : int
    duration_us : int
    events_per_s : float or None
        None if the recording has no duration.
    on_share : float
        Share of ON events.
    first_us, last_us : int
        From the start of the recording.
    start_us : int
        On the file's clock.
    faults : Faults
    """

    path: str
    format: str
    sensor: str
    events: int
    duration_us: int
    events_per_s: float | None
    on_share: float
    first_us: int
    last_us: int
    start_us: int
    faults: Faults


def summarise(recording: Recording) -> RecordingSummary:
    """Count a recording in one pass.

    Raises
    ------
    EdgeVprError
        If it cannot be read.
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
