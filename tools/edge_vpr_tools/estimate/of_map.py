"""The design of a device for a saved map."""

from __future__ import annotations

from typing import Any

import numpy as np

from edge_vpr.descriptors.activity import place_activity
from edge_vpr.matching.distances import typical_distances
from edge_vpr.matching.prediction import bias_of
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from firmware_model.design import Design, DeviceCode
from firmware_model.errors import DesignError
from firmware_model.memories import Memories


def design_of(reference: ReferenceMap, lanes: int = 8) -> Design:
    """Take every parameter of a design from a map.

    Parameters
    ----------
    reference : ReferenceMap
        Where it holds counts, the device's counters have as many bits as the map stores. The place
        filter gives every match that has a second best as accepted, and sequences give every match:
        trust and sum are for the user.
    lanes : int
        P, which a map does not say.

    Raises
    ------
    DesignError
        If the map is of no profile, or the device could not be.
    """
    if reference.settings.profile is None:
        raise DesignError(reference.settings.beyond_profile)
    settings = reference.settings
    code, bits = _code_of(reference)
    return design_by(
        settings,
        width=reference.pixel_map.sensor.width,
        height=reference.pixel_map.sensor.height,
        pixels=len(reference.pixel_map),
        code=code,
        code_bits=bits,
        window_events=1 if settings.events_per_pixel is None else settings.events_per_window,
        places=len(reference),
        length=0 if settings.matching == "filter" else settings.sequence_length,
        lanes=lanes,
    )


def design_by(settings: Settings, **others: Any) -> Design:
    """Take from settings how a design cuts windows and matches them, and the rest from `others`."""
    filters = settings.matching == "filter"
    if filters and settings.window == "count":
        raise DesignError(settings.beyond_profile)
    of_settings = {
        "window": settings.window,
        "tau_us": settings.tau_us,
        "matching": settings.matching,
        "places_per_window": settings.window_parts if filters else 1,
        "gains": settings.gains if filters else 1,
        "restart": settings.filter_restart,
        "exclusion": settings.exclusion_places,
    }
    return Design(**of_settings | others)


def memories_of(reference: ReferenceMap, design: Design) -> Memories:
    """Take the contents of the device's tables from a map."""
    places, events = reference.places.counts, reference.places.counted_events
    of_places = place_activity(events, reference.settings.window_parts)
    return Memories(
        design,
        np.stack([reference.pixel_map.x, reference.pixel_map.y], axis=1).tolist(),
        np.minimum(places, design.code_max).tolist(),
        mean=None if reference.mean is None else reference.mean.tolist(),
        activity=reference.mean_activity if design.pauses else 0,
        place_activity=of_places.tolist() if design.filters else None,
        limits=None if reference.limits is None else reference.limits.tolist(),
        place_bias=bias_of(typical_distances(places)).tolist() if design.filters else None,
    )


def _code_of(reference: ReferenceMap) -> tuple[DeviceCode, int]:
    """Return kind and bits of the codes; counts as they are saturate at what 8 or 16 bits hold."""
    settings = reference.settings
    if settings.matching == "filter":
        return "contrast", settings.counter_bits
    if settings.counter_code == "linear":
        return "counts", settings.counter_bits
    return "counts", 8 if reference.places.counts.max(initial=0) < 1 << 8 else 16


def event_rates(reference: ReferenceMap) -> tuple[float, float] | None:
    """Return the events per second of the reference drive, and their share at selected pixels.

    None if the drive was counted at the selected pixels alone, which says nothing about the others;
    also if these are all that its count frames hold.
    A code stands for the count in the middle of its range.
    """
    places, pixel_map = reference.places, reference.pixel_map
    everywhere = len(pixel_map) == pixel_map.sensor.pixels and reference.frame_period is None
    if (places.events <= places.selected_events).all() and not everywhere:
        return None
    seconds = int((places.end_us - places.start_us).sum()) / 1e6
    events = int(places.events.sum())
    selected = int(reference.decoded(places).counts.sum())
    return events / max(seconds, 1e-6), min(1.0, selected / max(events, 1))
