"""Inputs of mapping and matching as callers give them: a recording, a track, and odometry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

from edge_vpr.descriptors.published import WindowSource
from edge_vpr.errors import UsageError, expect, kind_of
from edge_vpr.evaluation.tables import AnyOdometry, load_odometry
from edge_vpr.evaluation.track_files import AnyTrack, load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import UNIX_US, Events, Sensor, SensorSize
from edge_vpr.odometry import Odometry
from edge_vpr.recordings import EventData, open_recording
from edge_vpr.recordings.memory import column_names, is_event_data
from edge_vpr.recordings.reading import NO_CAMERA, Camera, EventSource, ForeignRecording

# Recordings: of events, or of counts of finished windows.


class HasSensor(Protocol):
    """Any object with a sensor that yields events in time order; they are checked."""

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor."""
        ...

    def __iter__(self) -> Iterator[Events]:
        """Yield events from the start."""
        ...


#: A recording as callers hold it.
AnyRecording: TypeAlias = EventSource | WindowSource | EventData | HasSensor | str | Path


def opened(
    recording: AnyRecording,
    *,
    sensor: SensorSize | None = None,
    default: Camera = NO_CAMERA,
) -> EventSource | WindowSource:
    """Return a recording, or open it if it is a path or events in memory.

    Parameters
    ----------
    sensor : Sensor or (int, int) or str, optional
        Where the file or the events do not state it.
    default : Camera, optional
        See `open_recording`.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    drive: Any = recording  # the tests below are not those of its type
    if not isinstance(drive, EventSource | WindowSource):
        if isinstance(drive, str | Path) or is_event_data(drive):
            return open_recording(drive, sensor=sensor, default=default)
        if not (hasattr(drive, "sensor") and hasattr(drive, "__iter__")):
            raise UsageError(
                f"the recording is {kind_of(recording)}: give a path, events, what open_recording "
                "returns, or an object with a sensor that yields arrays of events"
            )
        drive = ForeignRecording(drive)
    if sensor is not None and Sensor.of(sensor) != drive.sensor:
        raise UsageError(
            f"the recording is of a {drive.sensor} sensor, and sensor {Sensor.of(sensor)} was "
            "given: leave it out"
        )
    source: EventSource | WindowSource = drive
    return source


def check_reading(changes: Mapping[str, Any], by: str) -> None:
    """Refuse, among settings, what says how a file is read."""
    for name in changes.keys() & signature(open_recording).parameters:
        raise UsageError(
            f"{by}: {name} is no setting, and says how a recording is read: give "
            f"open_recording(recording, {name}={changes[name]!r}) in its place"
        )


def unix_start(drive: EventSource | WindowSource) -> int:
    """Return where a whole recording begins on its clock, if that counts from 1970; else 0."""
    start_us = drive.start_us - drive.cropped_us
    return start_us if start_us >= UNIX_US else 0


# Tracks and odometry, of the part of a recording that is read.


def track_of(track: AnyTrack | None) -> Track | None:
    """Return a track, read from its file if that is given."""
    return None if track is None else loaded_track(track)


def loaded_track(track: AnyTrack) -> Track:
    """Return a track, read from its file or table."""
    if isinstance(track, Track):
        return track
    if column_names(track) is None:
        give = "the path of a log, a table with time_s and x_m, y_m, or Track(time_us, position)"
        expect(track, (str, Path), "track", give)
    return load_track(track)


def odometry_of(odometry: AnyOdometry | None) -> Odometry | None:
    """Return odometry, read from its file if that is given."""
    if odometry is None or isinstance(odometry, Odometry):
        return odometry
    return load_odometry(odometry)


_Timed = TypeVar("_Timed", bound=Track | Odometry | None)


def of_part(drive: EventSource | WindowSource, readings: _Timed) -> _Timed:
    """Return readings whose times count from where the part of a recording begins."""
    start_us = drive.cropped_us
    if readings is None or not start_us:
        return readings
    moved: Any = (
        readings.shifted(-start_us / 1e6)
        if isinstance(readings, Track)
        else readings.since(start_us)
    )
    return moved
