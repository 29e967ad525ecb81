"""Sequences: distances of L successive windows added along the diagonal (method.md section 5)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.settings import Anchor


def sequence_sums(distances: npt.NDArray[np.integer], length: int) -> npt.NDArray[np.integer]:
    """Add distances along diagonals: ``S[k, j] = sum_{i<L} D[k + i, j + i]``.

    This is L times D_seq of method.md section 5, in integers. The division by L would not change
    the order of places.

    Parameters
    ----------
    distances : ndarray of int, shape (K, Q)
        Row = reference place, column = query.
    length : int
        L, in windows.

    Returns
    -------
    ndarray of int32 or int64, shape (K - L + 1, Q - L + 1)

    Raises
    ------
    UsageError
        If L is below 1, or longer than a traverse.
    """
    check_length(length, *distances.shape)
    places, queries = (side - length + 1 for side in distances.shape)
    bound = int(distances.max()) * length
    sums = np.zeros((places, queries), dtype=np.int32 if bound < 2**31 else np.int64)
    for i in range(length):
        sums += distances[i : i + places, i : i + queries]
    return sums


def check_length(length: int, places: int, queries: int) -> None:
    """Check that a sequence of this length fits into both traverses."""
    if length < 1:
        raise UsageError(f"sequence length {length}: expected 1 or more")
    if length > min(places, queries):
        raise UsageError(
            f"sequence length {length} is longer than the traverse ({places} reference places, "
            f"{queries} query windows): take a shorter sequence or shorter windows"
        )


def anchor_offset(length: int, anchor: Anchor) -> int:
    """Return the window of a sequence that its match belongs to.

    Parameters
    ----------
    length : int
        L, in windows.
    anchor : {"middle", "end"}
        ``middle`` for evaluation offline, ``end`` (the newest window) for use online.

    Returns
    -------
    int
        Index within the sequence: ``L // 2`` or ``L - 1``.
    """
    if anchor == "middle":
        return length // 2
    if anchor == "end":
        return length - 1
    raise UsageError(f"sequence anchor {anchor!r}: expected middle or end")
