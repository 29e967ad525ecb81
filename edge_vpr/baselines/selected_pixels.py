"""The paper's method and its released code, with the interface of the baselines."""

from __future__ import annotations

import numpy as np

from edge_vpr.baselines.baseline import Described, Images
from edge_vpr.baselines.dense import AbsoluteDifferences
from edge_vpr.descriptors.descriptors import narrow
from edge_vpr.descriptors.informative_pixels import informative_pixels, shortlist
from edge_vpr.descriptors.pixels import PixelMap, select_pixels
from edge_vpr.descriptors.saliency import SaliencyPass
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.settings import PRESETS, Settings


class SelectedPixels(AbsoluteDifferences):
    """Counts at a few pixels of the reference, compared by the sum of absolute differences.

    Parameters
    ----------
    title : str
    settings : Settings
        `pixels`, `strategy`, `sigma`, `seed` and `clip` are used.
    """

    def __init__(self, title: str, settings: Settings) -> None:
        self.title = title
        self._settings = settings
        self._pixels: PixelMap | None = None

    def prepare(self, reference: Images) -> None:
        """Draw the pixels by their saliency in the reference."""
        chosen = self._settings
        sensor = Sensor(reference.shape[2], reference.shape[1])
        with SaliencyPass(sensor, clip=chosen.clip, spool_bytes=-1) as first:
            for image in reference:
                counts = image.astype(np.int64).ravel()
                first.add(WindowCounts(counts, 0, 1, int(counts.sum())))
            saliency = first.mean() if chosen.strategy == "seed-code" else first.variance()
        if chosen.strategy == "information":
            listed = shortlist(saliency, np.zeros(saliency.shape, dtype=np.bool_))
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
        """Return the counts at the pixels, clipped if the settings have a limit, shape (n, J)."""
        counts = images[:, self.pixel_map.y, self.pixel_map.x]
        clip = self._settings.clip
        return narrow(counts if clip is None else np.minimum(counts, clip))


def paper(seed: int) -> SelectedPixels:
    """Make the paper's method: 150 varying pixels."""
    settings = PRESETS["paper"].replaced({"seed": seed}, "baseline")
    return SelectedPixels(f"{settings.pixels} varying pixels, SAD", settings)


def released_code(seed: int) -> SelectedPixels:
    """Make the released code's selection and clipping: 100 pixels, counts up to 10."""
    settings = PRESETS["seed-code"].replaced({"seed": seed}, "baseline")
    return SelectedPixels("released code: 100 pixels, clipped at 10, SAD", settings)
