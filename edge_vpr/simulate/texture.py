"""Value noise: random values on a lattice, smoothly joined."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def _lattice(at: Floats, cell: float) -> tuple[npt.NDArray[np.int64], Floats]:
    scaled = at / cell
    low = np.floor(scaled).astype(np.int64)
    share = scaled - low
    return low, share * share * (3 - 2 * share)


def noise_1d(rng: np.random.Generator, at: Floats, cell: float) -> Floats:
    """Smooth noise over a line.

    Parameters
    ----------
    rng : numpy.random.Generator
    at : ndarray of float64, shape (n,)
        Where, 0 or more.
    cell : float
        Distance of the lattice, in the unit of `at`.

    Returns
    -------
    ndarray of float64, shape (n,)
        From -1 to 1.
    """
    low, share = _lattice(at, cell)
    knots = rng.uniform(-1, 1, int(low.max(initial=0)) + 2)
    return knots[low] + share * (knots[low + 1] - knots[low])


def noise_2d(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[float, float]
) -> npt.NDArray[np.float32]:
    """Smooth noise over an image.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : tuple of int
        Rows and columns.
    cells : tuple of float
        Distance of the lattice in rows and in columns, at least 1 each.

    Returns
    -------
    ndarray of float32, shape `shape`
        From -1 to 1.
    """
    row, row_share = _lattice(np.arange(shape[0], dtype=np.float64), cells[0])
    column, column_share = _lattice(np.arange(shape[1], dtype=np.float64), cells[1])
    knots = rng.uniform(-1, 1, (int(row[-1]) + 2, int(column[-1]) + 2)).astype(np.float32)
    across = knots[:, column] + column_share.astype(np.float32) * (
        knots[:, column + 1] - knots[:, column]
    )
    return across[row] + row_share.astype(np.float32)[:, None] * (across[row + 1] - across[row])
