"""Binary frames: the pixels with any event in a window, compared by their overlap.

The idea is that of Flash (active pixel locations, normalised by activity). This is our own
interpretation, not the code of its authors. The similarity is the cosine of the two binary frames.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, Images, VectorBaseline


class ActivePixels(VectorBaseline):
    """Frames of one bit a pixel; distance is 1 less ``|A and B| / sqrt(|A| |B|)``."""

    title = "active pixels, overlap"

    def describe(self, images: Images) -> Described:
        """Return packed bits, shape (n, ceil(pixels / 8)), uint8."""
        return np.packbits(images.reshape(len(images), -1) > 0, axis=1)

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distances, shape (K, Q); 1 to a frame without an active pixel."""
        active = [np.bitwise_count(bits).sum(axis=1, dtype=np.int64) for bits in (places, queries)]
        overlap = np.empty((len(places), len(queries)), dtype=np.int64)
        for j, query in enumerate(queries):
            overlap[:, j] = np.bitwise_count(places & query).sum(axis=1, dtype=np.int64)
        scale = np.sqrt(active[0][:, None] * active[1].astype(np.float64))
        like = np.divide(overlap, scale, out=np.zeros(overlap.shape), where=scale > 0)
        return np.maximum(1.0 - like, 0.0)

    def operations_per_place(self, places: Described) -> int:
        """Return the number of 64-bit words to combine."""
        return -(-places.shape[1] // 8)


def active_pixels(seed: int) -> ActivePixels:
    """Make the baseline; it draws no random numbers."""
    return ActivePixels()
