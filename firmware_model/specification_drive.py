"""What only a computer adds to a device, to the bit; section 10 of docs/specification.md lists it.

Smoothing, odometry, unseen time and misfit extend the place filter of `specification`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

from firmware_model.specification import (
    GAIN_STEP,
    PATIENCE,
    Advanced,
    Best,
    Edges,
    Filter,
    FilterMap,
    Rows,
    activity_of,
    add,
    best,
    change_gain,
    differences_of,
    distance,
    evidence,
    is_pause,
    mean_activity_after,
    mean_shift,
    means_after,
    move,
    own_mean_code,
    predict,
    see,
    state_after,
    steps_of,
    sums_of,
    trust,
    window_mean,
)
from fixedpoint.activity import BANK_COSTS, GAINS

#: patience of a whole drive, see `specification.PATIENCE`
PATIENCE_SMOOTHED = 8
#: windows of a number of events say nothing about the speed: costs of steps in every row
COUNT_COSTS = {1: (4, 0, 0, 4), 2: (4, 0, 0, 0, 0, 4)}


# Constants of a map.


def limits_of(counts: Rows) -> list[int]:
    """Return the most events of each pixel that count, from the windows of the reference.

    At most one window in 50 has more events at this pixel.
    """
    n = len(counts)
    return [sorted(column)[n - 1 - n // 50] for column in zip(*counts, strict=True)]


def typical_distances(places: Rows) -> list[int]:
    """Return the mean distance of each place to all places, less the mean of these means."""
    means = [sum(distance(a, b) for b in places) // len(places) for a in places]
    return [mean - sum(means) // len(means) for mean in means]


def bias_of(typical: Sequence[int]) -> list[int]:
    """Return what is added to the distances of each place, from the typical distances."""
    parts = [(4 * one) >> 3 for one in typical]
    return [min(max(parts) - part, 255) for part in parts]


class DriveMap(NamedTuple):
    """What a map says about drives.

    Attributes
    ----------
    filter : FilterMap
    typical : sequence of int, length K
        See `typical_distances`.
    mean_activity : int
        Mean of the events that count of the reference's windows, in units of 1/256 event.
    along : sequence of int, length K, or empty
        Distance of each place on the reference drive, in millimetres.
    """

    filter: FilterMap
    typical: Sequence[int]
    mean_activity: int
    along: Sequence[int] = ()

    @classmethod
    def of(
        cls,
        activity: Sequence[int],
        typical: Sequence[int],
        mean_activity: int,
        per_window: int,
        restart: int,
        exclusion: int,
        along: Sequence[int] = (),
        gains: Sequence[int] = GAINS,
        by_count: bool = False,
    ) -> DriveMap:
        """Return the map with the bias of these typical distances, and its costs of steps."""
        costs: Rows = BANK_COSTS[per_window]
        if by_count:
            costs = (COUNT_COSTS[per_window],) * len(costs)
        of_filter = FilterMap(
            activity, bias_of(typical), per_window, restart, exclusion, gains, costs
        )
        return cls(of_filter, typical, mean_activity, along)

    def begin(self) -> Filter:
        """Return the filter before the first window."""
        return Filter([[0] * len(self.typical) for _ in self.filter.gains])


# Odometry.


def spacing_of(along: Sequence[int]) -> int:
    """Return the mean distance between two places, at least 1, in millimetres."""
    return max((along[-1] - along[0]) // max(len(along) - 1, 1), 1)


def anchored(driven: Sequence[int | None], spacing: int) -> list[int | None]:
    """Return the counted distances: short ones accumulate until they reach a place.

    Parameters
    ----------
    driven : sequence of int or None
        Newest reading of each window less that of the window before, None without both.
    """
    that_count: list[int | None] = []
    since_anchor = 0
    for distance_mm in driven:
        since_anchor += distance_mm or 0
        if distance_mm is None:
            that_count.append(None)
        elif 2 * abs(distance_mm) < spacing and abs(since_anchor) < spacing:
            that_count.append(0)
        else:
            that_count.append(since_anchor)
            since_anchor = 0
    return that_count


def transitions_by_distance(along: Sequence[int], driven: int, per_window: int) -> Edges:
    """Return the transitions between all places, with costs by the driven distance."""
    rate = (1 << 19) // (spacing_of(along) * per_window)

    def cost(length: int) -> int:
        return (abs(length - driven) * rate) >> 16

    every = range(len(along))
    return [(j, k, cost(along[k] - along[j])) for j in every for k in every]


def most_weight(along: Sequence[int], driven: int, per_window: int) -> int:
    """Return the largest weight of the evidence after a driven distance."""
    window = spacing_of(along) * per_window
    return min((8 * abs(driven) + window - 1) // window, 8)


def sum_by_distance(most: int) -> int:
    """Return which sum of windows every gain looks at, by the distance driven in one of them."""
    return int(most <= 5) + int(most <= 2)


# A window of a drive.


class Window(NamedTuple):
    """Results of a window.

    Attributes
    ----------
    advanced : Advanced
    steps : sequence of Edges
        Of each gain.
    by_distance : Edges or None
        In place of them, with odometry: from every gain to every other.
    share : int
        What odometry leaves of the weight of the evidence, in eighths.
    unseen : int
        Halves of a window in which nothing was seen, as known in this window.
    seen : bool
        Whether it has an event of the whole sensor.
    """

    advanced: Advanced
    steps: Sequence[Edges]
    by_distance: Edges | None
    share: int
    unseen: int = 0
    seen: bool = True

    @property
    def metrics(self) -> Rows:
        """M, of each gain and place."""
        return self.advanced.state.metrics

    def evidence(self, gain: int) -> Sequence[int]:
        """Return the evidence of the sum that a gain, by its index, looks at."""
        return self.advanced.evidence.against[self.advanced.seen.looks[gain]]

    def factor(self, gain: int) -> int:
        """Return the reciprocal times the weight by which it was made; 0 in a pause."""
        seen = self.advanced.seen
        return self.advanced.evidence.scales[seen.looks[gain]] * seen.weight


def advance_window(
    drive_map: DriveMap,
    state: Filter,
    activity: int,
    paused: bool,
    distances: Rows,
    *,
    patience: int = PATIENCE,
    driven: int | None = None,
    most: int = 8,
    most_before: int = 0,
) -> Window:
    """Advance the filter by a window: `specification.advance`, with odometry.

    Parameters
    ----------
    driven : int, optional
        With odometry, the distance that counts.
    most, most_before : int
        Then, the largest weights of this window and of the one before it.
    """
    of_filter = drive_map.filter
    seen = see(of_filter, state, activity, paused, patience)
    whole, by_distance = seen.weight, None
    if driven is not None:
        by_distance = transitions_by_distance(drive_map.along, driven, of_filter.per_window)
        look = sum_by_distance(max(most, most_before)) if len(distances) > 1 else 0
        seen = seen._replace(weight=min(whole, most), looks=[look] * len(seen.looks))
    steps = [steps_of(of_filter, seen, gain) for gain in of_filter.gains]
    if by_distance is None:
        predicted = predict(of_filter, state, steps)
    else:
        predicted = predict_by_distance(of_filter, state, by_distance)
    against = evidence(of_filter, state, seen, distances)
    metrics = add(predicted, against, seen.looks)
    match = best(of_filter, metrics)
    follows = is_reached(drive_map, state.place, match.place, by_distance)
    judged = trust(state, match, against.against[seen.looks[match.gain]][match.place], follows)
    after = state_after(state, seen, against, metrics, match, judged)
    share = 8 * seen.weight // whole if whole and not paused else 8
    return Window(
        Advanced(after, seen, predicted, against, match, judged), steps, by_distance, share
    )


def predict_by_distance(
    filter_map: FilterMap, state: Filter, by_distance: Edges
) -> list[list[int]]:
    """Return the predictions by a driven distance, which is the same for every gain."""
    if state.place is None:
        return predict(filter_map, state, ())
    least = [min(column) for column in zip(*state.metrics, strict=True)]
    once = move([one - min(least) for one in least], by_distance, filter_map.restart)
    return [
        [one + GAIN_STEP * (h != state.gain) for one in once] for h in range(len(filter_map.gains))
    ]


def is_reached(
    drive_map: DriveMap, before: int | None, place: int, by_distance: Edges | None
) -> bool:
    """Return whether a best place follows that of the window before."""
    if before is None:
        return False
    if by_distance is not None:
        return any(
            (j, k) == (before, place) and cost < drive_map.filter.restart
            for j, k, cost in by_distance
        )
    return 0 <= place - before <= drive_map.filter.last


# The rest of a drive.


def smoothed(drive_map: DriveMap, windows: Sequence[Window]) -> list[tuple[Best, Rows]]:
    """Return the best place of each window by the whole drive, and the costs of whole paths.

    Each gain looks at the same sums backwards as forwards.
    """
    to_go: Rows = drive_map.begin().metrics
    of_windows: list[tuple[Best, Rows]] = []
    for window in reversed(windows):
        whole = _sums(window.metrics, to_go)
        of_windows.append((best(drive_map.filter, whole), whole))
        behind = _sums(to_go, [window.evidence(h) for h in range(len(to_go))])
        to_go = change_gain(_before(drive_map, window, behind))
        if window.unseen:
            steps = window.unseen * drive_map.filter.per_window
            to_go = [spread(row[::-1], steps)[::-1] for row in to_go]
    return of_windows[::-1]


def _sums(one: Rows, other: Rows) -> list[list[int]]:
    return [
        [a + b for a, b in zip(row, also, strict=True)]
        for row, also in zip(one, other, strict=True)
    ]


def _before(drive_map: DriveMap, window: Window, behind: Rows) -> list[list[int]]:
    """Return the least costs before a window: the steps of each gain, mirrored."""
    restart = drive_map.filter.restart
    if window.by_distance is not None:
        least = [min(column) for column in zip(*behind, strict=True)]
        return [move(least, _mirrored(window.by_distance), restart)] * len(behind)
    pairs = zip(behind, window.steps, strict=True)
    return [move(row, _mirrored(steps), restart) for row, steps in pairs]


def _mirrored(edges: Edges) -> Edges:
    return [(target, origin, cost) for origin, target, cost in edges]


# A drive.


class DriveMatch(NamedTuple):
    """Match of a window of a drive; second is None if there is none."""

    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int
    trust: int


def _match_of(one: Best, trust_in_it: int) -> DriveMatch:
    return DriveMatch(*one.nearest._replace(place=one.told), trust_in_it)


def windows_of(
    drive_map: DriveMap,
    distances: Sequence[Rows],
    counted: Sequence[int],
    driven: Sequence[int | None] = (),
    *,
    patience: int = PATIENCE,
    unseen: Sequence[int] = (),
    seen: Sequence[bool] = (),
) -> list[Window]:
    """Advance the filter by the n windows of a drive.

    Parameters
    ----------
    distances : sequence of Rows, shape (n, 1 or 3, K)
        Of the sums of each window to each place.
    counted : sequence of int, length n
        Events that count of each window.
    driven : sequence of int or None, length n, optional
        Distance between the newest readings of the odometer in a window and in the one before.
    unseen : sequence of int, length n, optional
        Halves of a window in which nothing was seen, as known in each window. A gap without an
        event of the whole sensor, from a (the start, or an event) to the next event b, counts if it
        is a quarter of a window (and 1 us) or longer: as ``ceil((b - a) / max(window // 2, 1))``
        halves, the first in the window that holds a plus a quarter of a window, the others in the
        window that holds b.
    seen : sequence of bool, length n, optional
        Whether each window has an event of the whole sensor.
    """
    state, mean = drive_map.begin(), drive_map.mean_activity
    raw = driven or [None] * len(counted)
    that_counts = anchored(raw, spacing_of(drive_map.along)) if drive_map.along else raw
    advanced, most_before = [], 0
    halves, with_events = unseen or [0] * len(counted), seen or [True] * len(counted)
    for rows, events, of_anchor, mm, gap, has_event in zip(
        distances, counted, that_counts, raw, halves, with_events, strict=True
    ):
        if gap:
            steps = gap * drive_map.filter.per_window
            metrics = [spread(row, steps) for row in state.metrics]
            state = state._replace(metrics=metrics, support=0, age=0)
        of_mean = drive_map.mean_activity if len(drive_map.filter.gains) > 1 else mean
        most = 0
        if mm is not None:
            most = most_weight(drive_map.along, mm, drive_map.filter.per_window)
        window = advance_window(
            drive_map, state, activity_of(events, of_mean), is_pause(events, mean), rows,
            patience=patience, driven=of_anchor, most=most, most_before=most_before,
        )  # fmt: skip
        most_before = most
        state, mean = window.advanced.state, mean_activity_after(mean, events)
        advanced.append(window._replace(unseen=gap, seen=has_event))
    return advanced


def live_matches(windows: Sequence[Window]) -> list[DriveMatch]:
    """Return the match of each window by the windows before it."""
    return [_match_of(one.advanced.best, one.advanced.trust.trust) for one in windows]


def smoothed_matches(drive_map: DriveMap, windows: Sequence[Window]) -> list[DriveMatch]:
    """Return the match of each window by the whole drive."""
    n, bests = len(windows), [one for one, _ in smoothed(drive_map, windows)]
    places = [one.place for one in bests]
    pairs = enumerate(pairwise(places), 1)
    chained = [False, *(is_reached(drive_map, *pair, windows[w].by_distance) for w, pair in pairs)]
    # no window speaks for one beyond unseen time
    chained = [one and not window.unseen for one, window in zip(chained, windows, strict=True)]
    alike = [len(list(same)) for _, same in groupby(places)]
    row = [size for size in alike for _ in range(size)]
    terms = []
    for size, one in zip(row, bests, strict=True):
        second = one.nearest.second_sum
        term = 16 * (1023 if second is None else second - one.nearest.sum)
        for _ in range(size - 1):
            term -= term >> 4
        terms.append(term)
    against = [w.evidence(one.gain)[one.place] for w, one in zip(windows, bests, strict=True)]
    trusts = []
    for w in range(n):
        first, last = w, w
        while first > max(w - 16, 0) and chained[first]:
            first -= 1
        while last < min(w + 16, n - 1) and chained[last + 1]:
            last += 1
        worst = max(against[max(w - 4, 0) : w + 5])
        trusts.append(max(sum(terms[first : last + 1]) // 33 - 16 * worst, 0))
    part, parts, held = 0, [], [0] * n  # between two gaps
    for window in windows:
        part += window.unseen > 0
        parts.append(part)
    for part in set(parts):
        of_part = [w for w in range(n) if parts[w] == part and windows[w].seen]
        for w, most in zip(of_part, held_trust([trusts[w] for w in of_part]), strict=True):
            held[w] = most
    return [_match_of(one, most) for one, most in zip(bests, held, strict=True)]


def held_trust(trusts: Sequence[int]) -> list[int]:
    """Return the largest trust that all windows of a stretch around each window have."""
    n, long = len(trusts), min(33, (len(trusts) + 1) // 2)
    least = [min(trusts[w : w + long]) for w in range(n - long + 1)] if n else []
    return [max(least[max(w - long + 1, 0) : w + 1]) for w in range(n)]


# Codes of the sums.


def codes_of_sums(
    counts: Rows, levels: Sequence[int], means: Sequence[int], bits: int, paused: Sequence[bool],
    number: int = 3,
) -> list[list[list[int]]]:  # fmt: skip
    """Return the contrast codes of the newest 1, 2 and 4 windows at each window, section 4.

    Parameters
    ----------
    means : sequence of int, length J
        Initial means.
    paused : sequence of bool, length n
        Windows that move no mean.
    number : int
        Number of sums.

    Returns
    -------
    lists of int, shape (n, number, J)
    """
    running: list[Sequence[int]] = [[256 * mean for mean in means]] * number
    moves, codes_of = 0, []
    for w, pause in enumerate(paused):
        newest = [counts[v] if v >= 0 else [0] * len(means) for v in range(w, w - 4, -1)]
        of_window = []
        for i, sums in enumerate(sums_of(newest, number)):
            of_sum = [levels[min(one, len(levels) - 1)] for one in sums]
            differences = differences_of(of_sum, running[i])
            shared = window_mean(differences)
            of_window.append([own_mean_code(one - shared, bits) for one in differences])
            if not pause:
                running[i] = means_after(running[i], of_sum, mean_shift(moves))
        moves += not pause
        codes_of.append(of_window)
    return codes_of


# Unseen time.


def spread(metrics: Sequence[int], steps: int) -> list[int]:
    """Return the least metric from which up to so many steps lead to each place."""
    lowered = list(metrics)
    for _ in range(min(steps, len(lowered))):
        lowered = [lowered[0], *(min(pair) for pair in pairwise(lowered))]
    return lowered


# Misfit.


def misfit_of(window: Window, gain: int, place: int, typical: int) -> int | None:
    """Return the misfit of a window at a place with a gain; None without evidence."""
    factor, share, against = window.factor(gain), window.share, window.evidence(gain)
    if not factor:
        return None
    mean = sum(against) // len(against)
    advantage = 8 * (mean - against[place] + ((4 * typical * factor) >> 20)) // share
    return min(8 * against[place] // share, 23) - min(max(advantage, -23), 23)


def running_misfits(of_windows: Sequence[int | None]) -> list[int]:
    """Return the misfit after each window; `of_windows` has None for those without evidence."""
    mean, misfits = -1280, []
    for one in of_windows:
        if one is not None:
            mean += (256 * one - mean) >> 4
        misfits.append(max((mean >> 4) + 80, 0))
    return misfits


def smoothed_misfits(of_windows: Sequence[int | None]) -> list[int]:
    """Return the misfit of each window by up to 16 windows on each side of it."""
    misfits = []
    for w in range(len(of_windows)):
        near = [one for one in of_windows[max(w - 16, 0) : w + 17] if one is not None]
        misfits.append(max(16 * sum(near) // len(near) + 80, 0) if near else 0)
    return misfits


def confidence_of(trust: int, misfit: int) -> int:
    """Return the net trust, which determines the probability; sequences have a misfit of -1."""
    return trust if misfit < 0 else min(trust, 368) - 4 * misfit
