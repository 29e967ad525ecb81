"""Making a map of a reference drive: select pixels, and make its windows places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.descriptors import narrow
from edge_vpr.descriptors.hot_pixels import find_hot_pixels
from edge_vpr.descriptors.informative_pixels import informative_pixels, shortlist
from edge_vpr.descriptors.own_mean import drive_mean
from edge_vpr.descriptors.pauses import find_pauses, mean_activity
from edge_vpr.descriptors.pixels import PixelMap, select_pixels
from edge_vpr.descriptors.saliency import SaliencyPass
from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import UsageError
from edge_vpr.pipeline.cleaned_events import Removed, event_windows
from edge_vpr.pipeline.describing import count_windows, too_short
from edge_vpr.pipeline.sources import EventSource, WindowSource, check_windows_only
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from fixedpoint.codes import learn_full_scale


def map_traverse(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    hot: npt.NDArray[np.bool_] | None = None,
    removed: Removed | None = None,
) -> ReferenceMap:
    """Make a reference map of one drive, in one pass over its events or two.

    A second pass is needed for fixed-count windows, for polarity, and if the images of all windows
    are too large for a temporary file.

    Parameters
    ----------
    recording : EventSource or WindowSource
        For example from `open_recording`.
    settings : Settings
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it.
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
    if hot is not None and hot.shape != (sensor.height, sensor.width):
        raise UsageError(
            f"hot pixels are given for {hot.shape[1]}x{hot.shape[0]} pixels and the recording is "
            f"of a {sensor} sensor: give the list of this camera"
        )
    # the released code selects by clipped counts; with other codes, pixels are selected by plain
    # counts, so that maps with different codes have the same pixels
    with SaliencyPass(sensor, clip=settings.clip) as first:
        if isinstance(recording, WindowSource):
            check_windows_only(settings)
            settings = settings.replaced({"tau_us": recording.window_us}, "the published windows")
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
        if hot is None and settings.remove_hot_pixels and counted.all():
            hot = find_hot_pixels(first.totals)
        elif hot is None:
            hot = np.zeros_like(counted)
        if first.windows == 1 and settings.strategy in ("variance", "top", "information"):
            raise UsageError(
                f"the drive holds one window of {FixedTime(settings.tau_us)}, and pixels can be "
                "selected only from two windows or more: take shorter windows (--tau), or a "
                "longer drive"
            )
        saliency = first.mean() if settings.strategy == "seed-code" else first.variance()
        if settings.strategy == "information":
            listed = shortlist(saliency, hot | ~counted)
            pixel_map = _most_informative(first, recording, settings, listed)
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
        needs_events = settings.window == "count" or settings.polarity
        places = None if needs_events else first.descriptors(pixel_map)
    if places is None:
        places = count_windows(recording, pixel_map, settings, removed)
    return coded_map(
        ReferenceMap(settings.uncoded, pixel_map, places, saliency.astype(np.float32), hot),
        settings,
    )


def _most_informative(
    first: SaliencyPass, recording: EventSource | WindowSource, settings: Settings, listed: PixelMap
) -> PixelMap:
    windows = first.descriptors(listed)
    if windows is None:  # too large for a temporary file: events are counted again
        by_time = settings.uncoded.replaced({"window": "time", "polarity": False}, "the shortlist")
        windows = count_windows(recording, listed, by_time)
    return informative_pixels(listed, windows.counts, settings.pixels)


def coded_map(counted: ReferenceMap, settings: Settings) -> ReferenceMap:
    """Code the counts of a reference map, and compute the parameters of its code from them.

    Parameters
    ----------
    counted : ReferenceMap
        With counts as they are, at least one place.
    settings : Settings
        Of the map to make.
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


def _with_mean_count(settings: Settings, first: SaliencyPass, pixel_map: PixelMap) -> Settings:
    """Set the number of events in a window to the average of a window of tau."""
    events = int(first.totals[pixel_map.y, pixel_map.x].sum())
    mean = max(1, round(events / first.windows))
    return settings.replaced({"events_per_pixel": mean / len(pixel_map)}, "the reference")
