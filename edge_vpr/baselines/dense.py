"""Sums of absolute differences over the whole image: of counts, and of normalised patches."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, Images, VectorBaseline
from edge_vpr.descriptors.descriptors import narrow
from edge_vpr.matching.distances import distance_matrix

#: side of the image whose patches are normalised, and of a patch (Milford and Wyeth, 2012)
SIDE, PATCH = 32, 8
#: steps of a stored value for one standard deviation; values are saturated to 8 bits
STEPS = 32


class AbsoluteDifferences(VectorBaseline):
    """Descriptions of unsigned integers, compared by the sum of their absolute differences."""

    title = "all pixels, SAD"

    def describe(self, images: Images) -> Described:
        """Return the counts of every pixel, shape (n, pixels)."""
        return narrow(images.reshape(len(images), -1))

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the sums of absolute differences, shape (K, Q)."""
        return distance_matrix(places, queries).astype(np.float64)


class PatchNormalised(AbsoluteDifferences):
    """Images of 32 x 32, each 8 x 8 patch normalised to mean 0 and deviation 1, in 8 bits."""

    title = f"patch-normalised {SIDE} x {SIDE}, SAD"

    def describe(self, images: Images) -> Described:
        """Return the normalised values, shape (n, 1024), uint8."""
        small = mean_cells(images, SIDE, SIDE)
        n, patches = len(images), SIDE // PATCH
        cut = small.reshape(n, patches, PATCH, patches, PATCH)
        mean = cut.mean(axis=(2, 4), keepdims=True)
        deviation = cut.std(axis=(2, 4), keepdims=True)
        normal = np.divide(
            cut - mean, deviation, out=np.zeros_like(cut), where=deviation > 1e-9
        ).reshape(n, -1)
        return np.clip(np.rint(128 + STEPS * normal), 0, 255).astype(np.uint8)


def mean_cells(images: Images, rows: int, columns: int) -> npt.NDArray[np.float64]:
    """Return the mean of the pixels in each cell of a grid; smaller images repeat pixels.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
    rows, columns : int

    Returns
    -------
    ndarray of float64, shape (n, rows, columns)
    """
    _, height, width = images.shape
    total = np.zeros((len(images), height + 1, width + 1))
    total[:, 1:, 1:] = images.cumsum(axis=1, dtype=np.int64).cumsum(axis=2)
    edges = []
    for length, cells in ((height, rows), (width, columns)):
        first = np.arange(cells) * length // cells
        edges.append((first, np.maximum((np.arange(cells) + 1) * length // cells, first + 1)))
    (top, bottom), (left, right) = edges
    sums = (
        total[:, bottom[:, None], right] - total[:, top[:, None], right]
        - total[:, bottom[:, None], left] + total[:, top[:, None], left]
    )  # fmt: skip
    return np.asarray(sums / ((bottom - top)[:, None] * (right - left)))


def all_pixels(seed: int) -> AbsoluteDifferences:
    """Make the paper's dense baseline; it draws no random numbers."""
    return AbsoluteDifferences()


def patch_normalised(seed: int) -> PatchNormalised:
    """Make the baseline; it draws no random numbers."""
    return PatchNormalised()
