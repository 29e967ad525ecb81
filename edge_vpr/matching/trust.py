"""Trust and misfit: how sure a match of the place filter is, and how badly its view fits the map.

`edge_vpr.confidence` turns both into a probability.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.confidence import TRUST_TOP
from edge_vpr.matching.evidence import FACTOR_SHIFT
from edge_vpr.matching.prediction import (
    TYPICAL_EIGHTHS,
    Metrics,
    Transitions,
    Travelled,
)
from fixedpoint.activity import WEIGHT_BITS

# Trust.


#: margin of a match without a second best: more than counts
ALONE = 1_023
#: bits of an eighth
EIGHTHS = 3
#: support, in units of 1/16 of a margin, moves by 1/4 of the difference in each window
TRUST_SHIFT, TRUST_FRACTION_BITS = 2, 4
#: while the place stays the same, support falls by 1/8 in each window; of a smoothed drive, the
#: margin by 1/16 for each other window
LIVE_STANDING_SHIFT, STANDING_SHIFT = 3, 4
#: trust is whole after 8 windows of a path
WHOLE_AGE = 8
#: margins and residuals are capped at 23, which bounds the influence of one window
MARGIN_TOP = RESIDUAL_TOP = TRUST_TOP >> TRUST_FRACTION_BITS


@kernel(inline="always")
def margin_of(metric: Metrics, place: int, second: int) -> int:
    """Return the second-best metric less the best; 1,023 if there is no second."""
    if second < 0:
        return ALONE
    return int(metric[second]) - int(metric[place])


@kernel(inline="always")
def support_after(kept: int, stands: bool, margin: int) -> int:
    """Return the support of a match after a window: a running mean of the margins.

    At a standstill, further windows of the same view add no information: the support decays by 1/8
    in each window.

    Parameters
    ----------
    kept : int
        Support of the window before; 0 if this place is not reachable from that of the window
        before.
    stands : bool
        Whether the place is the same as in the window before.
    margin : int
        Second metric less the least.

    Returns
    -------
    int
        0 to `TRUST_TOP`, in units of 1/16 of a metric.
    """
    before, capped = np.int64(kept), np.int64(min(margin, MARGIN_TOP))
    raised = before + (((capped << TRUST_FRACTION_BITS) - before) >> TRUST_SHIFT)
    if stands:
        raised = min(raised, before - (before >> LIVE_STANDING_SHIFT))
    return int(raised)


@kernel(inline="always")
def residual_of(evidence: int) -> int:
    """Return the residual of a window: the evidence against the matched place, up to 23."""
    return min(int(evidence), RESIDUAL_TOP)


@kernel(inline="always")
def trust_of(support: int, residual: int, age: int) -> int:
    """Return the trust in a match: its support less the residual of the matched place.

    A path that has become wrong keeps the support of earlier windows for a while, but its places no
    longer fit the view. A path that has just begun may be any.

    Parameters
    ----------
    support : int
        See `support_after`.
    residual : int
        Largest `residual_of` of this window and the two before it.
    age : int
        Windows of the path so far, at most `WHOLE_AGE`.

    Returns
    -------
    int
        0 to `TRUST_TOP`.
    """
    return max(int(support) - (int(residual) << TRUST_FRACTION_BITS), 0) * age // WHOLE_AGE


# Misfit.


#: the running misfit moves by 1/16 of the difference in each window, and has 4 more fraction bits
RUNNING_SHIFT, MISFIT_BITS = 4, 4
#: Misfit that is reported as 0. Windows of drives along the map in the same light are lower on
#: average.
MISFIT_ZERO = -80
#: running misfit before the first window
FIRST_MISFIT = MISFIT_ZERO << MISFIT_BITS


@kernel
def window_misfit(
    evidence: npt.NDArray[np.uint8],
    place: int,
    typical: npt.NDArray[np.int64],
    factor: int,
    share: int,
) -> int:
    """Return how badly a window fits the matched place, relative to all places.

    Some place of the map is nearest to any view, even off the map or in another light. The path
    cannot follow these nearest places, and so the matched place is then as far from the view as
    any other.

    Parameters
    ----------
    evidence : ndarray of uint8, shape (K,)
        Evidence of the window.
    typical : ndarray of int64, shape (K,)
        Subtracted, since places without contrast are nearer to any view.
    factor, share : int
        See `WindowRows`. The result is divided by the share, because a short driven distance lowers
        the weight of the evidence but not how well the view fits.

    Returns
    -------
    int
        Evidence against the place less its advantage over the mean of all places, each divided by
        the share and limited to 23: -23 to 46.
    """
    total = np.int64(0)
    for k in range(evidence.size):
        total += np.int64(evidence[k])
    rest = (1 << EIGHTHS) - TYPICAL_EIGHTHS  # the evidence has the others
    nearer = (np.int64(typical[place]) * factor * rest) >> (FACTOR_SHIFT + EIGHTHS)
    against, whole = np.int64(evidence[place]), max(share, 1)
    advantage = int((total // evidence.size - against + nearer) << WEIGHT_BITS) // whole
    residual = residual_of((against << WEIGHT_BITS) // whole)
    return residual - min(max(advantage, -RESIDUAL_TOP), RESIDUAL_TOP)


@kernel(inline="always")
def update_misfit(before: int, misfit: int, factor: int) -> int:
    """Return the running mean of `window_misfit` after a window, in units of 1/256 of a metric."""
    if factor == 0:
        return before
    return before + (((misfit << (TRUST_FRACTION_BITS + MISFIT_BITS)) - before) >> RUNNING_SHIFT)


@kernel(inline="always")
def reported_misfit(running: int) -> int:
    """Return the misfit that is reported with a match, in units of 1/16 of a metric like trust."""
    return max((running >> MISFIT_BITS) - MISFIT_ZERO, 0)


# Both, of a drive that was smoothed as a whole.


#: numbers of windows before and after a window whose mean margin and misfit it has in a smoothed
#: drive, and whose largest residual
NEIGHBOURS, RESIDUAL_NEIGHBOURS = 16, 4


def smoothed_trust(
    place: npt.NDArray[np.int64],
    margin: npt.NDArray[np.int64],
    residual: npt.NDArray[np.int64],
    travelled: Sequence[Travelled],
    unseen: Sequence[int],
    seen: npt.NDArray[np.bool_],
    transitions: Transitions,
) -> npt.NDArray[np.int64]:
    """Return the trust of the matches of a smoothed drive, see `filter_drive`.

    Parameters
    ----------
    place, margin, residual : ndarray of int64, shape (n,)
        Match of each window, its margin in units of 1/16 of a metric, and the evidence against it.
    travelled : sequence of int or None
        Driven distance of each window.
    unseen : sequence of int
        See `Descriptors`; no window speaks for one beyond a gap.
    seen : ndarray of bool, shape (n,)
        Whether a window has an event of the whole sensor; one within a gap has none, and no trust.
    """
    mean = _mean_around(place, _standing(place, margin), travelled, unseen, transitions)
    trust = np.maximum(mean - (_largest_around(residual) << TRUST_FRACTION_BITS), 0)
    held = np.zeros_like(trust)
    for part in np.split(np.arange(trust.size), np.flatnonzero(unseen)):  # between two gaps
        of_part = part[seen[part]]
        held[of_part] = held_trust(trust[of_part])
    return held


def held_trust(trust: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the largest trust that all windows of a stretch around each window have, shape (n,).

    Parts of two streets look alike for some windows, and rarely for as many as a trust is made of.
    Of few windows, a stretch is half, so that a single bad one does not decide about all.
    """
    length = min(2 * NEIGHBOURS + 1, (len(trust) + 1) // 2)
    if not length:
        return trust
    least = np.lib.stride_tricks.sliding_window_view(trust, length).min(axis=1)
    around = np.pad(least, length - 1)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(around, length).max(axis=1))


def _largest_around(values: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the largest value among each window and its neighbours."""
    around = np.pad(values, RESIDUAL_NEIGHBOURS)
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(around, 2 * RESIDUAL_NEIGHBOURS + 1).max(axis=1)
    )


def _standing(place: npt.NDArray[np.int64], margin: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the margins, reduced by 1/16 for each other consecutive window with the same place.

    Repeated views add no information. A path that leaves the map may also stay at one place, which
    is then better than all others.
    """
    begin = np.flatnonzero(np.diff(place, prepend=-1))
    windows = np.diff(begin, append=len(place))
    others, left = np.repeat(windows - 1, windows), margin.copy()
    for passed in range(others.max(initial=0)):
        fall = np.where(others > passed, left >> STANDING_SHIFT, 0)
        if not fall.any():
            break
        left -= fall
    return left


def _mean_around(
    place: npt.NDArray[np.int64],
    margin: npt.NDArray[np.int64],
    travelled: Sequence[Travelled],
    unseen: Sequence[int],
    transitions: Transitions,
) -> npt.NDArray[np.int64]:
    """Return the mean margin of each window and its neighbours; 0 for those beyond a restart."""
    places = place.tolist()
    total = np.concatenate([[0], np.cumsum(margin)])
    chain = np.zeros(len(places), dtype=np.int64)  # number of each run without a restart
    for j in range(1, len(places)):
        follows = transitions.reaches(places[j - 1], places[j], travelled[j])
        chain[j] = chain[j - 1] + (unseen[j] > 0 or not follows)
    at = np.arange(len(places))
    first = np.maximum(at - NEIGHBOURS, np.searchsorted(chain, chain, side="left"))
    last = np.minimum(at + NEIGHBOURS, np.searchsorted(chain, chain, side="right") - 1)
    return np.asarray((total[last + 1] - total[first]) // (2 * NEIGHBOURS + 1))


def smoothed_misfit(
    misfit: npt.NDArray[np.int64], informative: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """Return the misfit of smoothed matches, averaged over windows that are not pauses."""
    n = len(misfit)
    totals = [
        np.concatenate([[0], np.cumsum(column)]) for column in (misfit * informative, informative)
    ]
    first = np.maximum(np.arange(n) - NEIGHBOURS, 0)
    last = np.minimum(np.arange(n) + NEIGHBOURS + 1, n)
    summed, number = (total[last] - total[first] for total in totals)
    mean = (summed << TRUST_FRACTION_BITS) // np.maximum(number, 1)
    return np.where(number > 0, np.maximum(mean - MISFIT_ZERO, 0), 0)
