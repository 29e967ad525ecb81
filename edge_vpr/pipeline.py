"""The main job: a recording in, a reference map or the descriptors of a query out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from edge_vpr.cleaning import BurstFilter, find_hot_pixels
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.matches import Matches, match_descriptors
from edge_vpr.pixels import PixelMap, select_pixels
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.saliency import SaliencyPass
from edge_vpr.settings import Settings
from edge_vpr.windows import (
    Descriptors,
    DescriptorStream,
    FixedCount,
    FixedTime,
    Window,
    WindowCounts,
    collect,
)


class EventSource(Protocol):
    """What the main job needs of a recording: its sensor, and its events as often as asked."""

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor."""
        ...

    def __iter__(self) -> Iterator[Events]:
        """Start anew and yield event arrays in time order, on the sensor."""
        ...


@runtime_checkable
class WindowSource(Protocol):
    """Counts that were published as finished windows, in place of a recording's events."""

    @property
    def sensor(self) -> Sensor:
        """Size of the sensor."""
        ...

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Which pixels were counted, shape (height, width)."""
        ...

    def windows(self) -> Iterator[WindowCounts]:
        """Start anew and yield windows over all pixels, row by row; zero where not counted."""
        ...


def map_traverse(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    hot: npt.NDArray[np.bool_] | None = None,
) -> ReferenceMap:
    """Make a reference map of one drive, in one pass over its events or two.

    The second pass is needed for fixed-count windows, for polarity, and where the images of all
    windows would not fit a temporary file.

    Parameters
    ----------
    recording : EventSource or WindowSource
        For example from `open_recording`.
    settings : Settings
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it.

    Returns
    -------
    ReferenceMap

    Raises
    ------
    UsageError
        If the recording is shorter than a window, or too few pixels can be drawn.
    RecordingError, EventError
        If the recording is faulty.
    """
    sensor = recording.sensor
    if hot is not None and hot.shape != (sensor.height, sensor.width):
        raise UsageError(
            f"hot pixels are given for {hot.shape[1]}x{hot.shape[0]} pixels and the recording is "
            f"of a {sensor} sensor: give the list of this camera"
        )
    with SaliencyPass(sensor) as first:
        if isinstance(recording, WindowSource):
            windows = _published_windows(recording, settings)
        else:
            everything = PixelMap.all_of(sensor)
            windows = _windows(recording, everything, FixedTime(settings.tau_us), settings)
        for window in windows:
            first.add(window)
        if first.windows == 0:
            raise _too_short(FixedTime(settings.tau_us))
        counted = np.ones((sensor.height, sensor.width), dtype=np.bool_)
        if isinstance(recording, WindowSource):
            counted = recording.counted
        # among pixels that were not counted, every other one would stand out
        if hot is None and settings.remove_hot_pixels and counted.all():
            hot = find_hot_pixels(first.totals)
        elif hot is None:
            hot = np.zeros_like(counted)
        saliency = first.mean() if settings.strategy == "seed-code" else first.variance()
        pixel_map = select_pixels(
            saliency,
            settings.pixels,
            strategy=settings.strategy,
            sigma=settings.sigma,
            rng=np.random.default_rng(settings.seed),
            exclude=hot | ~counted,
        )
        if settings.window == "count" and settings.events_per_pixel == 0:
            settings = _with_mean_count(settings, first, pixel_map)
        needs_events = settings.window == "count" or settings.polarity
        places = None if needs_events else first.descriptors(pixel_map)
    if places is None:
        places = describe(recording, pixel_map, settings)
    return ReferenceMap(settings, pixel_map, places, saliency.astype(np.float32), hot)


def describe(
    recording: EventSource | WindowSource, pixel_map: PixelMap, settings: Settings
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    recording : EventSource or WindowSource
    pixel_map : PixelMap
    settings : Settings
        Of the map.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    MapError
        If the recording's sensor is not the map's.
    UsageError
        If the recording is shorter than a window.
    """
    if recording.sensor != pixel_map.sensor:
        raise MapError(
            f"the recording is of a {recording.sensor} sensor and the map of a {pixel_map.sensor} "
            "one: use the map of this camera, or name the right sensor (--sensor)"
        )
    if isinstance(recording, WindowSource):
        _check_counted(recording, pixel_map, settings)
        flat = pixel_map.y.astype(np.int64) * pixel_map.sensor.width + pixel_map.x
        windows: Iterator[WindowCounts] = (
            window._replace(counts=window.counts[flat])
            for window in _published_windows(recording, settings)
        )
    else:
        windows = _windows(recording, pixel_map, window_of(settings), settings, settings.polarity)
    descriptors = collect(windows, len(pixel_map))
    if len(descriptors) == 0:
        raise _too_short(window_of(settings))
    return descriptors


def match_traverse(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    settings: Settings | None = None,
) -> tuple[Matches, Descriptors]:
    """Match a query drive against a map.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
    settings : Settings, optional
        Sequence length, anchor and exclusion to use instead of the map's.

    Returns
    -------
    matches : Matches
    queries : Descriptors
        What was matched.

    Raises
    ------
    MapError, UsageError
        As `describe` and `match_descriptors` do.
    """
    settings = reference.settings if settings is None else settings
    queries = describe(recording, reference.pixel_map, settings)
    return match_descriptors(reference.places, queries, settings), queries


def window_of(settings: Settings) -> Window:
    """Tell the window that the settings ask for."""
    if settings.window == "time":
        return FixedTime(settings.tau_us)
    return FixedCount(settings.events_per_window)


def cleaned(recording: EventSource, settings: Settings) -> Iterator[Events]:
    """Yield a recording's events without bursts, if the settings ask for it."""
    if not settings.remove_bursts:
        yield from recording
        return
    bursts = BurstFilter(recording.sensor)
    for events in recording:
        yield from bursts.pieces(events)
    yield bursts.finish()


def _windows(
    recording: EventSource,
    pixel_map: PixelMap,
    window: Window,
    settings: Settings,
    polarity: bool = False,
) -> Iterator[WindowCounts]:
    stream = DescriptorStream(pixel_map, window, polarity=polarity, clip=settings.clip or None)
    for events in cleaned(recording, settings):
        yield from stream.windows(events)
    if settings.keep_incomplete:
        yield from stream.last()


def _published_windows(source: WindowSource, settings: Settings) -> Iterator[WindowCounts]:
    for window in source.windows():
        if settings.clip:
            yield window._replace(counts=np.minimum(window.counts, settings.clip))
        else:
            yield window


def _check_counted(source: WindowSource, pixel_map: PixelMap, settings: Settings) -> None:
    if settings.window == "count" or settings.polarity:
        raise UsageError(
            "published windows hold no events: fixed-count windows and polarity need a recording "
            "of events"
        )
    missing = np.count_nonzero(~source.counted[pixel_map.y, pixel_map.x])
    if missing:
        raise MapError(
            f"{missing} of the map's {len(pixel_map)} pixels were not counted in this file: "
            "map and match windows of the same pixels"
        )


def _with_mean_count(settings: Settings, first: SaliencyPass, pixel_map: PixelMap) -> Settings:
    """Let a window hold as many events as one of tau does on average."""
    events = int(first.totals[pixel_map.y, pixel_map.x].sum())
    mean = max(1, round(events / first.windows))
    return settings.replaced({"events_per_pixel": mean / len(pixel_map)}, "the reference")


def _too_short(window: Window) -> UsageError:
    return UsageError(
        f"the recording is shorter than one window of {window}: "
        "take shorter windows, or a longer drive"
    )
