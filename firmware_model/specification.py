"""What a device computes between an event and a match: docs/specification.md as a program.

Sections and symbols are those of the page. Functions are pure; `Machine` has the state of a device.
It generates the golden vectors, and every other implementation is tested against it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
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
from fixedpoint.activity import ACTIVITY_COSTS, EVENTS_TOP, SAME_ROW

#: origin, target and cost of each transition between places in a window
Edges = list[tuple[int, int, int]]


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
    """A window that ended, the number of events before its end, its activity and pause."""

    number: int
    events: int
    codes: Codes
    activity: int = 0
    paused: bool = False


class MatchResult(NamedTuple):
    """One match; second and second_sum are None if every place lies in the exclusion zone.

    With the place filter the two sums are metrics, and there is a trust, in 1/16 of a metric.
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
    counted: int  #: Events at selected pixels.
    mean_activity: int  #: Mean number of events before this window, in units of 1/256 event.
    activity: int
    paused: bool
    mean_shift: int | None  #: With contrast codes.
    window_mean: int | None  #: With contrast codes.
    # of the filter
    weight: int | None = None
    reciprocal: int | None = None  #: Scale of the evidence; None in a pause.
    spread: int | None = None  #: Of the distances of this window; None in a pause.
    least: int | None = None  #: Least metric.
    margin: int | None = None
    kept: int | None = None
    support: int | None = None
    worst_residual: int | None = None


Result = EventResult | WindowResult | MatchResult


# Section 3: pause and activity.


def ilog(number: int) -> int:
    """Return ``floor(16 log2(1 + number))``, exact."""
    return int(((number + 1) ** 16).bit_length()) - 1


def is_pause(counted: int, mean_activity: int) -> bool:
    """Return whether a window has no events, or less than 1/8 of the mean number."""
    return counted == 0 or counted * 256 * 8 < mean_activity


def activity_of(counted: int, mean_activity: int) -> int:
    """Return the logarithm of a window's events less that of the mean number, in 1/16 octave."""
    if counted == 0:
        return -ilog(EVENTS_TOP)
    return ilog(min(counted, EVENTS_TOP)) - ilog(mean_activity >> 8)


def mean_activity_after(mean_activity: int, counted: int) -> int:
    """Return the mean number of events, in units of 1/256 event, after a window."""
    if is_pause(counted, mean_activity):
        return mean_activity + (-mean_activity >> 10)
    return mean_activity + ((min(counted, EVENTS_TOP) * 256 - mean_activity) >> 6)


# Section 4: contrast codes.


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


def accepts(design: Design, found: BestPlaces, trust: int) -> bool:
    """Return whether a match is accepted; the trust is that of the filter."""
    if design.filters:
        return found.second is not None and trust >= design.trust
    return found.sum <= design.largest_sum


# Section 6: the place filter.


class Costs(NamedTuple):
    """Costs of the place filter, with their fraction bits."""

    #: of steps of 0, 1, 2 ... places, a row for each half octave of activity
    rows: Sequence[Sequence[int]]
    restart: int

    @property
    def last(self) -> int:
        """Longest step by which a match follows the one before."""
        return len(self.rows[0]) - 1


def row_of(activity: int) -> int:
    """Return the row of the costs for the activity of a window less that of a place."""
    return min(max(((activity + 4) >> 3) + SAME_ROW, 0), len(ACTIVITY_COSTS) - 1)


def transitions_by_steps(costs: Costs, activity: int, place_activity: Sequence[int]) -> Edges:
    """Return all steps from place to place in a window of this activity, step 1."""
    found = []
    for target, of_place in enumerate(place_activity):
        for step, cost in enumerate(costs.rows[row_of(activity - of_place)][: target + 1]):
            found.append((target - step, target, cost))
    return found


def predict(metrics: Sequence[int], transitions: Edges, restart: int) -> list[int]:
    """Return the cost of being at each place after a window, without its evidence, step 1."""
    predicted, least = [restart] * len(metrics), min(metrics)
    for origin, target, cost in transitions:
        predicted[target] = min(predicted[target], metrics[origin] - least + cost)
    return predicted


def spread_of(distances: Sequence[int]) -> int:
    """Return the mean absolute deviation of the distances, rounded down, at least 1, step 2."""
    mean = sum(distances) // len(distances)
    return max(sum(abs(d - mean) for d in distances) // len(distances), 1)


def weight_of(activity: int, most: int = 8) -> int:
    """Return the weight of a window's evidence in eighths, step 2."""
    return min(max((activity + 48) >> 1, 0), most)


def evidence_of(distances: Sequence[int], reciprocal: int, weight: int) -> list[int]:
    """Return the evidence against each place, step 2."""
    least = min(distances)
    scaled = (min(((d - least) * reciprocal) >> 14, EVIDENCE_TOP) for d in distances)
    return [(one * weight) >> 3 for one in scaled]


def margin_of(found: BestPlaces) -> int:
    """Return the second best metric less the best, step 4."""
    return METRIC_TOP if found.second_sum is None else found.second_sum - found.sum


def support_after(kept: int, margin: int, stands: bool) -> int:
    """Return the support of a match with this margin, step 4."""
    support = kept + ((16 * min(margin, MARGIN_TOP) - kept) >> 2)
    return min(support, kept - (kept >> 4)) if stands else support


class Filter(NamedTuple):
    """State of the place filter between two windows."""

    metrics: Sequence[int]
    reciprocal: int = 0  #: Of the spread of the last window that was no pause; 0 before one.
    place: int | None = None  #: Of the match before; None before the first window.
    support: int = 0
    residuals: tuple[int, int] = (0, 0)  #: Of the match before and the one before that.


def advance(
    before: Filter, predicted: Sequence[int], distances: Sequence[int] | None, weight: int
) -> tuple[Filter, list[int]]:
    """Return the filter with its metrics and reciprocal after a window, and the evidence.

    Parameters
    ----------
    predicted : sequence of int, length K
        See `predict`; zeros in the first window.
    distances : sequence of int, length K, or None
        None in a pause.
    weight : int
        See `weight_of`.
    """
    evidence, own = [0] * len(predicted), before.reciprocal
    if distances is not None:
        own = (1 << 16) // spread_of(distances)
        evidence = evidence_of(distances, before.reciprocal or own, weight)
    metrics = [min(p + e, METRIC_TOP) for p, e in zip(predicted, evidence, strict=True)]
    return before._replace(metrics=metrics, reciprocal=own), evidence


class Trust(NamedTuple):
    """Trust in a match, and its terms, step 4."""

    trust: int
    margin: int
    kept: int
    support: int
    worst_residual: int


def judge(
    advanced: Filter, found: BestPlaces, evidence: int, follows: bool
) -> tuple[Filter, Trust]:
    """Return the filter after its match, and the trust in it, step 4.

    Parameters
    ----------
    advanced : Filter
        Place, support and residuals are those of the match before.
    evidence : int
        Against the matched place, in this window.
    follows : bool
        Whether the match follows the one before.
    """
    kept, margin = advanced.support if follows else 0, margin_of(found)
    support = support_after(kept, margin, stands=found.place == advanced.place)
    residual = min(evidence, RESIDUAL_TOP)
    worst = max(residual, *advanced.residuals)
    after = advanced._replace(
        place=found.place, support=support, residuals=(residual, advanced.residuals[0])
    )
    return after, Trust(max(support - 16 * worst, 0), margin, kept, support, worst)


# The device.


@dataclass(frozen=True)
class Kept:
    """What a device keeps from window to window, beside the distances of sequences."""

    windows: int  #: Windows so far.
    mean_activity: int  #: Events of a window, in units of 1/256 event.
    means: Sequence[int]  #: Mean of each slot of contrast codes, in units of 1/65,536 octave.
    moves: int  #: Windows that moved these means.
    filter: Filter

    @classmethod
    def of(cls, memories: Memories) -> Kept:
        """Return what a device begins with, sections 2 to 4."""
        blank = Filter([0] * memories.design.places)
        return cls(0, memories.activity, [256 * mean for mean in memories.mean], 0, blank)


class Machine:
    """A device with its design and tables.

    Parameters
    ----------
    start : int
        Time at which the first window opens; only its lower `timestamp_bits` matter, as of events.
    begin : Kept, optional
        What is kept of the windows before; by default there were none.

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
    """

    def __init__(self, memories: Memories, start: int = 0, begin: Kept | None = None) -> None:
        self.memories, self.design = memories, memories.design
        self.kept = begin or Kept.of(memories)
        self.counts, self.counted, self.events = [0] * self.design.slots, 0, 0
        self.end = (start + self.design.tau_us) % (1 << self.design.timestamp_bits)
        self.history: list[list[int]] = []
        self.states: list[WindowState] = []
        self._pixels = {pixel: slot for slot, pixel in enumerate(memories.pixels)}
        self._costs = Costs(self.design.step_costs, self.design.restart << FRACTION_BITS)

    def take(self, event: Event) -> Iterator[Result]:
        """Process an event, section 2.

        Yields
        ------
        EventResult, WindowResult or MatchResult
            In the order in which they happen. After a `WindowResult`, counters and means are still
            those of the window.
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

    def _end_window(self) -> Iterator[Result]:
        """End the open window, section 3."""
        design, kept, codes = self.design, self.kept, self.counts
        paused = is_pause(self.counted, kept.mean_activity)
        activity = activity_of(self.counted, kept.mean_activity)
        levels: list[int] = []
        shift: int | None = None
        shared: int | None = None
        if design.contrast:
            levels = [LEVELS[count] for count in self.counts]
            differences = differences_of(levels, kept.means)
            shared, shift = window_mean(differences), mean_shift(kept.moves)
            codes = [own_mean_code(one - shared, design.code_bits) for one in differences]
        window = WindowResult(kept.windows, self.events, tuple(codes), activity, paused)
        yield window
        state = WindowState(
            kept.windows, self.counted, kept.mean_activity, activity, paused, shift, shared
        )
        if shift is not None and not paused:
            means = means_after(kept.means, levels, shift)
            self.kept = replace(self.kept, means=means, moves=kept.moves + 1)
        mean = mean_activity_after(kept.mean_activity, self.counted)
        self.kept = replace(self.kept, mean_activity=mean, windows=kept.windows + 1)
        self.counts, self.counted = [0] * design.slots, 0
        match: MatchResult | None
        if design.filters:
            match, state = self._filter(window, state)
        else:
            match = self._sequence(window)
        if design.pauses:
            self.states.append(state)
        if match is not None:
            yield match

    def distances(self, codes: Codes) -> list[int]:
        """Return the distance of the codes of a window to every place, section 5."""
        return [distance(codes, place) for place in self.memories.places]

    def _sequence(self, window: WindowResult) -> MatchResult | None:
        """Match a window by sequences, section 5; None before there are L windows."""
        length = self.design.length
        self.history = [self.distances(window.codes), *self.history][:length]
        if len(self.history) < length:
            return None
        found = search(sequence_sums(self.history), self.design.exclusion, length - 1)
        return MatchResult(window.number, *found, accepts(self.design, found, 0))

    def predictions(self, activity: int) -> list[int]:
        """Return the cost of being at each place after a window of this activity, section 6."""
        before = self.kept.filter
        if before.place is None:
            return [0] * self.design.places
        transitions = transitions_by_steps(self._costs, activity, self.memories.place_activity)
        return predict(before.metrics, transitions, self._costs.restart)

    def _filter(self, window: WindowResult, state: WindowState) -> tuple[MatchResult, WindowState]:
        """Match a window by the place filter, section 6."""
        design, before = self.design, self.kept.filter
        distances, weight = None, 0
        if not window.paused:
            distances, weight = self.distances(window.codes), weight_of(window.activity)
        advanced, evidence = advance(before, self.predictions(window.activity), distances, weight)
        found = search(advanced.metrics, design.exclusion)
        step = None if before.place is None else found.place - before.place
        follows = step is not None and 0 <= step <= self._costs.last
        after, trust = judge(advanced, found, evidence[found.place], follows)
        self.kept = replace(self.kept, filter=after)
        if distances is not None:
            reciprocal = before.reciprocal or after.reciprocal
            state = state._replace(reciprocal=reciprocal, spread=spread_of(distances))
        state = state._replace(
            weight=weight, least=min(after.metrics), margin=trust.margin, kept=trust.kept,
            support=trust.support, worst_residual=trust.worst_residual,
        )  # fmt: skip
        accepted = accepts(design, found, trust.trust)
        return MatchResult(window.number, *found, accepted, trust.trust), state


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
