"""Kernels that write a match: the best place and how sure it is."""

from __future__ import annotations

import numpy as np

from edge_vpr.compiling import kernel
from edge_vpr.descriptors.pauses import is_pause, is_quiet
from edge_vpr.matching.filter_arithmetic import (
    add_evidence,
    least_and_second,
    margin_of,
    reciprocal_of_spread,
    trust_after,
)
from edge_vpr.matching.step_prices import METRIC_TOP
from edge_vpr.online.vector_kernels import least_in


@kernel
def sequence_answer(sums, total, c, length, row):
    """Write the place with the nearest sequence.

    Parameters
    ----------
    sums : ndarray of uint16 or uint32
        Of `Sliding`, with all moves taken.
    total : record of TOTALS
    c : record of CONTROL
        Changed in place: the place told last.
    length : int
        L.
    row : record of MATCH_DTYPE
        Written to, but for what `judge` and the kernel write.

    Returns
    -------
    bool
        False if only changes are asked for and there is none; nothing is written then.
    """
    best, least = least_in(sums, total.sums, 0, c.places)
    if c.change and best == c.place_told:
        return False
    c.place_told = best
    second, second_least = _second(sums, total.sums, best, c.exclusion, c.places)
    row["place"], row["distance_sum"] = best + length - 1, np.int64(least) + total.common
    row["second"], row["second_sum"], row["trust"] = -1, -1, 0
    if second >= 0:
        row["second"] = second + length - 1
        row["second_sum"] = np.int64(second_least) + total.common
        row["trust"] = np.int64(second_least) - np.int64(least)
    return True


@kernel(inline="always")
def _second(sums, count, best, exclusion, places):
    """Find the best place outside the exclusion zone; -1 if there is none."""
    second, second_least = -1, sums[best]
    if best - exclusion > 0:
        second, second_least = least_in(sums, count, 0, best - exclusion)
    if best + exclusion + 1 < places:
        after, after_least = least_in(sums, count, best + exclusion + 1, places)
        if second < 0 or after_least < second_least:
            second, second_least = after, after_least
    return second, second_least


@kernel
def filter_answer(predicted, metric, sums, c, events, row):
    """Write the place of the lowest metric for the unfinished window.

    Parameters
    ----------
    predicted : Predictions
    metric : ndarray of int32, shape (K,)
        Scratch.
    sums : ndarray of uint16 or uint32
        Of `Sliding` with one window, with all moves taken.
    c : record of CONTROL
        Changed in place: the place told last.
    events : int
        In the window, at selected pixels.
    row : record of MATCH_DTYPE
        Written to, but for what `judge` and the kernel write.

    Returns
    -------
    bool
        False if only changes are asked for and there is none; nothing is written then.
    """
    prediction = predicted.quiet if is_quiet(events, c.usual) else predicted.moving
    if is_pause(events, c.usual):
        for k in range(metric.size):
            metric[k] = min(prediction[k], METRIC_TOP)
    else:
        some = sums[: metric.size]
        reciprocal = c.reciprocal
        if reciprocal == 0:
            reciprocal = reciprocal_of_spread(some)
        add_evidence(prediction, some, reciprocal, metric)
    best, second, _ = least_and_second(metric, c.exclusion)
    if c.change and best == c.place_told:
        return False
    c.place_told = best
    kept = c.trust if predicted.follows[best] else np.int64(0)
    row["place"], row["distance_sum"] = best, metric[best]
    row["second"], row["second_sum"] = second, -1
    if second >= 0:
        row["second_sum"] = metric[second]
    row["trust"] = trust_after(int(kept), bool(best == c.place), margin_of(metric, best, second))
    return True


@kernel
def judge(row, trust, probability, least_trust):
    """Write the ratio, the probability, and whether the match is lost.

    Parameters
    ----------
    row : record of MATCH_DTYPE
        With its trust and both sums.
    trust : ndarray of int64, shape (m,)
    probability : ndarray of float64, shape (m,)
        Steps of `Confidence`; m is 0 where nothing is known.
    least_trust : int
        Of a match that is not lost.
    """
    second = row["second_sum"]
    row["ratio"] = np.nan if second < 0 else 1.0
    if second > 0:
        row["ratio"] = row["distance_sum"] / second
    row["probability"], row["lost"] = np.nan, row["trust"] < least_trust
    first, last = 0, trust.size - 1  # binary search: the step lies between these two
    if last >= 0:
        while first < last:
            middle = (first + last + 1) // 2
            if trust[middle] <= row["trust"]:
                first = middle
            else:
                last = middle - 1
        row["probability"] = probability[first]
