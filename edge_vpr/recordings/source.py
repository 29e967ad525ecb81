"""Interface of readers: unchecked raw columns on the file's own clock."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog

#: Approximate events of one chunk: 64 Ki events are 850 kB, which stay in a core's second-level
#: cache.
CHUNK_EVENTS = 1 << 16


@dataclass(frozen=True)
class ReadOptions:
    """Format of the file (a name of `FORMATS`), and what the caller states beside the file."""

    format: str
    sensor: Sensor | None = None
    frame_period: Fraction | None = None
    chunk_events: int = CHUNK_EVENTS
    topic: str | None = None
    time_unit: str | None = None
    columns: str | None = None


class Source(ABC):
    """Reader of one file.

    Attributes
    ----------
    path : Path
    sensor : Sensor or None
        As stated by the file, else by the caller; None if neither states it.
    start_us : int or None
        Time t = 0 on the file's clock in microseconds, if the file itself states it; None if the
        first event is the start.
    relative : bool
        True if the times already count from the start.
    position : float or None
        Share of the file that has been read, 0 to 1; None if it is not known.
    unit_assumed : bool
        True if neither the file nor the caller states the unit of the times.
    """

    start_us: int | None = None
    relative: bool = False
    position: float | None = 0.0
    unit_assumed: bool = False

    def __init__(self, path: Path, options: ReadOptions, sensor: Sensor | None = None) -> None:
        self.path = path
        self.options = options
        self.sensor = sensor if sensor is not None else options.sensor
        if self.sensor is not None and not self.sensor.possible:
            raise RecordingError(
                f"{path} names a sensor of {self.sensor}: sides are 1 to {LONGEST_SIDE:,} pixels, "
                "so copy or record it again"
            )
        if sensor is not None and options.sensor not in (None, sensor):
            raise UsageError(
                f"{path} was recorded by a {sensor} sensor, and {options.sensor} was named: "
                "leave the sensor out"
            )

    @abstractmethod
    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events from the first on, in file order, about ``chunk_events`` at a time.

        Entries that cannot be decoded are reported to `log`, which raises or counts.
        """
