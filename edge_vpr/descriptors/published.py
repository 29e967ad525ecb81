"""Windows that were published as counts: each frame of counts is one window."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Sensor, SensorSize
from edge_vpr.recordings import Faults, TimeCrop, parse_period, read_count_frames
from edge_vpr.recordings.frames import MOST_PIXELS, Counts
from edge_vpr.settings import Settings

T = TypeVar("T")


@runtime_checkable
class WindowSource(Protocol):
    """Interface of counts that were published as finished windows, without events.

    `start_us`, `cropped_us`, `frame_period` and `faults` are those of an `EventSource`.
    """

    start_us: int
    cropped_us: int
    frame_period: Fraction | None
    faults: Faults

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor."""
        ...

    @property
    def window_us(self) -> int:
        """Length of a window in microseconds, rounded."""
        ...

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Mask of the pixels that were counted, shape (height, width)."""
        ...

    def windows(self) -> Iterator[WindowCounts]:
        """Yield windows from the start, over all pixels, row by row; zero where not counted."""
        ...


class PublishedWindows:
    """Source of windows from frames of counts, in place of a recording of events.

    Parameters
    ----------
    path : path
        Count frames, see `read_count_frames`.
    frame_period : Fraction or float or str, optional
        Seconds a frame, such as ``"1/30"``, if the file does not say.
    sensor : Sensor or (int, int) or str, optional
        If the file does not say.
    crop : TimeCrop, optional
        Only the frames that lie wholly in this part are read.

    Attributes
    ----------
    window_us : int
        Length of a window in microseconds, rounded.
    counted : ndarray of bool, shape (height, width)
        Which pixels the frames count.
    start_us : int
        The first frame that is read, on the clock of the frames in microseconds.
    frame_period : Fraction or None
        As given.
    faults : Faults
        Empty: damaged frames are errors.

    Raises
    ------
    UsageError
        If the period, the sensor or the pixels are not known.
    RecordingError
        If the file cannot be read.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        frame_period: Fraction | float | str | None = None,
        sensor: SensorSize | None = None,
        crop: TimeCrop | None = None,
    ) -> None:
        self.frame_period = period = None if frame_period is None else parse_period(frame_period)
        size = None if sensor is None else Sensor.of(sensor)
        frames = read_count_frames(path)
        self._frames = frames
        start, end = (0, None) if crop is None else crop.span(frames.start_us)
        self._period_us = _stated(
            frames.period or period, path, "how long a frame lasts: pass frame_period="
        ) * Fraction(1_000_000)
        self.window_us = max(1, round(self._period_us))
        self._first = math.ceil(start / self._period_us)
        self._last = frames.n_frames if end is None else math.floor(end / self._period_us)
        if self._first >= min(self._last, frames.n_frames):
            raise UsageError(
                f"{path} has no whole frame in the part that start= and end= leave of its "
                f"{float(frames.n_frames * self._period_us / 1_000_000):g} s: leave more"
            )
        self.cropped_us = math.floor(self._first * self._period_us)
        self.start_us = frames.start_us + self.cropped_us
        self.sensor = _stated(frames.sensor or size, path, "its sensor: pass sensor='WxH'")
        x = _stated(frames.pixel_x, path, "where its pixels lie: add pixel_x and pixel_y")
        y = _stated(frames.pixel_y, path, "where its pixels lie: add pixel_x and pixel_y")
        if x.max() >= self.sensor.width or y.max() >= self.sensor.height:
            raise UsageError(
                f"{path} counts pixels up to column {x.max()} and row {y.max()}, off the "
                f"{self.sensor} sensor: name the right sensor"
            )
        if self.sensor.pixels > MOST_PIXELS:
            raise UsageError(
                f"{path} is of a sensor of {self.sensor}, and windows take at most "
                f"{MOST_PIXELS:,} pixels: name the right sensor"
            )
        self._flat = y.astype(np.int64) * self.sensor.width + x
        self.counted = np.zeros((self.sensor.height, self.sensor.width), dtype=np.bool_)
        self.counted[y, x] = True
        self.faults = Faults()

    def __repr__(self) -> str:
        frames = min(self._last, self._frames.n_frames) - self._first
        return f"PublishedWindows({frames:,} frames of {self.window_us / 1e6:g} s, {self.sensor})"

    def windows(self) -> Iterator[WindowCounts]:
        """Yield one window for each frame, over all pixels, row by row."""
        for k, row in enumerate(self._rows()):
            counts = np.zeros(self.sensor.pixels, dtype=np.int64)
            counts[self._flat] = row
            start, end = (math.floor(i * self._period_us) for i in (k, k + 1))
            yield WindowCounts(counts, start, end, int(counts.sum()))

    def _rows(self) -> Iterator[Counts]:
        rows = (row for block in self._frames.blocks() for row in block)
        return itertools.islice(rows, self._first, self._last)


def _stated(value: T | None, path: str | Path, what: str) -> T:
    if value is None:
        raise UsageError(f"{path} does not say {what}")
    return value


def check_windows_only(settings: Settings) -> None:
    """Raise UsageError if the settings need events, which published windows do not hold."""
    if settings.window == "count":
        raise UsageError(
            "published windows hold no events: fixed-count windows need a recording of events"
        )


def check_counted(source: WindowSource, pixel_map: PixelMap, settings: Settings) -> None:
    """Check that the published windows have the pixels and the length of those of a map."""
    check_windows_only(settings)
    if source.window_us != settings.tau_us:
        raise MapError(
            f"the published windows last {source.window_us} us and the map's {settings.tau_us} us: "
            "match windows of one length"
        )
    missing = np.count_nonzero(~source.counted[pixel_map.y, pixel_map.x])
    if missing:
        raise MapError(
            f"{missing} of the map's {len(pixel_map)} pixels were not counted in this file: "
            "map and match windows of the same pixels"
        )
