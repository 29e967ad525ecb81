"""A recording: an iterable of checked event arrays that can be walked again and again."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator
from pathlib import Path

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.faults import FaultLog, Faults, check_policy
from edge_vpr.recordings.source import Source


class Recording:
    """Iterate over event arrays: never empty, in time order, inside the sensor.

    Each ``iter()`` starts anew at the first event and resets `faults` and `position`; memory
    does not grow with the length of the file.

    Attributes
    ----------
    path : Path
    format : str
        Short name, as in :data:`edge_vpr.recordings.FORMATS`.
    sensor : Sensor
    start_us : int
        The moment t = 0 on the file's own clock, in microseconds: the Unix epoch where the file
        has wall-clock time (ROS, AEDAT4), the camera's clock otherwise.
    faults : Faults
        What the newest pass has dropped so far.
    """

    def __init__(self, source: Source, format_name: str, on_fault: str = "error") -> None:
        check_policy(on_fault)
        if source.sensor is None:
            raise UsageError(
                f"{source.path} does not say how large its sensor is: "
                "pass --sensor WIDTHxHEIGHT (sensor=), for example --sensor 346x260"
            )
        self.path: Path = source.path
        self.format = format_name
        self.sensor: Sensor = source.sensor
        self.faults = Faults()
        self._source = source
        self._on_fault = on_fault
        self._origin_us, self.start_us = self._find_start()

    @property
    def position(self) -> float | None:
        """Share of the file that the newest pass has read, 0 to 1; None where it is not known."""
        return self._source.position

    def __iter__(self) -> Iterator[Events]:
        log = FaultLog(self.path, self.sensor, self._on_fault, self._origin_us)
        self.faults = log.faults
        return self._walk(log)

    def __repr__(self) -> str:
        return f"<Recording {self.path} ({self.format}, {self.sensor})>"

    def _walk(self, log: FaultLog) -> Generator[Events, None, None]:
        try:
            for columns in self._source.chunks(log):
                events = log.admit(columns)
                if events.size:
                    yield events
        except OSError as error:
            raise RecordingError(
                f"{self.path} cannot be read: {error.strerror or error}: check the disk"
            ) from error

    def _find_start(self) -> tuple[int, int]:
        """Read up to the first good event, so that an empty file is known at once."""
        log = FaultLog(
            self.path, self.sensor, "drop", origin_us=0 if self._source.relative else None
        )
        with contextlib.closing(self._walk(log)) as chunks:
            found = next(chunks, None) is not None
        if not found:
            lost = f" (dropped: {log.faults})" if log.faults.total else ""
            raise RecordingError(
                f"{self.path} holds no events of a {self.sensor} sensor{lost}: "
                "check the file, its format and its sensor"
            )
        self._source.position = 0.0 if self._source.position is not None else None
        assert log.origin_us is not None
        start = self._source.start_us
        return log.origin_us, log.origin_us if start is None else start
