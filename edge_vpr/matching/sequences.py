"""Sequences: distances of L successive windows added along the diagonal (method.md section 5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import NO_MISFIT, Acceptance
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import best_matches
from edge_vpr.matching.matches import Matches, margin_to_second, nearest_places
from edge_vpr.settings import Anchor, Settings

# Sequences: distances of L successive windows added along the diagonal (method.md section 5).


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


# Matches by sequences, from the sums of distances along them.


class BestSequences(NamedTuple):
    """Best places of n sequences, with the fields of `Matches`; place 0 is the first sum."""

    place: npt.NDArray[np.int64]
    distance_sum: npt.NDArray[np.int64]
    second: npt.NDArray[np.int64]
    second_sum: npt.NDArray[np.int64]
    ties: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]

    @classmethod
    def of(cls, sums: npt.NDArray[np.integer], exclusion: int) -> BestSequences:
        """Find the best places in the columns of sums of distances, shape (K - L + 1, n)."""
        best, second, ties = best_matches(sums, exclusion)
        column = np.arange(sums.shape[1])
        best_sum = sums[best, column].astype(np.int64)
        second_sum = np.where(second < 0, -1, sums[second, column]).astype(np.int64)
        return cls(best, best_sum, second, second_sum, ties, nearest_places(sums))


def sequence_matches(
    parts: list[BestSequences],
    settings: Settings,
    places: int,
    query_us: npt.NDArray[np.int64],
    acceptance: Acceptance,
) -> Matches:
    """Return the matches of successive sequences.

    Parameters
    ----------
    settings : Settings
        `sequence_length` and `anchor` say which window a sequence's match belongs to.
    places : int
        K.
    query_us : ndarray of int64, shape (Q,)
        Centre of each query window.
    acceptance : Judge
        Gives the probability of the margin to the second.
    """
    best, best_sum, second, second_sum, ties, candidates = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    offset = anchor_offset(settings.sequence_length, settings.anchor)
    query = np.arange(len(best), dtype=np.int64) + offset
    trust = margin_to_second(best_sum, second_sum)
    probability, lost = acceptance.acceptance(trust)
    return Matches(
        settings=settings,
        places_in_map=places,
        query=query,
        time_us=query_us[query],
        place=best + offset,
        distance_sum=best_sum,
        second=np.where(second < 0, -1, second + offset),
        second_sum=second_sum,
        ties=ties,
        candidates=np.where(candidates < 0, -1, candidates + offset),
        trust=trust,
        misfit=np.full(trust.shape, NO_MISFIT, dtype=np.int64),
        probability=probability,
        lost=lost,
    )
