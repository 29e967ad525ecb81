"""The main job: a recording in, a reference map or the descriptors of a query out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.cleaning import BurstFilter, find_hot_pixels
from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.own_mean import drive_mean
from edge_vpr.descriptors.pauses import find_pauses, mean_activity
from edge_vpr.descriptors.pixels import PixelMap, select_pixels
from edge_vpr.descriptors.saliency import SaliencyPass
from edge_vpr.descriptors.windows import (
    Descriptors,
    DescriptorStream,
    FixedCount,
    FixedTime,
    Window,
    WindowCounts,
    collect,
    narrow,
)
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Events, Sensor
from edge_vpr.matching.matches import Matches, match_descriptors
from edge_vpr.odometry import Odometry
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from fixedpoint.codes import learn_full_scale


@dataclass
class Removed:
    """What cleaning left out of the newest pass over a recording; filled while it is read.

    Attributes
    ----------
    events : int
        Read in all.
    burst_events : int
        Removed as bursts.
    """

    events: int = 0
    burst_events: int = 0

    @property
    def burst_share(self) -> float:
        """Share of the events that were removed as bursts."""
        return self.burst_events / self.events if self.events else 0.0


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
    def window_us(self) -> int:
        """Length of a window in microseconds, rounded."""
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
    removed: Removed | None = None,
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
    removed : Removed, optional
        Is filled with what was left out.

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
    # the released code selects by clipped counts; with other codes, pixels are selected by counts,
    # so that maps of different codes have the same pixels
    with SaliencyPass(sensor, clip=settings.clip) as first:
        if isinstance(recording, WindowSource):
            _check_windows_only(settings)
            settings = settings.replaced({"tau_us": recording.window_us}, "the published windows")
            windows = recording.windows()
        else:
            everything = PixelMap.all_of(sensor)
            stream = DescriptorStream(everything, FixedTime(settings.tau_us))
            windows = _windows(recording, stream, settings, removed)
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
        if settings.window == "count" and settings.events_per_pixel is None:
            settings = _with_mean_count(settings, first, pixel_map)
        needs_events = settings.window == "count" or settings.polarity
        places = None if needs_events else first.descriptors(pixel_map)
    if places is None:
        places = count_windows(recording, pixel_map, settings, removed)
    return coded_map(
        ReferenceMap(settings.uncoded, pixel_map, places, saliency.astype(np.float32), hot),
        settings,
    )


def coded_map(counted: ReferenceMap, settings: Settings) -> ReferenceMap:
    """Code the counts of a reference map, and learn what the code needs of them.

    Parameters
    ----------
    counted : ReferenceMap
        With counts as they are, at least one place.
    settings : Settings
        Of the map to make.

    Returns
    -------
    ReferenceMap
    """
    places = counted.places
    counts, events = places.counts, places.activity
    full_scale, mean = None, None
    code = settings.own_mean_code
    if code is not None:
        mean = drive_mean(counts, find_pauses(events, mean_activity(events)), code)
        coded: npt.NDArray[np.unsignedinteger] = code.encode(counts, mean)
    else:
        full_scale = learn_full_scale(counts) if settings.learns_full_scale else None
        codes = codes_of(settings, counts.shape[1], full_scale)
        coded = counts if codes is None else narrow(codes.encode(counts))
    return replace(
        counted,
        settings=settings,
        places=replace(places, counts=coded, selected=events),
        full_scale=full_scale,
        mean=mean,
    )


def count_windows(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window; see `describe`."""
    return describe(recording, pixel_map, settings.uncoded, removed=removed)


def describe_query(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    settings: Settings | None = None,
    removed: Removed | None = None,
) -> Descriptors:
    """Describe a query drive as the places of a map are described, in its codes.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
    settings : Settings, optional
        To use in place of the map's.
    removed : Removed, optional
        Filled with how much the cleaning took.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    MapError, UsageError
        As `describe` does.
    """
    if settings is not None:
        reference = replace(reference, settings=settings)
    counted = count_windows(recording, reference.pixel_map, reference.settings, removed)
    return reference.coded(counted)


def describe(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    full_scale: npt.NDArray[np.uint16] | None = None,
    *,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    recording : EventSource or WindowSource
    pixel_map : PixelMap
    settings : Settings
        Of the map.
    full_scale : ndarray of uint16, shape (J,), optional
        Of the map, where its code is scaled to each pixel.
    removed : Removed, optional
        Is filled with what was left out.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    MapError
        If the recording's sensor is not the map's, or the full scales are missing.
    UsageError
        If the recording is shorter than a window.
    """
    check_sensor(recording.sensor, pixel_map.sensor)
    counters = len(pixel_map) * (2 if settings.polarity else 1)
    codes = codes_of(settings, counters, full_scale)
    if isinstance(recording, WindowSource):
        _check_counted(recording, pixel_map, settings)
        flat = pixel_map.y.astype(np.int64) * pixel_map.sensor.width + pixel_map.x
        windows: Iterator[WindowCounts] = (
            window._replace(counts=window.counts[flat]) for window in recording.windows()
        )
    else:
        stream = DescriptorStream(pixel_map, window_of(settings), polarity=settings.polarity)
        windows = _windows(recording, stream, settings, removed)
    descriptors = collect(windows, counters)
    if len(descriptors) == 0:
        raise _too_short(window_of(settings))
    events = descriptors.activity
    if codes is None:
        return replace(descriptors, selected=events)
    return replace(descriptors, counts=narrow(codes.encode(descriptors.counts)), selected=events)


def match_traverse(
    reference: ReferenceMap,
    recording: EventSource | WindowSource,
    settings: Settings | None = None,
    odometry: Odometry | None = None,
) -> tuple[Matches, Descriptors]:
    """Match a query drive against a map.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
    settings : Settings, optional
        Sequence length, anchor and exclusion to use instead of the map's.
    odometry : Odometry, optional
        Of the query drive.

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
    if settings is not None:
        reference = reference.matched_with(settings)
    queries = describe_query(reference, recording)
    return match_query(reference, queries, odometry), queries


def match_query(
    reference: ReferenceMap, queries: Descriptors, odometry: Odometry | None = None
) -> Matches:
    """Match a described query by the settings, probabilities and jumps of a map.

    Parameters
    ----------
    reference : ReferenceMap
    queries : Descriptors
    odometry : Odometry, optional
        Of the query drive.

    Returns
    -------
    Matches
    """
    return match_descriptors(
        reference.places, queries, reference.settings, reference.judge.confidence,
        jumps=reference.jumps, along_mm=reference.along_mm, odometry=odometry,
    )  # fmt: skip


def check_sensor(recording: Sensor, mapped: Sensor) -> None:
    """Raise MapError unless the recording's sensor is the map's."""
    if recording != mapped:
        raise MapError(
            f"the recording is of a {recording} sensor and the map of a {mapped} one: use the map "
            "of this camera, or name the right sensor (--sensor)"
        )


def window_of(settings: Settings) -> Window:
    """Tell the window that the settings ask for."""
    if settings.window == "time":
        return FixedTime(settings.tau_us)
    return FixedCount(settings.events_per_window)


def cleaned(
    recording: EventSource, settings: Settings, removed: Removed | None = None
) -> Iterator[Events]:
    """Yield a recording's events without bursts, if the settings ask for it.

    Parameters
    ----------
    recording : EventSource
    settings : Settings
    removed : Removed, optional
        Is filled with what was left out.

    Yields
    ------
    Events
    """
    removed = Removed() if removed is None else removed
    removed.events = removed.burst_events = 0
    bursts = BurstFilter(recording.sensor) if settings.remove_bursts else None
    for events in recording:
        removed.events += int(events.size)
        if bursts is None:
            yield events
        else:
            yield from bursts.pieces(events)
            removed.burst_events = bursts.removed
    if bursts is not None:
        yield bursts.finish()
        removed.burst_events = bursts.removed


def _windows(
    recording: EventSource,
    stream: DescriptorStream,
    settings: Settings,
    removed: Removed | None,
) -> Iterator[WindowCounts]:
    for events in cleaned(recording, settings, removed):
        yield from stream.windows(events)
    if settings.keep_incomplete:
        yield from stream.last()


def _check_windows_only(settings: Settings) -> None:
    if settings.window == "count" or settings.polarity:
        raise UsageError(
            "published windows hold no events: fixed-count windows and polarity need a recording "
            "of events"
        )


def _check_counted(source: WindowSource, pixel_map: PixelMap, settings: Settings) -> None:
    _check_windows_only(settings)
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
