"""From recordings to descriptors and maps: sources, cleaning, description, mapping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.cleaning import BurstFilter, can_be_searched, find_hot_pixels
from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import (
    PixelMap,
    PixelStatistics,
    informative_pixels,
    plugin_pixels,
    select_pixels,
    shortlist,
    too_few_pixels,
)
from edge_vpr.descriptors.windows import (
    Descriptors,
    FixedCount,
    FixedTime,
    Window,
    WindowCounts,
    collect,
    find_pauses,
    narrow,
    overlapping,
)
from edge_vpr.errors import MapError, UsageError, expect, kind_of
from edge_vpr.events import Events, Sensor
from edge_vpr.map_record import AnyMap, MapRecord, drive_mean, encoder_of
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PLUGIN, Settings
from fixedpoint.codes import learn_full_scale

# Inputs of mapping and matching: a recording of events, or counts of finished windows.


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


def opened(
    recording: EventSource | WindowSource | str | Path, frame_period: Fraction | None = None
) -> EventSource | WindowSource:
    """Return a recording, or open it if it is a path.

    Parameters
    ----------
    frame_period : Fraction, optional
        Seconds a frame of counts, where the file does not say.

    Raises
    ------
    UsageError
        If it is neither.
    RecordingError
        If the file cannot be read.
    """
    if isinstance(recording, str | Path):
        return open_recording(recording, default_frame_period=frame_period)
    if isinstance(recording, WindowSource):
        return recording
    if not hasattr(recording, "sensor") or not hasattr(recording, "__iter__"):
        raise UsageError(
            f"the recording is {kind_of(recording)}: give a path, what open_recording returns, or "
            "an object with a sensor that yields arrays of events"
        )
    return recording


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


# The events of a recording without bursts, and the number of removed events.


@dataclass
class Removed:
    """Counts of what cleaning removed in the newest pass over a recording; filled while reading.

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


def cleaned(
    recording: EventSource, settings: Settings, removed: Removed | None = None
) -> Iterator[Events]:
    """Yield the events of a recording, without bursts if the settings ask for it.

    Parameters
    ----------
    removed : Removed, optional
        Is filled with what was left out.
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


def event_windows(
    recording: EventSource, stream: DescriptorStream, settings: Settings, removed: Removed | None
) -> Iterator[WindowCounts]:
    """Yield the windows of a recording's cleaned events.

    Parameters
    ----------
    removed : Removed, optional
        Is filled with what was left out.
    """
    for events in cleaned(recording, settings, removed):
        yield from stream.windows(events)
    if settings.keep_incomplete:
        yield from stream.last()


# Conversion of a recording to descriptors: events at the selected pixels, window by window.


def count_windows(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window; see `describe`."""
    return describe(recording, pixel_map, settings.uncoded, removed=removed)


def count_places(
    recording: EventSource | WindowSource,
    pixel_map: PixelMap,
    settings: Settings,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the windows of a drive that can be places: as `count_windows`, or overlapping ones.

    With N places per window, a window starts at each N-th part of a window. It is as long as any
    other. Every N-th place is therefore a place of the map with one place per window.

    Raises
    ------
    UsageError
        If the recording is shorter than a window, holds no events, or a window has no whole parts.
    """
    number = settings.places_per_window
    if number == 1:
        return count_windows(recording, pixel_map, settings, removed)
    check_parts(recording, settings)
    part: dict[str, object] = {"places_per_window": 1, "tau_us": max(settings.tau_us // number, 1)}
    if settings.events_per_pixel is not None:
        part["events_per_pixel"] = settings.events_per_pixel / number
    pieces = count_windows(
        recording, pixel_map, settings.replaced(part, "parts of a window"), removed
    )
    found = overlapping(pieces, number, keep_incomplete=settings.keep_incomplete)
    if len(found) == 0:
        raise too_short(window_of(settings))
    return found


def check_parts(recording: EventSource | WindowSource, settings: Settings) -> None:
    """Raise UsageError unless places can start at the parts of a window that the settings say."""
    number = settings.places_per_window
    if number == 1:
        return
    where = f"setting places_per_window = {number}"
    if isinstance(recording, WindowSource):
        raise UsageError(
            f"{where} needs events, and published windows hold counts: set places_per_window to 1"
        )
    if settings.window == "time" and settings.tau_us % number:
        raise UsageError(
            f"{where} with windows of {settings.tau_us} us: expected an even number of microseconds"
        )
    by_count = settings.window == "count" and settings.events_per_pixel is not None
    if by_count and settings.events_per_window % number:
        raise UsageError(
            f"{where} with windows of {settings.events_per_window} events: expected an even "
            "number; set events_per_pixel to auto, or to another value"
        )


def describe_query(
    reference: MapRecord,
    recording: EventSource | WindowSource,
    removed: Removed | None = None,
) -> Descriptors:
    """Describe a query drive in the same way as the places of a map, with its codes.

    Parameters
    ----------
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
    settings = reference.settings.uncoded
    return reference.coded(describe(recording, reference.pixel_map, settings, removed=removed))


def describe(
    recording: EventSource | WindowSource | str | Path,
    pixel_map: PixelMap,
    settings: Settings,
    full_scale: npt.NDArray[np.uint16] | None = None,
    *,
    removed: Removed | None = None,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    recording : recording or path
        A path is opened by `open_recording`.
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
    recording = opened(recording)
    expect(pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels or of a map")
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    check_sensor(recording.sensor, pixel_map.sensor)
    counters = len(pixel_map) * (2 if settings.polarity else 1)
    codes = encoder_of(settings, pixel_map, counters, full_scale)
    if isinstance(recording, WindowSource):
        check_counted(recording, pixel_map, settings)
        flat = pixel_map.y.astype(np.int64) * pixel_map.sensor.width + pixel_map.x
        windows: Iterator[WindowCounts] = (
            window._replace(counts=window.counts[flat]) for window in recording.windows()
        )
    else:
        stream = DescriptorStream(pixel_map, window_of(settings), polarity=settings.polarity)
        windows = event_windows(recording, stream, settings, removed)
    descriptors = collect(windows, counters)
    if len(descriptors) == 0:
        raise too_short(window_of(settings))
    events = descriptors.activity
    if codes is None:
        return replace(descriptors, selected=events)
    return replace(descriptors, counts=narrow(codes.encode(descriptors.counts)), selected=events)


def window_of(settings: Settings) -> Window:
    """Return the kind and length of window of the settings."""
    if settings.window == "time":
        return FixedTime(settings.tau_us)
    return FixedCount(settings.events_per_window)


def too_short(window: Window) -> UsageError:
    """Return the error of a recording without a whole window."""
    return UsageError(
        f"the recording is shorter than one window of {window}: "
        "take shorter windows, or a longer drive"
    )


# Making a map of a reference drive: select pixels, and make its windows places.


def map_traverse(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    pixel_map: PixelMap | None = None,
    hot: npt.NDArray[np.bool_] | None = None,
    removed: Removed | None = None,
) -> MapRecord:
    """Make a reference map of one drive, in one pass over its events or two.

    A second pass is needed for fixed-count windows, for polarity, for several places per window,
    and if the images of all windows are too large for a temporary file. If a recording has events
    at few pixels alone, as published counts do, and no more than the settings ask for, all of them
    are the map's.

    Parameters
    ----------
    recording : EventSource or WindowSource
        For example from `open_recording`.
    pixel_map : PixelMap, optional
        Pixels to use; by default they are selected as the settings say.
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it and at least half of the
        pixels fire.
    removed : Removed, optional
        Is filled with what was left out.

    Raises
    ------
    UsageError
        If the recording is shorter than a window (than two, where pixels are selected by their
        variance), or too few pixels can be drawn.
    RecordingError, EventError
        If the recording is faulty.
    """
    recording = opened(recording)
    sensor = recording.sensor
    if removed is not None:
        expect(removed, Removed, "removed", "Removed() to be filled, or leave it out")
    if hot is not None:
        expect(hot, np.ndarray, "hot", "an array of bool, shape (height, width), or a file")
        if hot.dtype != np.bool_:
            raise UsageError(f"hot pixels are an array of {hot.dtype}: give one of bool")
    if hot is not None and hot.shape != (sensor.height, sensor.width):
        raise UsageError(
            f"hot pixels are given for {hot.shape[1]}x{hot.shape[0]} pixels and the recording is "
            f"of a {sensor} sensor: give the list of this camera"
        )
    if pixel_map is not None:
        expect(pixel_map, PixelMap, "pixel_map", "a PixelMap(sensor, x, y)")
        check_sensor(sensor, pixel_map.sensor)
        settings = settings.replaced({"pixels": len(pixel_map)}, "the pixel map")
    check_parts(recording, settings)
    # the released code selects by clipped counts; with other codes, pixels are selected by plain
    # counts, so that maps with different codes have the same pixels
    with PixelStatistics(sensor, clip=settings.clip) as first:
        if isinstance(recording, WindowSource):
            check_windows_only(settings)
            settings = settings.replaced({"tau_us": recording.window_us}, "the published windows")
            if pixel_map is not None:
                check_counted(recording, pixel_map, settings)
            windows = recording.windows()
        else:
            everything = PixelMap.all_of(sensor)
            stream = DescriptorStream(everything, FixedTime(settings.tau_us))
            windows = event_windows(recording, stream, settings, removed)
        for window in windows:
            first.add(window)
        if first.windows == 0:
            raise too_short(FixedTime(settings.tau_us))
        counted = np.ones((sensor.height, sensor.width), dtype=np.bool_)
        if isinstance(recording, WindowSource):
            counted = recording.counted
        # next to pixels that were not counted, all others would look hot
        searched = settings.remove_hot_pixels and counted.all() and can_be_searched(first.totals)
        if hot is None and searched:
            hot = find_hot_pixels(first.totals)
        elif hot is None:
            hot = np.zeros_like(counted)
        by_variance = pixel_map is None and settings.strategy in ("variance", "top", "information")
        if first.windows == 1 and by_variance:
            raise UsageError(
                f"the drive holds one window of {FixedTime(settings.tau_us)}, and pixels can be "
                "selected only from two windows or more: take shorter windows (--tau), or a "
                "longer drive"
            )
        saliency = first.mean() if settings.strategy == "seed-code" else first.variance()
        if pixel_map is not None:
            hot = hot & (pixel_map.table() < 0)
        elif (given := _given_pixels(first, settings.pixels, hot)) is not None:
            pixel_map = given
            settings = settings.replaced({"pixels": len(given)}, "the recording")
        elif settings.strategy == "information":
            listed = shortlist(saliency, hot | ~counted)
            if len(listed) < settings.pixels:
                varying = int(np.count_nonzero(saliency[hot]))
                raise too_few_pixels(len(listed), varying, settings.pixels, sensor)
            pixel_map = _most_informative(first, recording, settings, listed)
        elif settings.strategy.startswith(PLUGIN):
            pixel_map = plugin_pixels(first, settings, hot | ~counted)
        else:
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
        needs_events = (
            settings.window == "count" or settings.polarity or settings.places_per_window > 1
        )
        places = None if needs_events else first.descriptors(pixel_map)
    if places is None:
        places = count_places(recording, pixel_map, settings, removed)
    return coded_map(
        MapRecord(settings.uncoded, pixel_map, places, saliency.astype(np.float32), hot),
        settings,
    )


def _given_pixels(
    first: PixelStatistics, pixels: int, hot: npt.NDArray[np.bool_]
) -> PixelMap | None:
    """Return the pixels that fire, if they were selected before: few, and busy.

    Counts are often published at selected pixels alone, which are then all of the map. In a drive
    that is too short, few pixels fire too, but most of them not even once a window.
    """
    totals = first.totals
    fires = totals > 0
    few = int(np.count_nonzero(fires))
    busy = int(totals.sum()) >= few * first.windows
    if not 0 < few <= pixels or can_be_searched(totals) or not busy or (hot & fires).any():
        return None
    y, x = np.nonzero(fires)
    height, width = totals.shape
    return PixelMap(Sensor(width, height), x.astype(np.uint16), y.astype(np.uint16))


def check_matchable(reference: MapRecord) -> None:
    """Raise UsageError if a map has fewer places than its sequences have windows."""
    length, places = reference.settings.windows_per_match, len(reference)
    if length > places:
        raise UsageError(
            f"a sequence of {length} windows does not fit the {places} places of this drive: take "
            "a shorter sequence (-L), shorter windows (--tau), or a longer drive"
        )


def _most_informative(
    first: PixelStatistics,
    recording: EventSource | WindowSource,
    settings: Settings,
    listed: PixelMap,
) -> PixelMap:
    windows = first.descriptors(listed)
    if windows is None:  # too large for a temporary file: events are counted again
        by_time = settings.uncoded.replaced({"window": "time", "polarity": False}, "the shortlist")
        windows = count_windows(recording, listed, by_time)
    return informative_pixels(listed, windows.counts, settings.pixels)


def coded_map(counted: AnyMap, settings: Settings) -> AnyMap:
    """Code the counts of a reference map, and compute the parameters of its code from them.

    Parameters
    ----------
    counted : MapRecord
        With counts as they are, at least one place.
    settings : Settings
        Of the map to make.
    """
    places, windows = counted.places, counted.windows
    counts, events = places.counts, places.activity
    full_scale, mean = None, None
    code = settings.own_mean_code
    if code is not None:
        paused = find_pauses(windows.activity, counted.mean_activity)
        mean = drive_mean(windows.counts, paused, code)
        coded: npt.NDArray[np.unsignedinteger] = code.encode(counts, mean)
    else:
        full_scale = learn_full_scale(windows.counts) if settings.learns_full_scale else None
        codes = encoder_of(settings, counted.pixel_map, counts.shape[1], full_scale)
        coded = counts if codes is None else narrow(codes.encode(counts))
    return replace(
        counted,
        settings=settings,
        places=replace(places, counts=coded, selected=events),
        full_scale=full_scale,
        mean=mean,
    )


def _with_mean_count(settings: Settings, first: PixelStatistics, pixel_map: PixelMap) -> Settings:
    """Set the number of events in a window to the average of a window of tau."""
    events = int(first.totals[pixel_map.y, pixel_map.x].sum())
    number = settings.places_per_window  # a window has as many whole parts
    mean = number * max(1, round(events / first.windows / number))
    return settings.replaced({"events_per_pixel": mean / len(pixel_map)}, "the reference")
