"""Registration of a query with a map: estimate by how many pixels the image has shifted.

The pixels of the map are tried at every shift. The result is the shift at which the first windows
of the query are most similar to sequences of places. Counts are compared as logarithms less the
mean of each counter, so that neither light nor properties of single pixels (thresholds, noise)
matter.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.own_mean import FULL_SCALE, ContrastCode

#: most windows of the query that are used
WINDOWS = 128
#: largest shift, in pixels, and as a share of the sensor's shorter side
REACH, SHARE = 10, 8
#: smallest number of pixels of the map that must lie on the sensor at every shift
LEAST_PIXELS = 8
#: windows in a sequence, and the standard errors by which the similarity must grow for the map to
#: be moved; both chosen on the walks (docs/results.md)
SEQUENCE, LEAST_ERRORS = 5, 5.0
_ROUGH = 4  # from 1/256 to 1/16 octave, so that sums of squares are exact in double precision

Floats = npt.NDArray[np.float64]


def register(
    reference: ReferenceMap, images: npt.NDArray[np.integer]
) -> tuple[ReferenceMap, int, int]:
    """Move the pixels of a map by the shift of a query's image.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
        Counts of the query's windows at all pixels; the first `WINDOWS` are used.

    Returns
    -------
    reference : ReferenceMap
    dx, dy : int
        By which the map's pixels were moved, to the right and downwards; 0 where no shift is clear.

    Raises
    ------
    UsageError
        If fewer than `LEAST_PIXELS` of the map stay on the sensor at every shift.
    """
    first = np.minimum(images[:WINDOWS], FULL_SCALE)
    dx, dy, likeness, unmoved = estimate_shift(reference, first)
    if not _is_clear(likeness - unmoved):
        dx = dy = 0
    return moved_map(reference, dx, dy), dx, dy


def estimate_shift(
    reference: ReferenceMap, images: npt.NDArray[np.integer]
) -> tuple[int, int, Floats, Floats]:
    """Find the shift at which windows are most similar to the places of a map.

    Every shift is tried: the similarity can fall within one pixel, so that a coarser search could
    miss it.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
        Counts of n windows at all pixels.

    Returns
    -------
    dx, dy : int
        In pixels, up to `REACH` and an eighth of the sensor's shorter side. Of equal ones the
        smallest shift.
    likeness, unmoved : ndarray of float64, shape (n - L + 1,)
        Of each sequence of the query, at this shift and at none.
    """
    pixel_map = reference.pixel_map
    reach = reach_of(pixel_map.sensor)
    # the same pixels at every shift, because with fewer pixels more similarity arises by chance
    x, y = pixel_map.x.astype(np.int64), pixel_map.y.astype(np.int64)
    width, height = pixel_map.sensor
    inner = (x >= reach) & (x < width - reach) & (y >= reach) & (y < height - reach)
    if int(inner.sum()) < LEAST_PIXELS:
        raise UsageError(
            f"{int(inner.sum())} of the map's {len(pixel_map)} pixels lie {reach} or more from the "
            f"border: expected {LEAST_PIXELS} to estimate a shift"
        )
    x, y = x[inner], y[inner]
    counts = reference.decoded(reference.windows).counts
    places = _levels(counts[:, inner].astype(np.int64))
    sums = {
        (dx, dy): _likeness(places, _levels(images[:, y + dy, x + dx]))
        for dy in range(-reach, reach + 1)
        for dx in range(-reach, reach + 1)
    }
    dx, dy = min(sums, key=lambda s: (-math.fsum(sums[s]), s[0] ** 2 + s[1] ** 2, s))
    return dx, dy, sums[dx, dy], sums[0, 0]


def reach_of(sensor: Sensor) -> int:
    """Return the largest shift that is tried on a sensor, in pixels."""
    return min(REACH, min(sensor) // SHARE)


def moved_map(reference: ReferenceMap, dx: int, dy: int) -> ReferenceMap:
    """Move the pixels of a map; drop those that leave the sensor or would be hot pixels.

    Parameters
    ----------
    dx, dy : int
        To the right and downwards, in pixels.

    Returns
    -------
    ReferenceMap
        The same one for no shift.
    """
    if (dx, dy) == (0, 0):
        return reference
    pixel_map = reference.pixel_map
    x, y = pixel_map.x.astype(np.int64) + dx, pixel_map.y.astype(np.int64) + dy
    width, height = pixel_map.sensor
    kept = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    kept[kept] = ~reference.hot[y[kept], x[kept]]
    if not kept.any():
        raise UsageError(
            f"no pixel of the map is left after a shift of ({dx}, {dy}): make a new map"
        )
    moved = PixelMap(pixel_map.sensor, x[kept].astype(np.uint16), y[kept].astype(np.uint16))
    return _with_pixels(reference, kept, moved)


def _with_pixels(
    reference: ReferenceMap, kept: npt.NDArray[np.bool_], pixel_map: PixelMap
) -> ReferenceMap:
    """Return a map with some of its pixels, at other positions, and all that it has of them."""
    settings, places, left = reference.settings, reference.places, len(pixel_map)
    # codes give roughly the share of events that the remaining counters had
    counts = reference.decoded(places).counts
    events = max(1, int(counts[:, kept].sum(dtype=np.int64)))
    share = min(1.0, events / max(1, int(counts.sum(dtype=np.int64))))
    changes: dict[str, float] = {"pixels": left}
    if settings.events_per_pixel is not None:  # so that a window covers the same distance
        changes["events_per_pixel"] = settings.events_per_pixel * share * kept.size / left

    def of_counters(values: npt.NDArray[Any] | None) -> npt.NDArray[Any] | None:
        return None if values is None else np.ascontiguousarray(values[..., kept])

    return replace(
        reference,
        settings=settings.replaced(changes, "the pixels that are left"),
        pixel_map=pixel_map,
        places=replace(
            places,
            counts=np.ascontiguousarray(places.counts[:, kept]),
            selected=np.rint(places.selected_events * share).astype(np.int64),
            counted=np.rint(places.counted_events * share).astype(np.int64),
        ),
        mean=of_counters(reference.mean),
        limits=of_counters(reference.limits),
        learnt_mean=of_counters(reference.learnt_mean),
    )


def _levels(counts: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
    """Return logarithms of counts less the mean of each counter, in whole 1/16 octaves."""
    code = ContrastCode()
    return ((code.level(counts) - code.mean(counts)) >> _ROUGH).astype(np.float64)


def _likeness(places: Floats, windows: Floats) -> Floats:
    """Return each query sequence's mean correlation with the most similar sequence of places."""
    n = places.shape[1]
    # sums and products of whole numbers are exact in any order
    cross = n * (places @ windows.T) - places.sum(axis=1)[:, None] * windows.sum(axis=1)
    spread = [np.sqrt(n * (c * c).sum(axis=1) - c.sum(axis=1) ** 2) for c in (places, windows)]
    scale = spread[0][:, None] * spread[1]
    like = np.divide(cross, scale, out=np.zeros_like(cross), where=scale > 0)
    length = min(SEQUENCE, *like.shape)
    sums = np.zeros((like.shape[0] - length + 1, like.shape[1] - length + 1))
    for i in range(length):
        sums += like[i : i + sums.shape[0], i : i + sums.shape[1]]
    return np.asarray(sums.max(axis=0) / length)


def _is_clear(gain: Floats) -> bool:
    """Return whether a gain in similarity is many standard errors above zero."""
    mean = math.fsum(gain) / len(gain)
    variance = math.fsum((gain - mean) ** 2) / len(gain)
    return mean > LEAST_ERRORS * math.sqrt(variance / len(gain))
