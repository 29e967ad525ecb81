"""The nearest places of a query, for Recall@N."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: largest number of nearest places that are kept
CANDIDATES = 25


def nearest_places(sums: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Return the nearest places of each query (column).

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
    # distance and place in one integer, which sorts by distance, then by place
    rows = sums.T
    narrow = rows.size > 0 and (int(rows.max()) + 1) * places <= np.iinfo(np.int32).max
    dtype = np.int32 if narrow else np.int64  # NumPy partitions rows of 32-bit integers fastest
    keys = np.multiply(rows, places, dtype=dtype, order="C")
    keys += np.arange(places, dtype=dtype)
    if places > CANDIDATES:
        keys = np.partition(keys, CANDIDATES - 1, axis=1)[:, :CANDIDATES]
    nearest = np.full((len(keys), CANDIDATES), -1, dtype=np.int64)
    nearest[:, : keys.shape[1]] = np.sort(keys, axis=1) % places
    return nearest
