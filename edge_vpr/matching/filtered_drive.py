"""The place filter over a recorded drive: window by window, or smoothed over the whole of it.

The filter's metric of a place is the price of the cheapest way that leads there. Run backwards, it
is the price of the cheapest way that leads on from there. Their sum is the price of the best path
of the whole drive that passes the place: the min-plus form of forward-backward smoothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.errors import UsageError
from edge_vpr.matching.candidates import CANDIDATES, nearest_places
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.moves import Moves
from edge_vpr.matching.place_filter import FilterMatch, PlaceFilter, match_of
from edge_vpr.matching.step_prices import Metrics
from edge_vpr.odometry import Odometry

#: distances held at once, so that memory does not grow with the drive
_BLOCK_DISTANCES = 4_000_000
#: most memory for metrics and evidence of a drive that is smoothed: 3 bytes a window and place
MOST_BYTES = 2 << 30
#: of a smoothed drive, so many windows before and after one have a part in its trust
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


class _Window(NamedTuple):
    """How a window followed from the one before."""

    paused: bool
    travelled_mm: int | None


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
    events = queries.activity.tolist()
    kept = (n, places) if smooth else (0, places)
    forward, evidence = np.empty(kept, dtype=np.uint16), np.empty(kept, dtype=np.uint8)
    windows: list[_Window] = []
    columns = np.empty((n, len(FilterMatch._fields)), dtype=np.int64)
    candidates = []
    block = max(1, _BLOCK_DISTANCES // places)
    for first in range(0, n, block):
        distances = np.ascontiguousarray(index.matrix(queries.counts[first : first + block]).T)
        found = np.empty(distances.shape, dtype=np.int32)
        for i, row in enumerate(distances):
            j = first + i
            way = ways[j]
            if way is not None:
                place_filter.travel(way)
            if smooth:
                windows.append(_Window(place_filter.activity.pauses(events[j]), way))
                evidence[j] = place_filter.evidence(row, events[j])
            columns[j] = place_filter.advance(row, events[j])
            found[i] = place_filter.metric
        if smooth:
            forward[first : first + block] = found
        else:
            if metrics is not None:
                metrics[:, first : first + block] = found.T
            candidates.append(nearest_places(found.T))
    if smooth:
        return _smoothed(place_filter, forward, evidence, windows, metrics)
    return FilteredDrive(columns, np.concatenate(candidates))


def _smoothed(
    place_filter: PlaceFilter,
    forward: npt.NDArray[np.uint16],
    evidence: npt.NDArray[np.uint8],
    windows: list[_Window],
    metrics: npt.NDArray[np.float64] | None,
) -> FilteredDrive:
    n, places = forward.shape
    backwards = place_filter.moves.reversed()
    columns = np.empty((n, len(FilterMatch._fields)), dtype=np.int64)
    candidates = np.empty((n, CANDIDATES), dtype=np.int64)
    onward = np.zeros(places, dtype=np.int32)
    block = max(1, _BLOCK_DISTANCES // places)
    for last in range(n, 0, -block):
        first = max(last - block, 0)
        summed = np.empty((last - first, places), dtype=np.int32)
        for j in range(last - 1, first - 1, -1):
            np.add(forward[j], onward, out=summed[j - first])
            columns[j] = match_of(summed[j - first], place_filter.exclusion)
            onward = _before(windows[j], evidence[j] + onward, backwards)
        candidates[first:last] = nearest_places(summed.T)
        if metrics is not None:
            metrics[:, first:last] = summed.T
    columns[:, -1] = _mean_trust(columns, windows, place_filter.moves)
    return FilteredDrive(columns, candidates)


def _mean_trust(
    columns: npt.NDArray[np.int64], windows: list[_Window], moves: Moves
) -> npt.NDArray[np.int64]:
    """Return the mean trust of each window and its neighbours, 0 beyond where a match jumps."""
    place, margin = columns[:, 0].tolist(), columns[:, -1]
    total = np.concatenate([[0], np.cumsum(margin)])
    chain = np.zeros(len(place), dtype=np.int64)  # a chain of matches of which each follows
    for j in range(1, len(place)):
        follows = moves.following(place[j - 1], windows[j].travelled_mm)[place[j]]
        chain[j] = chain[j - 1] + (not follows)
    at = np.arange(len(place))
    first = np.maximum(at - NEIGHBOURS, np.searchsorted(chain, chain, side="left"))
    last = np.minimum(at + NEIGHBOURS, np.searchsorted(chain, chain, side="right") - 1)
    return np.asarray((total[last + 1] - total[first]) // (2 * NEIGHBOURS + 1))


def _before(window: _Window, price: Metrics, backwards: Moves) -> Metrics:
    """Return the price of going on from each place of the window before."""
    turned = np.ascontiguousarray(price[::-1])
    if window.travelled_mm is not None:
        found = backwards.by_distance(turned, window.travelled_mm)
    elif window.paused:
        found = backwards.while_paused(turned)
    else:
        found = backwards.by_steps(turned)
    return found[::-1]
