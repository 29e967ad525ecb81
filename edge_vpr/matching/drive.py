"""Matching of all windows of a recorded drive, by sequences or by the place filter.

The filter matches each window immediately, some windows late, or by the whole drive. The code that
matching event by event shares is in `place_filter`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import NO_MISFIT, Acceptance, Confidence
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.map_record import MapRecord
from edge_vpr.matching.distances import ReferenceIndex, best_matches, nearest_places
from edge_vpr.matching.matches import CANDIDATES, Matches, margin_to_second
from edge_vpr.matching.place_filter import (
    MISFIT_NEIGHBOURS,
    MISFIT_ZERO,
    STANDING_SHIFT,
    TRUST_BITS,
    BackwardPass,
    FilterMatch,
    FixedLag,
    Metrics,
    PlaceFilter,
    Transitions,
    Travelled,
    WindowRows,
    check_no_transitions,
    runs,
)
from edge_vpr.route import Odometry
from edge_vpr.settings import Settings

# The place filter over a recorded drive: immediately, some windows late, or by the whole drive.


#: number of distances in memory at a time, so that memory does not grow with the drive
_BLOCK_DISTANCES = 4_000_000
#: number of metrics, and of evidence values, in memory at a time while a drive is smoothed
_SEGMENT_VALUES = 40_000_000
#: largest matrix of distances in memory
MOST_BYTES = 2 << 30
#: number of windows before and after a window that its trust uses in a smoothed drive
NEIGHBOURS = 4


class FilteredDrive(NamedTuple):
    """Matches of n windows.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 7)
        Fields of `FilterMatch`.
    candidates : ndarray of int64, shape (n, 25)
        Places of the least metrics, see `nearest_places`.
    """

    columns: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]


def filter_drive(
    place_filter: PlaceFilter,
    index: ReferenceIndex,
    queries: Descriptors,
    odometry: Odometry | None = None,
    *,
    smooth: bool = False,
    delay: int = 0,
    metrics: npt.NDArray[np.float64] | None = None,
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
    delay : int
        Without `smooth`, the number of later windows that contribute.
    metrics : ndarray of float64, shape (K, n), optional
        Output: the metric of each place after each window, the least of which is the match.

    Returns
    -------
    FilteredDrive
        Without smoothing, trust and misfit are those of `match_window`. With smoothing, the trust
        is the mean margin of the summed metrics over the window and the four before and after it,
        in units of 1/16 of a metric, less the largest evidence against a match in these nine
        windows, and at least 0. A margin counts as 0 if a match between it and the window is not
        reachable from the one before, and is reduced by 1/16 for each other consecutive window with
        the same place. The misfit is the mean of `window_misfit` over the window and the sixteen
        before and after it.
    """
    n = len(queries)
    travelled: list[Travelled] = [None] * n
    driven = [0] * n
    if odometry is not None:
        place_filter.transitions.check_odometry()
        spacing_mm = place_filter.transitions.spacing_mm
        counted, every, known = odometry.of_windows(queries.end_us, spacing_mm)
        driven = every.tolist()
        travelled = [
            mm if is_known else None for mm, is_known in zip(counted.tolist(), known, strict=True)
        ]
    drive = _Drive(place_filter, index, queries, travelled, driven)
    found = _Found.empty(n, metrics)
    if smooth:
        _smooth(drive, found)
        return FilteredDrive(found.columns, found.candidates)
    lag = FixedLag(place_filter.transitions, delay) if delay else None
    for first, last, rows in drive.advance(0, n):
        if lag is None:
            found.put(first, rows.columns, rows.metrics)
        else:
            found.put_late(last - delay, *lag.add(rows, travelled[first:last]))
    if lag is not None:
        found.put_late(n, *lag.finish())
    return FilteredDrive(found.columns, found.candidates)


class _Drive(NamedTuple):
    """A filter and the windows of a drive.

    Attributes
    ----------
    travelled, driven : list of int or None, list of int
        Distance in each window that `Odometer` counts, and the whole driven distance.
    """

    place_filter: PlaceFilter
    reference: ReferenceIndex
    queries: Descriptors
    travelled: list[Travelled]
    driven: list[int]

    @property
    def block(self) -> int:
        """Number of windows in memory at a time."""
        return max(1, _BLOCK_DISTANCES // self.reference.places)

    def advance(self, begin: int, end: int) -> Iterator[tuple[int, int, WindowRows]]:
        """Advance from window `begin` to before `end`; yield a few windows at a time."""
        events = self.queries.selected_events
        for i, j in runs(self.travelled[begin:end], self.block):
            first, last = begin + i, begin + j
            distance = self.travelled[first]
            if distance is not None:
                self.place_filter.predict_travelled(distance, self.driven[first])
            distances = self.reference.rows(self.queries.counts[first:last])
            yield first, last, self.place_filter.update_windows(distances, events[first:last])

    def rows(self, begin: int, end: int) -> WindowRows:
        """Advance from window `begin` to before `end`, and return all results."""
        rows = WindowRows.empty(end - begin, self.reference.places)
        for first, last, some in self.advance(begin, end):
            rows.part(first - begin, last - begin).take(some)
        return rows


class _Found(NamedTuple):
    """Matches of n windows, filled in parts; `metrics` as in `filter_drive`."""

    columns: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]
    metrics: npt.NDArray[np.float64] | None

    @classmethod
    def empty(cls, windows: int, metrics: npt.NDArray[np.float64] | None) -> _Found:
        columns = np.empty((windows, len(FilterMatch._fields)), dtype=np.int64)
        return cls(columns, np.empty((windows, CANDIDATES), dtype=np.int64), metrics)

    def put(self, first: int, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Store the matches of some windows, with the metrics of all places, shape (n, K)."""
        last = first + len(columns)
        self.columns[first:last] = columns
        self.candidates[first:last] = nearest_places(metrics.T)
        if self.metrics is not None:
            self.metrics[:, first:last] = metrics.T

    def put_late(self, last: int, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Store the matches of some windows, the last of which is before `last`."""
        if len(columns):
            self.put(last - len(columns), columns, metrics)


def _smooth(drive: _Drive, found: _Found) -> None:
    """Smooth the whole drive, segment by segment from the last one.

    The forward pass saves the filter's state at the start of each segment; the backward pass
    repeats the segment from there. Memory holds one segment at a time, and one state per segment.
    """
    place_filter, n = drive.place_filter, len(drive.travelled)
    length = max(_SEGMENT_VALUES // drive.reference.places, math.isqrt(n), 1)
    begins = list(range(0, n, length))
    states = []
    for begin in begins[:-1]:
        states.append((place_filter.state.metric.astype(np.uint16), place_filter.numbers))
        for _ in drive.advance(begin, begin + length):
            pass
    cost_to_go = BackwardPass(place_filter.transitions)
    residual, informative = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.bool_)
    for begin in reversed(begins):
        if begin != begins[-1]:
            metric, numbers = states.pop()
            place_filter.resume(metric.astype(np.int32), numbers)
        end = min(begin + length, n)
        rows = drive.rows(begin, end)
        cost_to_go.add_to(rows, drive.travelled[begin:end])
        residual[begin:end] = rows.evidence[np.arange(end - begin), rows.columns[:, 0]]
        informative[begin:end] = rows.factor > 0
        for first in range(0, end - begin, drive.block):
            some = rows.part(first, min(first + drive.block, end - begin))
            found.put(begin + first, some.columns, some.metrics)
        del rows, some  # or two segments would be in memory while the next one is computed
    found.columns[:, 5] = smoothed_trust(
        found.columns[:, 0],
        found.columns[:, 5],
        residual,
        drive.travelled,
        place_filter.transitions,
    )
    found.columns[:, 6] = _mean_misfit(found.columns[:, 6], informative)


def smoothed_trust(
    place: npt.NDArray[np.int64],
    margin: npt.NDArray[np.int64],
    residual: npt.NDArray[np.int64],
    travelled: Sequence[Travelled],
    transitions: Transitions,
) -> npt.NDArray[np.int64]:
    """Return the trust of the matches of a smoothed drive, see `filter_drive`.

    Parameters
    ----------
    place, margin, residual : ndarray of int64, shape (n,)
        Match of each window, its margin in units of 1/16 of a metric, and the evidence against it.
    travelled : sequence of int or None
        Driven distance of each window.
    """
    mean = _mean_around(place, _standing(place, margin), travelled, transitions)
    return np.maximum(mean - (_largest_around(residual) << TRUST_BITS), 0)


def _largest_around(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the largest value among each window and its neighbours."""
    around = np.pad(values, NEIGHBOURS)
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(around, 2 * NEIGHBOURS + 1).max(axis=1)
    )


def _standing(place: npt.NDArray[np.int64], margin: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the margins, reduced by 1/16 for each other consecutive window with the same place.

    Repeated views add no information. A path that leaves the map may also stay at one place, which
    is then better than all others.
    """
    begin = np.flatnonzero(np.diff(place, prepend=-1))
    windows = np.diff(begin, append=len(place))
    others, left = np.repeat(windows - 1, windows), margin.copy()
    for passed in range(others.max(initial=0)):
        fall = np.where(others > passed, left >> STANDING_SHIFT, 0)
        if not fall.any():
            break
        left -= fall
    return left


def _mean_around(
    place: npt.NDArray[np.int64],
    margin: npt.NDArray[np.int64],
    travelled: Sequence[Travelled],
    transitions: Transitions,
) -> npt.NDArray[np.int64]:
    """Return the mean margin of each window and its neighbours; 0 for those beyond a restart."""
    places = place.tolist()
    total = np.concatenate([[0], np.cumsum(margin)])
    chain = np.zeros(len(places), dtype=np.int64)  # number of each run without a restart
    for j in range(1, len(places)):
        chain[j] = chain[j - 1] + (not transitions.reaches(places[j - 1], places[j], travelled[j]))
    at = np.arange(len(places))
    first = np.maximum(at - NEIGHBOURS, np.searchsorted(chain, chain, side="left"))
    last = np.minimum(at + NEIGHBOURS, np.searchsorted(chain, chain, side="right") - 1)
    return np.asarray((total[last + 1] - total[first]) // (2 * NEIGHBOURS + 1))


def _mean_misfit(
    misfit: npt.NDArray[np.int64], informative: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """Return the misfit of smoothed matches, averaged over windows that are not pauses."""
    n = len(misfit)
    totals = [
        np.concatenate([[0], np.cumsum(column)]) for column in (misfit * informative, informative)
    ]
    first = np.maximum(np.arange(n) - MISFIT_NEIGHBOURS, 0)
    last = np.minimum(np.arange(n) + MISFIT_NEIGHBOURS + 1, n)
    summed, number = (total[last] - total[first] for total in totals)
    mean = (summed << TRUST_BITS) // np.maximum(number, 1)
    return np.where(number > 0, np.maximum(mean - MISFIT_ZERO, 0), 0)


# Sequences: distances of L successive windows added along the diagonal (method.md section 5).


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
    if length < 1:
        raise UsageError(f"sequence length {length}: expected 1 or more")
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


# Matches by sequences, from sums of distances.


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
    trust = margin_to_second(best_sum, second_sum)
    misfit = np.full(trust.shape, NO_MISFIT, dtype=np.int64)
    probability, lost = acceptance.accept(trust, misfit)
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
        misfit=misfit,
        probability=probability,
        lost=lost,
    )


# Matching of all query windows of a recorded drive, by sequences or by the place filter.


def match_query(
    reference: MapRecord, queries: Descriptors, odometry: Odometry | None = None
) -> Matches:
    """Match a described query with a map, using its settings, probabilities and jumps.

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
        jumps=reference.jumps,
        along_mm=reference.along_mm,
        odometry=odometry,
    )


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
        The K places of the reference.
    queries : Descriptors
        Q query windows, counted at the same pixels.
    settings : Settings
        Only `matching` and its settings, `exclusion` and `precision` are used.
    confidence : Confidence, optional
        Table of probabilities; by default the shipped one for the place filter, and none for
        sequences.
    jumps : ndarray of int32, shape (n, 2), optional
        Jumps of the map, see `MapRecord`; for the place filter only.
    along_mm : ndarray of int64, shape (K,), optional
        `MapRecord.along_mm`.
    odometry : Odometry, optional
        Odometry of the query drive; needs `along_mm` and the place filter.

    Returns
    -------
    Matches
        Of all Q windows by the filter; by sequences, of the Q - L + 1 windows in the middle of a
        whole sequence.
    """
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    check_counts(places, queries)
    acceptance = Acceptance.of(settings, confidence)
    if settings.matching == "filter":
        place_filter = PlaceFilter.of(places, settings, jumps, along_mm)
        index = ReferenceIndex(places.counts)
        return match_by_filter(place_filter, index, queries, settings, acceptance, odometry)
    check_no_transitions(jumps, odometry is not None)
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    index = ReferenceIndex(places.counts)
    n = len(queries) - length + 1
    block = max(1, _BLOCK_DISTANCES // len(places))
    parts = []
    for j in range(0, n, block):
        distances = index.matrix(queries.counts[j : min(j + block, n) + length - 1])
        parts.append(BestSequences.of(sequence_sums(distances, length), settings.exclusion_places))
    return sequence_matches(parts, settings, len(places), queries.centre_us, acceptance)


def check_counts(places: Descriptors, queries: Descriptors) -> None:
    """Check that places and queries have the same counters; raise MapError if not."""
    for name, windows in (("places", places), ("queries", queries)):
        expect(windows, Descriptors, name, "Descriptors, as of describe or of a map")
    if places.counts.shape[1] != queries.counts.shape[1]:
        raise MapError(
            f"reference descriptors have {places.counts.shape[1]} counts and the query's "
            f"{queries.counts.shape[1]}: describe both with the same map"
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
    found = filter_drive(
        place_filter, index, queries, odometry, smooth=settings.smooth, delay=settings.match_delay
    )
    place, metric, second, second_metric, ties, trust, misfit = found.columns.T
    probability, lost = acceptance.accept(trust, misfit)
    return Matches(
        settings=settings,
        places_in_map=index.places,
        query=np.arange(len(queries), dtype=np.int64),
        time_us=queries.centre_us,
        place=place,
        distance_sum=metric,
        second=second,
        second_sum=second_metric,
        ties=ties,
        candidates=found.candidates,
        trust=trust,
        misfit=misfit,
        probability=probability,
        lost=lost,
    )


# Matrix of the distances from all query windows of a drive to all places.


def query_distances(
    reference: MapRecord, queries: Descriptors, odometry: Odometry | None = None
) -> npt.NDArray[np.float64]:
    """Return the distance of each query window to each place, as `match_query` compares them.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite, see `drive_distances`.
    """
    return drive_distances(
        reference.places,
        queries,
        reference.settings,
        jumps=reference.jumps,
        along_mm=reference.along_mm,
        odometry=odometry,
    )


def drive_distances(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    *,
    jumps: npt.NDArray[np.int32] | None = None,
    along_mm: npt.NDArray[np.int64] | None = None,
    odometry: Odometry | None = None,
) -> npt.NDArray[np.float64]:
    """Return the distance of each query window to each place, as `match_descriptors` compares them.

    Parameters
    ----------
    places, queries : Descriptors
        K places and Q query windows.
    jumps, along_mm, odometry
        See `match_descriptors`.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite. By sequences, D_seq (method.md section 5): the mean distance of L windows
        along the diagonal; where a sequence would leave the matrix, the mean of those inside it.
        By the place filter, its metric at each place.
    """
    check_counts(places, queries)
    size = len(places) * len(queries) * 8
    if size > MOST_BYTES:
        raise UsageError(
            f"the distances of {len(queries):,} queries to {len(places):,} places take "
            f"{size / 1e9:.1f} GB: read a part (end=), or take longer windows (tau=)"
        )
    index = ReferenceIndex(places.counts)
    out = np.zeros((len(places), len(queries)), dtype=np.float64)
    if settings.matching == "filter":
        place_filter = PlaceFilter.of(places, settings, jumps, along_mm)
        filter_drive(
            place_filter, index, queries, odometry,
            smooth=settings.smooth, delay=settings.match_delay, metrics=out,
        )  # fmt: skip
        return out
    check_no_transitions(jumps, odometry is not None)
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    distances = index.matrix(queries.counts)
    inside = np.zeros(out.shape, dtype=np.int32)
    before = middle_window(length)
    for step in range(-before, length - before):
        # D[k + step, q + step] at [k, q], where both are in the matrix
        k, q = (slice(max(0, -step), n - max(0, step)) for n in out.shape)
        k_on, q_on = (slice(max(0, step), n - max(0, -step)) for n in out.shape)
        out[k, q] += distances[k_on, q_on]
        inside[k, q] += 1
    return out / inside
