"""What a saved localiser holds: the map as it is searched, and the events in its windows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from edge_vpr.archive import Arrays
from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.events import Sensor
from edge_vpr.online.state import Sliding, grown, recount
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def map_arrays(reference: ReferenceMap) -> Arrays:
    """Return what `searched_map` needs of a map, as arrays of an archive, without its places."""
    arrays: Arrays = {"pixel_x": reference.pixel_map.x, "pixel_y": reference.pixel_map.y}
    if reference.full_scale is not None:
        arrays["full_scale"] = reference.full_scale
    if reference.mean is not None:
        arrays["mean"] = reference.mean
    if reference.confidence is not None:
        arrays |= reference.confidence.to_arrays()
    if reference.settings.matching == "filter":
        arrays["activity"] = reference.places.activity
    return arrays


def searched_map(arrays: Arrays, meta: Mapping[str, Any]) -> ReferenceMap:
    """Build a map of what a localiser needs of it, without times and figures.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Of `map_arrays`, and ``places``.
    meta : mapping
        With ``sensor`` and ``settings``.
    """
    pixel_map = PixelMap(Sensor(*meta["sensor"]), arrays["pixel_x"], arrays["pixel_y"])
    sensor = pixel_map.sensor
    no_times = np.zeros(len(arrays["places"]), dtype=np.int64)
    figures = np.broadcast_to(np.float32(0), (sensor.height, sensor.width))
    return ReferenceMap(
        Settings.from_dict(meta["settings"]),
        pixel_map,
        Descriptors(arrays["places"], no_times, no_times, no_times, arrays.get("activity")),
        saliency=figures,
        hot=np.broadcast_to(np.False_, figures.shape),
        full_scale=arrays.get("full_scale"),
        mean=arrays.get("mean"),
        confidence=Confidence.from_arrays(arrays),
    )


def events_in_windows(s: Sliding) -> Arrays:
    """Return the events of the windows, as arrays of an archive."""
    alive = np.arange(s.bound[-1], s.bound[0]) & (s.slot.size - 1)
    return {"slot": s.slot[alive], "time": s.time[alive], "bound": s.bound}


def with_events(s: Sliding, arrays: Arrays) -> Sliding:
    """Return the state with the events that `events_in_windows` gave; distances are not taken."""
    while s.slot.size < arrays["slot"].size:
        s = grown(s)
    first = int(arrays["bound"][-1])
    at = np.arange(first, first + arrays["slot"].size) & (s.slot.size - 1)
    s.slot[at] = arrays["slot"]
    s.time[at] = arrays["time"]
    s.bound[:] = arrays["bound"]
    s.counts[:] = recount(s)
    return s
