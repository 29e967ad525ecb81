"""Ground truth: which places are correct for which query, from tracks, a matrix or an alignment."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, read_members, read_npy
from edge_vpr.errors import GroundTruthError, expect, printable
from edge_vpr.evaluation.tables import read_table
from edge_vpr.evaluation.tracks import Floats, Track, distances, interpolate, positions_at
from edge_vpr.files import open_input
from edge_vpr.recordings import parse_period
from edge_vpr.route import Kind

#: Number of distances that are computed at a time: a few arrays of 8 MB.
BLOCK_CELLS = 1 << 20
#: a larger truth is refused: 2 GiB
MOST_CELLS = 2 << 30


#: a truth that a larger share of all pairs of place and query passes is refused
MOST_CHANCE = 0.5


@dataclass(frozen=True, eq=False)
class Whereabouts:
    """Where each place may be: not further from two points of the log than the drive could come.

    In a gap of its log, the reference drive can have been wherever it could come to from the point
    before and still reach the point after, at the highest speed of the rest of the log.
    """

    kind: Kind
    point: Floats  #: Shape (K, 2, d): points of the log before and after each place.
    reach_m: Floats  #: Shape (K, 2): infinite where the log has no such point.

    @classmethod
    def of(cls, reference: Track, places_us: Floats) -> Whereabouts:
        """Return where the places at some times, shape (K,), may be."""
        time_s, n = reference.time_us / 1e6, reference.time_us.size
        steps = distances(reference.kind, reference.position[1:], reference.position[:-1])
        speed = float(np.quantile(steps / np.diff(time_s), 0.95)) if n > 1 else 0.0
        at_s = places_us / 1e6
        after = np.searchsorted(time_s, at_s)
        beside = np.stack([after - 1, after], axis=1)
        some = np.clip(beside, 0, n - 1)
        reach = speed * np.abs(time_s[some] - at_s[:, None])
        return cls(
            reference.kind, reference.position[some], np.where(some == beside, reach, np.inf)
        )

    def may_be_within(
        self, place: npt.NDArray[np.integer] | np.intp, positions: Floats, tolerance_m: float
    ) -> npt.NDArray[np.bool_]:
        """Return whether places, shape (n,) or (), may be within a tolerance of positions."""
        near = np.ones(len(positions), dtype=np.bool_)
        for side in (0, 1):
            off = distances(self.kind, self.point[place, side], positions)
            near &= off <= tolerance_m + self.reach_m[place, side]
        return near


@dataclass(frozen=True, eq=False)
class TruePositions:
    """Positions of the places, and the true position of each query."""

    place: Floats  #: Shape (K, d): NaN where it is not known.
    query: Floats  #: Shape (Q, d): in the same coordinates; NaN where it is not known.
    #: {"metric", "geographic"}: latitude and longitude in degrees, or coordinates in `unit`.
    kind: Kind
    unit: str  #: Of distances between positions: metres ("m"), or the unit of an alignment.
    tolerance: float  #: Largest error of a correct match, in this unit.
    #: Where the places without a position may be; by default anywhere.
    whereabouts: Whereabouts | None = None

    def are_like(self, kind: Kind, position: Floats) -> bool:
        """Return whether positions (K, d) of this kind are in the same coordinates, in metres."""
        form = (self.kind, self.query.shape[1])
        return self.unit == "m" and form == (kind, position.shape[1])


@dataclass(frozen=True, eq=False)
class GroundTruth(EqualByValue):
    """The correct places of each query.

    >>> GroundTruth(np.eye(3, dtype=np.bool_), np.ones(3, dtype=np.bool_), "by hand")
    GroundTruth(3 of 3 queries known, 3 places)

    Attributes
    ----------
    correct : ndarray of bool, shape (K, Q)
        ``correct[k, j]``: place k is correct for query j. Oriented as the distance matrix.
    has_truth : ndarray of bool, shape (Q,)
        Whether the truth of this query is known: its position is, and no place of unknown position
        can be correct for it. Only these queries are evaluated.
    description : str
        Source, tolerance and coverage, for reports.
    positions : TruePositions or None
        None of a matrix.
    placed : ndarray of bool, shape (K,)
        Whether the position of this place is known; by default all are. See `judged` for matches
        with the others.
    tracks : tuple of two Track, or None
        Of the reference and of the query, where it is of these.
    """

    correct: npt.NDArray[np.bool_]
    has_truth: npt.NDArray[np.bool_]
    description: str
    positions: TruePositions | None = None
    placed: npt.NDArray[np.bool_] | None = None
    tracks: tuple[Track, Track] | None = None

    def __repr__(self) -> str:
        places, queries = self.correct.shape
        number = int(np.count_nonzero(self.has_truth))
        return f"GroundTruth({number} of {queries} queries known, {places} places)"

    def __post_init__(self) -> None:
        correct, has_truth = np.asarray(self.correct), np.asarray(self.has_truth)
        if correct.dtype != np.bool_ or has_truth.dtype != np.bool_ or correct.ndim != 2:
            raise GroundTruthError(
                f"ground truth is {correct.dtype} {correct.shape} with has_truth "
                f"{has_truth.dtype}: give bool arrays (K, Q) and (Q,), or call edge_vpr.from_matrix"
            )
        if has_truth.shape != correct.shape[1:]:
            raise GroundTruthError(
                f"ground truth of {correct.shape[1]} queries comes with has_truth of shape "
                f"{has_truth.shape}: give one value per query"
            )
        if (correct.any(axis=0) & ~has_truth).any():
            raise GroundTruthError(
                "a query of unknown truth has a correct place: clear its column, or mark it known"
            )
        if self.placed is None:
            object.__setattr__(self, "placed", np.ones(correct.shape[0], dtype=np.bool_))
        elif self.placed.dtype != np.bool_ or self.placed.shape != correct.shape[:1]:
            raise GroundTruthError(
                f"ground truth of {correct.shape[0]} places has placed of shape "
                f"{self.placed.shape}: give one bool per place"
            )

    def judged(
        self, place: npt.NDArray[np.integer], query: npt.NDArray[np.integer]
    ) -> npt.NDArray[np.bool_]:
        """Return whether matches of places with queries can be judged, shape (...).

        A match with a place of unknown position is wrong if the place cannot be within the
        tolerance of the query.
        """
        assert self.placed is not None
        place, query = np.broadcast_arrays(place, query)
        judged = np.asarray(self.has_truth[query] & self.placed[place])
        at = self.positions
        if at is not None and at.whereabouts is not None:
            unplaced = self.has_truth[query] & ~judged
            judged[unplaced] = ~at.whereabouts.may_be_within(
                place[unplaced], at.query[query[unplaced]], at.tolerance
            )
        return judged

    @property
    def chance(self) -> float:
        """Share of correct cells among all that can be judged: the accuracy of guessing."""
        assert self.placed is not None
        cells = int(self.has_truth.sum()) * int(self.placed.sum())
        return int(self.correct.sum()) / max(cells, 1)

    @property
    def has_place(self) -> npt.NDArray[np.bool_]:
        """Whether the map holds a correct place for each query, shape (Q,)."""
        return np.asarray(self.correct.any(axis=0))

    @property
    def error_unit(self) -> str:
        """Unit of `errors`."""
        return "places" if self.positions is None else self.positions.unit

    @property
    def tolerance_text(self) -> str:
        """Tolerance with its unit, such as ``70 m``; empty without positions."""
        return "" if self.positions is None else f"{self.positions.tolerance:g} {self.error_unit}"

    def errors(self, place: npt.NDArray[np.integer], query: npt.NDArray[np.integer]) -> Floats:
        """Return how far each matched place is from the true position of its query.

        Parameters
        ----------
        place, query : ndarray of int, shape (n,)
            Indices of the matched places and of their queries.

        Returns
        -------
        ndarray of float64, shape (n,)
            In `error_unit`; without positions, the number of places to the nearest correct one. NaN
            where it is not known.
        """
        if self.positions is not None:
            at = self.positions
            return distances(at.kind, at.place[place], at.query[query])
        away = np.full(len(place), np.nan)
        for i, (k, j) in enumerate(zip(place, query, strict=True)):
            correct = np.flatnonzero(self.correct[:, j])
            if correct.size:
                away[i] = np.abs(correct - k).min()
        return away


def _described_truth(
    correct: npt.NDArray[np.bool_],
    judged: npt.NDArray[np.bool_],
    source: str,
    positions: TruePositions | None = None,
    placed: npt.NDArray[np.bool_] | None = None,
    tracks: tuple[Track, Track] | None = None,
) -> GroundTruth:
    """Return a ground truth with its source, and the number of known queries, as description.

    Raises
    ------
    GroundTruthError
        If more than half of all pairs of place and query pass it.
    """
    with_place = int(correct.any(axis=0).sum())
    description = (
        f"{source}; {int(judged.sum())} of {judged.size} windows known, {with_place} with a place"
    )
    truth = GroundTruth(correct, judged, description, positions, placed, tracks)
    if truth.chance > MOST_CHANCE:
        raise GroundTruthError(
            f"{truth.chance:.0%} of all pairs of place and query count as the same place, so that "
            "most matches are correct whatever they say: give a smaller tolerance, positions in "
            "the unit that is stated, and logs of receivers that moved"
        )
    return truth


def _window_times(values: npt.ArrayLike, which: str) -> Floats:
    """Return times of windows as float64, shape (n,), n of at least 1."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise GroundTruthError(
            f"{which} windows have times of shape {array.shape}: give one a window, at least one"
        )
    return array


def within(
    places: Floats, queries: Floats, distance: Callable[[Floats, Floats], Floats], tolerance: float
) -> npt.NDArray[np.bool_]:
    """Return which places are near which queries, shape (K, Q); never where a distance is NaN."""
    if len(places) * len(queries) > MOST_CELLS:
        raise GroundTruthError(
            f"the truth of {len(queries):,} queries and {len(places):,} places takes "
            f"{len(places) * len(queries) / 1e9:.1f} GB: match a part of the drive (end=)"
        )
    near = np.empty((len(places), len(queries)), dtype=np.bool_)
    step = max(1, BLOCK_CELLS // len(queries))
    for first in range(0, len(places), step):
        away = distance(places[first : first + step, None], queries[None])
        near[first : first + step] = away <= tolerance
    return near


def _check_tolerance(tolerance: float) -> None:
    """Check that the tolerance is a finite number of 0 or more."""
    expect(tolerance, (int, float, np.number), "tolerance", "a number such as 70")
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise GroundTruthError(f"tolerance {tolerance} is not a distance: give 0 or more")


# Ground truth from the tracks of two drives.


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
    reference_times_us, query_times_us : array_like, shapes (K,) and (Q,)
        Times of the windows' centres, in microseconds from each recording's start.
    tolerance_m : float
        In metres, inclusive.

    Returns
    -------
    GroundTruth
        A query is known where its track covers it, unless its only correct places may be ones
        without a position. A match with such a place is judged, as wrong, if the place cannot be
        within the tolerance.

    Raises
    ------
    GroundTruthError
        If the tracks cannot be compared, have no time in common with their windows or no place in
        common with each other, or if more than half of all pairs are within the tolerance.
    """
    for name, track in (("reference", reference), ("query", query)):
        expect(track, Track, f"track of the {name}", "a Track, as of load_track")
    _check_tolerance(tolerance_m)
    if reference.kind != query.kind or reference.position.shape[1] != query.position.shape[1]:
        raise GroundTruthError(
            f"the reference track is {_form(reference)} and the query track is {_form(query)}: "
            "give two tracks of one kind"
        )
    reference_us = _window_times(reference_times_us, "reference")
    places = positions_at(reference, reference_us, "reference track")
    queries = positions_at(query, _window_times(query_times_us, "query"), "query track")
    judged, placed = (np.isfinite(positions[:, 0]) for positions in (queries, places))
    correct = within(places, queries, partial(distances, reference.kind), tolerance_m)
    whereabouts, alone = None, np.flatnonzero(judged & ~correct.any(axis=0))
    if not placed.all():
        whereabouts = Whereabouts.of(reference, reference_us)
        for place in np.flatnonzero(~placed) if alone.size else ():
            judged[alone] &= ~whereabouts.may_be_within(place, queries[alone], tolerance_m)
    positions = TruePositions(places, queries, reference.kind, "m", tolerance_m, whereabouts)
    if not correct.any(axis=0).any():
        raise GroundTruthError(
            f"no query lies within {tolerance_m:g} m of any place, the nearest "
            f"{nearest(positions).min():,.0f} m away: check that both logs are of this route, "
            "their order (the reference's comes first), their clocks (Track.shifted) and the "
            "tolerance"
        )
    return _described_truth(
        correct,
        judged,
        f"{reference.kind} tracks at {tolerance_m:g} m, "
        f"{int(placed.sum())} of {len(places)} places with a position",
        positions,
        placed,
        (reference, query),
    )


#: most distances that `nearest` computes
_MOST_NEAREST = 1 << 24


def nearest(positions: TruePositions) -> Floats:
    """Return how far n windows with a position are from the nearest place, in its unit.

    Of all such windows, or of evenly spread ones if the drives are long.
    """
    places, queries = (each[np.isfinite(each[:, 0])] for each in (positions.place, positions.query))
    queries = queries[:: 1 + len(places) * len(queries) // _MOST_NEAREST]
    step = max(1, BLOCK_CELLS // len(places))
    blocks = (queries[first : first + step] for first in range(0, len(queries), step))
    return np.concatenate(
        [distances(positions.kind, places, block[:, None]).min(axis=1) for block in blocks]
    )


def _form(track: Track) -> str:
    return f"{track.kind} with {track.position.shape[1]} coordinates"


# Ground truth from pairs of moments at which two recordings show the same place.


class Alignment(NamedTuple):
    """Pairs of moments, in the query and in the reference, at which both show the same place.

    >>> Alignment([[0, 0], [60, 55.5]], "s").unit
    's'
    """

    #: Shape (n, 2): moment in the query, moment in the reference; the first strictly increasing.
    pairs: npt.ArrayLike
    unit: Literal["frame", "s"]  #: Of both moments.

    def __repr__(self) -> str:
        return f"Alignment({len(np.asarray(self.pairs, dtype=object))} pairs, in {self.unit!r})"

    def coordinate(
        self, times_us: npt.ArrayLike, frame_period: Fraction | float | str | None = None
    ) -> Floats:
        """Convert times in microseconds to moments of this alignment.

        Parameters
        ----------
        times_us : array_like, shape (m,)
            From the recording's start.
        frame_period : Fraction or float or str, optional
            Seconds a frame, needed for frames: frame i begins at ``i * frame_period``.

        Returns
        -------
        ndarray of float64, shape (m,)
        """
        times = np.asarray(times_us, dtype=np.float64)
        if self.unit == "s":
            return times / 1e6
        if self.unit != "frame":
            raise GroundTruthError(f"alignment unit {self.unit!r} is unknown: use s or frame")
        if frame_period is None:
            raise GroundTruthError(
                "the alignment is in frames: pass frame_period=, for example frame_period='1/30'"
            )
        return times / float(parse_period(frame_period) * 1_000_000)


def load_alignment(path: str | Path) -> Alignment:
    """Read an alignment for `from_alignment` from a CSV file, orientation and unit from the header.

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
    stated: set[Literal["frame", "s"]] = set()
    for number, name in enumerate(header):
        side, _, unit = name.partition("_")
        if side in ("query", "reference") and unit in units:
            columns[side] = number
            stated.add(units[unit])
    if len(header) != 2 or len(columns) != 2 or len(stated) != 1:
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected query_frame,reference_frame "
            "or query_s,reference_s, in either order; of tracks give two, the reference's and then "
            "the query's, and of a matrix its rows="
        )
    pairs = table[:, [columns["query"], columns["reference"]]]
    try:
        _check_pairs(pairs)
    except GroundTruthError as error:
        raise GroundTruthError(f"{path}: {error}") from None
    return Alignment(pairs, stated.pop())


def from_alignment(
    alignment: Alignment,
    reference_times_us: npt.ArrayLike,
    query_times_us: npt.ArrayLike,
    tolerance: float,
    *,
    frame_period: Fraction | float | str | None = None,
) -> GroundTruth:
    """Return the truth: places within `tolerance` of the aligned moment, linear between pairs.

    Parameters
    ----------
    alignment : Alignment
        Of `load_alignment`, or ``Alignment(pairs, "s")`` of moments in query and reference.
    reference_times_us, query_times_us : array_like, shapes (K,) and (Q,)
        Times of the windows' centres, in microseconds from each recording's start.
    tolerance : float
        In the unit of the alignment, inclusive.
    frame_period : Fraction or float or str, optional
        Seconds a frame, for an alignment in frames.

    Returns
    -------
    GroundTruth
        A query is known between the first and the last of the pairs.

    Raises
    ------
    GroundTruthError
        If the pairs do not increase, or no query lies between them.

    Examples
    --------
    >>> pairs = Alignment([[0, 0], [60, 55]], "s")  # load_alignment("pairs.csv")
    >>> from_alignment(pairs, [500_000, 1_500_000], [400_000], tolerance=0.5).correct.tolist()
    [[True], [False]]

    Of matches, the times are those of the map and of the result:

    >>> truth = from_alignment(
    ...     pairs, route.place_time_us, result.query_time_us, tolerance=2
    ... )  # doctest: +SKIP
    >>> result.evaluate(truth).precision_at_100_recall  # doctest: +SKIP
    """
    expect(
        alignment, Alignment, "alignment", "what load_alignment returned, or Alignment(pairs, 's')"
    )
    _check_tolerance(tolerance)
    points = np.asarray(alignment.pairs, dtype=np.float64)
    _check_pairs(points)
    period = None if frame_period is None else parse_period(frame_period)
    queries = alignment.coordinate(_window_times(query_times_us, "query"), period)
    places = alignment.coordinate(_window_times(reference_times_us, "reference"), period)
    expected = interpolate(queries, points[:, 0], points[:, 1:])[:, 0]
    covered = ~np.isnan(expected)
    if not covered.any():
        raise GroundTruthError(
            f"the alignment covers query {points[0, 0]:g} to {points[-1, 0]:g} and the queries lie "
            f"at {queries.min():g} to {queries.max():g}: check the unit and the frame period"
        )
    correct = within(places, expected, lambda a, b: np.abs(a - b), tolerance)
    unit = "frames" if alignment.unit == "frame" else "s"
    truth = _described_truth(
        correct,
        covered,
        f"alignment of {len(points)} points at {tolerance:g} {unit}",
        TruePositions(places[:, None], expected[:, None], "metric", unit, tolerance),
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
    values, number = np.unique(pairs[pairs[:, 1] < 0, 1], return_counts=True)
    if (number > 1).any():
        i = int(np.argmax(number))
        raise GroundTruthError(
            f"alignment has {number[i]} points at reference {values[i]:g}, before the drive: if "
            "this marks a query without a place, give a matrix of 0 and 1"
        )


# Ground truth from a matrix of 0 and 1.


def from_matrix(
    matrix: npt.ArrayLike, places: int, queries: int, *, rows: Literal["reference", "query"]
) -> GroundTruth:
    """Return the truth that a matrix of 0 and 1 gives.

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
    """
    if rows not in ("reference", "query"):
        raise GroundTruthError(f"rows={rows!r} is unknown: pass rows='reference' or rows='query'")
    array = np.asarray(matrix)
    expected = (places, queries) if rows == "reference" else (queries, places)
    if array.shape != expected:
        other = "query" if rows == "reference" else "reference"
        if array.shape == expected[::-1]:
            remedy = f"pass rows={other!r}"
        elif sorted(array.shape) == sorted([(places + 1) // 2, queries]):
            remedy = "the map has places at half windows; make the map with places_per_window=1"
        else:
            remedy = "use the windows that it was made for"
        raise GroundTruthError(
            f"ground-truth matrix has shape {array.shape}, expected {expected} for "
            f"rows={rows!r}: {remedy}"
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
            "ground-truth matrix is all zero, so that no match could be correct: "
            "check that it was filled before it was saved"
        )
    correct = np.ascontiguousarray(correct if rows == "reference" else correct.T)
    return _described_truth(correct, np.ones(queries, dtype=np.bool_), f"0/1 matrix, rows={rows}")


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
            with open_input(path) as file, warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a file without numbers is refused below
                matrix = np.loadtxt(file, delimiter=",", ndmin=2)
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
