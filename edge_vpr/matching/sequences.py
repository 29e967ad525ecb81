"""Sequences: distances of L successive windows, added along the diagonal (method.md section 5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import NO_MISFIT, Acceptance
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import BLOCK_DISTANCES, ReferenceIndex
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.search import best_matches, nearest_places
from edge_vpr.settings import Settings


def sequence_sums(distances: npt.NDArray[np.integer], length: int) -> npt.NDArray[np.integer]:
    """Add distances along diagonals: ``S[k, j] = sum_{i<L} D[k + i, j + i]``.

    This is L times D_seq of method.md section 5, in integers. Dividing by L would not change the
    order of places.

    Parameters
    ----------
    distances : ndarray of int, shape (K, Q)
        Row = reference place, column = query.
    length : int
        L, in windows.

    Returns
    -------
    ndarray of int32 or int64, shape (K - L + 1, Q - L + 1)
    """
    check_length(length, *distances.shape)
    places, queries = (side - length + 1 for side in distances.shape)
    bound = int(distances.max()) * length
    sums = np.zeros((places, queries), dtype=np.int32 if bound < 2**31 else np.int64)
    for i in range(length):
        sums += distances[i : i + places, i : i + queries]
    return sums


def check_length(length: int, places: int, queries: int) -> None:
    """Check that sequences of this length fit into both traverses."""
    if length > min(places, queries):
        raise UsageError(
            f"sequence length {length} is longer than the traverse ({places} reference places, "
            f"{queries} query windows): take a shorter sequence or shorter windows"
        )


def middle_window(length: int) -> int:
    """Return the index of the window of a sequence that a recorded match belongs to.

    Live and on devices, the match belongs to the newest window, ``length - 1``: the matches are
    equal but for this shift of windows and places.
    """
    return length // 2


class BestSequences(NamedTuple):
    """Best places of n sequences, with their sums of distances; place 0 is the first sum.

    Without a second place, `second` and `second_sum` are -1.
    """

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
        return cls(best, best_sum, second, second_sum, ties, nearest_places(sums.T))


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
        Settings of the matches.
    places : int
        K.
    query_us : ndarray of int64, shape (Q,)
        Centre of each query window.
    acceptance : Acceptance
        Probability and acceptance, by the margin to the second.
    """
    best, best_sum, second, second_sum, ties, candidates = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    offset = middle_window(settings.sequence_length)
    query = np.arange(len(best), dtype=np.int64) + offset
    ratio = np.where(second_sum < 0, np.nan, 1.0)  # 1 where both distances are zero
    np.divide(best_sum, second_sum, out=ratio, where=second_sum > 0)
    trust = np.where(second_sum < 0, 0, second_sum - best_sum)
    misfit = np.full(trust.shape, NO_MISFIT, dtype=np.int64)
    probability, lost = acceptance.accept(trust, misfit)
    return Matches(
        settings=settings,
        places_in_map=places,
        query=query,
        time_us=query_us[query],
        place=best + offset,
        distance=best_sum / settings.sequence_length,
        second=np.where(second < 0, -1, second + offset),
        second_distance=np.where(second < 0, np.nan, second_sum / settings.sequence_length),
        ratio=ratio,
        ties=ties,
        candidates=np.where(candidates < 0, -1, candidates + offset),
        trust=trust,
        misfit=misfit,
        probability=probability,
        lost=lost,
    )


def match_by_sequences(
    places: Descriptors, queries: Descriptors, settings: Settings, acceptance: Acceptance
) -> Matches:
    """Match the window in the middle of each sequence of L query windows."""
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    index = ReferenceIndex(places.counts)
    n = len(queries) - length + 1
    block = max(1, BLOCK_DISTANCES // len(places))
    parts = []
    for j in range(0, n, block):
        # the sums of a query lie together, since the search reads them query by query
        distances = index.rows(queries.counts[j : min(j + block, n) + length - 1])
        sums = sequence_sums(distances, length).T
        parts.append(BestSequences.of(sums, settings.exclusion_places))
    return sequence_matches(parts, settings, len(places), queries.centre_us, acceptance)


def sequence_distances(
    places: Descriptors, queries: Descriptors, length: int
) -> npt.NDArray[np.float64]:
    """Return D_seq of each query window and place, shape (K, Q).

    It is the mean distance of L windows along the diagonal; where a sequence would leave the
    matrix, the mean of those inside it.
    """
    check_length(length, len(places), len(queries))
    distances = ReferenceIndex(places.counts).matrix(queries.counts)
    total, inside = np.zeros(distances.shape), np.zeros(distances.shape, dtype=np.int32)
    before = middle_window(length)
    for step in range(-before, length - before):
        # D[k + step, q + step] at [k, q], where both are in the matrix
        k, q = (slice(max(0, -step), n - max(0, step)) for n in distances.shape)
        k_on, q_on = (slice(max(0, step), n - max(0, -step)) for n in distances.shape)
        total[k, q] += distances[k_on, q_on]
        inside[k, q] += 1
    return total / inside
