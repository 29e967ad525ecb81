"""A recording: an iterable of checked event arrays, for any number of passes."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Generator, Iterator
from pathlib import Path

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events, Sensor
from edge_vpr.recordings.faults import FaultLog, Faults
from edge_vpr.recordings.guard import foreign_errors
from edge_vpr.recordings.source import Source
from edge_vpr.recordings.time_crop import TimeCrop, cropped_events

#: Lowest and highest rate of a moving camera in events/s, and fewest events for a check.
_SLOWEST, _FASTEST, _FEWEST = 1_000.0, 2e9, 1_000


class Recording:
    """Iterable of event arrays that are never empty, in time order, and inside the sensor.

    Each ``iter()`` starts at the first event and resets `faults` and `position`. Memory does not
    grow with the length of the file.

    Attributes
    ----------
    path : Path
    format : str
        Short name, as in :data:`edge_vpr.recordings.FORMATS`.
    sensor : Sensor
    start_us : int
        Time t = 0 on the file's own clock, in microseconds: since the Unix epoch if the file has
        wall-clock time (ROS, AEDAT4), else on the camera's clock.
    faults : Faults
        Entries that the newest pass has dropped so far.
    remark : str
        Reason why the unit of the times is implausible, if the file does not state it; else "".
    """

    def __init__(self, source: Source, on_fault: str = "error") -> None:
        if source.sensor is None:
            raise UsageError(
                f"{source.path} does not say how large its sensor is: "
                "pass --sensor WIDTHxHEIGHT (sensor=), for example --sensor 346x260"
            )
        self.path: Path = source.path
        self.format = source.options.format
        self.sensor: Sensor = source.sensor
        self.faults = Faults()
        self._source = source
        self._on_fault = on_fault
        self.remark = ""
        self._span: tuple[int, int | None] = (0, None)
        self._origin_us, self.start_us = self._find_start()

    @property
    def position(self) -> float | None:
        """Share of the file that the newest pass has read, 0 to 1; None if it is not known."""
        return self._source.position

    def __iter__(self) -> Iterator[Events]:
        log = FaultLog(self.path, self.sensor, self._on_fault, self._origin_us)
        self.faults = log.faults
        return self._walk(log) if self._span == (0, None) else self._cropped(log)

    def cropped(self, crop: TimeCrop) -> Recording:
        """Return the part between two moments; its times count from the part's beginning.

        Returns
        -------
        Recording
            Part of the same file, with `start_us` at its beginning. A pass over a part without
            events raises RecordingError.

        Raises
        ------
        UsageError
            If the part ends before the recording begins.
        """
        start, end = crop.span(self.start_us)
        part = copy.copy(self)
        first, last = self._span
        part._span = (first + start, last if end is None else min(first + end, last or first + end))
        part.start_us = self.start_us + start
        part.faults = Faults()
        return part

    def __repr__(self) -> str:
        return f"<Recording {self.path} ({self.format}, {self.sensor})>"

    def _walk(self, log: FaultLog) -> Generator[Events, None, None]:
        with foreign_errors(self.path, lambda: f" after event {log.entries:,}"):
            for columns in self._source.chunks(log):
                events = log.admit(columns)
                if events.size:
                    yield events

    def _cropped(self, log: FaultLog) -> Generator[Events, None, None]:
        start, end = self._span
        found = False
        with contextlib.closing(self._walk(log)) as chunks:
            for events in cropped_events(chunks, start, end):
                found = True
                yield events
        if not found:
            until = "its end" if end is None else f"{end / 1e6:g} s"
            raise RecordingError(
                f"{self.path} holds no events from {start / 1e6:g} s to {until}: give another "
                "--start and --end (edge-vpr info shows its times)"
            )

    def _find_start(self) -> tuple[int, int]:
        """Read up to the first good event, so that an empty file is noticed at once."""
        log = FaultLog(
            self.path, self.sensor, "drop", origin_us=0 if self._source.relative else None
        )
        with contextlib.closing(self._walk(log)) as chunks:
            first = next(chunks, None)
        if first is None:
            lost = f" (dropped: {log.faults})" if log.faults.total else ""
            raise RecordingError(
                f"{self.path} holds no events of a {self.sensor} sensor{lost}: "
                "check the file, its format and its sensor"
            )
        self._source.position = 0.0 if self._source.position is not None else None
        assert log.origin_us is not None
        start = self._source.start_us
        if start is not None and abs(start) > TIME_LIMIT_US:
            raise RecordingError(
                f"{self.path} begins at {start} us, beyond 2**60 us: copy or record it again"
            )
        if self._source.unit_assumed:
            self.remark = _doubt(first)
        return log.origin_us, log.origin_us if start is None else start


def _doubt(events: Events) -> str:
    """Return why the rate of the first events is implausible; "" if it is plausible."""
    n, duration_us = events.size, int(events["t"][-1] - events["t"][0])
    if n < _FEWEST or not duration_us:
        return ""
    rate = n * 1e6 / duration_us
    if _SLOWEST <= rate <= _FASTEST:
        return ""
    return (
        f"the first {n:,} events take {duration_us / 1e6:,.6g} s if times are in microseconds, "
        f"which is {rate:,.3g} events/s: if they are in another unit, pass --time-unit "
        f"{'ns' if rate < _SLOWEST else 's or ms'}"
    )
