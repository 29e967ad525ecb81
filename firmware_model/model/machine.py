"""Model of the whole device, event by event, and within a match cycle by cycle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from firmware_model.cost import filter_cycles as cycles
from firmware_model.cost import window_mean_cycles
from firmware_model.model.comparator import (
    DistanceModel,
    MatchResult,
    PlaceFilterModel,
    SearchModel,
    SequenceModel,
    weight_of,
)
from firmware_model.model.descriptor import DescriptorModel, Event, EventResult, WindowResult
from firmware_model.model.memories import Codes, Memories
from fixedpoint.own_mean import LAST_SHIFT

Result = EventResult | WindowResult | MatchResult
Phase = Literal["encode", "compare", "drain", "divide", "filter", "accept"]


class WindowState(NamedTuple):
    """What a design with pauses has computed of a window, beside its codes and its match."""

    window: int
    counted: int  #: Events at selected pixels.
    #: Usual number of events with which the window is compared, in units of 1/256 event.
    usual: int
    #: Logarithm of `counted` less that of `usual`, in units of 1/16 octave; -368 without events.
    activity: int
    paused: bool
    #: Of own-mean codes: the means move by 1 / 2 to this power, if the window does not pause.
    mean_shift: int | None
    #: Of contrast codes: what is subtracted from all logarithms, in units of 1/256 octave; else 0.
    window_mean: int
    # of the filter
    weight: int | None = None  #: How many eighths of the evidence count; 0 in a pause.
    reciprocal: int | None = None  #: With which the evidence is scaled; None in a pause.
    spread: int | None = None  #: Of the distances of this window; None in a pause.
    least: int | None = None  #: Least metric.
    margin: int | None = None  #: Of the match.
    kept: int | None = None  #: Support that the match began with, 0 behind a jump.
    #: The match's; its trust is ``max(support - 16 * worst_residual, 0)``.
    support: int | None = None
    #: Largest evidence against a match of this window and the two before.
    worst_residual: int | None = None


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


class Cycle(NamedTuple):
    """State of the comparing units after one clock cycle of a match."""

    number: int  #: From 0, within this match.
    phase: Phase
    slot: int | None = None  #: Whose count was encoded and cleared.
    # of the distance unit: None while it stands
    place: int | None = None
    word: int | None = None
    accumulator: int | None = None
    # of the sequence unit
    sequence_place: int | None = None
    sequence_sum: int | None = None
    searched: int | None = None  #: The place that the search took in this cycle.
    metric: int | None = None  #: Of that place, by the filter.


class Machine:
    """A device with its design and tables.

    Parameters
    ----------
    start : int
        Time at which the first window opens.

    Attributes
    ----------
    search : SearchModel
        Of the last match of sequences.
    states : list of WindowState
        Of all windows so far, of a design with pauses.
    """

    def __init__(self, memories: Memories, start: int = 0) -> None:
        self.memories, self.design = memories, memories.design
        self.descriptor = DescriptorModel(memories, start)
        self.comparator = DistanceModel(memories)
        self.sequence = SequenceModel(self.design)
        self.search = SearchModel(self.design)
        self.place_filter = PlaceFilterModel(memories)
        self.states: list[WindowState] = []

    def take(self, event: Event) -> Iterator[Result]:
        """Process an event; each window that ends gives a match, once there were L windows.

        Yields
        ------
        EventResult, WindowResult or MatchResult
            In the order in which they happen.
        """
        for result in self.descriptor.take(event):
            yield result
            if isinstance(result, WindowResult):
                reciprocal = self.place_filter.reciprocal
                match = self.match(result)
                if self.design.filters or self.design.own_mean:
                    self.states.append(self._state(result, reciprocal))
                if match is not None:
                    yield match

    def _state(self, window: WindowResult, reciprocal: int) -> WindowState:
        """Return what was computed of a window that has just been matched.

        The descriptor unit is as the window found it; `reciprocal` is that of the window before.
        """
        descriptor, model = self.descriptor, self.place_filter
        shift = min(descriptor.mean.shift, LAST_SHIFT) if self.design.own_mean else None
        state = WindowState(
            window.number, descriptor.counted, descriptor.activity.usual, window.activity,
            window.paused, shift, descriptor.mean.window_mean(descriptor.entries()),
        )  # fmt: skip
        if not self.design.filters:
            return state
        state = state._replace(
            weight=0 if window.paused else weight_of(window.activity), least=min(model.metrics),
            margin=model.margin, kept=model.kept, support=model.support,
            worst_residual=model.worst,
        )  # fmt: skip
        if window.paused:
            return state
        # the first window is scaled by its own spread
        return state._replace(reciprocal=reciprocal or model.reciprocal, spread=model.spread)

    def match(self, window: WindowResult) -> MatchResult | None:
        """Compare a window with every place."""
        if self.design.filters:
            return self.place_filter.match(
                window.number, window.activity, window.paused,
                lambda: self._distances(window.codes),
            )  # fmt: skip
        self.sequence.next_window()
        self.search = SearchModel(self.design)
        for place in range(self.design.places):
            total = self.sequence.sum(place, self.comparator.distance(place, window.codes))
            if total is not None:
                self.search.take(place, total)
        return self.search.result(window.number)

    def _distances(self, codes: Codes) -> Iterator[int]:
        return (self.comparator.distance(place, codes) for place in range(self.design.places))

    def filter_cycles(
        self, codes: Codes, activity: int = 0, paused: bool = False
    ) -> Iterator[Cycle]:
        """Do what `match` does with the place filter, one clock cycle after another.

        Encoding takes a cycle a slot; contrast codes take it twice, and a division between. The
        distance unit takes P codes of a place in a cycle, for all places: then total and least
        distance are known, and a restoring divider makes the mean, a bit a cycle. The filter takes
        a place in a cycle; or in as many as its distance takes, if that is computed again. The
        divider makes the spread and its reciprocal for the next window. The first window, whose
        evidence is scaled by its own spread, takes as many cycles more as the deviations and two
        divisions do. A window that pauses needs no distances.
        """
        design, cost = self.design, cycles(self.design)
        phases = self._encoded()
        if not paused:
            first = self.place_filter.reciprocal == 0
            phases += self._compared(codes) + [Cycle(0, "divide")] * cost.mean
            if first:
                phases += self._compared(codes) if not design.keep_distances else []
                phases += [Cycle(0, "compare")] * (design.places if design.keep_distances else 0)
                phases += [Cycle(0, "divide")] * cost.scale
        self.place_filter.match(0, activity, paused, lambda: self._distances(codes))
        for place, metric in enumerate(self.place_filter.metrics):
            again = not (paused or design.keep_distances)
            words = list(self.comparator.steps(place, codes)) if again else [None]
            for word, accumulator in enumerate(words):
                last = word == len(words) - 1
                phases.append(
                    Cycle(
                        0, "filter", None,
                        place if again else None, word if again else None, accumulator,
                        searched=place if last else None, metric=metric if last else None,
                    )
                )  # fmt: skip
        phases += [] if paused else [Cycle(0, "divide")] * cost.scale
        for number, cycle in enumerate([*phases, Cycle(0, "accept")]):
            yield cycle._replace(number=number)

    def _encoded(self) -> list[Cycle]:
        one_pass = [Cycle(0, "encode", slot=slot) for slot in range(self.design.slots)]
        if not self.design.contrast:
            return one_pass
        return one_pass + [Cycle(0, "divide")] * window_mean_cycles(self.design) + one_pass

    def _compared(self, codes: Codes) -> list[Cycle]:
        return [
            Cycle(0, "compare", None, place, word, accumulator)
            for place in range(self.design.places)
            for word, accumulator in enumerate(self.comparator.steps(place, codes))
        ]

    def match_cycles(self, codes: Codes) -> Iterator[Cycle]:
        """Do what `match` does with sequences, one clock cycle after another.

        Encoding takes a cycle a slot. Then three units work at once, each handing its result to
        the next with the clock: the distance unit takes P codes of a place in a cycle, the sequence
        unit adds one of L terms in a cycle, and the search takes a sum in a cycle. The distance
        unit waits with a finished distance while the sequence unit is busy.
        """
        design, number = self.design, 0
        self.sequence.next_window()
        self.search = SearchModel(design)
        for cycle in self._encoded():
            yield cycle._replace(number=number)
            number += 1
        comparing = iter(
            (place, word, accumulator)
            for place in range(design.places)
            for word, accumulator in enumerate(self.comparator.steps(place, codes))
        )
        adding: Iterator[int | None] = iter(())
        adding_place: int | None = None
        terms_left = 0
        finished: tuple[int, int] | None = None  # a distance, and whose
        summed: tuple[int, int | None] | None = None  # a sum, and whose
        searched = -1
        while searched < design.places - 1:
            # from the back to the front, so that a unit sees what was there before this clock
            taken: int | None = None
            if summed is not None:
                taken = searched = summed[0]
                if summed[1] is not None:
                    self.search.take(taken, summed[1])
                summed = None
            partial: int | None = None
            if terms_left == 0 and finished is not None:
                adding_place, terms_left = finished[0], design.length
                adding, finished = self.sequence.steps(*finished), None
            at_work = adding_place if terms_left else None
            if terms_left:
                partial = next(adding)
                terms_left -= 1
                if terms_left == 0 and adding_place is not None:
                    summed = (adding_place, partial)
            step = next(comparing, None) if finished is None else None
            if step is not None and step[1] == design.words - 1:
                finished = (step[0], step[2])
            phase: Phase = "drain" if step is None and finished is None else "compare"
            place, word, accumulator = step or (None, None, None)
            yield Cycle(number, phase, None, place, word, accumulator, at_work, partial, taken)
            number += 1
        yield Cycle(number, "accept")


def trace(memories: Memories, events: Iterable[Event], start: int = 0) -> Trace:
    """Run a device over a stimulus.

    Parameters
    ----------
    start : int
        Time at which the first window opens.
    """
    machine, done = Machine(memories, start), Trace()
    for event in events:
        for result in machine.take(Event(*event)):
            done.add(result)
    done.states = machine.states
    return done
