"""Baselines on pixels: the paper's method, its released code, all pixels, active pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.pixels import PixelMap, PixelStatistics, select_pixels
from edge_vpr.descriptors.published import WindowSource
from edge_vpr.descriptors.windows import WindowCounts, narrow
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from lab.baselines.baseline import Described, Images, VectorBaseline
from lab.baselines.dense import AbsoluteDifferences
from lab.informative_pixels import informative_pixels, shortlist

# The paper's method and its released code, with the interface of the baselines.


class SelectedPixels(AbsoluteDifferences):
    """Counts at a few pixels of the reference, compared by the sum of absolute differences.

    Parameters
    ----------
    settings : Settings
        `pixels`, `strategy`, `sigma` and `seed` are used, and the count at which counters saturate.
    by_information : bool
        Choose by `informative_pixels`, and not by the strategy.
    """

    def __init__(self, title: str, settings: Settings, *, by_information: bool = False) -> None:
        self.title, self._by_information = title, by_information
        self._settings = settings
        self._pixels: PixelMap | None = None

    def prepare(self, reference: Images) -> None:
        """Draw the pixels by their saliency in the reference."""
        chosen = self._settings
        sensor = Sensor(reference.shape[2], reference.shape[1])
        with PixelStatistics(sensor, clip=chosen.clip, spool_bytes=-1) as first:
            for image in reference:
                counts = image.astype(np.int64).ravel()
                first.add(WindowCounts(counts, 0, 1, int(counts.sum())))
            saliency = first.mean() if chosen.strategy == "seed-code" else first.variance()
        if self._by_information:
            listed = shortlist(saliency)
            counts = narrow(reference[:, listed.y, listed.x])
            self._pixels = informative_pixels(listed, counts, chosen.pixels)
            return
        self._pixels = select_pixels(
            saliency, chosen.pixels, strategy=chosen.strategy, sigma=chosen.sigma,
            rng=np.random.default_rng(chosen.seed),
        )  # fmt: skip

    @property
    def pixel_map(self) -> PixelMap:
        """Selected pixels, after `prepare` has drawn them."""
        if self._pixels is None:
            raise UsageError("the pixels are not drawn yet: prepare with the reference first")
        return self._pixels

    def describe(self, images: Images) -> Described:
        """Return the counts at the pixels, shape (n, J)."""
        counts, most = images[:, self.pixel_map.y, self.pixel_map.x], self._settings.most_counted
        return narrow(counts if most is None else np.minimum(counts, np.uint16(most)))


def paper(seed: int) -> SelectedPixels:
    """Make the paper's method: 150 varying pixels."""
    settings = PRESETS["paper"].replaced({"seed": seed}, "baseline")
    return SelectedPixels(f"paper: {settings.pixels} varying pixels, SAD", settings)


def released_code(seed: int) -> SelectedPixels:
    """Make the released code's selection and clipping: 100 pixels, counts up to 10."""
    settings = PRESETS["seed-code"].replaced({"seed": seed}, "baseline")
    return SelectedPixels("seed-code: 100 pixels, clipped at 10, SAD", settings)


def by_strategy(seed: int, name: str) -> SelectedPixels:
    """Make the paper's method with pixels of a strategy of `Settings`."""
    settings = PRESETS["paper"].replaced({"seed": seed, "strategy": name}, "baseline")
    return SelectedPixels(f"strategy:{name}, {settings.pixels} pixels, SAD", settings)


# Dense baseline: the same counts and distances over all pixels of the sensor.


def map_all_pixels(
    recording: EventSource | WindowSource, settings: Settings, hot: npt.NDArray[np.bool_]
) -> ReferenceMap:
    """Map a drive with every pixel that is not hot (paper, "all pixels", after Milford 2015).

    Parameters
    ----------
    settings : Settings
        `pixels` and `strategy` are replaced. A fixed-count window holds `events_per_pixel` events
        for each pixel of the sensor; if that is None, it holds the average number of a window of
        tau.
    hot : ndarray of bool, shape (height, width)
        Pixels that are left out.
    """
    y, x = np.nonzero(~hot)
    everything = PixelMap(recording.sensor, x.astype(np.uint16), y.astype(np.uint16))
    settings = settings.replaced({"strategy": "top"}, "all pixels")
    return ReferenceMap.build(recording, settings, pixel_map=everything, hot=hot)


# Binary frames: the pixels with any event in a window, compared by their overlap.
#
# The idea is that of Flash (active pixel locations, normalised by activity). This is our own
# interpretation, not the code of its authors. The similarity is the cosine of the two binary
# frames.


class ActivePixels(VectorBaseline):
    """Frames of one bit a pixel; distance is 1 less ``|A and B| / sqrt(|A| |B|)``."""

    title = "active-pixels, overlap by activity"

    def describe(self, images: Images) -> Described:
        """Return packed bits, shape (n, ceil(pixels / 8)), uint8."""
        return np.packbits(images.reshape(len(images), -1) > 0, axis=1)

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distances, shape (K, Q); 1 to a frame without an active pixel."""
        active = [np.bitwise_count(bits).sum(axis=1, dtype=np.int64) for bits in (places, queries)]
        overlap = self._overlap(places, queries)
        scale = np.sqrt(active[0][:, None] * active[1].astype(np.float64))
        like = np.divide(overlap, scale, out=np.zeros(overlap.shape), where=scale > 0)
        return np.maximum(1.0 - like, 0.0)

    @staticmethod
    def _overlap(places: Described, queries: Described) -> npt.NDArray[np.int64]:
        """Return the numbers of pixels that are active in both, shape (K, Q)."""
        overlap = np.empty((len(places), len(queries)), dtype=np.int64)
        for j, query in enumerate(queries):
            overlap[:, j] = np.bitwise_count(places & query).sum(axis=1, dtype=np.int64)
        return overlap

    def operations_per_place(self, places: Described) -> int:
        """Return the number of 64-bit words to combine."""
        return -(-places.shape[1] // 8)
