"""Descriptions that are compared by the angle between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.baselines.baseline import Described, Images


def cosine_distances(
    places: npt.NDArray[np.floating], queries: npt.NDArray[np.floating]
) -> npt.NDArray[np.float64]:
    """Return 1 less the cosine of each pair; 1 if a description has only zeros.

    Parameters
    ----------
    places, queries : ndarray of float, shape (K, D) and (Q, D)

    Returns
    -------
    ndarray of float64, shape (K, Q)
        From 0 to 2.
    """
    a, b = (rows.astype(np.float64) for rows in (places, queries))
    scale = np.linalg.norm(a, axis=1)[:, None] * np.linalg.norm(b, axis=1)
    product = a @ b.T
    like = np.divide(product, scale, out=np.zeros_like(product), where=scale > 0)
    return np.maximum(1.0 - like, 0.0)


class CosineBaseline:
    """Part of a baseline whose descriptions are vectors, compared by their cosine."""

    def prepare(self, reference: Images) -> None:
        """Do nothing: no parameters are taken from the reference."""

    def distances(self, places: Described, queries: Described) -> npt.NDArray[np.float64]:
        """Return the distances, shape (K, Q); 1 to a description of zeros only."""
        return cosine_distances(places, queries)

    def bits_per_place(self, places: Described) -> int:
        """Return the size of one description in bits."""
        return 8 * int(places.itemsize) * int(places.shape[1])

    def operations_per_place(self, places: Described) -> int:
        """Return the number of products to add, without those of describing."""
        return int(places.shape[1])
