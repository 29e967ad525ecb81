"""The place filter over place and gain: the number of events is not taken for the speed.

A window has more events if the robot drives faster, and also if the light, the lens or the
thresholds of the camera give more. The filter follows seven hypotheses of this gain side by side,
each with a metric of every place: the cost of the cheapest path that ends there with this gain.
`advance_windows` is the loop; the page of the specification (section 11) has the same steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel, plain
from edge_vpr.descriptors.windows import (
    ACTIVITY_FRACTION_BITS,
    Descriptors,
    activity_of_drive,
    is_pause,
    log_activity,
    mean_activity_after,
    place_activity,
)
from edge_vpr.errors import UsageError
from edge_vpr.matching.distances import typical_distances
from edge_vpr.matching.evidence import evidence_of, reciprocal_of_spread
from edge_vpr.matching.filter_match import (
    METRIC,
    MISFIT,
    PLACE,
    SECOND,
    SECOND_METRIC,
    TIES,
    TRUST,
    FilterMatch,
)
from edge_vpr.matching.prediction import (
    TransitionCosts,
    Transitions,
    is_reachable,
)
from edge_vpr.matching.search import least_and_second
from edge_vpr.matching.smoothing import runs
from edge_vpr.matching.trust import (
    FIRST_MISFIT,
    RESIDUAL_TOP,
    TRUST_FRACTION_BITS,
    margin_of,
    reported_misfit,
    residual_of,
    set_numbers,
    support_after,
    trust_of,
    update_misfit,
)
from edge_vpr.settings import Settings
from fixedpoint.activity import (
    BANK_COSTS,
    COST_ROW_SHIFT,
    EVENTS_TOP,
    GAINS,
    LOG_TOP,
    SAME_ROW,
    SUM_LIMITS,
    SUMS,
    WEIGHT_BITS,
)

Bytes = npt.NDArray[np.uint8]
Narrow = npt.NDArray[np.int16]

#: largest metric: seven bits
METRIC_TOP = 127
#: cost of a change of gain by half an octave, with fraction bits
GAIN_STEP = 24
#: eighths of the typical distance of a place that are subtracted from its distances
TYPICAL_EIGHTHS = 4
#: surplus of events, in 1/16 octave, from which the evidence has weight; below `-FEW`, a window has
#: few events
SEEN_FROM, FEW = 56, 48
#: after more windows with few events in a row, the robot stands: live, and in a smoothed drive
PATIENCE, PATIENCE_SMOOTHED = 2, 8
#: the match is the middle of the places near the best, by cost and, at half windows, by places
NEAR, REACH = 8, {1: 0, 2: 4}
#: at a standstill, support falls by 1/8 in each window; trust is whole after 8 windows of a path
STANDING_SHIFT, WHOLE_AGE = 3, 8
#: the mean speed of a drive moves by 1/64 of the difference, and has 4 more fraction bits
SPEED_SHIFT, SPEED_BITS = 6, 4

#: hypotheses, and their number in memory: a vector of which the last is not used
HYPOTHESES, LANES = len(GAINS), 8
_SAME_GAIN = GAINS.index(0)
_GAINS = np.array(GAINS, dtype=np.int64)
_LOWEST_ROW, _HIGHEST_ROW = -SAME_ROW, len(BANK_COSTS[1]) - 1 - SAME_ROW
# rows that a place's hypotheses span: row r of a place is r + 4 for the gain of two octaves less
_GAIN_ROWS = -GAINS[0] >> COST_ROW_SHIFT
_ROW_LOW, _ROW_HIGH = _LOWEST_ROW - _GAIN_ROWS, _HIGHEST_ROW + LANES - 1 - _GAIN_ROWS


# Constants of a map, and the state between two windows.


#: State that a match changes, and its values before the first window; see `BankFilter`.
BEFORE_FIRST = {
    "place": -1, "gain": _SAME_GAIN, "few": 0, "speed": 0, "moved": 0, "support": 0, "age": 0,
    "residual": 0, "residual_before": 0, "running_misfit": FIRST_MISFIT,
}  # fmt: skip
_BY_STEPS = -1
NUMBERS = np.dtype(
    [(name, np.int64) for name in ("mean_activity", *BEFORE_FIRST, "weight_by_distance")]
)


class BankTable(NamedTuple):
    """Constants of a map.

    Attributes
    ----------
    costs : ndarray of int16, shape (steps, rows)
        `BANK_COSTS`, the highest row first, so that the costs of the hypotheses of a place are
        neighbours.
    activity : ndarray of int32, shape (K,)
        See `place_activity`.
    typical : ndarray of int64, shape (K,)
        See `distances.typical_distances`.
    bias : ndarray of int64, shape (K,)
        Its part that is subtracted from distances.
    jumps : ndarray of int32, shape (n, 2)
        See `Transitions`.
    mean_log : int
        Logarithm of the reference's mean number of events.
    restart_cost, exclusion, reach, patience : int
        See `FilterTable`, `REACH` and `PATIENCE`.
    """

    costs: Narrow
    activity: npt.NDArray[np.int32]
    typical: npt.NDArray[np.int64]
    bias: npt.NDArray[np.int64]
    jumps: npt.NDArray[np.int32]
    mean_log: int
    restart_cost: int
    exclusion: int
    reach: int
    patience: int


class BankState(NamedTuple):
    """State of a `BankFilter`, which its kernels update in place.

    Attributes
    ----------
    numbers : ndarray of NUMBERS, shape (1,)
        See `BankFilter`.
    metric : ndarray of int16, shape (K, LANES)
        Metric of each place and hypothesis after the window before.
    reciprocal : ndarray of int64, shape (3,)
        Reciprocal of the spread of each sum in the window before; 0 if it had none.
    prediction : ndarray of int32, shape (K,)
        Cost of each place by odometry, if `weight_by_distance` is not negative.
    follows : ndarray of bool, shape (K,)
        Which places are then reachable from the latest match.
    """

    numbers: Any
    metric: Narrow
    reciprocal: npt.NDArray[np.int64]
    prediction: npt.NDArray[np.int32]
    follows: npt.NDArray[np.bool_]


class BankRows(NamedTuple):
    """Results of n windows.

    Attributes
    ----------
    columns : ndarray of int64, shape (n, 7)
        Fields of `FilterMatch`.
    least : ndarray of int32, shape (n, K)
        Least metric of each place.
    metrics : ndarray of int16, shape (n, K, LANES)
        Metrics after each window.
    evidence : ndarray of uint8, shape (n, 3, K)
        Evidence of each sum.
    looks : ndarray of int64, shape (n, LANES)
        Sum that each hypothesis looks at.
    activity : ndarray of int64, shape (n,)
        Logarithm of the events of each window less that of the reference; None of the reached rows
        if the robot stands: `_STANDS`.
    scale : ndarray of int64, shape (n, 3)
        Weight of the evidence of each sum per unit of distance, in units of 2**-17; 0 in a pause.
    share : ndarray of int64, shape (n,)
        Weight that odometry leaves, in units of 1/8; 8 without odometry.
    best : ndarray of int64, shape (n, 2)
        Best place and its hypothesis.
    """

    columns: npt.NDArray[np.int64]
    least: npt.NDArray[np.int32]
    metrics: Narrow
    evidence: Bytes
    looks: npt.NDArray[np.int64]
    activity: npt.NDArray[np.int64]
    scale: npt.NDArray[np.int64]
    share: npt.NDArray[np.int64]
    best: npt.NDArray[np.int64]

    @classmethod
    def empty(cls, windows: int, places: int) -> BankRows:
        """Return uninitialised rows."""
        return cls(
            np.empty((windows, len(FilterMatch._fields)), dtype=np.int64),
            np.empty((windows, places), dtype=np.int32),
            np.empty((windows, places, LANES), dtype=np.int16),
            np.empty((windows, len(SUMS), places), dtype=np.uint8),
            np.empty((windows, LANES), dtype=np.int64),
            np.empty(windows, dtype=np.int64),
            np.empty((windows, len(SUMS)), dtype=np.int64),
            np.empty(windows, dtype=np.int64),
            np.empty((windows, 2), dtype=np.int64),
        )

    def part(self, first: int, last: int) -> BankRows:
        """Return the rows of the windows from `first` to before `last`, in the same memory."""
        return BankRows(*(column[first:last] for column in self))


#: metric of the hypothesis that is not used
_NEVER = 1 << 12
#: in place of the activity of a window: all places have the costs of standing
_STANDS = -4 * LOG_TOP


# Step 1: does the robot stand? Step 2: the prediction.


@kernel(inline="always")
def activity_against_map(events: int, mean_log: int) -> int:
    """Return the logarithm of a window's events less that of the reference's mean."""
    if events == 0:
        return -LOG_TOP
    return log_activity(min(events, EVENTS_TOP)) - mean_log


@kernel(inline="always")
def weight_of_surplus(surplus: int) -> int:
    """Return the weight of the evidence, in eighths, by the events beyond those of standing."""
    return min(max((surplus + SEEN_FROM) >> 1, 0), 1 << WEIGHT_BITS)


@kernel(inner=True)
def change_gains(metric: Narrow) -> None:
    """Lower each metric to that of another gain of the same place and the cost of the change."""
    for k in range(len(metric)):
        for h in range(1, HYPOTHESES):
            metric[k, h] = min(metric[k, h], np.int16(metric[k, h - 1] + GAIN_STEP))
        for h in range(HYPOTHESES - 2, -1, -1):
            metric[k, h] = min(metric[k, h], np.int16(metric[k, h + 1] + GAIN_STEP))


@kernel(inline="always")
def first_row(activity: int, of_place: int) -> int:
    """Return where the costs of a place's hypotheses begin in a row of `BankTable.costs`."""
    row = (activity - of_place + (1 << (COST_ROW_SHIFT - 1))) >> COST_ROW_SHIFT
    return _ROW_HIGH - min(max(row, _ROW_LOW), _ROW_HIGH)


@kernel(inner=True)
def move_bank(metric: Narrow, table: BankTable, activity: int, back: bool, out: Narrow) -> None:
    """Compute the cheapest cost of each place and hypothesis one window later, or earlier.

    Parameters
    ----------
    metric : ndarray of int16, shape (K, LANES)
        Costs less the least of all.
    activity : int
        Of the later window; `_STANDS` if the robot stands there.
    back : bool
        Whether `metric` belongs to the later window.
    out : ndarray of int16, shape (K, LANES)
        The least of ``min M[h] + restart`` and ``M[k - i, h] + cost[i]`` for each step i; the costs
        are those of the place that the step reaches.
    """
    places = len(metric)
    restarted = np.empty(LANES, dtype=np.int16)
    for h in range(LANES):
        restarted[h] = metric[0, h]
    for k in range(places):
        for h in range(LANES):
            restarted[h] = min(restarted[h], metric[k, h])
    for h in range(LANES):
        restarted[h] = np.int16(restarted[h] + table.restart_cost)
    for k in range(places):
        for h in range(LANES):
            out[k, h] = restarted[h]
    for reached in range(places):
        at = first_row(activity, table.activity[reached])
        for i in range(min(len(table.costs), reached + 1)):
            cost = table.costs[i, at : at + LANES]
            origin = reached - i
            to, other = (origin, reached) if back else (reached, origin)
            for h in range(LANES):
                out[to, h] = min(out[to, h], np.int16(metric[other, h] + cost[h]))
    for j in range(len(table.jumps)):
        for i in range(1, len(table.costs)):
            for over in range(i):
                begin, end = table.jumps[j, 0] - (i - 1 - over), table.jumps[j, 1] + over
                if begin >= 0 and end < places:
                    at = first_row(activity, table.activity[end])
                    to, other = (begin, end) if back else (end, begin)
                    for h in range(LANES):
                        cost_h = table.costs[i, at + h]
                        out[to, h] = min(out[to, h], np.int16(metric[other, h] + cost_h))


@kernel(inner=True)
def predict(state: BankState, table: BankTable, activity: int, out: Narrow) -> None:
    """Compute the cost of each place and hypothesis before the evidence of the window."""
    now, places = state.numbers[0], len(out)
    if now.place < 0:
        for k in range(places):
            for h in range(LANES):
                out[k, h] = 0
    elif now.weight_by_distance != _BY_STEPS:
        for k in range(places):
            for h in range(LANES):
                changed = GAIN_STEP * (h != now.gain)
                out[k, h] = np.int16(state.prediction[k] + changed)
    else:
        before = np.empty((places, LANES), dtype=np.int16)
        least = state.metric[0, 0]
        for k in range(places):
            for h in range(HYPOTHESES):
                least = min(least, state.metric[k, h])
        for k in range(places):
            for h in range(LANES):
                before[k, h] = np.int16(state.metric[k, h] - least)
        change_gains(before)
        move_bank(before, table, activity, np.bool_(False), out)


# Step 3: the evidence.


@kernel(inline="always")
def which_sum(speed: int, gain: int) -> int:
    """Return which sum a hypothesis looks at: the slower the drive by it, the longer."""
    mean, which = (speed >> SPEED_BITS) - gain, 0
    for limit in SUM_LIMITS:
        which += mean < limit
    return which


@kernel(inner=True)
def evidence_of_sum(
    distances: npt.NDArray[np.integer], bias: npt.NDArray[np.int64], before: int, weight: int,
    out: Bytes,
) -> tuple[int, int]:  # fmt: skip
    """Compute the evidence of a sum, less the typical distances.

    Returns
    -------
    scale, reciprocal : int
        Reciprocal by which the evidence was scaled, and that of this window.
    """
    less = np.empty(len(bias), dtype=np.int64)
    for k in range(len(bias)):
        less[k] = np.int64(distances[k]) - bias[k]
    own = reciprocal_of_spread(less)
    scale = before if before > 0 else own
    evidence_of(less, scale, weight, out)
    return scale, own


# Steps 4 and 5: the best place, and the trust in it.


@kernel(inline="always")
def middle_of(least: npt.NDArray[np.int32], best: int, reach: int) -> int:
    """Return the middle of the places whose metric is near that of the best."""
    first, last, most = best, best, least[best] + NEAR
    while first > max(best - reach, 0) and least[first - 1] <= most:
        first -= 1
    while last < min(best + reach, least.size - 1) and least[last + 1] <= most:
        last += 1
    return (first + last + 1) >> 1


@kernel(inner=True)
def write_least(metric: Narrow, out: npt.NDArray[np.int32]) -> None:
    """Write the least metric of each place."""
    for k in range(len(metric)):
        least = metric[k, 0]
        for h in range(1, HYPOTHESES):
            least = min(least, metric[k, h])
        out[k] = least


@kernel(inline="always")
def gain_of(metric: npt.NDArray[np.integer]) -> int:
    """Return the first hypothesis of the least metric of a place."""
    best = 0
    for h in range(1, HYPOTHESES):
        if metric[h] < metric[best]:
            best = h
    return best


@kernel(inner=True)
def write_best(
    least: npt.NDArray[np.int32], exclusion: int, reach: int, out: npt.NDArray[np.int64]
) -> tuple[int, int]:
    """Write a match without its trust and misfit, and return its best place and its margin."""
    best, second, ties = least_and_second(least, exclusion)
    out[PLACE], out[METRIC], out[TIES] = middle_of(least, best, reach), least[best], ties
    out[SECOND], out[SECOND_METRIC] = second, -1
    if second >= 0:
        out[SECOND_METRIC] = least[second]
    return best, margin_of(least, best, second)


@kernel(inner=True)
def misfit_of_window(evidence: Bytes, place: int, typical: int, factor: int, share: int) -> int:
    """Return `trust.window_misfit` where a part of the typical distance is in the evidence."""
    total = np.int64(0)
    for k in range(evidence.size):
        total += np.int64(evidence[k])
    nearer = (typical * factor * ((1 << 3) - TYPICAL_EIGHTHS)) >> 20
    against, whole = np.int64(evidence[place]), max(share, 1)
    advantage = ((total // evidence.size - against + nearer) << WEIGHT_BITS) // whole
    residual = residual_of((against << WEIGHT_BITS) // whole)
    return residual - min(max(advantage, -RESIDUAL_TOP), RESIDUAL_TOP)


# The loop.


@kernel
def advance_windows(
    state: BankState,
    table: BankTable,
    distances: npt.NDArray[np.integer],
    events: npt.NDArray[np.int64],
    out: BankRows,
) -> None:
    """Advance the filter by n finished windows, one after the other.

    Parameters
    ----------
    state : BankState
        State before the first window; updated in place.
    distances : ndarray of int, shape (n, 3, K)
        From the sums of the newest 1, 2 and 4 windows to each place.
    events : ndarray of int64, shape (n,)
        Counted events of each window, see `windows.counted_events`.
    out : BankRows
        Results of the n windows.
    """
    for i in range(len(events)):
        now = state.numbers[0]
        activity = activity_against_map(events[i], table.mean_log)
        pause = is_pause(events[i], now.mean_activity)
        weight, few = 1 << WEIGHT_BITS, pause
        if now.place >= 0:
            surplus = activity - table.activity[now.place] - min(_GAINS[now.gain], 0)
            weight, few = weight_of_surplus(surplus), pause or surplus < -FEW
        now.few = min(now.few + 1, table.patience + 1) if few else 0
        out.activity[i] = _STANDS if now.few > table.patience else activity

        predict(state, table, out.activity[i], out.metrics[i])
        seen = (activity, pause, few, weight)
        out.share[i] = write_evidence(state, table, distances[i], seen, out, i)
        add_evidence(out.metrics[i], out.evidence[i], out.looks[i])
        write_least(out.metrics[i], out.least[i])
        best, margin = write_best(out.least[i], table.exclusion, table.reach, out.columns[i])
        write_bank_trust(state, table, best, margin, out, i)

        now.mean_activity = mean_activity_after(now.mean_activity, events[i])
        now.weight_by_distance = _BY_STEPS
        for k in range(len(state.metric)):
            for h in range(LANES):
                state.metric[k, h] = out.metrics[i, k, h]


@kernel(inner=True)
def write_evidence(
    state: BankState,
    table: BankTable,
    distances: npt.NDArray[np.integer],
    seen: tuple[int, bool, bool, int],
    out: BankRows,
    i: int,
) -> int:
    """Write the evidence of the sums that hypotheses look at, and return the share of its weight.

    The mean speed moves first, unless the window has few events.

    Parameters
    ----------
    seen : tuple
        Activity against the map, whether the window is a pause and has few events, and the weight.
    """
    activity, pause, few, weight = seen
    now, share = state.numbers[0], 1 << WEIGHT_BITS
    by_distance = now.weight_by_distance != _BY_STEPS
    if by_distance:
        whole = weight
        weight = min(whole, now.weight_by_distance)
        share = (weight << WEIGHT_BITS) // whole if whole > 0 else share
    if not few:
        shift = 0
        while (1 + now.moved) >> (shift + 1) > 0 and shift < SPEED_SHIFT:
            shift += 1
        now.speed += ((activity << SPEED_BITS) - now.speed) >> shift
        now.moved = min(now.moved + 1, (1 << SPEED_SHIFT) - 1)
    for h in range(LANES):
        out.looks[i, h] = 0
        if h < HYPOTHESES and not by_distance:
            out.looks[i, h] = which_sum(now.speed, _GAINS[h])
    for s in range(len(SUMS)):
        used = False
        for h in range(HYPOTHESES):
            used = used or out.looks[i, h] == s
        out.scale[i, s] = 0
        if used and not pause:
            scale, own = evidence_of_sum(
                distances[s], table.bias, state.reciprocal[s], weight, out.evidence[i, s]
            )
            out.scale[i, s], state.reciprocal[s] = scale * weight, own
        else:
            for k in range(len(table.bias)):
                out.evidence[i, s, k] = 0
            if not pause:
                state.reciprocal[s] = 0
    return share


@kernel(inner=True)
def add_evidence(metric: Narrow, evidence: Bytes, looks: npt.NDArray[np.int64]) -> None:
    """Add to each metric the evidence of the sum that its hypothesis looks at; 127 at most."""
    for k in range(len(metric)):
        for h in range(HYPOTHESES):
            total = np.int64(metric[k, h]) + np.int64(evidence[looks[h], k])
            metric[k, h] = min(total, METRIC_TOP)
        metric[k, LANES - 1] = METRIC_TOP


@kernel(inner=True)
def write_bank_trust(
    state: BankState, table: BankTable, best: int, margin: int, out: BankRows, i: int
) -> None:
    """Compute the trust in a match and its misfit, and advance the state by them."""
    now, row = state.numbers[0], out.columns[i]
    gain = gain_of(out.metrics[i, best])
    if now.weight_by_distance != _BY_STEPS:
        follows = state.follows[best]
    else:
        last = len(table.costs) - 1
        follows = now.place >= 0 and is_reachable(now.place, best, last, table.jumps)
    kept = now.support if follows else 0
    support = support_after(kept, np.bool_(False), margin)
    if best == now.place:
        support = min(support, kept - (kept >> STANDING_SHIFT))
    now.age = min(now.age + 1, WHOLE_AGE) if follows else 0
    evidence = out.evidence[i, out.looks[i, gain]]
    residual = residual_of(evidence[best])
    worst = max(residual, now.residual, now.residual_before)
    row[TRUST] = trust_of(support, worst) * now.age // WHOLE_AGE
    factor = out.scale[i, out.looks[i, gain]]
    share = out.share[i] if factor > 0 else 1 << WEIGHT_BITS
    misfit = np.int64(0)
    if factor > 0 and share > 0:
        misfit = misfit_of_window(evidence, best, table.typical[best], factor, share)
    now.running_misfit = update_misfit(now.running_misfit, misfit, factor)
    row[MISFIT] = reported_misfit(now.running_misfit)
    now.residual_before, now.residual = now.residual, residual
    now.place, now.gain, now.support = best, gain, support
    out.best[i, 0], out.best[i, 1] = best, gain


# Smoothing: the cost to go from each place and hypothesis to the end of a drive.


@kernel
def smooth_bank(
    cost_to_go: Narrow, table: BankTable, rows: BankRows, residual: npt.NDArray[np.int64]
) -> None:
    """Add the cost to go to the metrics of n windows, backwards from the last window.

    Parameters
    ----------
    cost_to_go : ndarray of int16, shape (K, LANES)
        Cost of the rest of the drive after the last of these windows; updated in place to that
        before the first.
    rows : BankRows
        Updated in place: `least` becomes the least cost of the whole paths through each place, and
        the columns and `best` the matches by it, with the margin as trust, in units of 1/16 of a
        metric, and `misfit_of_window` as misfit. `share` becomes 0 without evidence.
    residual : ndarray of int64, shape (n,)
        Output: the evidence against each best place.
    """
    places = len(cost_to_go)
    behind = np.empty((places, LANES), dtype=np.int16)
    for i in range(len(rows.columns) - 1, -1, -1):
        row, looks = rows.columns[i], rows.looks[i]
        for k in range(places):
            for h in range(LANES):
                rows.metrics[i, k, h] += cost_to_go[k, h]
        write_least(rows.metrics[i], rows.least[i])
        best, margin = write_best(rows.least[i], table.exclusion, table.reach, row)
        gain = gain_of(rows.metrics[i, best])
        evidence, factor = rows.evidence[i, looks[gain]], rows.scale[i, looks[gain]]
        residual[i], rows.best[i, 0], rows.best[i, 1] = evidence[best], best, gain
        row[TRUST], row[MISFIT] = margin << TRUST_FRACTION_BITS, 0
        if factor > 0 and rows.share[i] > 0:
            row[MISFIT] = misfit_of_window(
                evidence, best, table.typical[best], factor, rows.share[i]
            )
        for k in range(places):
            for h in range(HYPOTHESES):
                behind[k, h] = np.int16(cost_to_go[k, h] + rows.evidence[i, looks[h], k])
            behind[k, LANES - 1] = _NEVER
        move_bank(behind, table, rows.activity[i], np.bool_(True), cost_to_go)
        settle_back(cost_to_go)


@kernel(inner=True)
def settle_back(cost_to_go: Narrow) -> None:
    """Subtract the least cost, and allow changes of gain."""
    least = cost_to_go[0, 0]
    for k in range(len(cost_to_go)):
        for h in range(HYPOTHESES):
            least = min(least, cost_to_go[k, h])
    for k in range(len(cost_to_go)):
        for h in range(LANES):
            cost_to_go[k, h] -= least
    change_gains(cost_to_go)


# The filter of a map.


class BankFilter:
    """Place filter of a map over place and gain, advanced window by window.

    Parameters
    ----------
    transitions : Transitions
        Transitions of the map, with the costs of the bank.
    mean_activity : int
        Mean number of counted events per window of the reference, in units of 1/256 event.
    patience : int
        See `PATIENCE`.

    Attributes
    ----------
    state : BankState
        The numbers are: `mean_activity`, the running mean of the counted events, by which a window
        is a pause; `place` and `gain` of the best path (-1 before the first match), `few`, the
        windows with few events in a row; `speed`, the mean activity of the drive in units of 1/256
        octave, and `moved`, the windows that moved it; `support`, `age`, `residual` and
        `residual_before`, see `write_bank_trust`; and `running_misfit`, see `update_misfit`.
    """

    def __init__(
        self, transitions: Transitions, mean_activity: int, patience: int = PATIENCE
    ) -> None:
        self.transitions, table, places = transitions, transitions.table, transitions.places
        per_window = transitions.costs.places_per_window
        columns = np.arange(_ROW_HIGH - _ROW_LOW + LANES)
        rows = np.clip(_ROW_HIGH + _GAIN_ROWS - columns, _LOWEST_ROW, _HIGHEST_ROW) + SAME_ROW
        costs = np.array(BANK_COSTS[per_window], dtype=np.int16)[rows].T
        self.table = BankTable(
            np.ascontiguousarray(costs), table.activity, table.typical,
            table.typical * TYPICAL_EIGHTHS >> 3, table.jumps,
            plain(log_activity)(mean_activity >> ACTIVITY_FRACTION_BITS), table.restart_cost,
            table.exclusion, REACH[per_window], patience,
        )  # fmt: skip
        numbers = np.zeros(1, dtype=NUMBERS)
        begin = {"mean_activity": mean_activity, "weight_by_distance": _BY_STEPS}
        set_numbers(numbers, begin | BEFORE_FIRST)
        self.state = BankState(
            numbers.view(np.recarray), np.zeros((places, LANES), dtype=np.int16),
            np.zeros(len(SUMS), dtype=np.int64), np.zeros(places, dtype=np.int32),
            np.zeros(places, dtype=np.bool_),
        )  # fmt: skip

    @classmethod
    def of(
        cls,
        places: Descriptors,
        settings: Settings,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> BankFilter:
        """Return the filter of a map before its first window; see `PlaceFilter.of`."""
        events, number = places.selected_events, settings.window_parts
        transitions = Transitions(
            len(places), TransitionCosts.of(settings), place_activity(events, number), jumps,
            along_mm, typical_distances(places.counts), settings.exclusion_places,
        )  # fmt: skip
        patience = PATIENCE_SMOOTHED if settings.smooth else PATIENCE
        return cls(transitions, activity_of_drive(events[::number]), patience)

    def __len__(self) -> int:
        return self.transitions.places

    def update_windows(
        self, distances: npt.NDArray[np.integer], events: npt.NDArray[np.int64]
    ) -> BankRows:
        """Advance by n finished windows, n at least 1, one after the other.

        Parameters
        ----------
        distances : ndarray of int, shape (n, 3, K)
            From the sums of the newest 1, 2 and 4 windows to each place.
        events : ndarray of int64, shape (n,)
            Counted events of each window.
        """
        if distances.shape[1:] != (len(SUMS), len(self)) or distances.dtype.kind not in "iu":
            raise UsageError(
                f"distances of {distances.dtype} and shape {distances.shape}: expected whole "
                f"numbers, of each window {len(SUMS)} sums to {len(self)} places"
            )
        rows = BankRows.empty(len(distances), len(self))
        whole = np.ascontiguousarray(distances, dtype=np.int32)
        advance_windows(self.state, self.table, whole, events, rows)
        return rows

    def predict_travelled(self, travelled_mm: int, driven_mm: int) -> None:
        """Predict the next window by odometry instead of steps.

        Parameters
        ----------
        travelled_mm, driven_mm : int
            See `PlaceFilter.predict_travelled`.
        """
        place = int(self.state.numbers[0].place)
        if place < 0:
            return
        least = self.state.metric[:, :HYPOTHESES].min(axis=1).astype(np.int32)
        self.state.prediction[:] = self.transitions.by_distance(least, travelled_mm)
        self.state.follows[:] = self.transitions.following(place, travelled_mm)
        weight = self.transitions.weight_by_distance(driven_mm)
        self.state.numbers[0].weight_by_distance = weight

    def resume(self, state: Sequence[npt.NDArray[Any]]) -> None:
        """Continue from the arrays of the state of another filter with the same map."""
        for mine, other in zip(self.state, state, strict=True):
            mine[...] = other


class BankBackwards:
    """Cost to go from each place and hypothesis, from the last window of a drive to the first."""

    def __init__(self, bank: BankFilter) -> None:
        self._bank = bank
        self._cost_to_go = np.zeros((len(bank), LANES), dtype=np.int16)

    def add_to(
        self, rows: BankRows, travelled: Sequence[int | None], residual: npt.NDArray[np.int64]
    ) -> None:
        """Smooth the n windows before those added so far, see `smooth_bank`."""
        to_go, transitions = self._cost_to_go, self._bank.transitions
        for first, last in reversed(list(runs(travelled, len(travelled)))):
            after = to_go.copy()
            if last > first + 1:
                smooth_bank(
                    to_go, self._bank.table, rows.part(first + 1, last), residual[first + 1 : last]
                )
                after = to_go.copy()
            smooth_bank(to_go, self._bank.table, rows.part(first, first + 1), residual[first:])
            distance = travelled[first]
            if distance is not None:
                # odometry leads from every gain to every other
                of_window = np.take_along_axis(
                    rows.evidence[first], rows.looks[first][:HYPOTHESES, None], axis=0
                )
                behind = (after[:, :HYPOTHESES].T + of_window).min(axis=0).astype(np.int32)
                moved = transitions.by_distance(behind, distance, back=True)
                to_go[:] = (moved - moved.min())[:, None]
