"""Inputs of mapping and matching: a recording of events, or counts of finished windows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.settings import Settings


class EventSource(Protocol):
    """Interface of a recording: its sensor, and its events in any number of passes."""

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor."""
        ...

    def __iter__(self) -> Iterator[Events]:
        """Yield event arrays from the start, in time order, on the sensor."""
        ...


@runtime_checkable
class WindowSource(Protocol):
    """Interface of counts that were published as finished windows, without events."""

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


def check_sensor(recording: Sensor, mapped: Sensor) -> None:
    """Check that the recording has the sensor of the map; raise MapError if not."""
    if recording != mapped:
        raise MapError(
            f"the recording is of a {recording} sensor and the map of a {mapped} one: use the map "
            "of this camera, or name the right sensor (--sensor)"
        )


def check_windows_only(settings: Settings) -> None:
    """Raise UsageError if the settings need events, which published windows do not hold."""
    if settings.window == "count" or settings.polarity:
        raise UsageError(
            "published windows hold no events: fixed-count windows and polarity need a recording "
            "of events"
        )


def check_counted(source: WindowSource, pixel_map: PixelMap, settings: Settings) -> None:
    """Check that the published windows have the pixels and the length of those of a map.

    Raises
    ------
    MapError
        If they are of another length, or lack pixels of the map.
    UsageError
        If the settings need events.
    """
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
