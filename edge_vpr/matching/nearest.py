"""Search for the nearest place of a query, and the nearest one outside its neighbourhood."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError


def best_match(distances: npt.NDArray[Any], exclusion: int) -> tuple[int, int]:
    """Return the nearest place, and the nearest one outside its neighbourhood.

    Parameters
    ----------
    distances : ndarray, shape (K,)
        Distance to each place.
    exclusion : int
        Places no further than this from the best one, in index, are its neighbourhood.

    Returns
    -------
    best, second : int
        Ties go to the lowest index; `second` is -1 if every place is in the neighbourhood.

    Raises
    ------
    UsageError
        If there is no place, or the exclusion is negative.
    """
    _check_search(distances, 1, exclusion)
    best = int(distances.argmin())
    before, after = distances[: max(best - exclusion, 0)], distances[best + exclusion + 1 :]
    second = int(before.argmin()) if before.size else -1
    if after.size:
        later = int(after.argmin())
        if second < 0 or after[later] < before[second]:
            second = best + exclusion + 1 + later
    return best, second


def best_matches(
    matrix: npt.NDArray[Any], exclusion: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the best match of each column, as :func:`best_match` does, and the number of ties.

    Parameters
    ----------
    matrix : ndarray, shape (K, Q)
        Distances; row = reference place, column = query.
    exclusion : int
        Half width of the best place's neighbourhood, in places.

    Returns
    -------
    best, second, ties : ndarray of int64, shape (Q,)
        `ties` is the number of other places at the same smallest distance.

    Raises
    ------
    UsageError
        If there is no place, or the exclusion is negative.
    """
    _check_search(matrix, 2, exclusion)
    best, ties = (np.zeros(matrix.shape[1], dtype=np.int64) for _ in range(2))
    second = np.full(matrix.shape[1], -1, dtype=np.int64)
    _search(matrix, exclusion, best, second, ties)
    return best, second, ties


def _check_search(distances: npt.NDArray[Any], ndim: int, exclusion: int) -> None:
    if distances.ndim != ndim or len(distances) == 0:
        raise UsageError(
            f"distances of shape {distances.shape}: give {ndim} dimension(s), the first one "
            "the places, at least one of them"
        )
    if exclusion < 0:
        raise UsageError(f"exclusion of {exclusion} places is negative: give 0 or more")


@kernel
def _search(matrix: Any, exclusion: int, best: Any, second: Any, ties: Any) -> None:
    smallest, runner_up = matrix[0].copy(), matrix[0].copy()
    for k in range(1, matrix.shape[0]):
        for j in range(matrix.shape[1]):
            if matrix[k, j] < smallest[j]:
                smallest[j], best[j], ties[j] = matrix[k, j], k, 0
            elif matrix[k, j] == smallest[j]:
                ties[j] += 1
    for k in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            outside = abs(k - best[j]) > exclusion
            if outside and (second[j] < 0 or matrix[k, j] < runner_up[j]):
                second[j], runner_up[j] = k, matrix[k, j]
