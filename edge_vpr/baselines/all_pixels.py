"""Dense baseline: the same counts and distances over all pixels of the sensor."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.pipeline import EventSource, WindowSource, coded_map, count_windows, describe
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


def map_all_pixels(
    recording: EventSource | WindowSource, settings: Settings, hot: npt.NDArray[np.bool_]
) -> ReferenceMap:
    """Map a drive with every pixel that is not hot (paper, "all pixels", after Milford 2015).

    Parameters
    ----------
    recording : EventSource or WindowSource
    settings : Settings
        `pixels` and `strategy` are replaced. A fixed-count window holds `events_per_pixel` events
        for each pixel of the sensor; if that is None, it holds the average number of a window of
        tau.
    hot : ndarray of bool, shape (height, width)
    """
    y, x = np.nonzero(~hot)
    everything = PixelMap(recording.sensor, x.astype(np.uint16), y.astype(np.uint16))
    settings = settings.replaced({"pixels": len(everything), "strategy": "top"}, "all pixels")
    if settings.window == "count" and settings.events_per_pixel is None:
        by_time = describe(
            recording, everything, settings.uncoded.replaced({"window": "time"}, "all pixels")
        )
        mean = by_time.counts.sum(dtype=np.int64) / by_time.counts.size
        settings = settings.replaced({"events_per_pixel": float(mean)}, "all pixels")
    saliency = np.zeros(hot.shape, dtype=np.float32)
    counted = count_windows(recording, everything, settings)
    return coded_map(ReferenceMap(settings.uncoded, everything, counted, saliency, hot), settings)
