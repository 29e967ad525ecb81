"""Ground truth from a matrix of 0 and 1."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import read_members, read_npy
from edge_vpr.errors import GroundTruthError, printable
from edge_vpr.evaluation.ground_truth import GroundTruth, described_truth


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
    return described_truth(correct, np.ones(queries, dtype=np.bool_), f"0/1 matrix, rows={rows}")


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
                warnings.simplefilter("ignore")  # a file without numbers is refused below
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
