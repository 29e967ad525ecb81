"""Which places are right for which query: from tracks, from an alignment, or from a 0/1 matrix."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_members, read_npy
from edge_vpr.errors import GroundTruthError, printable
from edge_vpr.evaluation.track_files import load_nmea, load_track, read_table
from edge_vpr.evaluation.track_fit import notes, overlap
from edge_vpr.evaluation.tracks import Floats, Track, distances, great_circle, interpolate

__all__ = [
    "Alignment",
    "GroundTruth",
    "Track",
    "from_alignment",
    "from_matrix",
    "from_tracks",
    "great_circle",
    "load_alignment",
    "load_matrix",
    "load_nmea",
    "load_track",
]

# Distances are worked out for as many places at a time as make this many cells: a few 8 MB arrays.
_BLOCK_CELLS = 1 << 20


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The right places of each query.

    Attributes
    ----------
    correct : ndarray of bool, shape (K, Q)
        ``correct[k, j]``: place k is right for query j. Oriented as the distance matrix.
    known : ndarray of bool, shape (Q,)
        Whether the truth of this query is known; only these queries can be evaluated.
    description : str
        Source, tolerance and coverage, for reports.
    notes : tuple of str
        What makes it doubtful that this is the truth of these drives.

    Raises
    ------
    GroundTruthError
        If the shapes do not fit, or a query of unknown truth has a right place.
    """

    correct: npt.NDArray[np.bool_]
    known: npt.NDArray[np.bool_]
    description: str
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        places, queries = self.correct.shape
        known = int(np.count_nonzero(self.known))
        return f"GroundTruth({known} of {queries} queries known, {places} places)"

    def __post_init__(self) -> None:
        correct, known = np.asarray(self.correct), np.asarray(self.known)
        if correct.dtype != np.bool_ or known.dtype != np.bool_ or correct.ndim != 2:
            raise GroundTruthError(
                f"ground truth is {correct.dtype} {correct.shape} with known {known.dtype}: "
                "give bool arrays (K, Q) and (Q,), or call edge_vpr.from_matrix"
            )
        if known.shape != correct.shape[1:]:
            raise GroundTruthError(
                f"ground truth of {correct.shape[1]} queries has known of shape {known.shape}: "
                "give one value a query"
            )
        if correct[:, ~known].any():
            raise GroundTruthError(
                "a query of unknown truth has a right place: clear its column, or mark it known"
            )

    @property
    def has_place(self) -> npt.NDArray[np.bool_]:
        """Whether the map holds a right place for each query, shape (Q,)."""
        return np.asarray(self.correct.any(axis=0))


def from_tracks(
    reference: Track,
    query: Track,
    reference_times_us: npt.ArrayLike,
    query_times_us: npt.ArrayLike,
    tolerance_m: float,
) -> GroundTruth:
    """Right is what lies within `tolerance_m` of the query, great circle or straight line.

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
    _check_tolerance(tolerance_m)
    if reference.kind != query.kind or reference.position.shape[1] != query.position.shape[1]:
        raise GroundTruthError(
            f"the reference track is {_form(reference)} and the query track is {_form(query)}: "
            "give two tracks of one kind"
        )
    places = _positions(reference, reference_times_us, "reference")
    queries = _positions(query, query_times_us, "query")
    correct = np.empty((len(places), len(queries)), dtype=np.bool_)
    step = max(1, _BLOCK_CELLS // len(queries))
    for first in range(0, len(places), step):
        block = places[first : first + step, None, :]
        distance = distances(reference.kind, block, queries[None, :, :])
        # not a number: an unknown position, never within the tolerance
        correct[first : first + step] = distance <= tolerance_m
    known = ~np.isnan(queries[:, 0])
    placed = int((~np.isnan(places[:, 0])).sum())
    ways = overlap(reference, query, tolerance_m)
    doubts = notes(
        reference, query, _coordinates(reference_times_us, "reference"),
        _coordinates(query_times_us, "query"),
    )  # fmt: skip
    truth = _described(
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


class Alignment(NamedTuple):
    """Points at which two recordings show the same place.

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
        The columns are ``query_frame`` and ``reference_frame``, or ``query_s`` and
        ``reference_s`` (``query_time_s`` likewise), in either order.

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
    """Right is what lies within `tolerance` of the aligned coordinate, linear between the points.

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
    _check_tolerance(tolerance)
    points = np.asarray(pairs, dtype=np.float64)
    _check_pairs(points)
    queries = _coordinates(query_coordinate, "query")
    places = _coordinates(reference_coordinate, "reference")
    expected = interpolate(queries, points[:, 0], points[:, 1:])[:, 0]
    known = ~np.isnan(expected)
    if not known.any():
        raise GroundTruthError(
            f"the alignment covers query {points[0, 0]:g} to {points[-1, 0]:g} and the queries lie "
            f"at {queries.min():g} to {queries.max():g}: check the unit and the frame period"
        )
    correct = np.empty((places.size, queries.size), dtype=np.bool_)
    step = max(1, _BLOCK_CELLS // queries.size)
    for first in range(0, places.size, step):
        block = places[first : first + step, None]
        correct[first : first + step] = np.abs(block - expected) <= tolerance
    truth = _described(
        correct, known, f"alignment of {len(points)} points at {tolerance:g} {unit}".rstrip()
    )
    if not truth.has_place.any():
        raise GroundTruthError(
            f"no place lies within {tolerance:g} of an aligned query (places at {places.min():g} "
            f"to {places.max():g}, expected at {np.nanmin(expected):g} to "
            f"{np.nanmax(expected):g}): check the columns, the unit and the tolerance"
        )
    return truth


def from_matrix(
    matrix: npt.ArrayLike, places: int, queries: int, *, rows: Literal["reference", "query"]
) -> GroundTruth:
    """Right is what a 0/1 matrix says.

    Parameters
    ----------
    matrix : array_like
        Of 0 and 1, shape (K, Q) where `rows` is "reference" and (Q, K) where it is "query".
    places, queries : int
        K and Q.
    rows : {"reference", "query"}
        What a row stands for. Never guessed: a square matrix fits both ways.

    Returns
    -------
    GroundTruth
        All queries are known; one without any 1 has no place in the map.

    Raises
    ------
    GroundTruthError
        If the shape is another, a value is neither 0 nor 1, or all are 0.
    """
    if rows not in ("reference", "query"):
        raise GroundTruthError(f"rows={rows!r} is unknown: pass rows=reference or rows=query")
    array = np.asarray(matrix)
    expected = (places, queries) if rows == "reference" else (queries, places)
    if array.shape != expected:
        other = "query" if rows == "reference" else "reference"
        remedy = (
            f"pass rows={other}"
            if array.shape == expected[::-1]
            else "use the windows that it was made for"
        )
        raise GroundTruthError(
            f"ground-truth matrix has shape {array.shape}, expected {expected} for "
            f"rows={rows}: {remedy}"
        )
    wrong = ~np.isin(array, (0, 1))
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise GroundTruthError(
            f"ground-truth matrix holds {array[row, column]} at row {row}, column {column}: "
            "write 1 for the same place and 0 for another"
        )
    correct = array.astype(np.bool_)
    if not correct.any():
        raise GroundTruthError(
            "ground-truth matrix is all zero, so that no match could be right: "
            "check that it was filled before it was saved"
        )
    correct = np.ascontiguousarray(correct if rows == "reference" else correct.T)
    return _described(correct, np.ones(queries, dtype=np.bool_), f"0/1 matrix, rows={rows}")


def load_matrix(path: str | Path) -> npt.NDArray[np.generic]:
    """Read a matrix from ``.npz`` (its only array, or ``gt``), ``.npy`` or ``.csv`` without header.

    Raises
    ------
    GroundTruthError
        If the file cannot be read or holds no matrix of numbers.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".npz", ".npy", ".csv"):
        raise GroundTruthError(f"{path} is not a matrix: give a .npz, .npy or .csv file")
    matrix: npt.NDArray[Any] | None
    try:
        if suffix == ".csv":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of a file without numbers, refused below
                matrix = np.loadtxt(path, delimiter=",", ndmin=2)
        elif suffix == ".npy":
            matrix = read_npy(path)
        else:
            arrays = read_members(path)
            matrix = arrays.get("gt", next(iter(arrays.values())) if len(arrays) == 1 else None)
    except OSError as error:
        raise GroundTruthError(
            f"{path} cannot be read ({error.strerror or error}): check the path"
        ) from error
    except Exception as error:
        # zipfile, NumPy's header parser and loadtxt each have errors of their own for such files
        raise GroundTruthError(
            f"{path} is not a matrix of numbers ({printable(error, 200)}): save it again"
        ) from error
    if matrix is None:
        raise GroundTruthError(
            f"{path} holds the arrays {', '.join(arrays) or 'none'}: "
            "name the matrix gt, or save it alone"
        )
    if matrix.ndim != 2 or matrix.dtype.kind not in "biuf":
        raise GroundTruthError(
            f"{path} holds {matrix.dtype} of shape {matrix.shape}: save a matrix of 0 and 1"
        )
    return matrix


def _described(
    correct: npt.NDArray[np.bool_],
    known: npt.NDArray[np.bool_],
    source: str,
    doubts: tuple[str, ...] = (),
) -> GroundTruth:
    with_place = int(correct.any(axis=0).sum())
    return GroundTruth(
        correct,
        known,
        f"{source}; {int(known.sum())} of {known.size} queries known, {with_place} with a place",
        doubts,
    )


def _positions(track: Track, times_us: npt.ArrayLike, which: str) -> Floats:
    times = _coordinates(times_us, which)
    positions = track.at(times)
    if np.isnan(positions[:, 0]).all():
        raise GroundTruthError(
            f"the {which} track covers {track.time_us[0] / 1e6:g} to {track.time_us[-1] / 1e6:g} s "
            f"in {track.time_us.size} points and no window of {times.min() / 1e6:g} to "
            f"{times.max() / 1e6:g} s: check its clock, and allow longer gaps if the points are few"
        )
    return positions


def _coordinates(values: npt.ArrayLike, which: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise GroundTruthError(
            f"{which} windows have coordinates of shape {array.shape}: give one a window, "
            "at least one"
        )
    return array


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


def _check_tolerance(tolerance: float) -> None:
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise GroundTruthError(f"tolerance {tolerance} is not a distance: give 0 or more")


def _form(track: Track) -> str:
    return f"{track.kind} with {track.position.shape[1]} coordinates"
