"""Conversion of a recording to descriptors: events at the selected pixels, window by window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.codes import codes_of
from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.descriptors import Descriptors, collect, narrow
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime, Window, WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.pipeline.cleaned_events import Removed, event_windows
from edge_vpr.pipeline.sources import EventSource, WindowSource, check_counted, check_sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


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
    removed: Removed | None = None,
) -> Descriptors:
    """Describe a query drive in the same way as the places of a map, with its codes.

    Parameters
    ----------
    reference : ReferenceMap
    recording : EventSource or WindowSource
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
