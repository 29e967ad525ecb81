"""The nearest places of a query, for Recall@N."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: so many of the nearest places are kept
CANDIDATES = 25


def nearest_places(sums: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Return the nearest places of each column.

    Parameters
    ----------
    sums : ndarray of int, shape (K, n)
        Distances, or metrics of the place filter.

    Returns
    -------
    ndarray of int64, shape (n, 25)
        Nearest first (ties: lowest first); -1 where there are fewer places.
    """
    places = sums.shape[0]
    # distance and place in one integer: its order is by distance, then by the lower place
    keys = sums.astype(np.int64) * places + np.arange(places)[:, None]
    if places > CANDIDATES:
        keys = np.partition(keys, CANDIDATES - 1, axis=0)[:CANDIDATES]
    nearest = np.full((sums.shape[1], CANDIDATES), -1, dtype=np.int64)
    nearest[:, : len(keys)] = np.sort(keys, axis=0).T % places
    return nearest
