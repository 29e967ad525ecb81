"""Search for the best place, the best one outside its exclusion zone, and the nearest places."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import UsageError

Values = npt.NDArray[Any]
#: largest number of nearest places of a query that are kept, for Recall@N
CANDIDATES = 25


@kernel(inline="always")
def exclusion_zone(best: Any, exclusion: int) -> tuple[Any, Any]:
    """Return the first place of the exclusion zone around a place, and the first one behind it.

    Neighbours of the best place resemble it, so that the second-best one is searched for outside.

    Parameters
    ----------
    best : int, or ndarray of int
        The place in the middle.
    exclusion : int
        Number of places on each side of it. The zone may reach beyond the map.
    """
    return best - exclusion, best + exclusion + 1


@kernel
def least_and_second(values: Values, exclusion: int) -> tuple[int, int, int]:
    """Return the first place of the least value, that of the least outside its zone, and ties.

    Parameters
    ----------
    values : ndarray, shape (K,)
        Metrics, or sums of distances; K of at least 1.
    exclusion : int
        See `exclusion_zone`.

    Returns
    -------
    best, second, ties : int
        The second is -1 if no place lies outside the zone; ties are the other places of the least
        value.
    """
    best, ties = _first_least(values, np.int64(0), values.size), -1
    for k in range(values.size):
        ties += values[k] == values[best]
    first, end = exclusion_zone(best, exclusion)
    before = _first_least(values, np.int64(0), first)
    second = _first_least(values, end, values.size)
    if before >= 0 and (second < 0 or values[before] <= values[second]):
        second = before
    return best, second, ties


@kernel(inner=True)
def _first_least(values: Values, begin: int, end: int) -> int:
    """Return the first place of the least value in a range; -1 if the range is empty."""
    if begin >= end:
        return -1
    # two loops: the first compiles to vector instructions, the second stops early
    least = values[begin]
    for k in range(begin, end):
        least = min(least, values[k])
    k = begin
    while values[k] != least:
        k += 1
    return k


def best_matches(
    matrix: npt.NDArray[Any], exclusion: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the nearest place of each column, the nearest outside its exclusion zone, and ties.

    Parameters
    ----------
    matrix : ndarray, shape (K, Q)
        Distances; row = reference place, column = query.
    exclusion : int
        See `exclusion_zone`.

    Returns
    -------
    best, second, ties : ndarray of int64, shape (Q,)
        The lowest place in a tie; `second` is -1 if every place is in the zone; `ties` is
        the number of other places at the smallest distance.
    """
    if matrix.ndim != 2 or len(matrix) == 0:
        raise UsageError(
            f"distances of shape {matrix.shape}: give 2 dimensions, the first one the places, at "
            "least one of them"
        )
    rows = np.ascontiguousarray(matrix.T)
    searched = np.empty((len(rows), 3), dtype=np.int64)
    _search_rows(rows, exclusion, searched)
    best, second, ties = searched.T
    return best, second, ties


@kernel
def _search_rows(rows: Any, exclusion: int, out: npt.NDArray[np.int64]) -> None:
    for i in range(len(rows)):
        out[i, 0], out[i, 1], out[i, 2] = least_and_second(rows[i], exclusion)


def nearest_places(rows: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Return the nearest places of each query.

    Parameters
    ----------
    rows : ndarray of int, shape (n, K)
        Distances of each query, or metrics of the place filter.

    Returns
    -------
    ndarray of int64, shape (n, 25)
        Nearest first (ties: lowest first); -1 where there are fewer places.
    """
    places = rows.shape[1]
    # distance and place in one integer, which sorts by distance, then by place
    narrow = rows.size > 0 and (int(rows.max()) + 1) * places <= np.iinfo(np.int32).max
    dtype = np.int32 if narrow else np.int64  # partitioning is faster with 32 bits
    keys = np.multiply(rows, places, dtype=dtype, order="C")
    keys += np.arange(places, dtype=dtype)
    if places > CANDIDATES:
        keys = np.partition(keys, CANDIDATES - 1, axis=1)[:, :CANDIDATES]
    nearest = np.full((len(keys), CANDIDATES), -1, dtype=np.int64)
    nearest[:, : keys.shape[1]] = np.sort(keys, axis=1) % places
    return nearest
