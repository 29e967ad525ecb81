"""Ground truth: which places are right for which query."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.tracks import Floats

#: Number of distances that are computed at a time: a few arrays of 8 MB.
BLOCK_CELLS = 1 << 20


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


def described_truth(
    correct: npt.NDArray[np.bool_],
    known: npt.NDArray[np.bool_],
    source: str,
    doubts: tuple[str, ...] = (),
) -> GroundTruth:
    """Return a ground truth with a description that contains the number of known queries.

    Parameters
    ----------
    correct : ndarray of bool, shape (K, Q)
    known : ndarray of bool, shape (Q,)
    source : str
        Where it is from, and the tolerance.
    doubts : tuple of str, optional
    """
    with_place = int(correct.any(axis=0).sum())
    return GroundTruth(
        correct,
        known,
        f"{source}; {int(known.sum())} of {known.size} queries known, {with_place} with a place",
        doubts,
    )


def window_coordinates(values: npt.ArrayLike, which: str) -> Floats:
    """Return coordinates of windows as float64, shape (n,), n of at least 1.

    Raises
    ------
    GroundTruthError
        If they are of another shape; `which` names the drive.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise GroundTruthError(
            f"{which} windows have coordinates of shape {array.shape}: give one a window, "
            "at least one"
        )
    return array


def within(
    places: Floats, queries: Floats, distance: Callable[[Floats, Floats], Floats], tolerance: float
) -> npt.NDArray[np.bool_]:
    """Return which places are near which queries, shape (K, Q); never where a distance is NaN."""
    near = np.empty((len(places), len(queries)), dtype=np.bool_)
    step = max(1, BLOCK_CELLS // len(queries))
    for first in range(0, len(places), step):
        block = places[first : first + step, None]
        near[first : first + step] = distance(block, queries[None]) <= tolerance
    return near


def check_tolerance(tolerance: float) -> None:
    """Check that the tolerance is a finite number of 0 or more."""
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise GroundTruthError(f"tolerance {tolerance} is not a distance: give 0 or more")
