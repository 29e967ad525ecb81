"""Ground truth from pairs of moments at which two recordings show the same place."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

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
from edge_vpr.evaluation.track_files import read_table
from edge_vpr.evaluation.tracks import Floats, interpolate


class Alignment(NamedTuple):
    """Pairs of moments at which two recordings show the same place.

    Attributes
    ----------
    pairs : ndarray of float64, shape (n, 2)
        Coordinate in the query, coordinate in the reference; the first strictly increasing.
    unit : {"frame", "s"}
    """

    pairs: Floats
    unit: Literal["frame", "s"]

    def coordinate(self, times_us: npt.ArrayLike, frame_period_us: float | None = None) -> Floats:
        """Convert times in microseconds to coordinates of this alignment.

        Parameters
        ----------
        times_us : array_like, shape (m,)
        frame_period_us : float, optional
            Needed where the unit is frames: frame i begins at ``i * frame_period_us``.

        Returns
        -------
        ndarray of float64, shape (m,)

        Raises
        ------
        GroundTruthError
            If the frame period is needed and missing.
        """
        times = np.asarray(times_us, dtype=np.float64)
        if self.unit == "s":
            return times / 1e6
        if frame_period_us is None or not frame_period_us > 0:
            raise GroundTruthError(
                f"the alignment is in frames and the frame period is {frame_period_us}: "
                "state it in microseconds, greater than 0"
            )
        return times / frame_period_us


def load_alignment(path: str | Path) -> Alignment:
    """Read an alignment from a CSV file, its orientation and unit from the header.

    Parameters
    ----------
    path : str or Path
        The columns are ``query_frame`` and ``reference_frame``, or ``query_s`` and ``reference_s``
        (``query_time_s`` likewise), in either order.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, or the header does not say which column is which.
    """
    header, table = read_table(path)
    units: dict[str, Literal["frame", "s"]] = {
        "frame": "frame", "frames": "frame", "s": "s", "time_s": "s"
    }  # fmt: skip
    columns: dict[str, int] = {}
    found: set[Literal["frame", "s"]] = set()
    for number, name in enumerate(header):
        side, _, unit = name.partition("_")
        if side in ("query", "reference") and unit in units:
            columns[side] = number
            found.add(units[unit])
    if len(header) != 2 or len(columns) != 2 or len(found) != 1:
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected query_frame,reference_frame "
            "or query_s,reference_s, in either order"
        )
    pairs = table[:, [columns["query"], columns["reference"]]]
    try:
        _check_pairs(pairs)
    except GroundTruthError as error:
        raise GroundTruthError(f"{path}: {error}") from None
    return Alignment(pairs, found.pop())


def from_alignment(
    pairs: npt.ArrayLike,
    query_coordinate: npt.ArrayLike,
    reference_coordinate: npt.ArrayLike,
    tolerance: float,
    unit: str = "",
) -> GroundTruth:
    """Return the truth: places within `tolerance` of the aligned coordinate, linear between points.

    Parameters
    ----------
    pairs : array_like, shape (n, 2)
        Coordinate in the query, coordinate in the reference; the first strictly increasing.
    query_coordinate : array_like, shape (Q,)
    reference_coordinate : array_like, shape (K,)
        Of the windows' centres, in the unit of `pairs` (see `Alignment.coordinate`).
    tolerance : float
        In the same unit, inclusive.
    unit : str, optional
        For the description.

    Returns
    -------
    GroundTruth
        A query is known between the first and the last of the points.

    Raises
    ------
    GroundTruthError
        If the points do not increase, or no query lies between them.
    """
    check_tolerance(tolerance)
    points = np.asarray(pairs, dtype=np.float64)
    _check_pairs(points)
    queries = window_coordinates(query_coordinate, "query")
    places = window_coordinates(reference_coordinate, "reference")
    expected = interpolate(queries, points[:, 0], points[:, 1:])[:, 0]
    known = ~np.isnan(expected)
    if not known.any():
        raise GroundTruthError(
            f"the alignment covers query {points[0, 0]:g} to {points[-1, 0]:g} and the queries lie "
            f"at {queries.min():g} to {queries.max():g}: check the unit and the frame period"
        )
    correct = within(places, expected, lambda a, b: np.abs(a - b), tolerance)
    truth = described_truth(
        correct, known, f"alignment of {len(points)} points at {tolerance:g} {unit}".rstrip()
    )
    if not truth.has_place.any():
        raise GroundTruthError(
            f"no place lies within {tolerance:g} of an aligned query (places at {places.min():g} "
            f"to {places.max():g}, expected at {np.nanmin(expected):g} to "
            f"{np.nanmax(expected):g}): check the columns, the unit and the tolerance"
        )
    return truth


def _check_pairs(pairs: Floats) -> None:
    if pairs.ndim != 2 or pairs.shape[1:] != (2,) or len(pairs) < 2:
        raise GroundTruthError(
            f"alignment has shape {pairs.shape}: give (n, 2), query and reference, n at least 2"
        )
    if not np.isfinite(pairs).all():
        raise GroundTruthError("alignment holds a value that is not finite: leave that point out")
    back = np.flatnonzero(np.diff(pairs[:, 0]) <= 0)
    if back.size:
        i = int(back[0])
        raise GroundTruthError(
            f"alignment point {i + 1} is at query {pairs[i + 1, 0]:g} after {pairs[i, 0]:g}: "
            "sort the points and keep one a query coordinate"
        )
