"""Drives of the user that have intensity frames.

The folder given with ``--data`` can hold the bags of Brisbane-Event-VPR under their published
names, and a folder ``frames``. The latter has ``reference`` and ``query``, each an AEDAT file, a
ROS bag, HDF5 or a folder of images (see `edge_vpr.intensity`), and ``reference_track`` and
``query_track`` (``.csv``, ``.nmea`` or ``.gpx``), whose times count from the start of their
recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.datasets.published_drives import PublishedDrive, published_pairs
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.intensity import IntensityFrames, frames_at, open_intensity
from edge_vpr.pipeline import EventSource
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr_tools.experiments.counted_pairs import CountedDrive, CountedPair, count_pair
from edge_vpr_tools.experiments.trial import Times, truth_of_tracks

FRAMES = "frames"
#: largest distance of a correct match, by the kind of track
TOLERANCE_M = {"geographic": 70.0, "metric": 10.0}
SETTINGS = PRESETS["paper"]
_TRACKS = (".csv", ".nmea", ".gpx")


class FramedPair(NamedTuple):
    """Pair of drives as windows of events (None if none were recorded), and as frames."""

    name: str
    events: CountedPair | None
    frames: CountedPair


@dataclass(frozen=True, eq=False)
class FramedDrive:
    """Drive with frames.

    Attributes
    ----------
    frames : IntensityFrames
    start_us : int
        Time 0 of the drive on the clock of the frames.
    recording : EventSource or None
        Events of the drive.
    track : Track
    """

    frames: IntensityFrames
    start_us: int
    recording: EventSource | None
    track: Track


def framed_pairs(data: Path, on_start: Callable[[str], None]) -> Iterator[FramedPair]:
    """Yield the pairs of drives that have frames.

    Parameters
    ----------
    data : Path
    on_start : callable
        Called with a description before each part begins.

    Raises
    ------
    UsageError
        If the folder of own drives holds only half of a pair.
    """
    folder = data / FRAMES
    if folder.is_dir():
        on_start("reading frames")
        yield _read("own frames", _own_drive(folder, "reference"), _own_drive(folder, "query"))
    for pair in published_pairs(data, ("bag",)):
        on_start(f"reading {pair.name}")
        reference, query = (_published_drive(drive) for drive in (pair.reference, pair.query))
        yield _read(pair.name, reference, query, pair.tolerance_m)


def _read(
    name: str, reference: FramedDrive, query: FramedDrive, tolerance_m: float | None = None
) -> FramedPair:
    truth_of = truth_of_tracks(
        reference.track, query.track, tolerance_m or TOLERANCE_M[reference.track.kind]
    )
    if reference.recording is None or query.recording is None:
        events = None
        times = [_grid(drive) for drive in (reference, query)]
    else:
        events = count_pair(name, reference.recording, query.recording, SETTINGS, truth_of)
        times = [events.reference.centre_us, events.query.centre_us]
    first, second = (
        CountedDrive(
            frames_at(drive.frames, wanted, SETTINGS.tau_us // 2, drive.start_us)[0], wanted
        )
        for drive, wanted in zip((reference, query), times, strict=True)
    )
    return FramedPair(name, events, CountedPair(name, first, second, SETTINGS, truth_of))


def _grid(drive: FramedDrive) -> Times:
    """Return the centres of windows of tau, from the drive's start to its last frame."""
    last_us = max(frame.time_us for frame in drive.frames) - drive.start_us
    return np.arange(SETTINGS.tau_us // 2, last_us + 1, SETTINGS.tau_us, dtype=np.int64)


def _own_drive(folder: Path, side: str) -> FramedDrive:
    tracks = [path for path in sorted(folder.glob(f"{side}_track.*")) if path.suffix in _TRACKS]
    drives = [path for path in sorted(folder.iterdir()) if path.name.split(".")[0] == side]
    for what, found, example in (
        ("drive", drives, f"{side}.aedat4, {side}.bag, or a folder {side} of images"),
        ("track", tracks, f"{side}_track.csv"),
    ):
        if len(found) != 1:
            raise UsageError(
                f"{folder} has {len(found)} files of the {side} {what}, and one is needed: put "
                f"there {example}"
            )
    frames = open_intensity(drives[0])
    recording = open_recording(drives[0]) if frames.has_events else None
    return FramedDrive(frames, frames.start_us, recording, load_track(tracks[0]))


def _published_drive(drive: PublishedDrive) -> FramedDrive:
    frames = open_intensity(drive.path)
    return FramedDrive(frames, drive.recording.start_us, drive.recording, drive.track)
