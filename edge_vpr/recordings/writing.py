"""Writing of recordings, which appear whole or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Protocol

import numpy as np

from edge_vpr.archive import replacing
from edge_vpr.errors import EdgeVprError, RecordingError, UsageError
from edge_vpr.events import Events, Sensor, check_events
from edge_vpr.recordings.registry import FORMATS, Format


class Sink(Protocol):
    """Writer of one format: takes events in time order, then finishes the file."""

    def write(self, events: Events) -> None:
        """Append events."""

    def close(self) -> None:
        """Finish and close the file."""


def write_recording(
    path: str | Path,
    events: Iterable[Events] | Events,
    *,
    sensor: Sensor | None = None,
    start_us: int | None = None,
    format: str | None = None,
    overwrite: bool = False,
) -> int:
    """Write events in the format that the suffix of `path` names.

    The file appears under its name only when it is complete. Memory does not grow with the number
    of events.

    Parameters
    ----------
    path : str or Path
        With a suffix of a writable format: .npz, .npy, .csv, .txt, .parquet, .raw (EVT 2.0),
        .dat, .h5, .hdf5, .es.
    events : Recording, other iterable of event arrays, or one event array
        In time order, with times counted from the start.
    sensor : Sensor, optional
        Needed unless `events` has an attribute `sensor`, as a recording does.
    start_us : int, optional
        Time t = 0 on an outer clock; by default the attribute `start_us` of `events`, else 0. The
        formats .npz, .parquet, .raw, .dat and .h5 keep it.
    format : str, optional
        A name from :data:`FORMATS`, if the suffix does not determine it.
    overwrite : bool
        Whether a file that exists may be replaced.

    Returns
    -------
    int
        Number of events written.

    Raises
    ------
    UsageError
        If the file exists, the format is unknown or cannot be written, or no sensor is given.
    EventError
        If the events are out of order or off the sensor.
    RecordingError
        If the events do not fit the format, there are none, or the disk cannot be written.
    """
    path = Path(path)
    entry = _writable(path, format)
    sensor = getattr(events, "sensor", None) if sensor is None else sensor
    start_us = getattr(events, "start_us", 0) if start_us is None else start_us
    if sensor is None:
        raise UsageError(f"{path} needs the size of the sensor: pass sensor=")
    if path.exists() and (path.is_dir() or not overwrite):
        raise UsageError(f"{path} exists: choose another name, or pass --overwrite")
    open_sink = import_module(f"edge_vpr.recordings.{entry.module}").open_sink
    chunks = [events] if isinstance(events, np.ndarray) else events
    try:
        with replacing(path) as part:
            n = _fill(open_sink(part, sensor, start_us), chunks, sensor)
            if n == 0:
                raise RecordingError(f"there are no events to write to {path}: check the input")
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be written: {error.strerror or error}: check space and permissions"
        ) from error
    return n


def _fill(sink: Sink, chunks: Iterable[Events], sensor: Sensor) -> int:
    n, last = 0, None
    try:
        for events in chunks:
            check_events(events, sensor, after=last)
            if events.size:
                sink.write(events)
                n += events.size
                last = int(events["t"][-1])
    except BaseException:
        with contextlib.suppress(EdgeVprError, OSError):
            sink.close()  # the first error is reported
        raise
    sink.close()
    return n


def _writable(path: Path, name: str | None) -> Format:
    if name is not None and name not in FORMATS:
        raise UsageError(f"format {name!r} is unknown: choose one of {', '.join(FORMATS)}")
    for entry in FORMATS.values():
        if entry.writable and (entry.name == name or (not name and path.suffix in entry.suffixes)):
            return entry
    known = ", ".join(s for entry in FORMATS.values() if entry.writable for s in entry.suffixes)
    raise UsageError(f"{name or path.suffix or path} cannot be written: choose one of {known}")
