"""Which corners a case reaches, from the model's states while it runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Sequence

import numpy as np

from firmware_model.design import Design
from firmware_model.memories import Lookup, Memories
from firmware_model.specification import Event, Machine, MatchResult, Trace, WindowResult
from firmware_model.vectors.case import Case
from firmware_model.vectors.facts import (
    BITS,
    FILTER_CORNERS,
    Facts,
    bits_of,
    replaced,
    see_sums,
)
from firmware_model.vectors.fast_filter import advanced_by

#: name of each corner, and what is counted as one occurrence of it
CORNERS = {
    "saturated": "an event at a counter that is full",
    "filled": "an event that fills a counter",
    "same_pixel_twice": "an event at the selected pixel of the event before",
    "a_b_a": "an event at the selected pixel of the one before the last, with another between",
    "on_the_boundary": "an event at the very end of a window, which belongs to the next one",
    "before_the_boundary": "an event in the last microsecond of a window",
    "behind_silence": "an event a power of two of microseconds behind the end of a silent window",
    "late": "an event from before the open window's start",
    "half_a_period_late": "an event half the clock's period behind the end of a window",
    "unselected": "an event at a pixel that is not selected",
    "entry_of_another_row": "an event at such a pixel whose look-up entry belongs to another row",
    "off_the_sensor": "an event that names no pixel of the sensor",
    "below_the_sensor": "such an event in the row behind the last one",
    "ended_off_the_sensor": "an event that names no pixel of the sensor, and ends a window",
    "column_above_511": "an event at a selected pixel whose column is above 511",
    "on": "an ON event at a selected pixel",
    "off": "an OFF event at a selected pixel",
    "sensor_corner": "an event at one of the four corners of the sensor",
    "clock_wrapped": "a window whose end is behind the clock's wrap",
    "short_clock_wrapped": "such a window of a clock of fewer than 32 bits",
    "gap": "an event that ends three windows or more",
    "empty_window": "a window without events at selected pixels",
    "full_window": "a window that ends with its last event",
    "all_equal_counts": "a window with the same count, not zero, in every counter",
    "window_above_255": "a window with a number above 255",
    "window_above_4095": "a window with a number above 4,095",
    "window_above_65535": "a window with a number above 65,535",
    "narrow_clock": "a window longer than a ninth of the clock's period",
    "incomplete_sequence": "a window before which there were fewer than L - 1",
    "zero_distance": "a place at distance zero",
    "largest_distance": "a place at the largest distance that there can be",
    "diagonal_off_the_map": "a window nearest to a place at which no sequence can end",
    "tie_of_two": "a match with one more place at its sum",
    "tie_of_three": "a match with two more places, or more",
    "ties_above_32767": "a match with more than 32,767 more places",
    "tie_across_zone": "a match whose second best has the same sum",
    "tie_of_seconds": "a match with two places or more at the second best sum, outside the zone",
    "tie_of_seconds_on_the_left": "such a match with two or more of them below the best",
    "tie_of_seconds_on_both_sides": "such a match with one of them below the best, and one above",
    "second_on_the_left": "a match whose second best place is lower",
    "second_on_the_right": "a match whose second best place is higher",
    "nearer_in_the_zone": "a match with a place in the zone that is nearer than the second best",
    "no_second": "a match without a second best",
    "one_place": "a match in a map of one place",
    "accepted": "a match that is accepted",
    "rejected": "a match that is not accepted",
    "accepted_at_threshold": "a match that is accepted, and would not be were its sum one larger",
    "rejected_at_threshold": "a match that is rejected, and would not be were its sum one smaller",
    "lanes_unfilled": "a window whose last memory word is not full",
    "long_sequence": "a match of a sequence of more than eight windows",
    "place_0_on_the_left": "a match whose second best is place 0, and lower than the best",
}


#: facts of filter and contrast codes, and of the bits of any design
ALL = FILTER_CORNERS | BITS


class _Drawing(Machine):
    """The model by which cases are drawn: NumPy computes its distances."""

    def __init__(self, memories: Memories, start: int = 0) -> None:
        super().__init__(memories, start)
        self._places = np.array(memories.places, dtype=np.int64)

    def distances(self, codes: Sequence[int]) -> list[int]:
        return list(map(int, abs(self._places - codes).sum(axis=1)))


def coverage(case: Case, wanted: Container[str] = ALL) -> dict[str, int]:
    """Count how often a case reaches each of `CORNERS`; see `watched_trace`."""
    with replaced("advance", advanced_by):
        return watched_trace(case, wanted, _Drawing)[1]


def watched_trace(
    case: Case, wanted: Container[str] = ALL, model: type[Machine] = Machine
) -> tuple[Trace, dict[str, int]]:
    """Run the model over a case, and count how often it reaches each of `CORNERS`.

    Parameters
    ----------
    wanted : container of str
        Facts that are counted though they take long; all others are.
    model : type of Machine
        The specification, or an equal one.

    Returns
    -------
    done : Trace
        Same as that of `Case.trace`.
    reached : dict of str to int
        All corners and `bits_of` the design, including those that are not reached. For a design
        with the filter or contrast codes, `FILTER_CORNERS` are included.
    """
    done = Trace()
    machine, lookup = model(case.memories, case.start), case.memories.lookup()
    corners = CORNERS | FILTER_CORNERS if case.design.pauses else CORNERS
    tally: Counter[str] = Counter(dict.fromkeys([*corners, *sorted(bits_of(case.design))], 0))
    facts = Facts(machine, tally, wanted)
    before: list[int | None] = [None, None]
    rows: list[list[int]] = []
    for event in case.events:
        _see_event(machine, lookup, event, before, tally)
        ended = 0
        for result in machine.take(event):
            done.add(result)
            if isinstance(result, WindowResult):
                ended += 1
                _see_window(machine, result, tally)
                facts.see_window()
                if not case.design.filters:
                    distances = machine.distances(result.codes)
                    rows = [distances, *rows[: case.design.length - 1]]
                    _see_distances(case.design, distances, tally)
            elif isinstance(result, MatchResult) and case.design.filters:
                _see_distances(case.design, machine.compared[0], tally)
                facts.see_match(result)
            elif isinstance(result, MatchResult):
                _see_match(case.design, result, rows, tally, wanted)
        tally["gap"] += ended >= 3
    done.states = machine.states
    if case.design.pauses:
        facts.see_case(case, done)
    return done, dict(tally)


def _see_event(
    machine: Machine, lookup: Lookup, event: Event, before: list[int | None], tally: Counter[str]
) -> None:
    design, slot = machine.design, machine.slot(event)
    _, x, y, on = event
    ends = False
    if design.window == "time":
        tau = design.tau_us
        elapsed = tau - machine.left(event.t)
        ends = elapsed >= tau
        behind = elapsed % tau
        tally["on_the_boundary"] += elapsed > 0 and behind == 0
        tally["before_the_boundary"] += elapsed > 0 and behind == tau - 1
        tally["behind_silence"] += elapsed >= 2 * tau and behind > 0 and behind & (behind - 1) == 0
        tally["late"] += elapsed < 0
        half = 1 << (design.timestamp_bits - 1)
        tally["half_a_period_late"] += elapsed - tau == half
        missing = half - tau + elapsed
        if missing > 0 and missing & (missing - 1) == 0:
            tally[f"late_bit_{missing.bit_length() - 1}"] += missing < half
    if y == design.height:
        tally["below_the_sensor"] += 1
    if x in (0, design.width - 1) and y in (0, design.height - 1):
        tally["sensor_corner"] += 1
    if x >= design.width or y >= design.height:
        tally["off_the_sensor"] += 1
        tally["ended_off_the_sensor"] += ends
        beside = {f"column_bit_{n}": event._replace(x=x ^ 1 << n) for n in range(16)}
        beside |= {f"row_bit_{n}": event._replace(y=y ^ 1 << n) for n in range(15)}
        for name, one in beside.items():
            if name in tally:
                tally[name] += machine.slot(one) is not None
    elif slot is None:
        tally["unselected"] += 1
        tally["entry_of_another_row"] += lookup.taken(x, y)
    else:
        # the end of a window clears the counter before the event is counted
        count, full = 0 if ends else machine.counts[slot], design.count_max
        if count >= full - 1:
            tally["saturated" if count == full else "filled"] += 1
        if x > 511:
            tally["column_above_511"] += 1
        if design.contrast and count >= 255:
            tally["count_above_255"] += 1
        if before[-1] == slot:
            tally["same_pixel_twice"] += 1
        elif before[-2] == slot:
            tally["a_b_a"] += 1
        tally["on" if on else "off"] += 1
    before[:] = [before[-1], slot]


def _see_window(machine: Machine, window: WindowResult, tally: Counter[str]) -> None:
    design, counts = machine.design, machine.counts
    tally["empty_window"] += not any(counts)
    tally["full_window"] += machine.counted == design.window_events and design.window == "count"
    tally["all_equal_counts"] += counts[0] > 0 and len(set(counts)) == 1 and len(counts) > 1
    if design.window == "time":
        tally["narrow_clock"] += 9 * design.tau_us > 1 << design.timestamp_bits
        tally["clock_wrapped"] += machine.end < design.tau_us
        tally["short_clock_wrapped"] += machine.end < design.tau_us and design.timestamp_bits < 32
    tally["window_above_255"] += window.number > 255
    tally["window_above_4095"] += window.number > 4095
    tally["window_above_65535"] += window.number > 65_535
    tally["incomplete_sequence"] += window.number + 1 < design.length
    tally["lanes_unfilled"] += design.slots % design.lanes > 0


def _see_distances(design: Design, distances: Sequence[int], tally: Counter[str]) -> None:
    tally["zero_distance"] += 0 in distances
    tally["largest_distance"] += design.slots * design.code_max in distances
    tally["diagonal_off_the_map"] += min(distances) < min(distances[design.length - 1 :])


def _see_match(
    design: Design,
    match: MatchResult,
    rows: list[list[int]],
    tally: Counter[str],
    wanted: Container[str],
) -> None:
    """Count a match's corners; `rows` are the distances of the last L windows, newest first."""
    ends = range(design.length - 1, design.places)
    sums = [(k, sum(row[k - ago] for ago, row in enumerate(rows))) for k in ends]
    see_sums(tally, wanted, [total for _, total in sums], design.exclusion)
    tally["tie_of_two"] += match.ties == 1
    tally["tie_of_three"] += match.ties >= 2
    tally["ties_above_32767"] += match.ties > 32_767
    tally["long_sequence"] += design.length > 8
    tally["one_place"] += design.places == 1
    tally["accepted"] += match.accepted
    tally["rejected"] += not match.accepted
    tally["accepted_at_threshold"] += match.sum == design.largest_sum
    tally["rejected_at_threshold"] += match.sum == design.largest_sum + 1
    if match.second is None or match.second_sum is None:
        tally["no_second"] += 1
        return
    tally["place_0_on_the_left"] += match.second == 0 < match.place
    tally["tie_across_zone"] += match.second_sum == match.sum
    outside = [(k, s) for k, s in sums if abs(k - match.place) > design.exclusion]
    seconds = [k for k, s in outside if s == match.second_sum]
    inside = [s for k, s in sums if 0 < abs(k - match.place) <= design.exclusion]
    tally["tie_of_seconds"] += len(seconds) > 1
    tally["tie_of_seconds_on_the_left"] += sum(k < match.place for k in seconds) > 1
    tally["tie_of_seconds_on_both_sides"] += min(seconds) < match.place < max(seconds)
    tally["nearer_in_the_zone"] += min(inside, default=match.second_sum) < match.second_sum
    left = match.second < match.place
    tally["second_on_the_left" if left else "second_on_the_right"] += 1
