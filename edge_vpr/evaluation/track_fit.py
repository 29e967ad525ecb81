"""Checks whether two tracks are of the same route, and belong to their drives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.evaluation.tracks import Floats, Track, distances

#: number of points of the query's track that are compared, evenly spread along it
QUERY_POINTS = 200
#: largest number of points of the reference's track; else two for each tolerance
REFERENCE_POINTS = 2_000
#: A note is given if a log and its drive have less than this share of their time in common: loggers
#: usually start and stop within seconds of the camera. Chosen by judgement.
LEAST_COMMON = 0.8
#: Smallest differences for two notes, chosen by judgement: that swapped logs would fit better, and
#: that the lengths of two drives with the same log differ.
SWAPPED_BY = 0.05


class Overlap(NamedTuple):
    """Overlap of two tracks.

    Attributes
    ----------
    share : float
        Of the query's track, by its length, how much lies within the tolerance of the reference's.
    nearest_m : float
        Least distance between the two.
    """

    share: float
    nearest_m: float


def overlap(reference: Track, query: Track, tolerance_m: float) -> Overlap:
    """Compare the paths of two tracks, without their times.

    Parameters
    ----------
    reference, query : Track
        Of one kind and dimension.
    tolerance_m : float
    """
    places, spacing_m = _spread(reference, REFERENCE_POINTS, tolerance_m / 2)
    queries, _ = _spread(query, QUERY_POINTS, 0.0)
    nearest = distances(reference.kind, places, queries[:, None]).min(axis=1)
    return Overlap(float((nearest <= tolerance_m + spacing_m / 2).mean()), float(nearest.min()))


def notes(
    reference: Track,
    query: Track,
    reference_us: npt.NDArray[np.float64],
    query_us: npt.NDArray[np.float64],
) -> tuple[str, ...]:
    """Return notes on logs that probably do not belong to these drives.

    Parameters
    ----------
    reference, query : Track
    reference_us, query_us : ndarray of float64
        Times of the windows' centres.

    Returns
    -------
    tuple of str
        Empty where nothing is.
    """
    given = (_common(reference, reference_us), _common(query, query_us))
    swapped = (_common(query, reference_us), _common(reference, query_us))
    found = []
    ends = (float(reference_us.max()), float(query_us.max()))
    if _same(reference, query) and min(ends) < (1 - SWAPPED_BY) * max(ends):
        found.append("both logs are the same, of drives that are not as long: give one of each")
    if sum(swapped) > sum(given) + 2 * SWAPPED_BY:
        found.append(
            "the two logs fit the drives better the other way round: the reference's comes first"
        )
    for name, track, times, common in zip(
        ("reference", "query"), (reference, query), (reference_us, query_us), given, strict=True
    ):
        if common < LEAST_COMMON:
            found.append(
                f"the {name} log covers {track.time_us[0] / 1e6:.0f} to "
                f"{track.time_us[-1] / 1e6:.0f} s and its drive lasts until "
                f"{times.max() / 1e6:.0f} s: is it the log of this drive, and its clock right "
                "(--offset)?"
            )
        total = sum(track.dropped.values())
        if total * 10 > track.entries:
            found.append(f"of the {name} log {track.describe_dropped()}")
    return tuple(found)


def _same(reference: Track, query: Track) -> bool:
    """Return whether two tracks have the same points, whatever their clocks' offsets."""
    return np.array_equal(reference.position, query.position) and np.array_equal(
        np.diff(reference.time_us), np.diff(query.time_us)
    )


def _common(track: Track, times_us: npt.NDArray[np.float64]) -> float:
    """Return the common time of track and windows, divided by the time that they span together."""
    first, last = float(track.time_us[0]), float(track.time_us[-1])
    start, end = float(times_us.min()), float(times_us.max())
    whole = max(last, end) - min(first, start)
    return max(0.0, min(last, end) - max(first, start)) / whole if whole > 0 else 1.0


def _spread(track: Track, most: int, least_m: float) -> tuple[Floats, float]:
    """Return points evenly spread along a track, without those in gaps, and their spacing."""
    points = track.position
    steps = distances(track.kind, points[1:], points[:-1])
    if track.max_gap_us is not None:
        steps = np.where(np.diff(track.time_us) > track.max_gap_us, 0.0, steps)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    if not way[-1] > 0:
        return points[:1], 0.0
    n = most if least_m * most <= way[-1] else math.ceil(way[-1] / least_m) + 1
    at = np.linspace(0.0, way[-1], n)
    rising = np.flatnonzero(np.diff(way, prepend=-1.0) > 0)
    if track.kind == "geographic":
        points = np.column_stack([points[:, 0], np.unwrap(points[:, 1], period=360.0)])
    found = [np.interp(at, way[rising], column[rising]) for column in points.T]
    return np.column_stack(found), float(way[-1] / (n - 1))
