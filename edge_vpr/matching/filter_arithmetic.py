"""Integer arithmetic of one window of the place filter: spread, evidence, best places, trust."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.matching.step_prices import FRACTION_BITS, METRIC_TOP, Metrics

#: largest evidence: 8 bits
EVIDENCE_TOP = (1 << 8) - 1
#: fraction bits of the reciprocal of the spread
RECIPROCAL_BITS = 16
#: trust, in units of 1/16 of a margin, moves by 1/4 of the difference in each window
TRUST_SHIFT, TRUST_BITS = 2, 4
#: while the place stays the same, trust falls by 1/16 in each window
STANDING_SHIFT = 4


@kernel
def trust_after(kept: int, stands: bool, margin: int) -> int:
    """Return the trust after a window, in units of 1/16 of a metric.

    While the robot stands, it sees the same view again and learns nothing new. The trust then falls
    by 1/16 in each window.

    Parameters
    ----------
    kept : int
        Trust of the window before; 0 where this match does not follow from that one.
    stands : bool
        Whether the place is that of the window before.
    margin : int
        Second metric less the least.
    """
    before = np.int64(kept)
    raised = before + (((np.int64(margin) << TRUST_BITS) - before) >> TRUST_SHIFT)
    if stands:
        raised = min(raised, before - (before >> STANDING_SHIFT))
    return int(raised)


@kernel
def reciprocal_of_spread(distances: npt.NDArray[np.integer]) -> int:
    """Return ``floor(2**16 / s)``, with s the mean absolute deviation of the distances.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)

    Returns
    -------
    int
        s is rounded down, as is the mean that it is taken from, and at least 1.
    """
    total = np.int64(0)
    for distance in distances:
        total += np.int64(distance)
    mean = total // distances.size
    spread = np.int64(0)
    for distance in distances:
        spread += abs(np.int64(distance) - mean)
    return (1 << RECIPROCAL_BITS) // max(int(spread) // distances.size, 1)


@kernel
def evidence_of(
    distances: npt.NDArray[np.integer], reciprocal: int, evidence: npt.NDArray[Any]
) -> None:
    """Write ``E = min((D - min D) / s, 255)``, in fraction bits.

    Parameters
    ----------
    distances : ndarray of int, shape (K,)
        What all of them have in common does not matter.
    reciprocal : int
        Of s, see `reciprocal_of_spread`; 0 of a spread above 2**16: nothing is evidence then.
    evidence : ndarray of int, shape (K,)
        Written to.
    """
    shift = RECIPROCAL_BITS - FRACTION_BITS
    # a larger difference gives the largest evidence anyway, and this product fits into 32 bits
    most = np.int64((EVIDENCE_TOP << shift) // max(reciprocal, 1) + 1)
    least = np.int64(distances.min())
    factor = np.int32(reciprocal)
    for k in range(evidence.size):
        difference = np.int32(min(np.int64(distances[k]) - least, most))
        evidence[k] = min((difference * factor) >> shift, EVIDENCE_TOP)


@kernel
def add_evidence(
    prediction: Metrics, distances: npt.NDArray[np.integer], reciprocal: int, metric: Metrics
) -> None:
    """Write ``min(P + E, 2**10 - 1)``, with E as `evidence_of` gives it.

    Parameters
    ----------
    prediction : ndarray of int32, shape (K,)
    distances : ndarray of int, shape (K,)
    reciprocal : int
    metric : ndarray of int32, shape (K,)
        Written to.
    """
    evidence_of(distances, reciprocal, metric)
    for k in range(metric.size):
        metric[k] = min(prediction[k] + metric[k], METRIC_TOP)


@kernel
def least_and_second(metric: Metrics, exclusion: int) -> tuple[int, int, int]:
    """Return the place of the lowest metric, the best one outside its zone or -1, and ties."""
    best, ties = _first_least(metric, 0, metric.size), -1
    for k in range(metric.size):
        ties += metric[k] == metric[best]
    before = _first_least(metric, 0, best - exclusion)
    second = _first_least(metric, best + exclusion + 1, metric.size)
    if before >= 0 and (second < 0 or metric[before] <= metric[second]):
        second = before
    return best, second, ties


@kernel
def margin_of(metric: Metrics, place: int, second: int) -> int:
    """Return the second-best less the best metric; the largest value if there is no second."""
    if second < 0:
        return METRIC_TOP
    return int(metric[second]) - int(metric[place])


@kernel
def _first_least(metric: Metrics, begin: int, end: int) -> int:
    """Return the first place of the lowest metric in a range; -1 if the range is empty."""
    if begin >= end:
        return -1
    # two loops: the first compiles to vector instructions, the second ends early
    least = metric[begin]
    for k in range(begin, end):
        least = min(least, metric[k])
    k = begin
    while metric[k] != least:
        k += 1
    return k
