"""Ground truth from the tracks of two drives."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.ground_truth import (
    GroundTruth,
    check_tolerance,
    described_truth,
    window_coordinates,
    within,
)
from edge_vpr.evaluation.track_fit import notes, overlap
from edge_vpr.evaluation.tracks import Floats, Track, distances


def from_tracks(
    reference: Track,
    query: Track,
    reference_times_us: npt.ArrayLike,
    query_times_us: npt.ArrayLike,
    tolerance_m: float,
) -> GroundTruth:
    """Return the truth: places within `tolerance_m` of the query, by great circle or straight line.

    Parameters
    ----------
    reference, query : Track
        Of one kind and dimension.
    reference_times_us : array_like, shape (K,)
    query_times_us : array_like, shape (Q,)
        Times of the windows' centres, in microseconds from each recording's start.
    tolerance_m : float
        In metres, inclusive.

    Returns
    -------
    GroundTruth
        A query is known where its track covers it. A place without a position is never right.

    Raises
    ------
    GroundTruthError
        If the tracks cannot be compared, do not cover the windows, or never meet.
    """
    check_tolerance(tolerance_m)
    if reference.kind != query.kind or reference.position.shape[1] != query.position.shape[1]:
        raise GroundTruthError(
            f"the reference track is {_form(reference)} and the query track is {_form(query)}: "
            "give two tracks of one kind"
        )
    places = _positions(reference, reference_times_us, "reference")
    queries = _positions(query, query_times_us, "query")
    correct = within(places, queries, partial(distances, reference.kind), tolerance_m)
    known = ~np.isnan(queries[:, 0])
    placed = int((~np.isnan(places[:, 0])).sum())
    ways = overlap(reference, query, tolerance_m)
    doubts = notes(
        reference, query, window_coordinates(reference_times_us, "reference"),
        window_coordinates(query_times_us, "query"),
    )  # fmt: skip
    truth = described_truth(
        correct,
        known,
        f"{reference.kind} tracks at {tolerance_m:g} m, "
        f"{placed} of {len(places)} places with a position, "
        f"{100 * ways.share:.0f} % of the query's track along the reference's",
        doubts,
    )
    if not truth.has_place.any():
        if ways.share == 0:
            reason = (
                f"the two tracks come no nearer than {ways.nearest_m:,.0f} m: check that both are "
                "of this route, and the tolerance"
            )
        else:
            reason = (
                f"{100 * ways.share:.0f} % of the query's track runs along the reference's, at "
                "other times: check their clocks (--offset) and their order"
            )
        raise GroundTruthError(
            "; ".join([f"no query lies within {tolerance_m:g} m of any place: {reason}", *doubts])
        )
    return truth


def _positions(track: Track, times_us: npt.ArrayLike, which: str) -> Floats:
    times = window_coordinates(times_us, which)
    positions = track.at(times)
    if np.isnan(positions[:, 0]).all():
        raise GroundTruthError(
            f"the {which} track covers {track.time_us[0] / 1e6:g} to {track.time_us[-1] / 1e6:g} s "
            f"in {track.time_us.size} points and no window of {times.min() / 1e6:g} to "
            f"{times.max() / 1e6:g} s: check its clock, and allow longer gaps if the points are few"
        )
    return positions


def _form(track: Track) -> str:
    return f"{track.kind} with {track.position.shape[1]} coordinates"
