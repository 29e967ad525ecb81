"""The design of a device that matches as a saved map says."""

from __future__ import annotations

from edge_vpr.reference_map import ReferenceMap
from firmware_model.design import Design
from fixedpoint.codes import CounterCode, PixelCodes


def design_of(reference: ReferenceMap, lanes: int = 8) -> Design:
    """Take every parameter of a design from a map.

    Parameters
    ----------
    reference : ReferenceMap
        Where it holds counts, the device's counters have as many bits as the map stores.
    lanes : int
        P, which a map does not say.

    Returns
    -------
    Design

    Raises
    ------
    DesignError
        If the device could not be.
    """
    settings, codes = reference.settings, device_codes(reference)
    return Design(
        width=reference.pixel_map.sensor.width,
        height=reference.pixel_map.sensor.height,
        pixels=len(reference.pixel_map),
        polarity=settings.polarity,
        code=codes.codes[0].kind,
        code_bits=codes.codes[0].bits,
        full_scales=tuple(code.full_scale for code in codes.codes),
        window=settings.window,
        tau_us=settings.tau_us,
        window_events=max(1, settings.events_per_window),
        places=len(reference),
        length=settings.sequence_length,
        lanes=lanes,
        exclusion=settings.exclusion,
    )


def device_codes(reference: ReferenceMap) -> PixelCodes:
    """Tell the codes of a device for this map.

    Where the map holds counts as they are, they saturate at what 8 or 16 bits hold.
    """
    if reference.codes is not None:
        return reference.codes
    counts = reference.places.counts
    bits = 8 if counts.max(initial=0) < 1 << 8 else 16
    return PixelCodes.shared(CounterCode("linear", bits), counts.shape[1])


def event_rates(reference: ReferenceMap) -> tuple[float, float]:
    """Events a second of the whole sensor in the reference drive, and the share at selected pixels.

    Counts that are codes are put back, each in the middle of its code's.
    """
    places = reference.places
    seconds = int((places.end_us - places.start_us).sum()) / 1e6
    events = int(places.events.sum())
    selected = int(reference.decoded(places).counts.sum())
    return events / max(seconds, 1e-6), min(1.0, selected / max(events, 1))
