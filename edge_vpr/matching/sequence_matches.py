"""Matches by sequences, from the sums of distances along them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Judge
from edge_vpr.matching.candidates import nearest_places
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.nearest import best_matches
from edge_vpr.matching.runner_up import margin_to_second
from edge_vpr.matching.sequence import anchor_offset
from edge_vpr.settings import Settings


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
    judge: Judge,
) -> Matches:
    """Return the matches of successive sequences.

    Parameters
    ----------
    parts : list of BestSequences
    settings : Settings
        `sequence_length` and `anchor` say which window a sequence's match belongs to.
    places : int
        K.
    query_us : ndarray of int64, shape (Q,)
        Centre of each query window.
    judge : Judge
        Gives the probability of the margin to the second.
    """
    best, best_sum, second, second_sum, ties, candidates = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    offset = anchor_offset(settings.sequence_length, settings.anchor)
    query = np.arange(len(best), dtype=np.int64) + offset
    trust = margin_to_second(best_sum, second_sum)
    probability, lost = judge.judge(trust)
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
        probability=probability,
        lost=lost,
    )
