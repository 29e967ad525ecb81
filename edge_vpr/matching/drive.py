"""Matching of all windows of a recorded drive, by sequences or by the place filter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Acceptance, Confidence, default_confidence, net_trust
from edge_vpr.descriptors.windows import Descriptors, activity_of_drive, place_activity
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.matching.distances import ReferenceIndex, typical_distances
from edge_vpr.matching.matches import CANDIDATES, Matches, nearest_places
from edge_vpr.matching.place_filter import (
    LASTING_NEIGHBOURS,
    TRUST_BITS,
    USUAL_FIT,
    FilterMatch,
    Metrics,
    PlaceFilter,
    TransitionCosts,
    Transitions,
    WindowRows,
)
from edge_vpr.matching.sequences import (
    BestSequences,
    anchor_offset,
    check_length,
    sequence_matches,
    sequence_sums,
)
from edge_vpr.matching.smoother import BackwardPass, FixedLag, Way, runs
from edge_vpr.route import Odometry
from edge_vpr.settings import Settings

# The place filter over a recorded drive: at once, some windows late, or by the whole drive.


#: number of distances in memory at a time, so that memory does not grow with the drive
_BLOCK_DISTANCES = 4_000_000
#: number of metrics and of pieces of evidence in memory at a time while a drive is smoothed
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
        Of `FilterMatch`.
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
        Before its first window.
    index : ReferenceIndex
        Of the K places.
    queries : Descriptors
        n windows in the map's codes.
    odometry : Odometry, optional
        Of this drive.
    smooth : bool
        Let all windows after each one decide with.
    delay : int
        If not, the number of windows after each one that decide with.
    metrics : ndarray of float64, shape (K, n), optional
        Filled with the metric of each place after each window, the least of which is the match.

    Returns
    -------
    FilteredDrive
        If smoothed, the trust is the mean margin of the summed metrics over the window and the
        four before and after it, in units of 1/16 of a metric, less the largest evidence against a
        match of these nine windows, and at least 0. A margin counts as 0 where a match between
        does not follow from the one before. The misfit is the mean of `window_misfit` over the
        window and sixteen before and after it. Else trust and misfit are those of `match_window`.

    Raises
    ------
    UsageError
        If the map takes no odometry.
    """
    n = len(queries)
    ways: list[Way] = [None] * n
    if odometry is not None:
        place_filter.transitions.check_odometry()
        travelled, known = odometry.of_windows(queries.end_us)
        ways = [way if sure else None for way, sure in zip(travelled.tolist(), known, strict=True)]
    drive, found = _Drive(place_filter, index, queries, ways), _Found.empty(n, metrics)
    if smooth:
        _smooth(drive, found)
        return FilteredDrive(found.columns, found.candidates)
    lag = FixedLag(place_filter.transitions, place_filter.exclusion, delay) if delay else None
    for first, last, rows in drive.advance(0, n):
        if lag is None:
            found.put(first, rows.columns, rows.metrics)
        else:
            found.put_late(last - delay, *lag.add(rows, ways[first:last]))
    if lag is not None:
        found.put_late(n, *lag.finish())
    return FilteredDrive(found.columns, found.candidates)


class _Drive(NamedTuple):
    """A filter and the windows of a drive that it advances by.

    Attributes
    ----------
    ways : list of int or None
        Distance driven before each window.
    """

    place_filter: PlaceFilter
    reference: ReferenceIndex
    queries: Descriptors
    ways: list[Way]

    @property
    def block(self) -> int:
        """Number of windows in memory at a time."""
        return max(1, _BLOCK_DISTANCES // self.reference.places)

    def advance(self, begin: int, end: int) -> Iterator[tuple[int, int, WindowRows]]:
        """Advance from window `begin` to before `end`; yield a few windows at a time."""
        events = self.queries.activity
        for i, j in runs(self.ways[begin:end], self.block):
            first, last = begin + i, begin + j
            way = self.ways[first]
            if way is not None:
                self.place_filter.predict_travelled(way)
            distances = self.reference.rows(self.queries.counts[first:last])
            yield first, last, self.place_filter.update_windows(distances, events[first:last])

    def rows(self, begin: int, end: int) -> WindowRows:
        """Advance, and return the results of all these windows."""
        rows = WindowRows.empty(end - begin, self.reference.places)
        for first, last, some in self.advance(begin, end):
            rows.part(first - begin, last - begin).take(some)
        return rows


class _Found(NamedTuple):
    """Matches of n windows, filled in parts; `metrics` are those of `filter_drive`."""

    columns: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]
    metrics: npt.NDArray[np.float64] | None

    @classmethod
    def empty(cls, windows: int, metrics: npt.NDArray[np.float64] | None) -> _Found:
        columns = np.empty((windows, len(FilterMatch._fields)), dtype=np.int64)
        return cls(columns, np.empty((windows, CANDIDATES), dtype=np.int64), metrics)

    def put(self, first: int, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Put the matches of some windows, with the metrics of all places, shape (n, K)."""
        last = first + len(columns)
        self.columns[first:last] = columns
        self.candidates[first:last] = nearest_places(metrics.T)
        if self.metrics is not None:
            self.metrics[:, first:last] = metrics.T

    def put_late(self, last: int, columns: npt.NDArray[np.int64], metrics: Metrics) -> None:
        """Put the matches of some windows, the last of which is before `last`."""
        if len(columns):
            self.put(last - len(columns), columns, metrics)


def _smooth(drive: _Drive, found: _Found) -> None:
    """Smooth the whole drive, segment by segment from the last one.

    The forward pass keeps the filter's state at the begin of each segment, from which the backward
    pass repeats it. What lies in memory at a time is one segment, and a state for each.
    """
    place_filter, n = drive.place_filter, len(drive.ways)
    length = max(_SEGMENT_VALUES // drive.reference.places, math.isqrt(n), 1)
    begins = list(range(0, n, length))
    states = []
    for begin in begins[:-1]:
        states.append((place_filter.state.metric.astype(np.uint16), place_filter.numbers))
        for _ in drive.advance(begin, begin + length):
            pass
    onward = BackwardPass(place_filter.transitions, place_filter.exclusion)
    residual, told = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.bool_)
    for begin in reversed(begins):
        if begin != begins[-1]:
            metric, numbers = states.pop()
            place_filter.resume(metric.astype(np.int32), numbers)
        end = min(begin + length, n)
        rows = drive.rows(begin, end)
        onward.add_to(rows, drive.ways[begin:end])
        residual[begin:end] = rows.evidence[np.arange(end - begin), rows.columns[:, 0]]
        told[begin:end] = rows.factor > 0
        for first in range(0, end - begin, drive.block):
            some = rows.part(first, min(first + drive.block, end - begin))
            found.put(begin + first, some.columns, some.metrics)
        del rows, some  # else two segments are in memory while the next one is computed
    residual = _largest_around(residual)
    trust = _mean_trust(found.columns, drive.ways, place_filter.transitions)
    found.columns[:, 5] = np.maximum(trust - (residual << TRUST_BITS), 0)
    found.columns[:, 6] = _mean_misfit(found.columns[:, 6], told)


def _largest_around(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the largest value of each window and its neighbours."""
    around = np.pad(values, NEIGHBOURS)
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(around, 2 * NEIGHBOURS + 1).max(axis=1)
    )


def _mean_trust(
    columns: npt.NDArray[np.int64], ways: Sequence[Way], transitions: Transitions
) -> npt.NDArray[np.int64]:
    """Return the mean trust of each window and its neighbours, with 0 for those beyond a jump."""
    place, margin = columns[:, 0].tolist(), columns[:, 5]
    total = np.concatenate([[0], np.cumsum(margin)])
    chain = np.zeros(len(place), dtype=np.int64)  # runs without a jump
    for j in range(1, len(place)):
        chain[j] = chain[j - 1] + (not transitions.lead_to(place[j - 1], place[j], ways[j]))
    at = np.arange(len(place))
    first = np.maximum(at - NEIGHBOURS, np.searchsorted(chain, chain, side="left"))
    last = np.minimum(at + NEIGHBOURS, np.searchsorted(chain, chain, side="right") - 1)
    return np.asarray((total[last + 1] - total[first]) // (2 * NEIGHBOURS + 1))


def _mean_misfit(
    misfit: npt.NDArray[np.int64], told: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """Return the misfit of smoothed matches, from that of each window that is not a pause."""
    n = len(misfit)
    totals = [np.concatenate([[0], np.cumsum(column)]) for column in (misfit * told, told)]
    first = np.maximum(np.arange(n) - LASTING_NEIGHBOURS, 0)
    last = np.minimum(np.arange(n) + LASTING_NEIGHBOURS + 1, n)
    summed, number = (total[last] - total[first] for total in totals)
    mean = (summed << TRUST_BITS) // np.maximum(number, 1)
    return np.where(number > 0, np.maximum(mean - USUAL_FIT, 0), 0)


# Matching of all query windows of a recorded drive, by sequences or by the place filter.


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
        Of the map, see `MapRecord`; only the place filter takes them.
    along_mm : ndarray of int64, shape (K,), optional
        `MapRecord.along_mm`.
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
    expect(settings, Settings, "settings", "Settings, as of a map or of resolve_settings")
    check_counts(places, queries)
    if confidence is None and settings.matching == "filter":
        confidence = default_confidence(settings.smooth, settings.late, settings.stays_on_map)
    acceptance = Acceptance(confidence, settings.precision)
    if settings.matching == "filter":
        place_filter = filter_of(places, settings, jumps, along_mm)
        index = ReferenceIndex(places.counts)
        return match_by_filter(place_filter, index, queries, settings, acceptance, odometry)
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


def filter_of(
    places: Descriptors,
    settings: Settings,
    jumps: npt.NDArray[np.int32] | None,
    along_mm: npt.NDArray[np.int64] | None,
) -> PlaceFilter:
    """Return the place filter of a map, before its first window.

    Parameters
    ----------
    jumps, along_mm : ndarray or None
        Of the map, see `match_descriptors`.
    """
    events, number = places.activity, settings.places_per_window
    return PlaceFilter(
        len(places), TransitionCosts.of(settings), settings.exclusion_places,
        activity_of_drive(events[::number]), place_activity=place_activity(events, number),
        jumps=jumps, along_mm=along_mm, typical=typical_distances(places.counts),
    )  # fmt: skip


def check_no_ways(jumps: npt.NDArray[np.int32] | None, odometry: bool) -> None:
    """Raise UsageError if sequences are asked to use jumps or odometry.

    Parameters
    ----------
    jumps : ndarray of int32, shape (n, 2), optional
        None if there are none.
    odometry : bool
        Whether it is given.
    """
    given = "odometry" if odometry else "a map with jumps"
    if odometry or (jumps is not None and len(jumps)):
        raise UsageError(
            f"{given} is for the place filter, and sequences follow neither: match with "
            "--matching filter"
        )


def match_by_filter(
    place_filter: PlaceFilter,
    index: ReferenceIndex,
    queries: Descriptors,
    settings: Settings,
    acceptance: Acceptance,
    odometry: Odometry | None = None,
) -> Matches:
    """Match every query window by a filter before its first window; see `filter_drive`."""
    found = filter_drive(
        place_filter, index, queries, odometry, smooth=settings.smooth, delay=settings.late
    )
    place, metric, second, second_metric, ties, trust, misfit = found.columns.T
    probability, lost = acceptance.acceptance(net_trust(trust, misfit))
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


# Matrix of the distances of all query windows of a drive to all places.


def drive_distances(
    places: Descriptors,
    queries: Descriptors,
    settings: Settings,
    *,
    jumps: npt.NDArray[np.int32] | None = None,
    along_mm: npt.NDArray[np.int64] | None = None,
    odometry: Odometry | None = None,
) -> npt.NDArray[np.float64]:
    """Return the distance of every place to every query window, as matching compares them.

    Parameters
    ----------
    places, queries : Descriptors
        K and Q of them.
    jumps, along_mm, odometry
        As `match_descriptors` takes them.

    Returns
    -------
    ndarray of float64, shape (K, Q)
        All finite. By sequences, D_seq (method.md section 5): the mean distance of L windows
        along the diagonal; where a sequence would leave the matrix, the mean of those inside it.
        By the place filter, its metric at each place.

    Raises
    ------
    MapError
        If the descriptors differ in length.
    UsageError
        If the matrix is larger than 2 GiB, or as `match_descriptors` raises.
    """
    check_counts(places, queries)
    size = len(places) * len(queries) * 8
    if size > MOST_BYTES:
        raise UsageError(
            f"the distances of {len(queries):,} queries to {len(places):,} places take "
            f"{size / 1e9:.1f} GB: read a part (--end), or take longer windows (--tau)"
        )
    index = ReferenceIndex(places.counts)
    out = np.zeros((len(places), len(queries)), dtype=np.float64)
    if settings.matching == "filter":
        place_filter = filter_of(places, settings, jumps, along_mm)
        filter_drive(
            place_filter, index, queries, odometry,
            smooth=settings.smooth, delay=settings.late, metrics=out,
        )  # fmt: skip
        return out
    check_no_ways(jumps, odometry is not None)
    length = settings.sequence_length
    check_length(length, len(places), len(queries))
    distances = index.matrix(queries.counts)
    inside = np.zeros(out.shape, dtype=np.int32)
    before = anchor_offset(length, settings.anchor)
    for step in range(-before, length - before):
        # D[k + step, q + step] at [k, q], where both are in the matrix
        k, q = (slice(max(0, -step), n - max(0, step)) for n in out.shape)
        k_on, q_on = (slice(max(0, step), n - max(0, -step)) for n in out.shape)
        out[k, q] += distances[k_on, q_on]
        inside[k, q] += 1
    return out / inside
