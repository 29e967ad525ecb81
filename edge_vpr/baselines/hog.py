"""Histograms of oriented gradients (Dalal and Triggs, 2005) of event images, by their cosine."""

from __future__ import annotations

from typing import Any

import numpy as np

from edge_vpr.baselines.baseline import Described, Images
from edge_vpr.baselines.cosine import CosineBaseline
from edge_vpr.baselines.dense import mean_cells
from edge_vpr.errors import MissingExtraError

SIDE, CELL, BLOCK, ORIENTATIONS = 64, 8, 2, 9


def load_hog() -> Any:
    """Import scikit-image's function, or raise an error that names the extra with it."""
    try:
        from skimage.feature import hog as function
    except ImportError as error:
        raise MissingExtraError("the baseline hog", "scikit-image", "baselines") from error
    return function


class OrientedGradients(CosineBaseline):
    """Gradients of the logarithm of counts, shrunk to 64 x 64; distance is 1 less the cosine."""

    title = f"HOG {SIDE} x {SIDE}, cosine"

    def __init__(self) -> None:
        self._hog = load_hog()

    def describe(self, images: Images) -> Described:
        """Return the histograms, shape (n, D), float32."""
        rows = [
            self._hog(
                image, orientations=ORIENTATIONS, pixels_per_cell=(CELL, CELL),
                cells_per_block=(BLOCK, BLOCK), block_norm="L2-Hys",
            )
            for image in np.log1p(mean_cells(images, SIDE, SIDE))
        ]  # fmt: skip
        return np.array(rows, dtype=np.float32)


def hog(seed: int) -> OrientedGradients:
    """Make the baseline; it draws no random numbers."""
    return OrientedGradients()
