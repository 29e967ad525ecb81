"""Maps of drives: select pixels, count the windows, and code them.

What `ReferenceMap.build` and `ReferenceMap.update` do.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import archive_kind
from edge_vpr.descriptors.activity import activity_of_drive
from edge_vpr.descriptors.cleaning import can_be_searched, find_hot_pixels, load_hot_pixels
from edge_vpr.descriptors.codes import counted_events, drive_mean, limits_of, saturated
from edge_vpr.descriptors.counting import (
    DescriptorStream,
    Removed,
    check_parts,
    check_sensor,
    count_places,
    count_windows,
    event_windows,
    too_short,
)
from edge_vpr.descriptors.pixels import (
    PixelMap,
    PixelStatistics,
    load_pixel_map,
    select_pixels,
)
from edge_vpr.descriptors.published import WindowSource, check_counted, check_windows_only
from edge_vpr.descriptors.windows import Descriptors, FixedTime, overlapping
from edge_vpr.drive_inputs import (
    AnyRecording,
    check_reading,
    odometry_of,
    of_part,
    opened,
    track_of,
    unix_start,
)
from edge_vpr.errors import EdgeVprWarning, MapError, UsageError, expect
from edge_vpr.evaluation.tables import AnyOdometry
from edge_vpr.evaluation.track_files import AnyTrack
from edge_vpr.evaluation.tracks import with_positions
from edge_vpr.events import Sensor, SensorSize
from edge_vpr.learning import MapUpdate, learn_drive
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import KIND, ReferenceMap
from edge_vpr.settings import Preset, Settings, resolve_settings

# A map of a drive, and of another one too.


def build(
    recording: AnyRecording,
    settings: Settings | Preset | Path | None,
    changes: Mapping[str, Any],
    *,
    sensor: SensorSize | None,
    pixel_map: PixelMap | str | Path | None,
    hot: npt.NDArray[np.bool_] | str | Path | None,
    track: AnyTrack | None,
    odometry: AnyOdometry | None,
    removed: Removed | None,
) -> ReferenceMap:
    """Make a map of one drive, see `ReferenceMap.build`."""
    check_reading(changes, "build")
    chosen = _settings_of(settings, changes)
    drive = opened(recording, sensor=sensor)
    if isinstance(hot, str | Path):
        hot = load_hot_pixels(hot, drive.sensor)
    if isinstance(pixel_map, str | Path):
        is_map = archive_kind(pixel_map) == KIND
        pixel_map = (
            ReferenceMap.load(pixel_map).pixel_map
            if is_map
            else load_pixel_map(pixel_map, drive.sensor)
        )
    track, odometry = track_of(track), odometry_of(odometry)
    made = replace(
        map_traverse(drive, chosen, pixel_map=pixel_map, hot=hot, removed=removed),
        frame_period=drive.frame_period,
        start_us=drive.cropped_us,
        clock_us=unix_start(drive),
    )
    check_matchable(made)
    if "pixels" in changes and pixel_map is None and made.settings.pixels < chosen.pixels:
        warnings.warn(
            f"pixels={chosen.pixels}, and the recording has events at {made.settings.pixels} "
            "pixels alone: the map has these",
            EdgeVprWarning,
            stacklevel=3,
        )
    if track is not None:
        clock_us = drive.start_us - drive.cropped_us
        made = with_positions(made, track, clock_us)
    if odometry is not None:
        made = replace(made, odometer_mm=of_part(drive, odometry).along(made.places.centre_us))
    return made


def update(
    reference: ReferenceMap,
    recording: AnyRecording,
    *,
    track: AnyTrack | None,
    odometry: AnyOdometry | None,
    same_route: bool,
    removed: Removed | None,
) -> MapUpdate:
    """Update a map with another drive, see `ReferenceMap.update`."""
    drive = opened(recording, default=reference.camera)
    counted = count_places(drive, reference.pixel_map, reference.settings, removed)
    return learn_drive(
        reference,
        counted,
        track=of_part(drive, track_of(track)),
        odometry=of_part(drive, odometry_of(odometry)),
        same_route=same_route,
    )


def _settings_of(settings: Settings | str | Path | None, changes: Mapping[str, Any]) -> Settings:
    if isinstance(settings, Settings):
        return settings.replaced(changes, "build")
    if settings is None:
        settings = "default"
    expect(
        settings,
        (str, Path),
        "settings",
        "Settings, the name of a preset, or a TOML file; single settings as keywords: pixels=50",
    )
    is_file = isinstance(settings, Path) or settings.endswith(".toml")
    if is_file:
        return resolve_settings(config=settings, flags=changes, source="build")
    return resolve_settings(cast("Preset", str(settings)), flags=changes, source="build")


#: frames in a window of a reference of frames that has places at half windows, at least: its halves
#: then differ little in length
LEAST_FRAMES = 20


# Descriptors of a drive, with the codes of a map.


def describe(
    recording: EventSource | WindowSource | str | Path,
    pixel_map: PixelMap,
    settings: Settings,
) -> Descriptors:
    """Count the events of a drive at the selected pixels, window by window, in one pass.

    Parameters
    ----------
    recording : recording or path
        A path is opened by `open_recording`.
    settings : Settings
        Of the map, with counts: contrast codes need the mean of a drive.

    Returns
    -------
    Descriptors
        At least one.

    Raises
    ------
    UsageError
        If the recording is shorter than a window.
    """
    recording = opened(recording)
    expect(pixel_map, PixelMap, "pixel_map", "a PixelMap, as of select_pixels or of a map")
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    if settings.contrast_code is not None:
        raise MapError(
            "contrast codes need the mean of a drive: take ReferenceMap.match, or counts with "
            "settings.uncoded"
        )
    return saturated(count_windows(recording, pixel_map, settings), settings.most_counted)


# Making a map of a reference drive: select pixels, and make its windows places.


def map_traverse(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    pixel_map: PixelMap | None = None,
    hot: npt.NDArray[np.bool_] | None = None,
    removed: Removed | None = None,
) -> ReferenceMap:
    """Make a map of one drive, in one pass over its events or two.

    A second pass is needed for fixed-count windows, and if the images of all windows,
    or of their parts, are too large for a temporary file. Where a file counts no more
    pixels than the settings ask for, all of them are the map's.

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
    sensor = recording.sensor
    _check_of_sensor(sensor, pixel_map, hot, removed)
    if pixel_map is not None:
        settings = settings.replaced({"pixels": len(pixel_map)}, "the pixel map")
    if settings.places_per_window is None:
        settings = with_places(settings, recording)
    check_parts(recording, settings)
    if isinstance(recording, WindowSource):
        check_windows_only(settings)
        settings = settings.replaced({"tau_us": recording.window_us}, "the published windows")
        if pixel_map is not None:
            check_counted(recording, pixel_map, settings)
    # the released code selects by clipped counts; with codes, pixels are selected by plain counts,
    # so that maps with different codes have the same pixels
    needs_events = settings.window == "count"
    parts = 1 if needs_events else settings.window_parts
    with PixelStatistics(sensor, clip=settings.clip, parts=parts) as first:
        _scan(recording, settings, first, parts, removed)
        counted = recording.counted
        if counted is None:
            counted = np.ones((sensor.height, sensor.width), dtype=np.bool_)
        if hot is None:
            hot = _hot_pixels(first, settings, counted)
        saliency = first.mean() if settings.strategy == "seed-code" else first.variance()
        if pixel_map is not None:
            hot = hot & (pixel_map.table() < 0)
        else:
            pixel_map = _choose_pixels(first, recording, settings, saliency, hot, counted)
            settings = settings.replaced({"pixels": len(pixel_map)}, "the recording")
        if settings.window == "count" and settings.events_per_pixel is None:
            settings = _with_mean_count(settings, first, pixel_map)
        pieces = None if needs_events else first.pieces(pixel_map)
    if pieces is None:
        places = count_places(recording, pixel_map, settings, removed)
    else:
        places = pieces if parts == 1 else overlapping(pieces, parts)
    return coded_map(
        ReferenceMap(settings.uncoded, pixel_map, places, saliency.astype(np.float32), hot),
        settings,
    )


def _check_of_sensor(
    sensor: Sensor,
    pixel_map: PixelMap | None,
    hot: npt.NDArray[np.bool_] | None,
    removed: Removed | None,
) -> None:
    """Check that the parts of a map that a caller gives are of this sensor."""
    if removed is not None:
        expect(removed, Removed, "removed", "Removed() to be filled, or leave it out")
    if hot is not None:
        expect(hot, np.ndarray, "hot", "an array of bool, shape (height, width), or a file")
        if hot.dtype != np.bool_:
            raise UsageError(f"hot pixels are an array of {hot.dtype}: give one of bool")
        if hot.shape != (sensor.height, sensor.width):
            raise UsageError(
                f"hot pixels are given for {hot.shape[1]}x{hot.shape[0]} pixels and the recording "
                f"is of a {sensor} sensor: give the list of this camera"
            )
    if pixel_map is not None:
        expect(pixel_map, PixelMap, "pixel_map", "a PixelMap(sensor, x, y)")
        check_sensor(sensor, pixel_map.sensor)


def _scan(
    recording: EventSource | WindowSource,
    settings: Settings,
    first: PixelStatistics,
    parts: int,
    removed: Removed | None,
) -> None:
    """Count the events of all pixels, window by window or part by part."""
    stream = None
    if isinstance(recording, WindowSource):
        windows = recording.windows()
    else:
        every_pixel = PixelMap.all_of(recording.sensor)
        stream = DescriptorStream(every_pixel, FixedTime(settings.tau_us // parts))
        windows = event_windows(recording, stream, settings, removed)
    for window in windows:
        first.add(window)
    if first.windows == 0:
        raise too_short(FixedTime(settings.tau_us), stream)


def _hot_pixels(
    first: PixelStatistics, settings: Settings, counted: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Return the hot pixels, if the settings ask for them and they can be told."""
    # next to pixels that were not counted, all others would look hot
    if settings.remove_hot_pixels and counted.all() and can_be_searched(first.totals):
        return find_hot_pixels(first.totals)
    return np.zeros_like(counted)


def _choose_pixels(
    first: PixelStatistics,
    recording: EventSource | WindowSource,
    settings: Settings,
    saliency: npt.NDArray[np.float64],
    hot: npt.NDArray[np.bool_],
    counted: npt.NDArray[np.bool_],
) -> PixelMap:
    """Choose the pixels of a map by the strategy of its settings."""
    if first.windows == 1 and settings.strategy in ("variance", "top"):
        raise UsageError(
            f"the drive holds one window of {FixedTime(settings.tau_us)}, and pixels can be "
            "selected only from two windows or more: take shorter windows (tau=), or a "
            "longer drive"
        )
    if not counted.all() and np.count_nonzero(counted) <= settings.pixels:
        y, x = np.nonzero(counted)  # somebody else has selected them
        return PixelMap(recording.sensor, x.astype(np.uint16), y.astype(np.uint16))
    return select_pixels(
        saliency,
        settings.pixels,
        strategy=settings.strategy,
        sigma=settings.sigma,
        rng=np.random.default_rng(settings.seed),
        exclude=hot | ~counted,
    )


def check_matchable(reference: ReferenceMap) -> None:
    """Raise UsageError if a map has fewer places than its sequences have windows."""
    length, places = reference.settings.windows_per_match, len(reference)
    if length > places:
        raise UsageError(
            f"a sequence of {length} windows does not fit the {places} places of this drive: take "
            "a shorter sequence (sequence_length=), shorter windows (tau=), or a longer drive"
        )


def coded_map(counted: ReferenceMap, settings: Settings) -> ReferenceMap:
    """Code the counts of a reference map, and compute the parameters of its code from them.

    Parameters
    ----------
    counted : ReferenceMap
        With counts as they are, at least one place.
    settings : Settings
        Of the map to make.
    """
    places, windows = counted.places, counted.windows
    code, selected = settings.contrast_code, places.selected_events
    if code is None:
        places = replace(saturated(places, settings.most_counted), selected=selected)
        return replace(counted, settings=settings, places=places)
    limits = limits_of(windows.counts)
    that_count, of_windows = (counted_events(each.counts, limits) for each in (places, windows))
    windows = replace(windows, counted=of_windows)
    mean = drive_mean(windows, code, activity_of_drive(of_windows))
    coded = code.encode(places.counts, mean)
    return replace(
        counted,
        settings=settings,
        places=replace(places, counts=coded, selected=selected, counted=that_count),
        mean=mean,
        limits=limits,
    )


class FittingWindow(NamedTuple):
    """The length of window that fits the speed of a drive, from `fitting_window`."""

    tau_us: int
    travel_m: float | None  #: Of the median window of the map; None without track or odometry.
    events_per_pixel: float  #: Mean of a window of the map, at each selected pixel.


#: travel in a window that is aimed at; without a speed, events for each selected pixel and window
_WINDOW_M, _ENOUGH_EVENTS = 2.5, 3.0


def fitting_window(reference: ReferenceMap) -> FittingWindow:
    """Return the length of window that fits the speed of a map's drive, as ``map --tau auto``.

    Parameters
    ----------
    reference : ReferenceMap
        Of the drive, with windows of fixed time.

    Returns
    -------
    FittingWindow
        Of 2.5 m of travel in the median window in which the robot moves, if the map has a track or
        odometry; else of 3 events at each selected pixel. In whole 100 ms, and never shorter than
        the map's: short windows of a fast robot make fewer matches confident.

    Raises
    ------
    UsageError
        If the map has windows of a number of events.

    Examples
    --------
    >>> route = ReferenceMap.build("slow.raw", odometry="slow.csv")  # doctest: +SKIP
    >>> tau_us = fitting_window(route).tau_us  # doctest: +SKIP
    >>> ReferenceMap.build("slow.raw", odometry="slow.csv", tau_us=tau_us)  # doctest: +SKIP
    """
    expect(reference, ReferenceMap, "reference", "a ReferenceMap, as of ReferenceMap.build")
    if reference.settings.window != "time":
        raise UsageError(
            "the map has window=count: a length fits windows of fixed time, so build it with "
            "window=time"
        )
    tau_us, along_mm = reference.settings.tau_us, reference.along_mm
    moved, travel_m = np.empty(0), None
    if along_mm is not None:
        moved = np.diff(along_mm[:: reference.settings.window_parts])
        moved = moved[moved > 0.1 * moved.mean()] if moved.size else moved
    events = float(reference.windows.selected_events.mean()) / len(reference.pixel_map)
    if moved.size:
        travel_m = float(np.median(moved)) / 1e3
        share = _WINDOW_M / travel_m
    else:
        share = _ENOUGH_EVENTS / events if events else 1.0
    fitting_us = max(tau_us, round(tau_us * share / 100_000) * 100_000)
    return FittingWindow(fitting_us, travel_m, events)


def _with_mean_count(settings: Settings, first: PixelStatistics, pixel_map: PixelMap) -> Settings:
    """Set the number of events in a window to the average of a window of tau."""
    events = int(first.totals[pixel_map.y, pixel_map.x].sum())
    number = settings.window_parts  # a window has as many whole parts
    mean = number * max(1, round(events / first.windows / number))
    return settings.replaced({"events_per_pixel": mean / len(pixel_map)}, "the reference")


def with_places(settings: Settings, recording: EventSource | WindowSource | None) -> Settings:
    """Set the number of places per window: two if windows of this recording can overlap.

    None stands for a recording of single events.
    """
    period = None if recording is None else recording.frame_period
    two = (
        settings.matching == "filter"
        and settings.window == "time"
        and settings.tau_us % 2 == 0
        and not isinstance(recording, WindowSource)
        and (period is None or LEAST_FRAMES * period * 1_000_000 <= settings.tau_us)
    )
    return settings.replaced({"places_per_window": 2 if two else 1}, "the reference")
