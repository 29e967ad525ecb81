"""What a device computes between an event and a match: docs/specification.md as a program.

Sections and symbols are those of the page. Functions are pure; `Machine` has the state of a device.
It generates the golden vectors, and every other implementation is tested against it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

from firmware_model.design import (
    EVIDENCE_TOP,
    FRACTION_BITS,
    LEVELS,
    MARGIN_TOP,
    METRIC_TOP,
    RESIDUAL_TOP,
    Design,
)
from firmware_model.memories import Codes, Memories
from fixedpoint.activity import BANK_COSTS, EVENTS_TOP, GAINS, SAME_ROW, SUM_LIMITS, SUMS

#: origin, target and cost of each transition between places in a window
Edges = list[tuple[int, int, int]]
#: a row of numbers for each gain, sum or window
Rows = Sequence[Sequence[int]]


class Event(NamedTuple):
    """One event as the sensor sends it."""

    t: int
    x: int
    y: int
    on: bool


# Section 9: records, and intermediate results of a window for debugging.


class EventResult(NamedTuple):
    """Result of one event; slot None and count 0 if its pixel is not selected."""

    number: int
    slot: int | None
    counted: int


class WindowResult(NamedTuple):
    """A window that ended, and the number of events before its end."""

    number: int
    events: int
    codes: Codes


class MatchResult(NamedTuple):
    """One match; second and second_sum are None if every place lies in the exclusion zone.

    With the place filter `place` is the middle that is told, the two sums are metrics, and there is
    a trust, in 1/16 of a metric.
    """

    window: int
    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int
    accepted: bool
    trust: int | None = None


class WindowState(NamedTuple):
    """Intermediate results of a window of a design with pauses, for debugging."""

    window: int
    counted: int  #: Events that count.
    mean_activity: int  #: Mean number of them before this window, in units of 1/256 event.
    activity: int  #: f
    paused: bool
    mean_shift: int | None  #: With contrast codes.
    window_mean: int | None  #: With contrast codes, of the sum of one window.
    # of the filter
    weight: int | None = None  #: 0 in a pause.
    few: int | None = None
    stands: bool | None = None
    speed: int | None = None  #: With several gains.
    sums: int | None = (
        None  #: Those that some gain looks at: 1, 2 and 4 windows by bits 0, 1 and 2.
    )
    best: int | None = None
    gain: int | None = None  #: Of the best place, in units of 1/16 octave.
    least: int | None = None  #: Least metric.
    # of the sum that this gain looks at; None in a pause
    reciprocal: int | None = None  #: Scale of the evidence.
    spread: int | None = None  #: Of the distances with their bias.
    margin: int | None = None
    kept: int | None = None
    support: int | None = None
    age: int | None = None
    worst_residual: int | None = None


Result = EventResult | WindowResult | MatchResult


# Section 3: events that count, pause and activity.


def counted_events(counts: Sequence[int], limits: Sequence[int]) -> int:
    """Return the events of a window, of which no pixel gives more than its limit."""
    return sum(min(count, most) for count, most in zip(counts, limits, strict=True))


def ilog(number: int) -> int:
    """Return ``floor(16 log2(1 + number))``, exact."""
    return int(((number + 1) ** 16).bit_length()) - 1


def is_pause(counted: int, mean_activity: int) -> bool:
    """Return whether a window has no events, or less than 1/8 of the mean number."""
    return counted == 0 or counted * 256 * 8 < mean_activity


def activity_of(counted: int, mean_activity: int) -> int:
    """Return the logarithm of a window's events less that of a mean number, in 1/16 octave."""
    if counted == 0:
        return -ilog(EVENTS_TOP)
    return ilog(min(counted, EVENTS_TOP)) - ilog(mean_activity >> 8)


def mean_activity_after(mean_activity: int, counted: int) -> int:
    """Return the mean number of events, in units of 1/256 event, after a window."""
    if is_pause(counted, mean_activity):
        return mean_activity + (-mean_activity >> 10)
    return mean_activity + ((min(counted, EVENTS_TOP) * 256 - mean_activity) >> 6)


# Section 4: contrast codes.


def sums_of(newest: Sequence[Sequence[int]], number: int) -> list[list[int]]:
    """Return the counts of the first sums of the newest 1, 2 and 4 windows, newest first."""
    return [[sum(counts) for counts in zip(*newest[:n], strict=True)] for n in SUMS[:number]]


def differences_of(levels: Sequence[int], means: Sequence[int]) -> list[int]:
    """Return the level of each counter less its rounded mean."""
    return [level - ((mean + 128) >> 8) for level, mean in zip(levels, means, strict=True)]


def window_mean(differences: Sequence[int]) -> int:
    """Return the mean of a window's differences, rounded, halves up."""
    slots = len(differences)
    return (2 * sum(differences) + slots) // (2 * slots)


def own_mean_code(difference: int, bits: int) -> int:
    """Return the code of a difference: octaves, rounded and saturated."""
    half = 1 << (bits - 1)
    return min(max((difference + 128) >> 8, -half), half - 1) + half


def mean_shift(moves: int) -> int:
    """Return the shift of the update of the means after a number of windows that are no pause."""
    return min((16 + moves).bit_length() - 1, 8)


def means_after(means: Sequence[int], levels: Sequence[int], shift: int) -> list[int]:
    """Return the means after a window that is no pause."""
    pairs = zip(means, levels, strict=True)
    return [mean + ((256 * level - mean) >> shift) for mean, level in pairs]


# Sections 5, 7 and 8: distances, sequences, search and acceptance.


def distance(codes: Sequence[int], place: Sequence[int]) -> int:
    """Return the sum of absolute differences of the codes of a window and of a place."""
    return sum(abs(a - b) for a, b in zip(codes, place, strict=True))


def sequence_sums(history: Sequence[Sequence[int]]) -> list[int]:
    """Return the sums of sequences that end at places L - 1 and above.

    Parameters
    ----------
    history : sequence of L sequences of int
        Distances of the last L windows to all places, newest first.
    """
    ends = range(len(history) - 1, len(history[0]))
    return [sum(row[k - ago] for ago, row in enumerate(history)) for k in ends]


class BestPlaces(NamedTuple):
    """Best place, second best outside the exclusion zone, and ties with the best."""

    place: int
    sum: int
    second: int | None
    second_sum: int | None
    ties: int


def search(sums: Sequence[int], exclusion: int, first: int = 0) -> BestPlaces:
    """Find the best and second best of the sums of places from `first` on."""
    least = min(sums)
    best = sums.index(least)
    outside = [k for k in range(len(sums)) if abs(k - best) > exclusion]
    ties = sum(one == least for one in sums) - 1
    if not outside:
        return BestPlaces(first + best, least, None, None, ties)
    second = min(outside, key=lambda k: sums[k])
    return BestPlaces(first + best, least, first + second, sums[second], ties)


def accepts(design: Design, places: BestPlaces, trust: int) -> bool:
    """Return whether a match is accepted; the trust is that of the filter."""
    if design.filters:
        return places.second is not None and trust >= design.trust
    return places.sum <= design.largest_sum


# Section 6: the place filter.

#: cost of a change of gain by half an octave
GAIN_STEP = 24
#: a window has few events below this surplus
FEW_BELOW = -48
#: after more windows with few events in a row, the robot stands
PATIENCE = 2
#: windows of a path after which its trust is whole
WHOLE_AGE = 8


class FilterMap(NamedTuple):
    """What a map says to the place filter.

    Attributes
    ----------
    activity : sequence of int, length K
        A.
    bias : sequence of int, length K
        b, which is added to the distances.
    per_window : {1, 2}
        Places per window.
    restart : int
        Cost of a restart, with its fraction bits.
    exclusion : int
    gains : sequence of int
        G, in units of 1/16 octave.
    costs : Rows
        A row of costs of steps for each half octave.
    """

    activity: Sequence[int]
    bias: Sequence[int]
    per_window: int
    restart: int
    exclusion: int
    gains: Sequence[int]
    costs: Rows

    @classmethod
    def of(cls, memories: Memories) -> FilterMap:
        """Return what the tables of a design say."""
        design = memories.design
        return cls(
            memories.place_activity, memories.place_bias, design.places_per_window,
            design.restart << FRACTION_BITS, design.exclusion, gains_of(design.gains),
            BANK_COSTS[design.places_per_window],
        )  # fmt: skip

    @property
    def last(self) -> int:
        """Longest step by which a match follows the one before."""
        return len(self.costs[0]) - 1

    @property
    def reach(self) -> int:
        """Places on each side of the best among which the middle is told."""
        return 4 if self.per_window == 2 else 0


def gains_of(number: int) -> tuple[int, ...]:
    """Return the gains of a filter with so many, 7 or 1."""
    return GAINS if number > 1 else (0,)


class Filter(NamedTuple):
    """State of the place filter between two windows."""

    metrics: Rows  #: M, of each gain and place.
    place: int | None = None  #: p, the best place; None before the first window.
    gain: int = 0  #: h, index of the gain of its metric.
    few: int = 0  #: c, windows with few events in a row.
    speed: int = 0  #: u, the mean activity, in units of 1/256 octave.
    moved: int = 0  #: v, windows that moved it.
    reciprocals: Sequence[int] = (0, 0, 0)  #: R of each sum; 0 if it had none.
    support: int = 0
    age: int = 0
    residuals: tuple[int, int] = (0, 0)  #: Of the window before and the one before that.


class Seen(NamedTuple):
    """What the number of events of a window says, step 1."""

    activity: int
    paused: bool
    weight: int
    few: int
    stands: bool
    speed: int
    moved: int
    looks: Sequence[int]  #: Index of the sum that each gain looks at.


def see(
    filter_map: FilterMap, state: Filter, activity: int, paused: bool, patience: int = PATIENCE
) -> Seen:
    """Return what the number of events says: weight, standing and sums, step 1."""
    weight, few = 8, paused
    if state.place is not None:
        surplus = activity - filter_map.activity[state.place] - min(filter_map.gains[state.gain], 0)
        weight, few = min(max((surplus + 56) >> 1, 0), 8), paused or surplus < FEW_BELOW
    in_row = min(state.few + 1, patience + 1) if few else 0
    speed, moved, several = state.speed, state.moved, len(filter_map.gains) > 1
    if several and not few:
        speed += (16 * activity - speed) >> min((1 + moved).bit_length() - 1, 6)
        moved = min(moved + 1, 63)
    looks = [which_sum(speed, gain) if several else 0 for gain in filter_map.gains]
    return Seen(activity, paused, weight, in_row, in_row > patience, speed, moved, looks)


def which_sum(speed: int, gain: int) -> int:
    """Return the index of the sum that a gain looks at: the slower the drive, the longer."""
    return sum((speed >> 4) - gain < limit for limit in SUM_LIMITS)


def predict(filter_map: FilterMap, state: Filter, steps: Sequence[Edges]) -> list[list[int]]:
    """Return the cost of being at each place with each gain, without the evidence, step 2.

    Parameters
    ----------
    steps : sequence of Edges
        Of each gain, see `steps_of`.
    """
    if state.place is None:
        return [[0] * len(filter_map.activity) for _ in filter_map.gains]
    changed = change_gain(state.metrics)
    return [move(row, edges, filter_map.restart) for row, edges in zip(changed, steps, strict=True)]


def change_gain(metrics: Rows) -> list[list[int]]:
    """Return the metrics less the least of all, after changes of gain."""
    least = min(map(min, metrics))
    changed = [[one - least for one in row] for row in metrics]
    for order in (range(len(changed)), range(len(changed) - 1, -1, -1)):
        for before, h in pairwise(order):
            pairs = zip(changed[h], changed[before], strict=True)
            changed[h] = [min(one, other + GAIN_STEP) for one, other in pairs]
    return changed


def move(costs: Sequence[int], edges: Edges, restart: int) -> list[int]:
    """Return the least cost of each place after a step, or after a restart from the best one."""
    reached = [min(costs) + restart] * len(costs)
    for origin, target, cost in edges:
        reached[target] = min(reached[target], costs[origin] + cost)
    return reached


def row_of(activity: int) -> int:
    """Return the row of the costs for the activity that remains for the speed."""
    return min(max((activity + 4) >> 3, -12), 6) + SAME_ROW


def costs_to(filter_map: FilterMap, seen: Seen, gain: int, place: int) -> Sequence[int]:
    """Return the costs of the steps of 0, 1, 2 ... places by which a place is reached."""
    if seen.stands:
        return filter_map.costs[0]
    return filter_map.costs[row_of(seen.activity - filter_map.activity[place] - gain)]


def steps_of(filter_map: FilterMap, seen: Seen, gain: int) -> Edges:
    """Return all steps of a gain."""
    edges = []
    for k in range(len(filter_map.activity)):
        costs = costs_to(filter_map, seen, gain, k)[: k + 1]
        edges += [(k - i, k, cost) for i, cost in enumerate(costs)]
    return edges


def spread_of(distances: Sequence[int]) -> int:
    """Return the mean absolute deviation of the distances, rounded down, at least 1, step 3."""
    mean = sum(distances) // len(distances)
    return max(sum(abs(d - mean) for d in distances) // len(distances), 1)


class Evidence(NamedTuple):
    """Evidence of a window, step 3."""

    against: Rows  #: E, of each sum and place.
    scales: Sequence[int]  #: Reciprocal by which each sum was scaled; 0 without evidence.
    reciprocals: Sequence[int]  #: R of each sum, for the next window.


def evidence(filter_map: FilterMap, state: Filter, seen: Seen, distances: Rows) -> Evidence:
    """Return the evidence of the sums that gains look at, step 3.

    Parameters
    ----------
    distances : Rows
        D of each sum to each place; not used in a pause.
    """
    places, sums = len(filter_map.activity), range(len(SUMS))
    if seen.paused:
        return Evidence([[0] * places for _ in sums], (0, 0, 0), state.reciprocals)
    against, scales, own = [[0] * places for _ in sums], [0 for _ in sums], [0 for _ in sums]
    for i in set(seen.looks):
        biased = [d + b for d, b in zip(distances[i], filter_map.bias, strict=True)]
        own[i] = (1 << 16) // spread_of(biased)
        scales[i] = state.reciprocals[i] or own[i]
        against[i] = evidence_of(biased, scales[i], seen.weight)
    return Evidence(against, scales, own)


def evidence_of(distances: Sequence[int], reciprocal: int, weight: int) -> list[int]:
    """Return the evidence against each place, step 3."""
    least = min(distances)
    scaled = (min(((d - least) * reciprocal) >> 14, EVIDENCE_TOP) for d in distances)
    return [(one * weight) >> 3 for one in scaled]


def add(predicted: Rows, against: Evidence, looks: Sequence[int]) -> list[list[int]]:
    """Return the metrics: predictions, and the evidence that each gain looks at, step 3."""
    return [
        [min(p + e, METRIC_TOP) for p, e in zip(row, against.against[i], strict=True)]
        for row, i in zip(predicted, looks, strict=True)
    ]


class Best(NamedTuple):
    """Best place of a window and what is told of it, step 4."""

    place: int
    gain: int
    told: int  #: Middle of the places near the best.
    nearest: BestPlaces

    @property
    def margin(self) -> int:
        """Second best metric less the best."""
        second = self.nearest.second_sum
        return METRIC_TOP if second is None else second - self.nearest.sum


def best(filter_map: FilterMap, metrics: Rows) -> Best:
    """Return the best place, its gain, and the middle of the places near it, step 4."""
    least = [min(column) for column in zip(*metrics, strict=True)]
    nearest = search(least, filter_map.exclusion)
    gain = min(range(len(metrics)), key=lambda h: metrics[h][nearest.place])
    return Best(nearest.place, gain, middle(least, nearest.place, filter_map.reach), nearest)


def middle(least: Sequence[int], place: int, reach: int) -> int:
    """Return the middle of the places around the best whose metric is near its own."""
    first, last, most = place, place, least[place] + 8
    while first > max(place - reach, 0) and least[first - 1] <= most:
        first -= 1
    while last < min(place + reach, len(least) - 1) and least[last + 1] <= most:
        last += 1
    return (first + last + 1) >> 1


def support_after(kept: int, margin: int) -> int:
    """Return the support of a match with this margin, step 5."""
    return kept + ((16 * min(margin, MARGIN_TOP) - kept) >> 2)


class Trust(NamedTuple):
    """Trust in a match, and its terms, step 5."""

    trust: int
    kept: int
    support: int
    age: int
    residual: int
    worst_residual: int


def trust(state: Filter, one: Best, against: int, follows: bool) -> Trust:
    """Return the trust in a match, step 5.

    Parameters
    ----------
    state : Filter
        Before the window.
    against : int
        Evidence against the best place.
    follows : bool
        Whether the best place follows that of the window before.
    """
    kept, age = (state.support, min(state.age + 1, WHOLE_AGE)) if follows else (0, 0)
    support = support_after(kept, one.margin)
    if one.place == state.place:
        support = min(support, kept - (kept >> 3))
    residual = min(against, RESIDUAL_TOP)
    worst = max(residual, *state.residuals)
    whole = max(support - 16 * worst, 0)
    return Trust(whole * age // WHOLE_AGE, kept, support, age, residual, worst)


class Advanced(NamedTuple):
    """Results of a window."""

    state: Filter  #: After the window.
    seen: Seen
    predicted: Rows  #: P, of each gain and place.
    evidence: Evidence
    best: Best
    trust: Trust


def advance(
    filter_map: FilterMap, state: Filter, activity: int, paused: bool, distances: Rows
) -> Advanced:
    """Advance the filter by a window, and match it."""
    seen = see(filter_map, state, activity, paused)
    predicted = predict(
        filter_map, state, [steps_of(filter_map, seen, gain) for gain in filter_map.gains]
    )
    return decide(filter_map, state, seen, predicted, evidence(filter_map, state, seen, distances))


def decide(
    filter_map: FilterMap, state: Filter, seen: Seen, predicted: Rows, against: Evidence
) -> Advanced:
    """Match a window by its prediction and its evidence."""
    metrics = add(predicted, against, seen.looks)
    match = best(filter_map, metrics)
    follows = state.place is not None and 0 <= match.place - state.place <= filter_map.last
    judged = trust(state, match, against.against[seen.looks[match.gain]][match.place], follows)
    after = state_after(state, seen, against, metrics, match, judged)
    return Advanced(after, seen, predicted, against, match, judged)


def state_after(
    state: Filter, seen: Seen, against: Evidence, metrics: Rows, match: Best, judged: Trust
) -> Filter:
    """Return what is kept for the next window."""
    return Filter(
        metrics, match.place, match.gain, seen.few, seen.speed, seen.moved, against.reciprocals,
        judged.support, judged.age, (judged.residual, state.residuals[0]),
    )  # fmt: skip


# The device.


@dataclass(frozen=True)
class Kept:
    """What a device keeps from window to window, beside the distances of sequences."""

    windows: int  #: Windows so far.
    mean_activity: int  #: Events that count of a window, in units of 1/256 event.
    newest: Rows  #: Counts of the last three windows, newest first, of several gains.
    means: Rows  #: Of contrast codes, means of each sum and slot, in units of 1/65,536 octave.
    moves: int  #: Windows that moved these means.
    filter: Filter

    @classmethod
    def of(cls, memories: Memories) -> Kept:
        """Return what a device begins with, sections 2 to 4."""
        design = memories.design
        blank = Filter([[0] * design.places] * design.gains)
        means = [[256 * mean for mean in memories.mean]] * design.sums
        newest = [[0] * design.slots] * 3
        return cls(0, memories.activity, newest, means, 0, blank)


class Machine:
    """A device with its design and tables.

    Parameters
    ----------
    start : int
        Time at which the first window opens; only its lower `timestamp_bits` matter, as of events.

    Attributes
    ----------
    counts : list of int, length slots
        Counters of the open window.
    counted, events : int
        Events at selected pixels in the open window; all events so far.
    end : int
        Time at which the open window ends, for windows by time.
    kept : Kept
        What is kept of the windows that ended.
    history : list of lists of int
        Distances of the last windows to all places, newest first, of sequences.
    states : list of WindowState
        Of all windows so far, of a design with pauses.
    compared, advanced : Rows, Advanced or None
        Of the last window, of the place filter: distances of each sum, and what followed.
    """

    def __init__(self, memories: Memories, start: int = 0) -> None:
        self.memories, self.design = memories, memories.design
        self.kept = Kept.of(memories)
        self.counts, self.counted, self.events = [0] * self.design.slots, 0, 0
        self.end = (start + self.design.tau_us) % (1 << self.design.timestamp_bits)
        self.history: list[list[int]] = []
        self.states: list[WindowState] = []
        self.compared: Rows = ()
        self.advanced: Advanced | None = None
        self._pixels = {pixel: slot for slot, pixel in enumerate(memories.pixels)}
        self._filter_map = FilterMap.of(memories) if self.design.filters else None

    def take(self, event: Event) -> Iterator[Result]:
        """Process an event, section 2.

        Yields
        ------
        EventResult, WindowResult or MatchResult
            In the order in which they happen. After a `WindowResult`, counters and what is kept are
            still those of the window.
        """
        design = self.design
        if design.window == "time":
            while self.left(event.t) <= 0:
                yield from self._end_window()
                self.end = (self.end + design.tau_us) % (1 << design.timestamp_bits)
        slot, count = self.slot(event), 0
        if slot is not None:
            count = self.counts[slot] = min(self.counts[slot] + 1, design.count_max)
            self.counted += 1
        self.events += 1
        yield EventResult(self.events - 1, slot, count)
        if design.window == "count" and slot is not None and self.counted == design.window_events:
            yield from self._end_window()

    def left(self, t: int) -> int:
        """Return the time from an event to the end of the open window, as a signed number."""
        half = 1 << (self.design.timestamp_bits - 1)
        return (self.end - t + half) % (2 * half) - half

    def slot(self, event: Event) -> int | None:
        """Return the slot of an event; None if its pixel is not selected."""
        return self._pixels.get((event.x, event.y))

    @property
    def that_count(self) -> int:
        """Events of the open window that count, section 3."""
        if self.design.contrast:
            return counted_events(self.counts, self.memories.limits)
        return self.counted

    def _end_window(self) -> Iterator[Result]:
        """End the open window, section 3."""
        design, kept = self.design, self.kept
        counted, mean = self.that_count, kept.mean_activity
        paused = is_pause(counted, mean)
        activity = activity_of(counted, self.memories.activity if design.gains > 1 else mean)
        codes, means = [self.counts], kept.means
        shift: int | None = None
        shared: int | None = None
        newest = [self.counts, *kept.newest]
        if design.contrast:
            codes, shift, shared, means = self._contrast_codes(newest)
        yield WindowResult(kept.windows, self.events, tuple(codes[0]))
        state = WindowState(kept.windows, counted, mean, activity, paused, shift, shared)
        self.kept = replace(
            kept, windows=kept.windows + 1, mean_activity=mean_activity_after(mean, counted),
            newest=newest[:3], means=kept.means if paused else means,
            moves=kept.moves + (not paused),
        )  # fmt: skip
        self.counts, self.counted = [0] * design.slots, 0
        match: MatchResult | None
        if self._filter_map is not None:
            match, state = self._filter(self._filter_map, codes, state)
        else:
            match = self._sequence(kept.windows, codes[0])
        if design.pauses:
            self.states.append(state)
        if match is not None:
            yield match

    def _contrast_codes(self, newest: Rows) -> tuple[list[list[int]], int, int, Rows]:
        """Return codes of each sum, shift, mean of the differences of one window, and new means."""
        codes, means, shared_of = [], [], []
        shift = mean_shift(self.kept.moves)
        sums = sums_of(newest, self.design.sums)
        for counts, mean in zip(sums, self.kept.means, strict=True):
            levels = [LEVELS[min(count, len(LEVELS) - 1)] for count in counts]
            differences = differences_of(levels, mean)
            shared = window_mean(differences)
            codes.append([own_mean_code(d - shared, self.design.code_bits) for d in differences])
            means.append(means_after(mean, levels, shift))
            shared_of.append(shared)
        return codes, shift, shared_of[0], means

    def distances(self, codes: Sequence[int]) -> list[int]:
        """Return the distance of the codes of a window to every place, section 5."""
        return [distance(codes, place) for place in self.memories.places]

    def _sequence(self, window: int, codes: Sequence[int]) -> MatchResult | None:
        """Match a window by sequences, section 5; None before there are L windows."""
        length = self.design.length
        self.history = [self.distances(codes), *self.history][:length]
        if len(self.history) < length:
            return None
        nearest = search(sequence_sums(self.history), self.design.exclusion, length - 1)
        return MatchResult(window, *nearest, accepts(self.design, nearest, 0))

    def _filter(
        self, filter_map: FilterMap, codes: Rows, state: WindowState
    ) -> tuple[MatchResult, WindowState]:
        """Match a window by the place filter, section 6."""
        self.compared = distances = [self.distances(of_sum) for of_sum in codes]
        self.advanced = advance(
            filter_map, self.kept.filter, state.activity, state.paused, distances
        )
        after, seen, _, against, matched, judged = self.advanced
        self.kept = replace(self.kept, filter=after)
        state = state._replace(
            weight=0 if state.paused else seen.weight, few=seen.few, stands=seen.stands,
            speed=seen.speed, sums=sum(1 << i for i in set(seen.looks)), best=matched.place,
            gain=filter_map.gains[matched.gain], least=matched.nearest.sum, margin=matched.margin,
            kept=judged.kept, support=judged.support, age=judged.age,
            worst_residual=judged.worst_residual,
        )  # fmt: skip
        if not state.paused:
            i = seen.looks[matched.gain]
            biased = [d + b for d, b in zip(distances[i], filter_map.bias, strict=True)]
            state = state._replace(reciprocal=against.scales[i], spread=spread_of(biased))
        accepted = accepts(self.design, matched.nearest, judged.trust)
        told = matched.nearest._replace(place=matched.told)
        return MatchResult(state.window, *told, accepted, judged.trust), state


@dataclass
class Trace:
    """All results of a device, by kind and in order; `states` of designs with pauses alone."""

    events: list[EventResult] = field(default_factory=list)
    windows: list[WindowResult] = field(default_factory=list)
    matches: list[MatchResult] = field(default_factory=list)
    states: list[WindowState] = field(default_factory=list)

    def add(self, result: Result) -> None:
        """Append a result to the list of its kind."""
        if isinstance(result, EventResult):
            self.events.append(result)
        elif isinstance(result, WindowResult):
            self.windows.append(result)
        else:
            self.matches.append(result)


def trace(memories: Memories, events: Iterable[Event], start: int = 0) -> Trace:
    """Run a device over a stimulus whose first window opens at `start`."""
    machine, done = Machine(memories, start), Trace()
    for event in events:
        for result in machine.take(Event(*event)):
            done.add(result)
    done.states = machine.states
    return done
