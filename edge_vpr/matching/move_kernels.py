"""Kernels for the prices of places one window later: by steps, and by a known distance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.matching.step_prices import Metrics

#: fraction bits of the price of a millimetre
RATE_BITS = 16
#: with odometry, a jump may be taken from this many places before it to as many after it
JUMP_REACH = 8


class StepTable(NamedTuple):
    """The part of `Moves` that a kernel needs to predict by steps.

    Attributes
    ----------
    prices : ndarray of int32, shape (steps,)
        Of a step of ``first``, ``first + 1`` ... places, with fraction bits.
    quiet : ndarray of int32, shape (steps,)
        Of a step of 0, 1 ... places in a quiet window.
    first, last : int
        Smallest step, and the largest after which an answer follows from the one before.
    restart : int
        With fraction bits.
    jumps : ndarray of int32, shape (n, 2)
    """

    prices: Metrics
    quiet: Metrics
    first: int
    last: int
    restart: int
    jumps: npt.NDArray[np.int32]


@kernel
def leads_to(
    place: int, next_place: int, first: int, last: int, jumps: npt.NDArray[np.int32]
) -> bool:
    """Return whether a step of ``first`` to ``last`` places, or one over a jump, leads there."""
    if first <= next_place - place <= last:
        return True
    for n in range(len(jumps)):
        before, beyond = jumps[n, 0] - place, next_place - jumps[n, 1]
        if before >= 0 and beyond >= 0 and before + beyond < last:
            return True
    return False


@kernel
def mark_following(place: int, steps: StepTable, follows: npt.NDArray[np.bool_]) -> None:
    """Write which places can be reached from `place` by `leads_to`, shape (K,)."""
    for k in range(follows.size):
        follows[k] = leads_to(place, k, steps.first, steps.last, steps.jumps)


@kernel
def predict(
    metric: Metrics,
    prices: Metrics,
    first: int,
    restart: int,
    jumps: npt.NDArray[np.int32],
) -> Metrics:
    """Return the cheapest price of each place one window later.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
    prices : ndarray of int32, shape (steps,)
        Of a step of ``first``, ``first + 1`` ... places.
    first : int
    restart : int
    jumps : ndarray of int32, shape (n, 2)
        Of places below K.

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_i (M[k - i] + price[i]), min M + restart) - min M``; over a jump from a to b,
        k = b + o is i places from a - (i - 1 - o).
    """
    least = metric.min()
    prediction = np.full(metric.size, restart, dtype=metric.dtype)
    for i in range(prices.size):
        step = first + i
        # the price of this step to every place that it leads to
        to, source = prediction[max(step, 0) :], metric[max(-step, 0) :]
        offset = np.int32(prices[i] - least)
        for k in range(min(to.size, source.size)):
            to[k] = min(to[k], source[k] + offset)
        for j in range(len(jumps)):
            for over in range(step):
                begin, end = jumps[j, 0] - (step - 1 - over), jumps[j, 1] + over
                if begin >= 0 and end < metric.size:
                    prediction[end] = min(prediction[end], metric[begin] + offset)
    return prediction


@kernel
def predict_travelled(
    metric: Metrics,
    along: npt.NDArray[np.int64],
    travelled: int,
    rate_and_spacing: tuple[int, int],
    restart: int,
    jumps: npt.NDArray[np.int32],
) -> Metrics:
    """Return the cheapest price of each place after a known distance driven.

    Parameters
    ----------
    metric : ndarray of int32, shape (K,)
    along : ndarray of int64, shape (K,)
        Millimetres that the reference had driven at each place, not falling.
    travelled : int
        Millimetres since the window before; below 0 backwards.
    rate_and_spacing : tuple of int
        Price of a millimetre off in units of ``2**-16``, and millimetres between two places.
    restart : int
    jumps : ndarray of int32, shape (n, 2)

    Returns
    -------
    ndarray of int32, shape (K,)
        ``min(min_j (M[j] + |along[k] - along[j] - travelled| * rate), min M + restart) - min M``,
        rounded down. A jump is a way of one mean spacing.
    """
    rate, spacing = rate_and_spacing
    least, places = np.int64(metric.min()), metric.size
    prediction = np.full(places, np.int64(restart) << RATE_BITS, dtype=np.int64)
    # rounding down is monotone: the lowest exact price, rounded, is the lowest rounded price
    best, j = np.int64(1) << 62, 0
    for k in range(places):  # sources from which the distance ends at k or before it
        while j < places and along[j] + travelled <= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) - (along[j] + travelled) * rate
            best, j = min(best, cost), j + 1
        if j > 0:
            prediction[k] = min(prediction[k], best + along[k] * rate)
    best, j = np.int64(1) << 62, places - 1
    for k in range(places - 1, -1, -1):  # sources from which it ends beyond k
        while j >= 0 and along[j] + travelled >= along[k]:
            cost = ((metric[j] - least) << RATE_BITS) + (along[j] + travelled) * rate
            best, j = min(best, cost), j - 1
        if j < places - 1:
            prediction[k] = min(prediction[k], best - along[k] * rate)
    for n in range(len(jumps)):
        begin, end = jumps[n, 0], jumps[n, 1]
        for source in range(max(begin - JUMP_REACH + 1, 0), begin + 1):
            for k in range(end, min(end + JUMP_REACH, places)):
                way = along[begin] - along[source] + spacing + along[k] - along[end]
                cost = ((metric[source] - least) << RATE_BITS) + abs(way - travelled) * rate
                prediction[k] = min(prediction[k], cost)
    return (prediction >> RATE_BITS).astype(np.int32)
