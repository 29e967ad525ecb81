"""Ratio and margin of the best and the second-best place, from sums of distances."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Sums = npt.NDArray[np.int64]


def ratio_to_second(best: Sums, second: Sums) -> npt.NDArray[np.float64]:
    """Return the best divided by the second-best distance, from 0 (sure) to 1 (unsure).

    Parameters
    ----------
    best, second : ndarray of int64, shape (n,)
        Sums of distances; -1 where there is no second.

    Returns
    -------
    ndarray of float64, shape (n,)
        1 where both are zero, NaN where there is no second.
    """
    ratio = np.full(best.shape, np.nan)
    np.divide(best, second, out=ratio, where=second > 0)
    ratio[second == 0] = 1.0
    return ratio


def margin_to_second(best: Sums, second: Sums) -> Sums:
    """Return the second-best less the best sum of distances; 0 if there is no second (-1)."""
    return np.where(second < 0, 0, second - best)
