"""Section 11 of docs/specification.md as a program: the place filter over place and gain.

The number of events in a window depends on the speed of the robot and on the gain of its camera:
light, lens and thresholds. The filter follows seven gains side by side, so that neither is taken
for the other. A computer has it (`gains = 7`); devices have the filter of section 6, with one gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from firmware_model.design import MARGIN_TOP, RESIDUAL_TOP
from firmware_model.specification import (
    Edges,
    differences_of,
    distance,
    evidence_of,
    ilog,
    is_pause,
    mean_activity_after,
    mean_shift,
    means_after,
    own_mean_code,
    predict,
    search,
    spread_of,
    support_after,
    window_mean,
)
from firmware_model.specification_drive import (
    most_weight,
    transitions_by_distance,
)
from fixedpoint.activity import BANK_COSTS, EVENTS_TOP, GAINS, SAME_ROW, SUM_LIMITS, SUMS

#: largest metric: seven bits
METRIC_TOP = 127
#: cost of a change of gain by half an octave
GAIN_STEP = 24
#: after more windows with few events in a row, the robot stands: on a robot, and in a whole drive
PATIENCE, PATIENCE_SMOOTHED = 2, 8
#: gain with which a drive begins: that of the reference
SAME_GAIN = GAINS.index(0)
#: windows of a path after which its trust is whole
WHOLE_AGE = 8


class BankMap(NamedTuple):
    """Constants of a map.

    Attributes
    ----------
    activity : sequence of int, length K
        A of section 6, of the counted events below.
    typical : sequence of int, length K
        See `specification_drive.typical_distances`.
    mean_activity : int
        Mean of the counted events of the reference's windows, in units of 1/256 event.
    per_window : {1, 2}
        Places per window.
    restart : int
        Cost of a restart, with its fraction bits.
    exclusion : int
        Places on each side of the best one in which no second best is searched.
    along : sequence of int, length K, or empty
        Distance of each place on the reference drive, in millimetres.
    jumps : sequence of (int, int)
    """

    activity: Sequence[int]
    typical: Sequence[int]
    mean_activity: int
    per_window: int
    restart: int
    exclusion: int
    along: Sequence[int] = ()
    jumps: Sequence[tuple[int, int]] = ()

    @property
    def last(self) -> int:
        """Longest step."""
        return len(BANK_COSTS[self.per_window][0]) - 1


def limits_of(counts: Sequence[Sequence[int]]) -> list[int]:
    """Return the largest count of each pixel that is counted, from the windows of the reference.

    At most one window in 50 has more events at this pixel.
    """
    n = len(counts)
    return [sorted(column)[n - 1 - n // 50] for column in zip(*counts, strict=True)]


def counted_events(counts: Sequence[int], limits: Sequence[int]) -> int:
    """Return the events of a window, of which no pixel gives more than its limit."""
    return sum(min(count, most) for count, most in zip(counts, limits, strict=True))


class Filter(NamedTuple):
    """State between two windows.

    Attributes
    ----------
    metrics : sequence of sequences of int, shape (7, K)
    mean_activity : int
        Running mean of the counted events, by which a window is a pause.
    place, gain : int or None, int
        Best place and its gain in the window before.
    few : int
        Windows with few events in a row.
    speed, moved : int
        Mean activity of the drive in units of 1/256 octave, and windows that moved it.
    reciprocals : sequence of int, length 3
        Of each sum in the window before; 0 if it had none.
    """

    metrics: Sequence[Sequence[int]]
    mean_activity: int
    place: int | None = None
    gain: int = SAME_GAIN
    few: int = 0
    speed: int = 0
    moved: int = 0
    reciprocals: Sequence[int] = (0, 0, 0)
    support: int = 0
    age: int = 0
    residuals: tuple[int, int] = (0, 0)


class BankMatch(NamedTuple):
    """Match of a window; second is None if there is none."""

    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int
    trust: int


class Window(NamedTuple):
    """Results of a window that smoothing and the misfit need.

    Attributes
    ----------
    best : int
        Place of the least metric; the match told is the middle of the places near it.
    evidence : sequence of sequences of int, shape (7, K)
    transitions : sequence of Edges, length 7
    by_distance : Edges or None
        In place of them, with odometry: from every gain to every other.
    scale, share : int
        Reciprocal times weight of the evidence against the best place, and the share that odometry
        leaves, in eighths.
    """

    best: int
    gain: int
    metrics: Sequence[Sequence[int]]
    evidence: Sequence[Sequence[int]]
    transitions: Sequence[Edges]
    by_distance: Edges | None
    scale: int
    share: int


def surplus_of(f: int, known: BankMap, state: Filter) -> int:
    """Return the events beyond those of the place before at the slowest speed of its gain."""
    assert state.place is not None
    return f - known.activity[state.place] - min(GAINS[state.gain], 0)


def weight_of(surplus: int, most: int = 8) -> int:
    """Return the weight of the evidence in eighths."""
    return min(max((surplus + 56) >> 1, 0), most)


def change_gain(metrics: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the metrics, less the least, after changes of gain."""
    least = min(map(min, metrics))
    found = [[one - least for one in of_gain] for of_gain in metrics]
    for order in (range(len(found)), range(len(found) - 1, -1, -1)):
        for before, h in pairwise(order):
            changed = [one + GAIN_STEP for one in found[before]]
            found[h] = [min(pair) for pair in zip(found[h], changed, strict=True)]
    return found


def steps_of(known: BankMap, f: int, gain: int, stands: bool) -> Edges:
    """Return all steps of a gain from place to place, also those that lead through a jump."""
    rows, found = BANK_COSTS[known.per_window], []
    for k, of_place in enumerate(known.activity):
        row = 0 if stands else min(max((f - of_place - gain + 4) >> 3, -12), 6) + SAME_ROW
        for step, cost in enumerate(rows[row]):
            if step <= k:
                found.append((k - step, k, cost))
            for a, b in known.jumps:
                origin = a - (step - 1 - (k - b))
                if b <= k < b + step and origin >= 0:
                    found.append((origin, k, cost))
    return found


def which_sum(speed: int, gain: int) -> int:
    """Return the index of the sum that a gain looks at, by the mean speed that it says."""
    return sum((speed >> 4) - gain < limit for limit in SUM_LIMITS)


def middle(metrics: Sequence[int], best: int, per_window: int) -> int:
    """Return the middle of the places near the best, which whole places leave as it is."""
    reach, first, last = 4 if per_window == 2 else 0, best, best
    most = metrics[best] + 8
    while first > max(best - reach, 0) and metrics[first - 1] <= most:
        first -= 1
    while last < min(best + reach, len(metrics) - 1) and metrics[last + 1] <= most:
        last += 1
    return (first + last + 1) >> 1


def follows(known: BankMap, before: int | None, place: int, by_distance: Edges | None) -> bool:
    """Return whether a best place follows that of the window before."""
    if before is None:
        return False
    if by_distance is not None:
        return any((j, k) == (before, place) and cost < known.restart for j, k, cost in by_distance)
    return 0 <= place - before <= known.last or any(
        a >= before and place >= b and (a - before) + (place - b) < known.last
        for a, b in known.jumps
    )


def advance(
    known: BankMap,
    state: Filter,
    distances: Sequence[Sequence[int]],
    counted: int,
    *,
    patience: int = PATIENCE,
    driven: int | None = None,
    driven_whole: int = 0,
) -> tuple[Filter, BankMatch, Window]:
    """Advance the filter by a window, and match it.

    Parameters
    ----------
    distances : sequences of int, shape (3, K)
        Of the sums of the newest 1, 2 and 4 windows to each place.
    counted : int
        See `counted_events`.
    driven, driven_whole : int
        With odometry, the distance that counts and the whole distance of the window.
    """
    places, bank = len(known.activity), range(len(GAINS))
    # what the number of events says
    f = ilog(min(counted, EVENTS_TOP)) - ilog(known.mean_activity >> 8) if counted else -368
    pause, weight = is_pause(counted, state.mean_activity), 8
    few = pause
    if state.place is not None:
        surplus = surplus_of(f, known, state)
        weight, few = weight_of(surplus), pause or surplus < -48
    in_row = min(state.few + 1, patience + 1) if few else 0
    stands = in_row > patience
    # predict
    whole_weight, by_distance = weight, None
    if driven is not None:
        by_distance = transitions_by_distance(known.along, driven, known.per_window, known.jumps)
        weight = min(weight, most_weight(known.along, driven_whole, known.per_window))
    ways = [steps_of(known, f, gain, stands) for gain in GAINS]
    predicted = [[0] * places for _ in bank]
    if state.place is not None and by_distance is not None:
        least = [min(column) for column in zip(*state.metrics, strict=True)]
        once = predict(least, by_distance, known.restart)
        predicted = [[one + GAIN_STEP * (h != state.gain) for one in once] for h in bank]
    elif state.place is not None:
        changed = change_gain(state.metrics)
        for h in bank:
            moved = predict(changed[h], ways[h], known.restart)
            predicted[h] = [one + min(changed[h]) for one in moved]
    # evidence
    speed, moved_windows = state.speed, state.moved
    if not few:
        speed += (16 * f - speed) >> min((1 + moved_windows).bit_length() - 1, 6)
        moved_windows = min(moved_windows + 1, 63)
    looks = [0 if driven is not None else which_sum(speed, gain) for gain in GAINS]
    of_sum, scales, reciprocals = [[0] * places for _ in SUMS], [0] * len(SUMS), [0] * len(SUMS)
    bias = [(one * 4) >> 3 for one in known.typical]
    for i in range(len(SUMS)):
        if pause:
            reciprocals[i] = state.reciprocals[i]
        elif i in looks:
            less = [d - b for d, b in zip(distances[i], bias, strict=True)]
            reciprocals[i] = (1 << 16) // spread_of(less)
            scales[i] = state.reciprocals[i] or reciprocals[i]
            of_sum[i] = evidence_of(less, scales[i], weight)
    evidence = [of_sum[i] for i in looks]
    metrics = [
        [min(p + e, METRIC_TOP) for p, e in zip(*pair, strict=True)]
        for pair in zip(predicted, evidence, strict=True)
    ]
    # best
    least = [min(column) for column in zip(*metrics, strict=True)]
    found = search(least, known.exclusion)
    gain = min(bank, key=lambda h: metrics[h][found.place])
    # trust
    margin = 1023 if found.second_sum is None else found.second_sum - found.sum
    kept = follows(known, state.place, found.place, by_distance)
    support = support_after(state.support if kept else 0, margin, stands=False)
    age = min(state.age + 1, WHOLE_AGE) if kept else 0
    if found.place == state.place:
        before = state.support if kept else 0
        support = min(support, before - (before >> 3))
    residual = min(evidence[gain][found.place], RESIDUAL_TOP)
    worst = max(residual, *state.residuals)
    trust = max(support - 16 * worst, 0) * age // WHOLE_AGE
    after = Filter(
        metrics, mean_activity_after(state.mean_activity, counted), found.place, gain, in_row,
        speed, moved_windows, reciprocals, support, age, (residual, state.residuals[0]),
    )  # fmt: skip
    told = middle(least, found.place, known.per_window)
    match = BankMatch(told, *found[1:], trust)
    share = 8 * weight // whole_weight if whole_weight else 8
    scale = 0 if pause else scales[looks[gain]] * weight
    window = Window(
        found.place, gain, metrics, evidence, ways, by_distance, scale, share if scale else 8
    )
    return after, match, window


assert MARGIN_TOP == RESIDUAL_TOP


def misfit_of(window: Window, evidence: Sequence[int], place: int, typical: int) -> int | None:
    """Return the misfit of a window at a place; None without evidence, as section 10."""
    if not window.scale:
        return None
    mean, share = sum(evidence) // len(evidence), window.share
    advantage = mean - evidence[place] + ((typical * window.scale * 4) >> 20)
    if not share:
        return 0
    nearer = min(max(8 * advantage // share, -23), 23)
    return min(8 * evidence[place] // share, 23) - nearer


def smoothed(known: BankMap, windows: Sequence[Window]) -> list[tuple[int, int, list[int]]]:
    """Return best place, gain and the least costs of whole paths through each place, by window.

    Each gain looks at the same sums backwards as forwards.
    """
    places, bank = len(known.activity), range(len(GAINS))
    to_go, found = [[0] * places for _ in bank], []
    for window in reversed(windows):
        whole = [
            [m + c for m, c in zip(*pair, strict=True)]
            for pair in zip(window.metrics, to_go, strict=True)
        ]
        least = [min(column) for column in zip(*whole, strict=True)]
        best = search(least, known.exclusion).place
        found.append((best, min(bank, key=lambda h: whole[h][best]), least))
        behind = [
            [c + e for c, e in zip(*pair, strict=True)]
            for pair in zip(to_go, window.evidence, strict=True)
        ]
        back = []
        if window.by_distance is not None:
            mirrored = [(k, j, cost) for j, k, cost in window.by_distance]
            behind_all = [min(column) for column in zip(*behind, strict=True)]
            to_go = change_gain([predict(behind_all, mirrored, known.restart)] * len(GAINS))
            continue
        for h in bank:
            mirrored = [(k, j, cost) for j, k, cost in window.transitions[h]]
            moved = predict(behind[h], mirrored, known.restart)
            back.append([one + min(behind[h]) for one in moved])
        to_go = change_gain(back)
    return found[::-1]


# Codes of the sums.


def codes_of_sums(
    counts: Sequence[Sequence[int]], levels: Sequence[int], means: Sequence[int], bits: int,
    paused: Sequence[bool],
) -> list[list[list[int]]]:  # fmt: skip
    """Return the codes of the newest 1, 2 and 4 windows at each window, shape (n, 3, J).

    Parameters
    ----------
    means : sequence of int, length J
        Initial means, as `means.mem` of section 1.
    paused : sequence of bool, length n
        Windows that move no mean.
    """
    running = [[256 * mean for mean in means] for _ in SUMS]
    moves, found = 0, []
    for w, pause in enumerate(paused):
        of_window = []
        for i, number in enumerate(SUMS):
            newest = counts[max(w - number + 1, 0) : w + 1]
            of_sum = [levels[min(sum(one), len(levels) - 1)] for one in zip(*newest, strict=True)]
            differences = differences_of(of_sum, running[i])
            shared = window_mean(differences)
            of_window.append([own_mean_code(one - shared, bits) for one in differences])
            if not pause:
                running[i] = means_after(running[i], of_sum, mean_shift(moves))
        moves += not pause
        found.append(of_window)
    return found


def distances_of(
    codes: Sequence[Sequence[int]], places: Sequence[Sequence[int]]
) -> list[list[int]]:
    """Return the distances of the codes of the sums of a window to every place, shape (3, K)."""
    return [[distance(of_sum, place) for place in places] for of_sum in codes]
