"""The place filter over a recorded drive: window by window, or smoothed over the whole of it.

The metric of a place is the price of the cheapest path that leads there. With the filter run
backwards, it is the price of the cheapest path from there to the end of the drive. The sum is the
price of the best path of the whole drive through this place: the min-plus form of forward-backward
smoothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.candidates import CANDIDATES, nearest_places
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.filter_recursion import smooth_windows
from edge_vpr.matching.moves import Moves
from edge_vpr.matching.place_filter import FilterMatch, PlaceFilter
from edge_vpr.odometry import Odometry

#: number of distances in memory at a time, so that memory does not grow with the drive
_BLOCK_DISTANCES = 4_000_000
#: largest memory for smoothing a drive, which takes 3 bytes for each window and place
MOST_BYTES = 2 << 30
#: number of windows before and after a window that its trust uses in a smoothed drive
NEIGHBOURS = 4


class FilteredDrive(NamedTuple):
    """Matches of n windows.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 6)
        Of `FilterMatch`.
    candidates : ndarray of int64, shape (n, 25)
        Places of the least metrics, see `nearest_places`.
    """

    columns: npt.NDArray[np.int64]
    candidates: npt.NDArray[np.int64]


class _Kept(NamedTuple):
    """Values of all windows that smoothing needs: those of `WindowRows`, in fewer bits."""

    metrics: npt.NDArray[np.uint16]
    evidence: npt.NDArray[np.uint8]
    pauses: npt.NDArray[np.bool_]

    @classmethod
    def empty(cls, windows: int, places: int) -> _Kept:
        shape = (windows, places)
        return cls(
            np.empty(shape, dtype=np.uint16),
            np.empty(shape, dtype=np.uint8),
            np.empty(windows, dtype=np.bool_),
        )


def filter_drive(
    place_filter: PlaceFilter,
    index: ReferenceIndex,
    queries: Descriptors,
    odometry: Odometry | None = None,
    *,
    smooth: bool = False,
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
        Let the windows after each one decide with.
    metrics : ndarray of float64, shape (K, n), optional
        Filled with the metric of each place after each window, the least of which is the match.

    Returns
    -------
    FilteredDrive
        If smoothed, the trust is the mean margin of the summed metrics over the window and the
        four before and after it, in units of 1/16 of a metric; a window counts as 0 where a match
        between does not follow from the one before.

    Raises
    ------
    UsageError
        If the map takes no odometry, or too much memory would be needed to smooth.
    """
    n, places = len(queries), index.places
    if smooth and 3 * n * places > MOST_BYTES:
        raise UsageError(
            f"smoothing {n} windows over {places} places takes {3 * n * places / 1e9:.1f} GB: "
            "match with --no-smooth, or split the drive"
        )
    ways: list[int | None] = [None] * n
    if odometry is not None:
        place_filter.moves.check_odometry()
        travelled, known = odometry.of_windows(queries.end_us)
        ways = [way if sure else None for way, sure in zip(travelled.tolist(), known, strict=True)]
    events = queries.activity
    kept = _Kept.empty(n, places if smooth else 0)
    columns = np.empty((n, len(FilterMatch._fields)), dtype=np.int64)
    candidates = []
    for first, last in _runs(ways, max(1, _BLOCK_DISTANCES // places)):
        way = ways[first]
        if way is not None:
            place_filter.travel(way)
        distances = index.rows(queries.counts[first:last])
        rows = place_filter.advance_windows(distances, events[first:last])
        columns[first:last] = rows.columns
        if smooth:
            kept.metrics[first:last], kept.evidence[first:last] = rows.metrics, rows.evidence
            kept.pauses[first:last] = rows.pauses
            continue
        if metrics is not None:
            metrics[:, first:last] = rows.metrics.T
        candidates.append(nearest_places(rows.metrics.T))
    if smooth:
        return _smoothed(place_filter, kept, ways, metrics)
    return FilteredDrive(columns, np.concatenate(candidates))


def _runs(ways: list[int | None], most: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of runs of windows in which only the first has a known distance."""
    begin = 0
    while begin < len(ways):
        end = begin + 1
        while end < len(ways) and end - begin < most and ways[end] is None:
            end += 1
        yield begin, end
        begin = end


def _smoothed(
    place_filter: PlaceFilter,
    kept: _Kept,
    ways: list[int | None],
    metrics: npt.NDArray[np.float64] | None,
) -> FilteredDrive:
    n, places = kept.metrics.shape
    back = place_filter.moves.reversed()
    columns = np.empty((n, len(FilterMatch._fields)), dtype=np.int64)
    candidates = np.empty((n, CANDIDATES), dtype=np.int64)
    onward, turned = np.zeros(places, dtype=np.int32), np.empty(places, dtype=np.int32)
    for first, last in reversed(list(_runs(ways, max(1, _BLOCK_DISTANCES // places)))):
        summed = kept.metrics[first:last].astype(np.int32)
        smooth_windows(
            onward, turned, back.by_step, place_filter.exclusion,
            kept.pauses[first:last], kept.evidence[first:last], summed, columns[first:last],
        )  # fmt: skip
        way = ways[first]
        if way is not None:
            onward = np.ascontiguousarray(back.by_distance(turned, way)[::-1])
        candidates[first:last] = nearest_places(summed.T)
        if metrics is not None:
            metrics[:, first:last] = summed.T
    columns[:, -1] = _mean_trust(columns, ways, place_filter.moves)
    return FilteredDrive(columns, candidates)


def _mean_trust(
    columns: npt.NDArray[np.int64], ways: list[int | None], moves: Moves
) -> npt.NDArray[np.int64]:
    """Return the mean trust of each window and its neighbours, with 0 for those beyond a jump."""
    place, margin = columns[:, 0].tolist(), columns[:, -1]
    total = np.concatenate([[0], np.cumsum(margin)])
    chain = np.zeros(len(place), dtype=np.int64)  # runs without a jump
    for j in range(1, len(place)):
        chain[j] = chain[j - 1] + (not moves.lead_to(place[j - 1], place[j], ways[j]))
    at = np.arange(len(place))
    first = np.maximum(at - NEIGHBOURS, np.searchsorted(chain, chain, side="left"))
    last = np.minimum(at + NEIGHBOURS, np.searchsorted(chain, chain, side="right") - 1)
    return np.asarray((total[last + 1] - total[first]) // (2 * NEIGHBOURS + 1))
