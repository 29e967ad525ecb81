"""Which corners a case reaches, from the model's states while it runs."""

from __future__ import annotations

from collections import Counter

from firmware_model.design import (
    ACTIVITY_FRACTION_BITS,
    EVIDENCE_TOP,
    FRACTION_BITS,
    LEVELS,
    MARGIN_TOP,
    METRIC_TOP,
    RECIPROCAL_FRACTION_BITS,
    RESIDUAL_TOP,
    TRUST_FRACTION_BITS,
    Design,
)
from firmware_model.memories import Lookup
from firmware_model.specification import (
    Event,
    Machine,
    MatchResult,
    Trace,
    WindowResult,
    differences_of,
    evidence_of,
    mean_shift,
    row_of,
    spread_of,
    weight_of,
    window_mean,
)
from firmware_model.vectors.case import Case
from fixedpoint.activity import ACTIVITY_COSTS, PAUSE_SHIFT, SAME_ROW
from fixedpoint.own_mean import FIRST_SHIFT, LEVEL_FRACTION_BITS, MEAN_FRACTION_BITS

#: name of each corner, and what is counted as one occurrence of it
CORNERS = {
    "saturated": "an event at a counter that is full",
    "filled": "an event that fills a counter",
    "same_pixel_twice": "an event at the selected pixel of the event before",
    "a_b_a": "an event at the selected pixel of the one before the last, with another between",
    "on_the_boundary": "an event at the very end of a window, which belongs to the next one",
    "before_the_boundary": "an event in the last microsecond of a window",
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
    "gap": "an event that ends three windows or more",
    "empty_window": "a window without events at selected pixels",
    "full_window": "a window that ends with its last event",
    "all_equal_counts": "a window with the same count, not zero, in every counter",
    "window_above_255": "a window with a number above 255",
    "incomplete_sequence": "a window before which there were fewer than L - 1",
    "zero_distance": "a place at distance zero",
    "largest_distance": "a place at the largest distance that there can be",
    "diagonal_off_the_map": "a window nearest to a place at which no sequence can end",
    "tie_of_two": "a match with one more place at its sum",
    "tie_of_three": "a match with two more places, or more",
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


def coverage(case: Case) -> dict[str, int]:
    """Count how often a case reaches each of `CORNERS`; see `watched_trace`."""
    return watched_trace(case)[1]


def watched_trace(case: Case) -> tuple[Trace, dict[str, int]]:
    """Run the model over a case, and count how often it reaches each of `CORNERS`.

    Returns
    -------
    done : Trace
        Same as that of `Case.trace`.
    reached : dict of str to int
        All corners, including those that are not reached. For a design with the filter or contrast
        codes, `FILTER_CORNERS` are included.
    """
    done = Trace()
    machine, lookup = Machine(case.memories, case.start), case.memories.lookup()
    corners = CORNERS | FILTER_CORNERS if case.design.pauses else CORNERS
    found: Counter[str] = Counter(dict.fromkeys(corners, 0))
    filtered = FilterCoverage(machine, found)
    before: list[int | None] = [None, None]
    rows: list[list[int]] = []
    for event in case.events:
        _see_event(machine, lookup, event, before, found)
        ended = 0
        for result in machine.take(event):
            done.add(result)
            if isinstance(result, WindowResult):
                ended += 1
                _see_window(machine, result, found)
                distances = machine.distances(result.codes)
                rows = [distances, *rows[: case.design.length - 1]]
                _see_distances(case.design, distances, found)
                filtered.see_window(result, distances)
            elif isinstance(result, MatchResult) and case.design.filters:
                filtered.see_match(result)
            elif isinstance(result, MatchResult):
                _see_match(case.design, result, rows, found)
        found["gap"] += ended >= 3
    done.states = machine.states
    return done, dict(found)


def _see_event(
    machine: Machine, lookup: Lookup, event: Event, before: list[int | None], found: Counter[str]
) -> None:
    design, slot = machine.design, machine.slot(event)
    _, x, y, on = event
    ends = False
    if design.window == "time":
        tau = design.tau_us
        elapsed = tau - machine.left(event.t)
        ends = elapsed >= tau
        found["on_the_boundary"] += elapsed > 0 and elapsed % tau == 0
        found["before_the_boundary"] += elapsed > 0 and elapsed % tau == tau - 1
        found["late"] += elapsed < 0
        found["half_a_period_late"] += elapsed - tau == 1 << (design.timestamp_bits - 1)
    if y == design.height:
        found["below_the_sensor"] += 1
    if x in (0, design.width - 1) and y in (0, design.height - 1):
        found["sensor_corner"] += 1
    if x >= design.width or y >= design.height:
        found["off_the_sensor"] += 1
        found["ended_off_the_sensor"] += ends
    elif slot is None:
        found["unselected"] += 1
        found["entry_of_another_row"] += lookup.taken(x, y)
    else:
        # the end of a window clears the counter before the event is counted
        count, full = 0 if ends else machine.counts[slot], design.count_max
        if count >= full - 1:
            found["saturated" if count == full else "filled"] += 1
        if x > 511:
            found["column_above_511"] += 1
        if design.contrast and count >= 255:
            found["count_above_255"] += 1
        if before[-1] == slot:
            found["same_pixel_twice"] += 1
        elif before[-2] == slot:
            found["a_b_a"] += 1
        found["on" if on else "off"] += 1
    before[:] = [before[-1], slot]


def _see_window(machine: Machine, window: WindowResult, found: Counter[str]) -> None:
    design, counts = machine.design, machine.counts
    found["empty_window"] += not any(counts)
    found["full_window"] += machine.counted == design.window_events and design.window == "count"
    found["all_equal_counts"] += counts[0] > 0 and len(set(counts)) == 1 and len(counts) > 1
    if design.window == "time":
        found["clock_wrapped"] += machine.end < design.tau_us
    found["window_above_255"] += window.number > 255
    found["incomplete_sequence"] += window.number + 1 < design.length
    found["lanes_unfilled"] += design.slots % design.lanes > 0


def _see_distances(design: Design, distances: list[int], found: Counter[str]) -> None:
    found["zero_distance"] += 0 in distances
    found["largest_distance"] += design.slots * design.code_max in distances
    found["diagonal_off_the_map"] += min(distances) < min(distances[design.length - 1 :])


def _see_match(
    design: Design, match: MatchResult, rows: list[list[int]], found: Counter[str]
) -> None:
    """Count a match's corners; `rows` are the distances of the last L windows, newest first."""
    ends = range(design.length - 1, design.places)
    sums = [(k, sum(row[k - ago] for ago, row in enumerate(rows))) for k in ends]
    found["tie_of_two"] += match.ties == 1
    found["tie_of_three"] += match.ties >= 2
    found["long_sequence"] += design.length > 8
    found["one_place"] += design.places == 1
    found["accepted"] += match.accepted
    found["rejected"] += not match.accepted
    found["accepted_at_threshold"] += match.sum == design.largest_sum
    found["rejected_at_threshold"] += match.sum == design.largest_sum + 1
    if match.second is None or match.second_sum is None:
        found["no_second"] += 1
        return
    found["place_0_on_the_left"] += match.second == 0 < match.place
    found["tie_across_zone"] += match.second_sum == match.sum
    outside = [(k, s) for k, s in sums if abs(k - match.place) > design.exclusion]
    seconds = [k for k, s in outside if s == match.second_sum]
    inside = [s for k, s in sums if 0 < abs(k - match.place) <= design.exclusion]
    found["tie_of_seconds"] += len(seconds) > 1
    found["tie_of_seconds_on_the_left"] += sum(k < match.place for k in seconds) > 1
    found["tie_of_seconds_on_both_sides"] += min(seconds) < match.place < max(seconds)
    found["nearer_in_the_zone"] += min(inside, default=match.second_sum) < match.second_sum
    left = match.second < match.place
    found["second_on_the_left" if left else "second_on_the_right"] += 1


# Corners of the place filter and of contrast codes.


#: bits of mean numbers of events that no window of a small case has
LARGE_MEANS = range(19, 24)
#: name of each corner, and what is counted as one occurrence of it
FILTER_CORNERS = {
    "first_window": "a first window that does not pause: its evidence is scaled by its own spread",
    "first_window_pauses": "a first window that pauses",
    "pause": "a window that pauses, and is not the first",
    "pause_with_events": "a window that pauses though it has events at selected pixels",
    "long_pause": "a window that pauses behind one that pauses",
    "pause_at_threshold": "a pause that would be none with a mean activity lower by 1/256 event",
    "pause_by_two": "a pause that would be none with a mean activity lower by 2/256 event",
    "pause_by_eight_events": "a pause that would be none with a mean activity lower by 8 events",
    "busy_at_threshold": "no pause, and would be one with a mean activity higher by 1/256 event",
    **{f"weight_{n}": f"a window whose evidence has {n}/8 of its weight" for n in range(9)},
    **{
        f"{half}costs_{n}": f"a place that is reached for the costs of row {n}{at_half}, not in "
        "the first window"
        for half, at_half in (("", ""), ("half_", " of places at half windows"))
        for n in range(len(ACTIVITY_COSTS))
    },
    "costs_below": "a place that is reached for the costs of the lowest row, and is below it",
    "costs_above": "a place that is reached for the costs of the highest row, and is above it",
    "least_place_activity": "a place of the least activity there is",
    "largest_place_activity": "a place of the largest activity there is",
    "pause_restarted": "a match in a window that pauses, of a place that only a restart leads to",
    **{
        f"mean_of_{n}_bits": f"a window behind the first, of whose mean number of events {n} bits "
        "are whole"
        for n in LARGE_MEANS
    },
    "events_above_16_bits": "a window with more events than 16 bits can count",
    "spread_of_nothing": "a window with the same distance to all places",
    "spread_of_one": "a window behind the first that is scaled by a spread of 1, of distances "
    "that differ to places of two words",
    "evidence_saturated": "a place whose evidence is at its largest, and would be above it",
    "metric_saturated": "a place whose metric is at its largest, and would be above it",
    "second_saturated": "a match whose second best has the largest metric",
    "restarted": "a place that nothing leads to for less than a restart",
    "stood": "a match at the place of the one before",
    "stepped": "a match one place further",
    "largest_step": "a match that follows by the largest step that there is",
    "beyond_the_largest_step": "a match one place further than that, which does not follow",
    "stepped_back": "a match one place lower, which does not follow",
    "filter_tie": "a match with another place at its metric",
    "filter_no_second": "a match of the filter without a second best",
    "trusted_at_threshold": "a match whose trust is the least that is accepted",
    "distrusted_at_threshold": "a match that is rejected for a trust less by one",
    "margin_limited": "a match with a margin that is above the largest that counts",
    "residual_limited": "a match with the largest residual, whose trust is above 0 without it",
    "residual_of_this_window": "a match with less trust for its own residual alone, and some left",
    "residual_of_the_window_before": "the same for the residual of the match before",
    "residual_of_two_windows_before": "the same for the residual of the match before that one",
    "trust_of_nothing": "a match whose residual is above its support",
    "count_above_255": "an event at a counter of 255 or more, of contrast codes",
    "code_at_the_bottom": "a contrast code of 0 that would be below it",
    "code_at_the_top": "the largest contrast code, that would be above it",
    "window_mean_below_nothing": "a window of contrast codes whose mean is negative",
    "window_mean_rounded_up": "a window of contrast codes whose mean is rounded up",
    "window_mean_rounded_down": "a window of contrast codes whose mean is rounded down",
    "mean_falls_by_part": "a running mean that falls by what the shift does not divide",
    "mean_rises_by_part": "a running mean that rises by what the shift does not divide",
    "mean_held": "a window that pauses and leaves other means as they are",
    **{f"mean_shift_{n}": f"a mean that moves by 1/{1 << n}" for n in range(FIRST_SHIFT, 9)},
}


_OF_RESIDUALS = (
    "residual_of_this_window", "residual_of_the_window_before", "residual_of_two_windows_before",
)  # fmt: skip


class FilterCoverage:
    """Counts corners from what a machine keeps, before each window changes them.

    Of sequences of counts there are none.
    """

    def __init__(self, machine: Machine, found: Counter[str]) -> None:
        self.machine, self.found = machine, found
        self._residuals = (0, 0, 0)  # of the last matches, the newest first
        self._paused = self._restarted = False
        self._last = -1

    def see_window(self, window: WindowResult, distances: list[int]) -> None:
        """Count the corners of a window, before it is matched and its counters are cleared."""
        if self.machine.design.contrast:
            self._see_means(window)
        if self.machine.design.filters:
            self._see_metrics(window, distances)

    def _see_metrics(self, window: WindowResult, distances: list[int]) -> None:
        design, found = self.machine.design, self.found
        first, paused = window.number == 0, window.paused
        found["first_window"] += first and not paused
        found["first_window_pauses"] += first and paused
        found["pause"] += paused and not first
        found["pause_with_events"] += paused and self.machine.counted > 0
        counted, mean_activity = self.machine.counted, self.machine.kept.mean_activity
        threshold = counted << (ACTIVITY_FRACTION_BITS + PAUSE_SHIFT)
        found["pause_at_threshold"] += counted > 0 and mean_activity == threshold + 1
        found["pause_by_two"] += counted > 0 and mean_activity == threshold + 2
        found["pause_by_eight_events"] += counted > 0 and (
            mean_activity == threshold + (8 << ACTIVITY_FRACTION_BITS)
        )
        found["busy_at_threshold"] += counted > 0 and mean_activity == threshold
        found["long_pause"] += paused and self._paused
        self._paused = paused
        bits = (mean_activity >> ACTIVITY_FRACTION_BITS).bit_length()
        if not first and bits in LARGE_MEANS:
            found[f"mean_of_{bits}_bits"] += 1
        found["events_above_16_bits"] += counted > 0xFFFF
        predictions = self.machine.predictions(window.activity)
        limit = design.restart << FRACTION_BITS
        self._restarted = (
            paused
            and not first
            and predictions.index(min(predictions))
            in {place for place, metric in enumerate(predictions) if metric == limit}
        )
        if not first:
            self._see_costs(window.activity)
        if not first and design.restart:
            found["restarted"] += limit in predictions
        if paused:
            return
        found[f"weight_{weight_of(window.activity)}"] += 1
        found["spread_of_nothing"] += design.places > 1 and len(set(distances)) == 1
        one = 1 << RECIPROCAL_FRACTION_BITS
        scale = self.machine.kept.filter.reciprocal or one // spread_of(distances)
        least = min(distances)
        found["spread_of_one"] += (
            scale == one and not first and max(distances) > least and design.words == 2
        )
        against = evidence_of(distances, scale, weight_of(window.activity))
        for distance, predicted, evidence in zip(distances, predictions, against, strict=True):
            found["evidence_saturated"] += (distance - least) * scale >> 14 > EVIDENCE_TOP
            found["metric_saturated"] += predicted + evidence > METRIC_TOP

    def _see_costs(self, activity: int) -> None:
        """Count the rows of the costs of a window's steps, and the activities of places."""
        found, rows = self.found, len(ACTIVITY_COSTS)
        half = "half_" if self.machine.design.places_per_window == 2 else ""
        for own in self.machine.memories.place_activity:
            row = row_of(activity - own)
            beyond = ((activity - own + 4) >> 3) + SAME_ROW
            found[f"{half}costs_{row}"] += 1
            found["costs_below"] += beyond < 0
            found["costs_above"] += beyond >= rows
            found["least_place_activity"] += own == -128
            found["largest_place_activity"] += own == 127

    def see_match(self, match: MatchResult) -> None:
        """Count the corners of a match."""
        design, found, last = self.machine.design, self.found, self._last
        self._last = match.place
        found["pause_restarted"] += self._restarted
        found["filter_tie"] += match.ties > 0
        found["filter_no_second"] += match.second is None
        found["second_saturated"] += match.second_sum == METRIC_TOP
        assert match.trust is not None, "a match of the filter has one"
        self._see_trust(match)
        second = match.second is not None and design.trust > 0
        found["trusted_at_threshold"] += match.accepted and second and match.trust == design.trust
        found["distrusted_at_threshold"] += second and match.trust == design.trust - 1
        if last < 0:
            return
        step, largest = match.place - last, design.steps - 1
        found["stood"] += step == 0
        found["stepped"] += step == 1
        found["largest_step"] += step == largest
        found["beyond_the_largest_step"] += step == largest + 1
        found["stepped_back"] += step == -1

    def _see_trust(self, match: MatchResult) -> None:
        """Count the corners of the trust in a match, and keep its residual."""
        found, after = self.found, self.machine.kept.filter
        residuals = self._residuals = (after.residuals[0], *self._residuals[:2])
        worst = max(residuals)
        if match.second_sum is not None:
            found["margin_limited"] += match.second_sum - match.sum > MARGIN_TOP
        found["residual_limited"] += residuals[0] == RESIDUAL_TOP and after.support > 0
        found["trust_of_nothing"] += after.support < worst << TRUST_FRACTION_BITS
        for name, residual in zip(_OF_RESIDUALS, residuals, strict=True):
            found[name] += (
                match.trust != 0 and residuals.count(worst) == 1 and residual == worst > 0
            )

    def _see_means(self, window: WindowResult) -> None:
        found, kept = self.found, self.machine.kept
        levels = [LEVELS[count] for count in self.machine.counts]
        shift, differences = mean_shift(kept.moves), differences_of(levels, kept.means)
        half = 1 << (self.machine.design.code_bits - 1)
        shared = window_mean(differences)
        exact = shared * len(levels)
        found["window_mean_below_nothing"] += shared < 0
        found["window_mean_rounded_up"] += exact > sum(differences)
        found["window_mean_rounded_down"] += exact < sum(differences)
        for slot, level in enumerate(levels):
            octaves = (
                differences[slot] - shared + (1 << (LEVEL_FRACTION_BITS - 1))
            ) >> LEVEL_FRACTION_BITS
            found["code_at_the_bottom"] += octaves + half < 0
            found["code_at_the_top"] += octaves + half >= 2 * half
            difference = (level << MEAN_FRACTION_BITS) - kept.means[slot]
            if window.paused:
                found["mean_held"] += difference != 0
                continue
            part = difference % (1 << shift) > 0
            found["mean_falls_by_part"] += part and difference < 0
            found["mean_rises_by_part"] += part and difference > 0
        if not window.paused:
            found[f"mean_shift_{shift}"] += 1
