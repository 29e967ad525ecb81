"""Time t = 0 of images that were recorded beside events."""

from __future__ import annotations

from pathlib import Path

from edge_vpr.intensity.frames import IntensityFrames
from edge_vpr.recordings import open_recording


def start_of(frames: IntensityFrames, path: Path, topic: str | None = None) -> int:
    """Return the time of a file's first event, or of its first frame if it holds no events.

    Parameters
    ----------
    frames : IntensityFrames
        Its `has_events` says whether the file holds events.
    path : Path
    topic : str, optional
        Camera of the events, if there are several.
    """
    if frames.has_events:
        return open_recording(path, topic=topic).start_us
    return next((frame.time_us for frame in frames), 0)
