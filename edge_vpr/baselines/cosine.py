"""Descriptions that are compared by the angle between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, VectorBaseline


class CosineBaseline(VectorBaseline):
    """Part of a baseline whose descriptions are vectors, compared by their cosine."""

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return 1 less the cosine, from 0 to 2, shape (K, Q); 1 to a description of zeros only."""
        a, b = (rows.astype(np.float64) for rows in (places, queries))
        scale = np.linalg.norm(a, axis=1)[:, None] * np.linalg.norm(b, axis=1)
        product = a @ b.T
        like = np.divide(product, scale, out=np.zeros_like(product), where=scale > 0)
        return np.maximum(1.0 - like, 0.0)
