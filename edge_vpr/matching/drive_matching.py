"""Matching of all query windows of a recorded drive, by sequences or by the place filter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Confidence, Judge, default_confidence
from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.descriptors.pauses import mean_activity
from edge_vpr.errors import MapError, UsageError
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.filtered_drive import filter_drive
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.place_filter import PlaceFilter
from edge_vpr.matching.sequence import check_length, sequence_sums
from edge_vpr.matching.sequence_matches import BestSequences, sequence_matches
from edge_vpr.matching.smoothing import QUIET_EVIDENCE_SHIFT
from edge_vpr.matching.step_prices import StepPrices
from edge_vpr.odometry import Odometry
from edge_vpr.settings import Settings

#: number of distances in memory at a time, so that memory does not grow with the traverse
_BLOCK_DISTANCES = 4_000_000


def match_descriptors(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    confidence: Confidence | None = None,
    *,
    jumps: npt.NDArray[np.int32] | None = None,
    along_mm: npt.NDArray[np.int64] | None = None,
    odometry: Odometry | None = None,
) -> Matches:
    """Match every query window, by sequences of L windows or by the place filter.

    Parameters
    ----------
    places : Descriptors
        Reference, K of them.
    queries : Descriptors
        Q of them, counted at the same pixels.
    settings : Settings
        `matching` and its settings, `exclusion` and `precision` are used.
    confidence : Confidence, optional
        Table of probabilities; by default the shipped one for the place filter, and none for
        sequences.
    jumps : ndarray of int32, shape (n, 2), optional
        Of the map, see `ReferenceMap`; only the place filter takes them.
    along_mm : ndarray of int64, shape (K,), optional
        `ReferenceMap.along_mm`.
    odometry : Odometry, optional
        Of the query drive; takes `along_mm`, and the place filter.

    Returns
    -------
    Matches
        Of all Q windows by the filter. By sequences, of Q - L + 1: those that a whole sequence is
        centred on (or ends with).

    Raises
    ------
    MapError
        If the descriptors differ in length.
    UsageError
        If L is longer than a traverse, or the table does not promise the wanted precision, or
        jumps or odometry are given to sequences.
    """
    if confidence is None and settings.matching == "filter":
        confidence = default_confidence(settings.smooth, settings.late)
    judge = Judge(confidence, settings.precision)
    check_counts(places, queries)
    if settings.matching == "filter":
        place_filter = filter_of(places, settings, jumps, along_mm)
        return _match_by_filter(place_filter, places, queries, settings, judge, odometry)
    check_no_ways(jumps, odometry is not None)
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    index = ReferenceIndex(places.counts)
    n = len(queries) - length + 1
    block = max(1, _BLOCK_DISTANCES // len(places))
    parts = []
    for j in range(0, n, block):
        distances = index.matrix(queries.counts[j : min(j + block, n) + length - 1])
        parts.append(BestSequences.of(sequence_sums(distances, length), settings.exclusion))
    return sequence_matches(parts, settings, len(places), queries.centre_us, judge)


def check_counts(places: Descriptors, queries: Descriptors) -> None:
    """Check that places and queries have the same counters; raise MapError if not."""
    if places.counts.shape[1] != queries.counts.shape[1]:
        raise MapError(
            f"reference descriptors have {places.counts.shape[1]} counts and the query's "
            f"{queries.counts.shape[1]}: describe both with the same map"
        )


def filter_of(
    places: Descriptors,
    settings: Settings,
    jumps: npt.NDArray[np.int32] | None,
    along_mm: npt.NDArray[np.int64] | None,
) -> PlaceFilter:
    """Return the place filter of a map, before its first window.

    Parameters
    ----------
    places : Descriptors
    settings : Settings
    jumps, along_mm : ndarray or None
        Of the map, see `match_descriptors`.
    """
    return PlaceFilter(
        len(places), StepPrices.of(settings), settings.exclusion,
        mean_activity(places.activity),
        quiet_shift=QUIET_EVIDENCE_SHIFT if settings.smooth else 0, jumps=jumps, along_mm=along_mm,
    )  # fmt: skip


def check_no_ways(jumps: npt.NDArray[np.int32] | None, odometry: bool) -> None:
    """Raise UsageError if sequences are asked to use jumps or odometry.

    Parameters
    ----------
    jumps : ndarray of int32, shape (n, 2), optional
    odometry : bool
        Whether it is given.
    """
    given = "odometry" if odometry else "a map with jumps"
    if odometry or (jumps is not None and len(jumps)):
        raise UsageError(
            f"{given} is for the place filter, and sequences follow neither: match with "
            "--matching filter"
        )


def _match_by_filter(
    place_filter: PlaceFilter,
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    judge: Judge,
    odometry: Odometry | None,
) -> Matches:
    index, n = ReferenceIndex(places.counts), len(queries)
    found = filter_drive(
        place_filter, index, queries, odometry, smooth=settings.smooth, delay=settings.late
    )
    place, metric, second, second_metric, ties, trust = found.columns.T
    probability, lost = judge.judge(trust)
    return Matches(
        settings=settings,
        places_in_map=len(places),
        query=np.arange(n, dtype=np.int64),
        time_us=queries.centre_us,
        place=place,
        distance_sum=metric,
        second=second,
        second_sum=second_metric,
        ties=ties,
        candidates=found.candidates,
        trust=trust,
        probability=probability,
        lost=lost,
    )
