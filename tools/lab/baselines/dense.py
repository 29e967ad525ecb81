"""Baselines on all pixels: SAD of counts and of normalised patches, HOG, and ensembles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import narrow
from edge_vpr.errors import UsageError, import_extra
from edge_vpr.matching.distances import ReferenceIndex
from lab.baselines.baseline import Baseline, Described, Images, VectorBaseline

# Sums of absolute differences over the whole image: of counts, and of normalised patches.


#: side of the image whose patches are normalised, and of a patch (Milford and Wyeth, 2012)
SIDE, PATCH = 32, 8
#: steps of a stored value for one standard deviation; values are saturated to 8 bits
STEPS = 32


class AbsoluteDifferences(VectorBaseline):
    """Descriptions of unsigned integers, compared by the sum of their absolute differences."""

    title = "all-pixels, SAD"

    def describe(self, images: Images) -> Described:
        """Return the counts of every pixel, shape (n, pixels)."""
        return narrow(images.reshape(len(images), -1))

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the sums of absolute differences, shape (K, Q)."""
        return ReferenceIndex(places).matrix(queries).astype(np.float64)


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
    """Return the mean of the pixels in each cell of a grid; smaller images repeat pixels."""
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


# Descriptions that are compared by the angle between them.


class CosineBaseline(VectorBaseline):
    """Part of a baseline whose descriptions are vectors, compared by their cosine."""

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return 1 less the cosine, from 0 to 2, shape (K, Q); 1 to a description of zeros only."""
        a, b = (rows.astype(np.float64) for rows in (places, queries))
        scale = np.linalg.norm(a, axis=1)[:, None] * np.linalg.norm(b, axis=1)
        product = a @ b.T
        like = np.divide(product, scale, out=np.zeros_like(product), where=scale > 0)
        return np.maximum(1.0 - like, 0.0)


# Histograms of oriented gradients (Dalal and Triggs, 2005) of event images, by their cosine.


HOG_SIDE, CELL, BLOCK, ORIENTATIONS = 64, 8, 2, 9


class OrientedGradients(CosineBaseline):
    """Gradients of the logarithm of counts, shrunk to 64 x 64; distance is 1 less the cosine."""

    title = f"hog {HOG_SIDE} x {HOG_SIDE}, cosine"

    def __init__(self, seed: int = 0) -> None:
        features = import_extra("skimage.feature", "the baseline hog", "scikit-image", "lab")
        self._hog = features.hog

    def describe(self, images: Images) -> Described:
        """Return the histograms, shape (n, D), float32."""
        rows = [
            self._hog(
                image, orientations=ORIENTATIONS, pixels_per_cell=(CELL, CELL),
                cells_per_block=(BLOCK, BLOCK), block_norm="L2-Hys",
            )
            for image in np.log1p(mean_cells(images, HOG_SIDE, HOG_SIDE))
        ]  # fmt: skip
        return np.array(rows, dtype=np.float32)


# Ensembles: the mean distance of several systems with different descriptors or windows.
#
# Ensemble-Event-VPR (Fischer and Milford, 2020) averages the distances of one descriptor over
# windows of several lengths. Here any descriptors can be joined. The distances of each member are
# therefore first divided by their mean between places of the reference.


class Member(NamedTuple):
    """One system of an ensemble."""

    baseline: Baseline
    windows: int = 1  #: Number of neighbouring windows whose sum the system gets, at each window.


class Ensemble:
    """Mean of the members' distances; each is divided by its mean between different places."""

    def __init__(self, title: str, members: Sequence[Member]) -> None:
        if not members or any(member.windows < 1 for member in members):
            raise UsageError(
                f"an ensemble of {[member.windows for member in members]} windows: give one member "
                "or more, each with 1 window or more"
            )
        self.title = title
        self._members = list(members)
        self._scales = np.ones(len(members))

    def prepare(self, reference: Images) -> None:
        """Prepare each member, and measure the mean distance between its places."""
        for i, member in enumerate(self._members):
            images = summed(reference, member.windows)
            member.baseline.prepare(images)
            places = member.baseline.describe(images)
            distances = member.baseline.distances(places, places)
            between = distances[~np.eye(len(distances), dtype=np.bool_)]
            mean = float(between.mean()) if between.size else 0.0
            self._scales[i] = mean if mean > 0 else 1.0

    def describe(self, images: Images) -> Described:
        """Return a record for each window, with the description by each member as a field."""
        parts = [
            member.baseline.describe(summed(images, member.windows)) for member in self._members
        ]
        kind = np.dtype([(str(i), part.dtype, part.shape[1:]) for i, part in enumerate(parts)])
        described = np.empty(len(images), kind)
        for i, part in enumerate(parts):
            described[str(i)] = part
        return described

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the mean distances, shape (K, Q)."""
        total = np.zeros((len(places), len(queries)))
        for i, (member, scale) in enumerate(zip(self._members, self._scales, strict=True)):
            a, b = (np.ascontiguousarray(rows[str(i)]) for rows in (places, queries))
            total += member.baseline.distances(a, b) / scale
        return np.asarray(total / len(self._members))

    def bits_per_place(self, places: Described) -> int:
        """Return the total bits of all members' descriptions."""
        return sum(
            member.baseline.bits_per_place(places[str(i)]) for i, member in enumerate(self._members)
        )

    def operations_per_place(self, places: Described) -> int:
        """Return the total operations of all members."""
        return sum(
            member.baseline.operations_per_place(places[str(i)])
            for i, member in enumerate(self._members)
        )


def summed(images: Images, windows: int) -> Images:
    """Return for each window the sum of `windows` neighbours around it.

    If the number is even, one more neighbour lies after the window than before it. The first and
    the last window are repeated beyond the ends.

    Parameters
    ----------
    images : ndarray of int, shape (n, height, width)
        Counts of events at each pixel.

    Returns
    -------
    ndarray of int, shape (n, height, width)
        `images` itself for 1 window, else of 64 bits.

    Examples
    --------
    >>> summed(np.array([1, 2, 4, 8]).reshape(4, 1, 1), 2).ravel()
    array([ 3,  6, 12, 16])
    """
    if windows == 1:
        return images
    before = (windows - 1) // 2
    padded = np.pad(images, ((before, windows - 1 - before), (0, 0), (0, 0)), mode="edge")
    total = np.zeros(images.shape, np.int64)
    for shift in range(windows):
        total += padded[shift : shift + len(images)]
    return total
