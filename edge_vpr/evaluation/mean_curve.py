"""Curves of precision and recall of several trials, joined into one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from edge_vpr.evaluation.metrics import PrecisionRecall


def mean_precision(
    curves: Sequence[PrecisionRecall], recall: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the mean over trials of the precision at each recall.

    Parameters
    ----------
    curves : sequence of PrecisionRecall
        One of each trial.
    recall : ndarray of float64, shape (n,)
        From 0 to 1.

    Returns
    -------
    ndarray of float64, shape (n,)
        Precision at the strictest threshold that reaches the recall; a trial that never reaches it
        counts with 0.
    """
    rows = []
    for curve in curves:
        # recall never falls from one threshold to the next
        first = np.searchsorted(curve.recall, recall)
        rows.append(np.append(curve.precision, 0.0)[first])
    return np.asarray(np.mean(rows, axis=0))
