"""Matching of all windows of a recorded drive, by sequences or by the place filter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Acceptance, Confidence
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.matching.distances import BLOCK_DISTANCES, ReferenceIndex
from edge_vpr.matching.match import MATCH_DTYPE
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.place_filter import PlaceFilter, WindowRows
from edge_vpr.matching.prediction import LANES, Travelled, odometry_of_sequences
from edge_vpr.matching.search import CANDIDATES, nearest_places
from edge_vpr.matching.sequences import match_by_sequences, sequence_distances
from edge_vpr.matching.smoothing import add_cost_to_go, runs
from edge_vpr.matching.trust import smoothed_misfit, smoothed_trust
from edge_vpr.odometry import Odometry
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

# The place filter over a recorded drive.


#: number of metrics, and of evidence values, in memory at a time while a drive is smoothed
_SEGMENT_VALUES = 10_000_000
#: largest matrix of distances in memory
MOST_BYTES = 2 << 30


class FilteredDrive(NamedTuple):
    """Matches of n windows, filled in parts.

    Attributes
    ----------
    rows : ndarray of MATCH_DTYPE, shape (n,)
        Matches, without times and probability.
    candidates : ndarray of int64, shape (n, 25)
        Places of the least metrics, see `nearest_places`.
    metrics : ndarray of float64, shape (K, n)
        The metric of each place after each window, the least of which is the match; of no place
        unless asked for.
    """

    rows: npt.NDArray[np.void]
    candidates: npt.NDArray[np.int64]
    metrics: npt.NDArray[np.float64]

    @classmethod
    def empty(cls, windows: int, places: int) -> FilteredDrive:
        """Return the matches of so many windows, with metrics of so many places, not filled yet."""
        rows = np.empty(windows, dtype=MATCH_DTYPE)
        candidates = np.empty((windows, CANDIDATES), dtype=np.int64)
        return cls(rows, candidates, np.empty((places, windows)))

    def put(self, first: int, rows: WindowRows) -> None:
        """Store the results of the windows from `first` on."""
        last = first + len(rows.matches)
        self.rows[first:last] = rows.matches
        self.candidates[first:last] = nearest_places(rows.least)
        if self.metrics.size:
            self.metrics[:, first:last] = rows.least.T


def filter_drive(
    place_filter: PlaceFilter,
    index: ReferenceIndex,
    queries: Descriptors,
    odometry: Odometry | None = None,
    *,
    smooth: bool = False,
    with_metrics: bool = False,
) -> FilteredDrive:
    """Advance a filter over all windows of a drive.

    Parameters
    ----------
    place_filter : PlaceFilter
        Filter before its first window.
    index : ReferenceIndex
        Index of the K places.
    queries : Descriptors
        n windows in the map's codes.
    odometry : Odometry, optional
        Odometry of this drive.
    smooth : bool
        Whether all later windows contribute to each match.
    with_metrics : bool
        Whether to keep the metric of each place after each window.

    Returns
    -------
    FilteredDrive
        Without smoothing, trust and misfit are those of `match_window`. With smoothing, the trust
        is the mean margin of the summed metrics over the window and the four before and after it,
        in units of 1/16 of a metric, less the largest evidence against a match in these nine
        windows, and at least 0. A margin counts as 0 if a match between it and the window is not
        reachable from the one before, and is reduced by 1/16 for each other consecutive window with
        the same place. Of all stretches of 33 windows around a window, that with the largest least
        trust counts. The misfit is the mean of `window_misfit` over the window and the sixteen
        before and after it.
    """
    n = len(queries)
    travelled, driven = list[Travelled]([None] * n), [0] * n
    if odometry is not None:
        place_filter.transitions.check_odometry()
        spacing_mm = place_filter.transitions.spacing_mm
        travelled, driven = odometry.of_windows(queries.end_us, spacing_mm)
    unseen, seen = [0] * n, np.ones(n, dtype=np.bool_)
    if queries.unseen is not None:
        unseen, seen = queries.unseen.tolist(), np.asarray(queries.events > 0)
    drive = _Drive(place_filter, index, queries, travelled, driven, unseen, seen)
    filtered = FilteredDrive.empty(n, index.places if with_metrics else 0)
    if smooth:
        _smooth(drive, filtered)
        return filtered
    for first in range(0, n, drive.block):
        filtered.put(first, drive.advance(first, min(first + drive.block, n)))
    return filtered


class _Drive(NamedTuple):
    """A filter and the windows of a drive.

    Attributes
    ----------
    travelled, driven : list of int or None, list of int
        Distance in each window that `Odometer` counts, and the whole driven distance.
    unseen : list of int
        See `Descriptors`.
    seen : ndarray of bool, shape (n,)
        Whether each window has an event of the whole sensor, if that is known.
    """

    place_filter: PlaceFilter
    reference: ReferenceIndex
    queries: Descriptors
    travelled: list[Travelled]
    driven: list[int]
    unseen: list[int]
    seen: npt.NDArray[np.bool_]

    @property
    def block(self) -> int:
        """Number of windows in memory at a time."""
        return max(1, BLOCK_DISTANCES // self.reference.places)

    def advance(self, begin: int, end: int) -> WindowRows:
        """Advance from window `begin` to before `end`, and return the results."""
        events, place_filter = self.queries.counted_events, self.place_filter
        rows = WindowRows.empty(end - begin, place_filter.sums, self.reference.places)
        for i, j in runs(self.travelled[begin:end], self.unseen[begin:end], self.block):
            first, last = begin + i, begin + j
            if self.unseen[first]:
                place_filter.unseen(self.unseen[first])
            distance = self.travelled[first]
            if distance is not None:
                place_filter.predict_travelled(distance, self.driven[first])
            distances = self._distances(first, last)
            place_filter.update_windows(distances, events[first:last], rows.part(i, j))
        return rows

    def _distances(self, first: int, last: int) -> npt.NDArray[np.integer]:
        """Return the distances of the sums of windows to all places, shape (n, sums, K)."""
        counts = self.queries.counts[first:last, np.newaxis]
        if self.place_filter.sums > 1:
            assert self.queries.summed is not None
            counts = np.concatenate([counts, self.queries.summed[first:last]], axis=1)
        windows, sums, pixels = counts.shape
        rows = self.reference.rows(counts.reshape(windows * sums, pixels))
        return rows.reshape(windows, sums, self.reference.places)


def _smooth(drive: _Drive, filtered: FilteredDrive) -> None:
    """Smooth the whole drive, segment by segment from the last one.

    The forward pass saves the filter's state at the start of each segment; the backward pass
    repeats the segment from there. Memory holds one segment at a time, and one state per segment.
    """
    place_filter, n = drive.place_filter, len(drive.travelled)
    length = max(_SEGMENT_VALUES // drive.reference.places, math.isqrt(n), 1)
    begins = list(range(0, n, length))
    states = []
    for begin in begins[:-1]:
        states.append(place_filter.to_arrays())
        drive.advance(begin, begin + length)
    cost_to_go = np.zeros((drive.reference.places, LANES), dtype=np.int16)
    place, residual = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    informative = np.empty(n, dtype=np.bool_)
    for begin in reversed(begins):
        if begin != begins[-1]:
            place_filter.resume(states.pop())
        end = min(begin + length, n)
        rows = drive.advance(begin, end)
        add_cost_to_go(
            cost_to_go, place_filter.transitions, rows, drive.travelled[begin:end],
            drive.unseen[begin:end],
        )  # fmt: skip
        place[begin:end], gain = rows.best.T
        at = np.arange(end - begin)
        of_sum = rows.sums[at, gain]
        residual[begin:end] = rows.evidence[at, of_sum, place[begin:end]]
        informative[begin:end] = rows.factor[at, of_sum] > 0
        for first in range(0, end - begin, drive.block):
            filtered.put(begin + first, rows.part(first, min(first + drive.block, end - begin)))
        del rows  # or two segments would be in memory while the next one is computed
    filtered.rows["trust"] = smoothed_trust(
        place,
        filtered.rows["trust"],
        residual,
        drive.travelled,
        drive.unseen,
        drive.seen,
        place_filter.transitions,
    )
    filtered.rows["misfit"] = smoothed_misfit(filtered.rows["misfit"], informative)


# Matching of all query windows of a recorded drive, by sequences or by the place filter.


def match_query(
    reference: ReferenceMap, queries: Descriptors, odometry: Odometry | None = None
) -> Matches:
    """Match a described query with a map, using its settings and probabilities.

    Parameters
    ----------
    odometry : Odometry, optional
        Odometry of the query drive.
    """
    return match_descriptors(
        reference.places,
        queries,
        reference.settings,
        reference.confidence,
        along_mm=reference.along_mm,
        odometry=odometry,
    )


def match_descriptors(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    confidence: Confidence | None = None,
    *,
    along_mm: npt.NDArray[np.int64] | None = None,
    odometry: Odometry | None = None,
) -> Matches:
    """Match every query window, by sequences of L windows or by the place filter.

    Parameters
    ----------
    places : Descriptors
        The K places of the reference.
    queries : Descriptors
        Q query windows, counted at the same pixels.
    settings : Settings
        Only `matching` and its settings, `exclusion` and `precision` are used.
    confidence : Confidence, optional
        Table of probabilities; by default the shipped one for the place filter, and none for
        sequences.
    along_mm : ndarray of int64, shape (K,), optional
        `ReferenceMap.along_mm`.
    odometry : Odometry, optional
        Odometry of the query drive; needs `along_mm` and the place filter.

    Returns
    -------
    Matches
        Of all Q windows by the filter; by sequences, of the Q - L + 1 windows in the middle of a
        whole sequence.
    """
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    check_queries(places, queries, settings)
    acceptance = Acceptance.of(settings, confidence)
    if settings.matching == "filter":
        place_filter = PlaceFilter.of(places, settings, along_mm)
        index = ReferenceIndex(places.counts)
        return match_by_filter(place_filter, index, queries, settings, acceptance, odometry)
    if odometry is not None:
        raise odometry_of_sequences()
    return match_by_sequences(places, queries, settings, acceptance)


def check_queries(places: Descriptors, queries: Descriptors, settings: Settings) -> None:
    """Raise MapError unless places and queries have the same counters, and what a filter needs."""
    for name, windows in (("places", places), ("queries", queries)):
        expect(windows, Descriptors, name, "Descriptors, as of describe or of a map")
    if places.counts.shape[1] != queries.counts.shape[1]:
        raise MapError(
            f"reference descriptors have {places.counts.shape[1]} counts and the query's "
            f"{queries.counts.shape[1]}: describe both with the same map"
        )
    several = settings.matching == "filter" and settings.hypotheses > 1
    if several and queries.summed is None:
        raise MapError(
            f"the queries have codes of single windows, and gains = {settings.gains} needs those "
            "of sums too: describe them with the map (describe_query), or set gains to 1"
        )


def match_by_filter(
    place_filter: PlaceFilter,
    index: ReferenceIndex,
    queries: Descriptors,
    settings: Settings,
    acceptance: Acceptance,
    odometry: Odometry | None = None,
) -> Matches:
    """Match every query window by a place filter in its initial state; see `filter_drive`."""
    filtered = filter_drive(place_filter, index, queries, odometry, smooth=settings.smooth)
    rows = filtered.rows
    rows["start_us"], rows["time_us"] = queries.start_us, queries.end_us
    rows["probability"], rows["lost"] = acceptance.accept(rows["trust"], rows["misfit"])
    return Matches.of_rows(rows, settings, index.places, filtered.candidates)


# Matrix of the distances from all query windows of a drive to all places.


def query_distances(
    reference: ReferenceMap, queries: Descriptors, odometry: Odometry | None = None
) -> npt.NDArray[np.float64]:
    """Return the distance of each query window to each place, as `match_query` compares them.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite: by sequences `sequence_distances`, by the place filter its metric at each place.
    """
    places, settings = reference.places, reference.settings
    check_queries(places, queries, settings)
    size = len(places) * len(queries) * 8
    if size > MOST_BYTES:
        raise UsageError(
            f"the distances of {len(queries):,} queries to {len(places):,} places take "
            f"{size / 1e9:.1f} GB: read a part (end=), or take longer windows (tau=)"
        )
    if settings.matching == "filter":
        return filter_drive(
            PlaceFilter.of(places, settings, reference.along_mm), ReferenceIndex(places.counts),
            queries, odometry, smooth=settings.smooth, with_metrics=True,
        ).metrics  # fmt: skip
    if odometry is not None:
        raise odometry_of_sequences()
    return sequence_distances(places, queries, settings.sequence_length)
