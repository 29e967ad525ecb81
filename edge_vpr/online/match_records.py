"""One match of the localiser as a record."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Judge
from edge_vpr.matching.runner_up import margin_to_second, ratio_to_second

#: One match: time in microseconds; best place (ties: the lowest) and the best one outside the
#: exclusion zone (-1: none); their distances, summed over the L windows of the sequence; best over
#: second; events at the selected pixels in the newest window, and its start; trust, higher is
#: surer (of the place filter as `place_filter.FilterMatch` has it, of sequences the margin);
#: probability of being right (NaN: not known), and whether the match is lost at the precision that
#: the settings want. The place filter has metrics in place of distances, and windows in place of
#: sequences.
MATCH_DTYPE = np.dtype(
    [
        ("t", "<i8"),
        ("place", "<i8"),
        ("distance_sum", "<i8"),
        ("second", "<i8"),
        ("second_sum", "<i8"),
        ("ratio", "<f8"),
        ("events", "<i8"),
        ("start", "<i8"),
        ("trust", "<i8"),
        ("probability", "<f8"),
        ("lost", "?"),
    ]
)


def judged_matches(rows: npt.NDArray[np.int64], judge: Judge) -> npt.NDArray[np.void]:
    """Name the columns of a kernel's rows, and add what follows from them.

    Parameters
    ----------
    rows : ndarray of int64, shape (n, 7) or (n, 8)
        The integers of MATCH_DTYPE, in its order; of the place filter with the trust.
    judge : Judge

    Returns
    -------
    ndarray of MATCH_DTYPE, shape (n,)
    """
    matches = np.empty(len(rows), dtype=MATCH_DTYPE)
    derived = ("ratio", "trust", "probability", "lost")
    names = [name for name in MATCH_DTYPE.names or () if name not in derived]
    if rows.shape[1] > len(names):
        names.append("trust")
    for name, column in zip(names, rows.T, strict=True):
        matches[name] = column
    best, second = matches["distance_sum"], matches["second_sum"]
    if "trust" not in names:
        matches["trust"] = margin_to_second(best, second)
    matches["probability"], matches["lost"] = judge.judge(matches["trust"])
    matches["ratio"] = ratio_to_second(best, second)
    return matches
