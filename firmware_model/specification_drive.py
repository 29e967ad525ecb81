"""Section 10 of docs/specification.md as a program: matching of drives on a computer only.

Smoothing, odometry, jumps, unseen time and misfit extend the place filter of `specification`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise, product
from typing import NamedTuple

from firmware_model.specification import (
    Costs,
    Edges,
    Filter,
    activity_of,
    advance,
    distance,
    is_pause,
    judge,
    margin_of,
    mean_activity_after,
    predict,
    row_of,
    search,
    transitions_by_steps,
    weight_of,
)
from fixedpoint.activity import EVENTS_TOP

Rows = Sequence[Sequence[int]]


class DriveMatch(NamedTuple):
    """Match of a window by more than the windows before it; second is None if there is none."""

    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int
    trust: int


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
    found: list[int | None] = []
    since_anchor = 0
    for distance_mm in driven:
        since_anchor += distance_mm or 0
        if distance_mm is None:
            found.append(None)
        elif 2 * abs(distance_mm) < spacing and abs(since_anchor) < spacing:
            found.append(0)
        else:
            found.append(since_anchor)
            since_anchor = 0
    return found


def transitions_by_distance(
    along: Sequence[int], driven: int, per_window: int, jumps: Sequence[tuple[int, int]]
) -> Edges:
    """Return the transitions between all places, with costs by the driven distance."""
    spacing, last = spacing_of(along), len(along) - 1
    rate = (1 << 19) // (spacing * per_window)

    def cost(length: int) -> int:
        return (abs(length - driven) * rate) >> 16

    every = range(last + 1)
    found = [(j, k, cost(along[k] - along[j])) for j in every for k in every]
    for a, b in jumps:
        for j in range(max(a - 7, 0), a + 1):
            for k in range(b, min(b + 7, last) + 1):
                length = along[a] - along[j] + spacing + along[k] - along[b]
                found.append((j, k, cost(length)))
    return found


def most_weight(along: Sequence[int], driven: int, per_window: int) -> int:
    """Return the largest weight of the evidence after a driven distance."""
    window = spacing_of(along) * per_window
    return min((8 * abs(driven) + window - 1) // window, 8)


# Jumps.


def steps_and_jumps(
    costs: Costs,
    activity: int,
    place_activity: Sequence[int],
    jumps: Sequence[tuple[int, int]],
) -> Edges:
    """Return the steps of a window, also those that lead through a jump."""
    found = transitions_by_steps(costs, activity, place_activity)
    for k, of_place in enumerate(place_activity):
        row = costs.rows[row_of(activity - of_place)]
        for (a, b), step in product(jumps, range(1, len(row))):
            origin = a - (step - 1 - (k - b))
            if b <= k < b + step and origin >= 0:
                found.append((origin, k, row[step]))
    return found


# Unseen time.


def spread(metrics: Sequence[int], steps: int, jumps: Sequence[tuple[int, int]]) -> list[int]:
    """Return the least metric from which up to so many steps lead to each place."""
    found = list(metrics)
    for _ in range(min(steps, len(found))):
        reached = [found[0], *(min(pair) for pair in pairwise(found))]
        for a, b in jumps:
            reached[b] = min(reached[b], found[a])
        found = reached
    return found


# Misfit.


def typical_distances(places: Rows) -> list[int]:
    """Return the mean distance of each place to all places, less the mean of these means."""
    means = [sum(distance(a, b) for b in places) // len(places) for a in places]
    return [mean - sum(means) // len(means) for mean in means]


def running_misfits(of_windows: Sequence[int | None]) -> list[int]:
    """Return the misfit after each window; `of_windows` has None for those without evidence."""
    mean, found = -1280, []
    for one in of_windows:
        if one is not None:
            mean += (256 * one - mean) >> 4
        found.append(max((mean >> 4) + 80, 0))
    return found


def smoothed_misfits(of_windows: Sequence[int | None]) -> list[int]:
    """Return the misfit of each window by up to 16 windows on each side of it."""
    found = []
    for w in range(len(of_windows)):
        near = [one for one in of_windows[max(w - 16, 0) : w + 17] if one is not None]
        found.append(max(16 * sum(near) // len(near) + 80, 0) if near else 0)
    return found


def confidence_of(trust: int, misfit: int) -> int:
    """Return the net trust, which determines the probability; sequences have a misfit of -1."""
    return trust if misfit < 0 else min(trust, 368) - 4 * misfit


# A drive.


def possible_starts(counted: Sequence[int], mean_activity: int) -> tuple[int, ...]:
    """Return where the mean activity of a smoothed drive may start; first as the reference's."""
    own = min(256 * sum(counted) // len(counted), 256 * EVENTS_TOP)
    far = 2 * own <= mean_activity or own >= 2 * mean_activity
    return (mean_activity, own) if far else (mean_activity,)


class Drive:
    """A drive of n windows, matched to K places by the place filter.

    Parameters
    ----------
    exclusion : int
        Places on each side of the best one in which no second best is searched.
    distances : sequences of int, shape (n, K)
        Of each window to each place.
    counted : sequence of int, length n
        Events of each window.
    mean_activity : int
        Mean activity before the first window.
    place_activity : sequence of int, length K
    per_window : {1, 2}
        Places per window.
    along : sequence of int, length K, optional
        Distance of each place on the reference drive.
    driven : sequence of int or None, length n, optional
        Distance between the newest readings of the odometer in a window and in the one before.
    begin : Filter, optional
        State of the filter before these windows.
    unseen : sequence of int, length n, optional
        Halves of a window in which nothing was seen, as known in each window.

    Attributes
    ----------
    metrics, evidence : lists of lists of int, shape (n, K)
    """

    def __init__(
        self,
        costs: Costs,
        exclusion: int,
        distances: Rows,
        counted: Sequence[int],
        mean_activity: int,
        place_activity: Sequence[int],
        *,
        per_window: int = 1,
        jumps: Sequence[tuple[int, int]] = (),
        along: Sequence[int] = (),
        driven: Sequence[int | None] = (),
        begin: Filter | None = None,
        unseen: Sequence[int] = (),
    ) -> None:
        self.costs, self.exclusion, self.jumps = costs, exclusion, jumps
        raw = driven or [None] * len(distances)
        self.driven = anchored(raw, spacing_of(along)) if along else raw
        self.begin = begin or Filter([0] * len(place_activity))
        self.unseen, self.per_window = unseen or [0] * len(distances), per_window
        self.metrics: list[Sequence[int]] = []
        self.evidence: list[list[int]] = []
        self.transitions: list[Edges] = []
        #: reciprocal times weight of each window, and the share that odometry leaves, in eighths
        self.scales: list[tuple[int, int]] = []
        state, mean = self.begin, mean_activity
        for row, count, of_anchor, mm, halves in zip(
            distances, counted, self.driven, raw, self.unseen, strict=True
        ):
            state = state._replace(metrics=spread(state.metrics, halves * per_window, jumps))
            paused, activity = is_pause(count, mean), activity_of(count, mean)
            mean = mean_activity_after(mean, count)
            whole = weight = weight_of(activity)
            if of_anchor is None or mm is None:
                ways = steps_and_jumps(costs, activity, place_activity, jumps)
            else:
                ways = transitions_by_distance(along, of_anchor, per_window, jumps)
                weight = weight_of(activity, most_weight(along, mm, per_window))
            predicted = [0] * len(place_activity)
            if state.place is not None:
                predicted = predict(state.metrics, ways, costs.restart)
            before = state.reciprocal
            state, evidence = advance(state, predicted, None if paused else row, weight)
            # the first window has no place before it
            state = state._replace(place=0)
            self.transitions.append(ways)
            self.metrics.append(state.metrics)
            self.evidence.append(evidence)
            scale = 0 if paused else (before or state.reciprocal) * weight
            self.scales.append((scale, 8 * weight // whole if scale else 8))

    def whole(self, w: int) -> list[int]:
        """Return the cost of the whole path through each place in window w."""
        cost_to_go = [0] * len(self.metrics[0])
        end = len(cost_to_go) - 1
        for v in range(len(self.metrics) - 1, w, -1):
            total = [e + g for e, g in zip(self.evidence[v], cost_to_go, strict=True)]
            mirrored = [(k, j, cost) for j, k, cost in self.transitions[v]]
            cost_to_go = predict(total, mirrored, self.costs.restart)
            jumps = [(end - b, end - a) for a, b in self.jumps]
            cost_to_go = spread(cost_to_go[::-1], self.unseen[v] * self.per_window, jumps)[::-1]
        return [m + g for m, g in zip(self.metrics[w], cost_to_go, strict=True)]

    def follows(self, w: int, before: int | None, place: int) -> bool:
        """Return whether a match of window w follows the one before."""
        if before is None:
            return False
        if self.driven[w] is not None:
            return any(
                (j, k) == (before, place) and cost < self.costs.restart
                for j, k, cost in self.transitions[w]
            )
        if 0 <= place - before <= self.costs.last:
            return True
        return any(
            a >= before and place >= b and (a - before) + (place - b) < self.costs.last
            for a, b in self.jumps
        )

    def smoothed(self) -> list[DriveMatch]:
        """Return the match of each window by the whole drive."""
        n = len(self.metrics)
        best = [search(self.whole(w), self.exclusion) for w in range(n)]
        places, margins = [one.place for one in best], [margin_of(one) for one in best]
        chained = [False, *(self.follows(w, *pair) for w, pair in enumerate(pairwise(places), 1))]
        # no window speaks for one beyond unseen time
        chained = [one and not self.unseen[w] for w, one in enumerate(chained)]
        alike = [len(list(same)) for _, same in groupby(places)]
        row = [size for size in alike for _ in range(size)]
        terms = []
        for size, margin in zip(row, margins, strict=True):
            term = 16 * margin
            for _ in range(size - 1):
                term -= term >> 4
            terms.append(term)
        found = []
        for w in range(n):
            first, last = w, w
            while first > max(w - 4, 0) and chained[first]:
                first -= 1
            while last < min(w + 4, n - 1) and chained[last + 1]:
                last += 1
            near = range(max(w - 4, 0), min(w + 4, n - 1) + 1)
            worst = max(self.evidence[v][places[v]] for v in near)
            trust = max(sum(terms[first : last + 1]) // 9 - 16 * worst, 0)
            found.append(DriveMatch(*best[w], trust))
        return found

    def live(self) -> list[DriveMatch]:
        """Return the match of each window by the windows before it, as in section 6."""
        state, found = self.begin, []
        for w, row in enumerate(self.metrics):
            one = search(row, self.exclusion)
            if self.unseen[w]:
                state = state._replace(support=0)
            follows = self.follows(w, state.place, one.place)
            state, trust = judge(state, one, self.evidence[w][one.place], follows)
            found.append(DriveMatch(*one, trust.trust))
        return found

    def misfits(self, places: Sequence[int], typical: Sequence[int]) -> list[int | None]:
        """Return the misfit of each window matched to these places; None without evidence.

        Parameters
        ----------
        typical : sequence of int, length K
            See `typical_distances`.
        """
        found: list[int | None] = []
        for evidence, place, (scale, share) in zip(self.evidence, places, self.scales, strict=True):
            mean = sum(evidence) // len(evidence)
            advantage = mean - evidence[place] + ((typical[place] * scale) >> 17)
            against = min(8 * evidence[place] // share, 23) if share else 0
            nearer = min(max(8 * advantage // share, -23), 23) if share else 0
            found.append(against - nearer if scale else None)
        return found


def likelier(starts: Sequence[Drive]) -> Drive:
    """Return the drive whose smoothed matches have the most trust; the first of equal ones."""
    return max(starts, key=lambda drive: sum(match.trust for match in drive.smoothed()))
