"""The part of a map that a saved localiser needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from edge_vpr.archive import Arrays, present
from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def map_arrays(reference: ReferenceMap) -> Arrays:
    """Return the arrays of a map that `searched_map` needs, without the places, for an archive."""
    arrays = present(
        pixel_x=reference.pixel_map.x,
        pixel_y=reference.pixel_map.y,
        full_scale=reference.full_scale,
        mean=reference.mean,
        jumps=reference.jumps,
    )
    if reference.confidence is not None:
        arrays |= reference.confidence.to_arrays()
    if reference.settings.matching == "filter":
        arrays |= present(activity=reference.places.activity, odometer_mm=reference.along_mm)
    return arrays


def searched_map(arrays: Arrays, meta: Mapping[str, Any]) -> ReferenceMap:
    """Build a map with only the parts that a localiser needs.

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
        jumps=arrays.get("jumps"),
        odometer_mm=arrays.get("odometer_mm"),
    )
