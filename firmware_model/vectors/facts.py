"""What the specification does in a window, as named facts: those that vectors must show.

Facts are computed from what the model keeps and returns, not from how a case was made.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from firmware_model import specification
from firmware_model.design import (
    ACTIVITY_FRACTION_BITS,
    BIAS_TOP,
    EVIDENCE_TOP,
    FRACTION_BITS,
    LEVEL_TOP,
    LEVELS,
    MARGIN_TOP,
    METRIC_TOP,
    RECIPROCAL_FRACTION_BITS,
    RESIDUAL_TOP,
    TRUST_FRACTION_BITS,
    Design,
    formats_of,
)
from firmware_model.specification import (
    FEW_BELOW,
    PATIENCE,
    WHOLE_AGE,
    Advanced,
    Filter,
    FilterMap,
    Kept,
    Machine,
    MatchResult,
    Rows,
    Seen,
    Trace,
    activity_of,
    decide,
    differences_of,
    evidence,
    ilog,
    is_pause,
    mean_activity_after,
    mean_shift,
    search,
    see,
    sums_of,
    which_sum,
    window_mean,
)
from firmware_model.vectors.case import Case, in_order, window_codes
from firmware_model.vectors.fast_filter import advanced_by, changed, predictions
from fixedpoint.activity import BANK_COSTS, GAINS, LOG_TOP, PARTS, PAUSE_SHIFT, SAME_ROW, SUMS
from fixedpoint.own_mean import (
    FIRST_SHIFT,
    LAST_SHIFT,
    LEVEL_FRACTION_BITS,
    MEAN_FRACTION_BITS,
)

#: bits of a mean number of events, but for those that change a pause alone
_MEAN_BITS = range(ACTIVITY_FRACTION_BITS + PAUSE_SHIFT, 31)
#: bits of a sum over the places of the largest design
_SUM_BITS = range(55)
_ROWS = range(len(BANK_COSTS[1]))
#: facts of the parts of an octave in the logarithm of the mean
LOGARITHMS = [f"logarithm_{n}{which}" for which in ("", "_below") for n in range(PARTS)]
_OF_THE_MIDDLE = (
    "middle_below", "middle_above", "middle_of_the_reach", "near_at_threshold", "near_beyond",
    "middle_at_the_first", "middle_at_the_last", "told_back",
)  # fmt: skip
#: corners of `coverage` that a core of one size shows in windows by time
OF_THE_CLOCK = {"before_the_boundary", "clock_wrapped", "gap", "late", "on_the_boundary"}
#: those of such a core, if it is small, that take many windows
OF_MANY_WINDOWS = {"half_a_period_late", "window_above_4095"}
#: the same of its counters, in windows of any kind
OF_COUNTERS = {"filled", "saturated"}
#: and of its matches by sequences
OF_SEQUENCES = {
    "zero_distance", "largest_distance", "tie_of_two", "tie_of_three", "tie_across_zone",
    "tie_of_seconds", "tie_of_seconds_on_the_left", "tie_of_seconds_on_both_sides",
    "second_on_the_left", "second_on_the_right", "nearer_in_the_zone", "diagonal_off_the_map",
}  # fmt: skip
#: bits that decide; `bits_of` a design are those that it has
BITS = {
    **{
        f"{side}_bit_{n}": f"an event off the sensor, but for bit {n} of its {side} at a selected "
        "pixel"
        for side, bits in (("column", 16), ("row", 15))
        for n in range(bits)
    },
    **{
        f"late_bit_{n}": f"an event half the clock's period before the end of a window, less 2^{n}"
        for n in range(63)
    },
    **{f"sum_bit_{n}": f"a match that would be another were bit {n} of all sums 0"
       for n in range(43)},
    **{
        f"left_bit_{n}": f"a match whose second best is lower, with bit {n} in its sum"
        for n in range(43)
    },
    **{f"mean_bit_{n}": f"a match that would be another were bit {n} of the mean activity 0"
       for n in range(31)},
    **{f"distance_bit_{n}": f"a match that would be another were bit {n} of all distances 0"
       for n in range(31)},
    **{
        f"{name}_bit_{n}": f"a match that would be another were bit {n} of the sum of {what} 0"
        for name, what in (
            ("total", "distances"), ("deviations", "the deviations from their mean"),
        )
        for n in _SUM_BITS
    },
}  # fmt: skip
OF_MEANS = {f"mean_bit_{n}" for n in _MEAN_BITS}
#: facts of a design with the place filter; what is counted as one occurrence of each
FILTER = {
    "first_window": "a first window that does not pause: its evidence is scaled by its own spread",
    "first_window_pauses": "a first window that pauses",
    "pause": "a window that pauses, and is not the first",
    "pause_with_events": "a window that pauses though it has events that count",
    "long_pause": "a window that pauses behind one that pauses",
    "pause_at_threshold": "a pause that would be none with a mean activity lower by 1/256 event",
    "busy_at_threshold": "no pause, and would be one with a mean activity higher by 1/256 event",
    "scale_over_pause": "a window behind a pause that is scaled by the spread before the pause",
    **{f"weight_{n}": f"a window whose evidence has {n}/8 of its weight" for n in range(9)},
    **{
        f"{which}_at_threshold": "a match that would be another were the threshold of few events "
        f"1/16 octave {where}"
        for which, where in (("few", "lower"), ("enough", "higher"))
    },
    "few_forgotten": "a window that ends a row of one or two with few events",
    "standing_begins": "a window with which the robot stands",
    "standing_goes_on": "a window in which the robot still stands",
    "standing_ends": "a window with which the robot stands no more",
    **{
        f"{half}costs_{n}": f"a place that is reached for the costs of row {n}{at_half}, not in "
        "the first window"
        for half, at_half in (("", ""), ("half_", " of places at half windows"))
        for n in _ROWS
    },
    "costs_below": "a place that is reached for the costs of the lowest row, and is below it",
    "costs_above": "a place that is reached for the costs of the highest row, and is above it",
    "least_place_activity": "a place of the least activity there is",
    "largest_place_activity": "a place of the largest activity there is",
    **{
        f"logarithm_{n}{which}": f"a mean number of 18 bits or more {what} of part {n} of an "
        "octave, where a part less or more is another match"
        for n in range(16)
        for which, what in (("", "that is the least"), ("_below", "one below the least"))
    },
    "decay_rounded": "a pause that takes from the mean what 1,024 does not divide",
    "decay_decides": "a case that would be another had this been rounded towards 0",
    "events_decide": "a case that would be another had a number of events stopped at 65,535",
    "silence_of_nothing": "a window without events, of a mean of 0",
    "silence_decides": "a case that would be another were only few events a pause, of any mean",
    "restarted": "a place that nothing leads to for less than a restart",
    "pause_restarted": "a best place in a window that pauses that only a restart leads to",
    "evidence_limit_decides": "a match that would be another had evidence no limit before its "
    "weight",
    "large_evidence_decides": "a match that would be another had evidence 7 bits before its weight",
    "large_activity_decides": "a match that would be another had the activity of a window 7 bits "
    "and a sign",
    "metric_saturated": "a place whose metric is at its largest, and would be above it",
    "second_saturated": "a match whose second best has the largest metric",
    "spread_of_nothing": "a window with the same distance to all places",
    "spread_of_one": "a window behind the first that is scaled by a spread of 1, of distances "
    "that differ",
    "distance_above_8_bits": "a window with a distance above 255 to a place, and one below",
    "total_above_16_bits": "a window whose distances add up to more than 16 bits",
    "deviations_above_16_bits": "a window whose distances deviate by more than 16 bits in all",
    "nearest_above_7_bits": "a window with a distance above 127 to every place",
    "bias_decides": "a window whose nearest place is another one without the bias",
    "largest_bias": "a place of the largest bias there is",
    "middle_below": "a match that is told below the best place",
    "middle_above": "a match that is told above the best place",
    "middle_of_the_reach": "a match with more near places on a side than are asked",
    "near_at_threshold": "a match told for a place that is as far as a near one may be",
    "near_beyond": "a match told without a place that is one further",
    "middle_at_the_first": "a match whose near places go down to the first of the map",
    "middle_at_the_last": "a match whose near places go up to the last of the map",
    "whole_place_told": "a match of whole places beside a place that would be near",
    "stood": "a best place that is the one before",
    "stepped": "a best place one further",
    "largest_step": "a best place that follows by the largest step that there is",
    "beyond_the_largest_step": "a best place one further than that, which does not follow",
    "stepped_back": "a best place one lower, which does not follow",
    "told_back": "a best place that follows, though what is told is below what was told",
    "filter_tie": "a match with another place at its metric",
    "ties_above_4095": "a match with more than 4,095 further places at its metric",
    "all_places_tie": "a match with all other places at its metric",
    "filter_no_second": "a match of the filter without a second best",
    "trusted_at_threshold": "a match whose trust is the least that is accepted",
    "distrusted_at_threshold": "a match that is rejected for a trust less by one",
    "margin_limited": "a match with a margin that is above the largest that counts",
    "residual_limited": "a match with the largest residual, whose trust is above 0 without it",
    "residual_of_this_window": "a match with less trust for its own residual alone, and some left",
    "residual_of_the_window_before": "the same for the residual of the match before",
    "residual_of_two_windows_before": "the same for the residual of the match before that one",
    "trust_of_nothing": "a match whose residual is above its support",
    "support_stood": "a match at the place before whose support falls by 1/8 instead of rising",
    "young": "a match with less trust for the age of its path, and some left",
    "trust_rounded": "a match whose trust is rounded down for its age",
    "trust_above_255": "a match with a trust above 255",
    "of_age": "a match with trust whose path is of age, and was before",
}  # fmt: skip
#: facts of the place filter with several gains
SEVERAL_GAINS = {
    **{f"gain_{h}": f"a match of gain {gain}/16 octave" for h, gain in enumerate(GAINS)},
    "gain_tie": "a match whose best place has its metric with two gains",
    "gain_changed": "a match that follows with another gain",
    **{
        f"change_{which}_decides": f"a match that would be another had there been no change {what}"
        for which, what in (
            ("up", "to a higher gain"), ("down", "to a lower one"), ("by_one", "by one gain"),
            ("by_several", "by two gains and more"),
            ("by_five", "by five gains: one by six costs more than the largest metric"),
        )
    },
    "changes_before_restart_decide": "a match that would be another had a restart been from the "
    "best place of a gain before changes of gain",
    **{f"sum_{n}": f"a match by the sum of {n} windows" for n in SUMS},
    "three_sums": "a window in which gains look at all three sums",
    "sum_forgotten": "a window in which a sum is looked at no more",
    "sum_returns": "a window in which a sum is looked at again",
    "forgetting_decides": "a match that would be another had a sum not been forgotten",
    "slowness_decides": "a match that would be another had the mean speed moved by 1/32 at least",
    "first_speed_decides": "a match that would be another began the mean speed at one octave",
    "large_speed_decides": "a match that would be another had the mean speed 10 bits and a sign",
    "largest_speed_decides": "a match that would be another had the mean speed 11 bits and a sign",
    "lowest_speed_decides": "a match that would be another had the mean speed -1,024 at least",
    "low_gains_decide": "a match that would be another had no low gain become the next lower one",
    **{f"speed_shift_{n}": f"a mean speed that moves by 1/{1 << n}" for n in range(7)},
    "speed_saturated": "a mean speed that moves after 63 windows",
    "speed_below_nothing": "a negative mean speed that does not move by whole parts of an octave",
    "sum_above_1023": "a sum of counts that is above the largest count",
    "large_sum_decides": "a case that would be another had such a sum 10 bits",
    "quiet_place": "a window that is no pause and has part of its weight, at a place with fewer "
    "events by 4 1/2 octaves than the mean",
    "mean_apart": "a window whose running mean is an octave or more from the map's",
}  # fmt: skip
#: facts of contrast codes
CONTRAST = {
    "count_above_255": "an event at a counter of 255 or more, of contrast codes",
    "limit_clips": "a pixel with more events than count",
    "limit_of_nothing": "a pixel with events of which none counts",
    "code_at_the_bottom": "a contrast code of 0 that would be below it",
    "code_at_the_top": "the largest contrast code, that would be above it",
    "window_mean_below_nothing": "a window of contrast codes whose mean is negative",
    "window_mean_rounded_up": "a window of contrast codes whose mean is rounded up",
    "window_mean_rounded_down": "a window of contrast codes whose mean is rounded down",
    "mean_falls_by_part": "a running mean that falls by what the shift does not divide",
    "mean_rises_by_part": "a running mean that rises by what the shift does not divide",
    "mean_of_a_half": "a code that is another one if its mean of half a unit is rounded down",
    "mean_held": "a window that pauses and leaves other means as they are",
    **{
        f"mean_shift_{n}": f"a mean that moves by 1/{1 << n}"
        for n in range(FIRST_SHIFT, LAST_SHIFT + 1)
    },
    **{
        f"mean_shift_{n}_decides": f"a case that would be another had no mean moved by 1/{1 << n}"
        for n in range(FIRST_SHIFT + 1, LAST_SHIFT + 1)
    },
    "last_shift_stays": "a case that would be another had the number of windows begun anew",
    "highest_mean": "a counter whose running mean is the largest there is",
    "events_above_16_bits": "a window with more events than 16 bits can count",
}
#: all of them
FILTER_CORNERS = FILTER | SEVERAL_GAINS | CONTRAST


def facts_for(design: Design) -> set[str]:
    """Return the facts that vectors of a design show: of fewer than 8 pixels as many as can be."""
    names = set(CONTRAST) | set(FILTER) | OF_MEANS | {"window_above_4095"}
    names -= {"events_above_16_bits"}  # a case is large, and one that shows `events_decide` has it
    if design.gains > 1:
        names |= set(SEVERAL_GAINS)
    return names


def bits_of(design: Design) -> set[str]:
    """Return those of `BITS` that a design has."""
    bits = {
        "column": range((design.width - 1).bit_length(), 16),
        "row": range((design.height - 1).bit_length(), 15),
        "sum": range(formats_of(design)["sum"].width),
        "left": range(formats_of(design)["sum"].width),
    }
    if design.window == "time":
        bits["late"] = range(design.timestamp_bits - 1)
    if design.filters:
        places, farthest = design.places, far(design)
        # The division by the number of places takes the lower ones. The largest sums are those of
        # all places but one far away, and of half of them, less what rounding the mean may take.
        lowest = places.bit_length()
        bits["mean"] = _MEAN_BITS
        bits["distance"] = range(farthest.bit_length())
        bits["total"] = range(lowest, ((places - 1) * farthest).bit_length())
        bits["deviations"] = range(lowest, max(places // 2 * farthest - places, 0).bit_length())
    return {f"{name}_bit_{n}" for name, numbers in bits.items() for n in numbers}


def far(design: Design) -> int:
    """Return a distance that places can have from any codes, see `apart`."""
    return design.slots * ((design.code_max + 1) // 2)


def apart(codes: Sequence[int], design: Design) -> list[int]:
    """Return codes that are as far from these as any."""
    return [0 if 2 * code > design.code_max else design.code_max for code in codes]


def own_facts(design: Design) -> set[str]:
    """Return the facts that are looked for in cases of a design itself.

    The parts of a logarithm's table are the same in every design, and take long to show in a large
    map, as bits of the mean and thousands of windows do.
    """
    names = OF_COUNTERS | bits_of(design) | (set(FILTER) if design.filters else OF_SEQUENCES)
    # bits of its own widths, in place of those that are wide in other designs
    names -= {"distance_above_8_bits", "total_above_16_bits", "deviations_above_16_bits"}
    names = names.difference(LOGARITHMS, OF_MANY_WINDOWS, {"ties_above_4095"})
    if design.gains > 1:
        names |= set(SEVERAL_GAINS)
    small = design.places * design.slots <= 1 << 13
    if not small:
        names -= OF_MEANS | {"quiet_place", "lowest_speed_decides"}
    half = design.places_per_window == 2
    names -= {f"{'' if half else 'half_'}costs_{n}" for n in _ROWS}
    names -= {"whole_place_told"} if half else set(_OF_THE_MIDDLE)
    if design.contrast:
        names |= set(CONTRAST) - {"events_above_16_bits"}
    if design.length == 1:
        names -= {"diagonal_off_the_map"}
    if design.window == "count" or design.contrast:
        names -= {"largest_distance"}
    if design.window == "count" and design.window_events <= design.count_max:
        names -= OF_COUNTERS
    if design.places > 2 * design.exclusion + 1:
        names -= {"filter_no_second"}
    if design.slots * design.count_max <= 0xFFFF:
        names -= {"events_decide"}
    if design.restart << FRACTION_BITS > BANK_COSTS[design.places_per_window][-1][0]:
        names -= {"pause_restarted"}  # to stay costs less, also in the highest row
    if not design.trust:
        names -= {"trusted_at_threshold", "distrusted_at_threshold"}
    if design.window == "time":
        names |= OF_THE_CLOCK
        if small and not design.filters:
            half_a_period = 1 << (design.timestamp_bits - 1)
            names |= {"window_above_4095"}
            names |= {"half_a_period_late"} if half_a_period < 4096 * design.tau_us else set()
    return names


def see_sums(
    tally: Counter[str], wanted: Container[str], sums: Sequence[int], exclusion: int
) -> None:
    """Count bits of sums: without which places are others, and of a second best on the left."""
    nearest = search(sums, exclusion)
    places = nearest._replace(sum=0, second_sum=0)
    for n in range(max(sums).bit_length()):
        if f"sum_bit_{n}" in wanted:
            other = search([one & ~(1 << n) for one in sums], exclusion)
            tally[f"sum_bit_{n}"] += other._replace(sum=0, second_sum=0) != places
    if nearest.second is not None and nearest.second < nearest.place:
        seconds = nearest.second_sum or 0
        for n in range(seconds.bit_length()):
            tally[f"left_bit_{n}"] += seconds >> n & 1


class Facts:
    """Counts facts from what a machine keeps before and after each window.

    Facts that another device or filter decides take long, and are counted only if they are wanted.
    """

    def __init__(self, machine: Machine, tally: Counter[str], wanted: Container[str]) -> None:
        self.machine, self.tally, self._wanted = machine, tally, wanted
        self._kept: Kept = machine.kept
        self._residuals = (0, 0, 0)  # of the last matches, the newest first
        self._paused = False
        self._told = -1
        self._others: dict[str, Filter | None] = {}

    def see_window(self) -> None:
        """Count the facts of a window, before it is matched and its counters are cleared."""
        machine, design, tally = self.machine, self.machine.design, self.tally
        self._kept = machine.kept
        self._newest = [list(machine.counts), *machine.kept.newest]
        if not design.pauses:
            return
        counted = machine.that_count
        tally["events_above_16_bits"] += counted > 0xFFFF
        if design.contrast:
            self._see_means()
            for count, limit in zip(machine.counts, machine.memories.limits, strict=True):
                tally["limit_clips"] += count > limit > 0
                tally["limit_of_nothing"] += count > limit == 0

    def see_match(self, match: MatchResult) -> None:
        """Count the facts of a match of the place filter."""
        advanced, before = self.machine.advanced, self._kept.filter
        assert advanced is not None
        filter_map = FilterMap.of(self.machine.memories)
        self._see_pause(advanced, before)
        for name in _events_facts(before, advanced.seen):
            self.tally[name] += 1
        self._see_costs(filter_map, before, advanced)
        self._see_logarithm(filter_map, before, advanced)
        self._see_mean(filter_map, before, advanced)
        self._see_metrics(filter_map, before, advanced)
        self._see_best(filter_map, match, before, advanced)
        self._see_trust(match, advanced, before)
        if len(filter_map.gains) > 1:
            self._see_gains(filter_map, before, advanced)
        self._see_others(filter_map, before, advanced)
        self._paused, self._told = advanced.seen.paused, match.place

    def _see_pause(self, advanced: Advanced, before: Filter) -> None:
        tally, state = self.tally, self.machine.states[-1]
        first, paused = before.place is None, advanced.seen.paused
        counted, mean = state.counted, state.mean_activity
        tally["first_window"] += first and not paused
        tally["first_window_pauses"] += first and paused
        tally["pause"] += paused and not first
        tally["pause_with_events"] += paused and counted > 0
        tally["silence_of_nothing"] += counted == 0 == mean
        threshold = counted << (ACTIVITY_FRACTION_BITS + PAUSE_SHIFT)
        tally["pause_at_threshold"] += counted > 0 and mean == threshold + 1
        tally["busy_at_threshold"] += counted > 0 and mean == threshold
        tally["long_pause"] += paused and self._paused
        tally["decay_rounded"] += paused and mean % 1024 > 0
        tally["scale_over_pause"] += self._paused and not paused and any(before.reciprocals)

    def _see_costs(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        """Count the rows of the costs of a window's steps, and the activities of places."""
        tally, seen = self.tally, advanced.seen
        tally["least_place_activity"] += -128 in filter_map.activity
        tally["largest_place_activity"] += 127 in filter_map.activity
        tally["largest_bias"] += BIAS_TOP in filter_map.bias
        if before.place is None or seen.stands:
            return
        half = "half_" if filter_map.per_window == 2 else ""
        left = seen.activity - np.add.outer(filter_map.gains, filter_map.activity)
        beyond = ((left + 4) >> 3) + SAME_ROW
        rows = np.clip(beyond, 0, len(_ROWS) - 1)
        for row, times in enumerate(np.bincount(rows.ravel()).tolist()):
            tally[f"{half}costs_{row}"] += times
        tally["costs_below"] += int((beyond < 0).sum())
        tally["costs_above"] += int((beyond >= len(_ROWS)).sum())

    def _see_logarithm(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        """Count means at the edges of logarithms, where these decide about a row."""
        seen, design = advanced.seen, self.machine.design
        mean = self.machine.memories.activity if design.gains > 1 else self._kept.mean_activity
        number = mean >> ACTIVITY_FRACTION_BITS
        if before.place is None or seen.stands or number < 1 << 17:
            return
        log, state = ilog(number), self.machine.states[-1]
        for name, is_edge, other in (
            (f"logarithm_{log % 16}", log > ilog(number - 1), 1),
            (f"logarithm_{(log + 1) % 16}_below", log < ilog(number + 1), -1),
        ):
            if is_edge:
                activity = state.activity + other
                other_one = advanced_by(
                    filter_map, before, activity, state.paused, self.machine.compared
                )
                self.tally[name] += _told(other_one) != _told(advanced)

    def _see_mean(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        """Count bits of the mean without which one of the first matches is another."""
        state, seen = self.machine.states[-1], advanced.seen
        first = self.machine.memories.activity
        several = self.machine.design.gains > 1
        if state.window > 3:
            return
        for n in _MEAN_BITS:
            name, without = f"mean_bit_{n}", ~(1 << n)
            if name not in self._wanted or self.tally[name]:
                continue
            paused = is_pause(state.counted, state.mean_activity & without)
            mean = (first if several else state.mean_activity) & without
            activity = activity_of(state.counted, mean)
            if (paused, activity) != (seen.paused, seen.activity):
                other = advanced_by(filter_map, before, activity, paused, self.machine.compared)
                self.tally[name] += _told(other) != _told(advanced)

    def _see_metrics(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        tally, seen, first = self.tally, advanced.seen, before.place is None
        restarts = [int(row.min()) + filter_map.restart for row in changed(before.metrics)]
        best, gain = advanced.best.place, advanced.best.gain
        if not first and filter_map.restart:
            for row, restart in zip(advanced.predicted, restarts, strict=True):
                tally["restarted"] += restart in row
        if not first and seen.paused:
            tally["pause_restarted"] += advanced.predicted[gain][best] == restarts[gain]
        tally["second_saturated"] += advanced.best.nearest.second_sum == METRIC_TOP
        if seen.paused:
            return
        one = 1 << RECIPROCAL_FRACTION_BITS
        for i in set(seen.looks):
            plain = self.machine.compared[i]
            distances = [d + b for d, b in zip(plain, filter_map.bias, strict=True)]
            least, most, scale = min(distances), max(distances), advanced.evidence.scales[i]
            tally["spread_of_nothing"] += len(distances) > 1 and most == least
            tally["spread_of_one"] += scale == one and not first and most > least
            tally["nearest_above_7_bits"] += least > 127
            tally["distance_above_8_bits"] += least <= 255 < most
            total = sum(distances)
            mean = total // len(distances)
            tally["total_above_16_bits"] += total > 0xFFFF
            tally["deviations_above_16_bits"] += sum(abs(d - mean) for d in distances) > 0xFFFF
            tally["bias_decides"] += distances.index(least) != plain.index(min(plain))
        for row, i in zip(advanced.predicted, seen.looks, strict=True):
            pairs = zip(row, advanced.evidence.against[i], strict=True)
            tally["metric_saturated"] += any(p + e > METRIC_TOP for p, e in pairs)

    def _see_best(
        self, filter_map: FilterMap, match: MatchResult, before: Filter, advanced: Advanced
    ) -> None:
        tally, design, best = self.tally, self.machine.design, advanced.best.place
        least = [min(column) for column in zip(*advanced.state.metrics, strict=True)]
        see_sums(tally, self._wanted, least, filter_map.exclusion)
        near, last = least[best] + 8, len(least) - 1
        tally["middle_below"] += match.place < best
        tally["middle_above"] += match.place > best
        if filter_map.reach:
            first, end = best, best
            while first > max(best - filter_map.reach, 0) and least[first - 1] <= near:
                first -= 1
            while end < min(best + filter_map.reach, last) and least[end + 1] <= near:
                end += 1
            beside = [k for k in (first - 1, end + 1) if 0 <= k <= last]
            tally["middle_of_the_reach"] += any(least[k] <= near for k in beside)
            tally["near_beyond"] += any(least[k] == near + 1 for k in beside)
            tally["near_at_threshold"] += near in least[first : end + 1]
            tally["middle_at_the_first"] += first == 0 < best
            tally["middle_at_the_last"] += end == last > best
        else:
            beside = [k for k in (best - 1, best + 1) if 0 <= k <= last]
            # one on one side alone: the middle would be another
            tally["whole_place_told"] += sum(least[k] <= near for k in beside) == 1
        tally["filter_tie"] += match.ties > 0
        tally["ties_above_4095"] += match.ties > 4095
        tally["all_places_tie"] += 0 < match.ties == last
        tally["filter_no_second"] += match.second is None
        second = match.second is not None and design.trust > 0
        tally["trusted_at_threshold"] += second and match.trust == design.trust
        tally["distrusted_at_threshold"] += second and match.trust == design.trust - 1
        if before.place is None:
            return
        step = best - before.place
        tally["stood"] += step == 0
        tally["stepped"] += step == 1
        tally["largest_step"] += step == filter_map.last
        tally["beyond_the_largest_step"] += step == filter_map.last + 1
        tally["stepped_back"] += step == -1
        tally["told_back"] += 0 <= step <= filter_map.last and match.place < self._told

    def _see_trust(self, match: MatchResult, advanced: Advanced, before: Filter) -> None:
        """Count the facts of the trust in a match, and keep its residual."""
        tally, judged = self.tally, advanced.trust
        residuals = self._residuals = (judged.residual, *self._residuals[:2])
        worst, support = max(residuals), judged.support
        left = max(support - (worst << TRUST_FRACTION_BITS), 0)
        if match.second_sum is not None:
            tally["margin_limited"] += match.second_sum - match.sum > MARGIN_TOP
        tally["residual_limited"] += residuals[0] == RESIDUAL_TOP and support > 0
        tally["trust_of_nothing"] += support < worst << TRUST_FRACTION_BITS
        for name, residual in zip(_OF_RESIDUALS, residuals, strict=True):
            alone = residuals.count(worst) == 1 and residual == worst > 0
            tally[name] += bool(match.trust) and alone
        falls = judged.kept - (judged.kept >> 3)
        tally["support_stood"] += (
            advanced.best.place == before.place and support == falls < judged.kept
        )
        tally["young"] += 0 < judged.trust < left
        tally["trust_above_255"] += judged.trust > 255
        tally["trust_rounded"] += judged.trust > 0 and left * judged.age % WHOLE_AGE > 0
        tally["of_age"] += judged.trust > 0 and before.age == WHOLE_AGE == judged.age

    def _see_gains(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        tally, seen, best = self.tally, advanced.seen, advanced.best
        tally[f"gain_{best.gain}"] += 1
        of_best = [row[best.place] for row in advanced.state.metrics]
        tally["gain_tie"] += of_best.count(min(of_best)) > 1
        tally["gain_changed"] += advanced.trust.age > 0 and best.gain != before.gain
        if before.place is not None and not seen.paused:
            own = filter_map.activity[before.place] + min(filter_map.gains[before.gain], 0)
            tally["quiet_place"] += own <= -73 and 0 < seen.weight < 8
        if not seen.paused:
            tally[f"sum_{SUMS[seen.looks[best.gain]]}"] += 1
            tally["three_sums"] += len(set(seen.looks)) == len(SUMS)
            for i, reciprocal in enumerate(before.reciprocals):
                looks = i in seen.looks
                tally["sum_forgotten"] += reciprocal > 0 and not looks
                tally["sum_returns"] += reciprocal == 0 and looks and before.place is not None
        if seen.few == 0:
            tally[f"speed_shift_{min((1 + before.moved).bit_length() - 1, 6)}"] += 1
            tally["speed_saturated"] += before.moved == 63
            tally["speed_below_nothing"] += seen.speed < 0 and seen.speed % 16 > 0
        sums = sums_of(self._newest, len(SUMS))
        tally["sum_above_1023"] += max(map(max, sums)) > LEVELS.index(LEVEL_TOP)
        map_log = ilog(self.machine.memories.activity >> ACTIVITY_FRACTION_BITS)
        running = ilog(self._kept.mean_activity >> ACTIVITY_FRACTION_BITS)
        tally["mean_apart"] += abs(map_log - running) >= 16

    def _see_others(self, filter_map: FilterMap, before: Filter, advanced: Advanced) -> None:
        """Match on and on by a filter without a rule, until a match is another one."""
        window = _Window(filter_map, self.machine.compared, before, advanced)
        for name, rule in _OTHER_FILTERS.items():
            state = self._others.get(name, before)
            if state is None or name not in self._wanted:
                continue
            if state is before and rule.lacks and not window.holds(rule.lacks):
                continue
            other = window.without(rule, state)
            differs = _told(other) != _told(advanced)
            self.tally[name] += differs
            if differs:
                self._others[name] = None
            elif other is not advanced:
                self._others[name] = other.state

    def see_case(self, case: Case, done: Trace) -> None:
        """Run a case again, on each device without a rule, until a result is another one."""
        for name, (needed, rule, other) in _OTHER_DEVICES.items():
            if not self.tally[needed] or name not in self._wanted:
                continue
            with replaced(rule, other):
                if name in CONTRAST:  # of codes: without matches, it takes no time
                    codes = window_codes(case.memories, case.events, case.start)
                    self.tally[name] += codes != [window.codes for window in done.windows]
                else:
                    device = type(self.machine)(case.memories, case.start)
                    results = chain.from_iterable(map(device.take, case.events))
                    pairs = zip(results, in_order(done), strict=True)
                    self.tally[name] += any(one != another for one, another in pairs)

    def _see_means(self) -> None:
        tally, kept, design = self.tally, self._kept, self.machine.design
        paused = is_pause(self.machine.that_count, kept.mean_activity)
        shift, half = mean_shift(kept.moves), 1 << (design.code_bits - 1)
        unit = 1 << LEVEL_FRACTION_BITS
        for counts, means in zip(sums_of(self._newest, design.sums), kept.means, strict=True):
            levels = [LEVELS[min(count, len(LEVELS) - 1)] for count in counts]
            differences = differences_of(levels, means)
            shared = window_mean(differences)
            exact = shared * len(levels)
            tally["window_mean_below_nothing"] += shared < 0
            tally["window_mean_rounded_up"] += exact > sum(differences)
            tally["window_mean_rounded_down"] += exact < sum(differences)
            tally["highest_mean"] += LEVEL_TOP << MEAN_FRACTION_BITS in means
            for difference, level, mean in zip(differences, levels, means, strict=True):
                rounded = difference - shared + unit // 2
                octaves = rounded >> LEVEL_FRACTION_BITS
                tally["code_at_the_bottom"] += octaves + half < 0
                tally["code_at_the_top"] += octaves + half >= 2 * half
                tally["mean_of_a_half"] += (
                    mean % unit == unit // 2 and rounded % unit == unit - 1
                    and -half <= octaves < half - 1
                )  # fmt: skip
                left = (level << MEAN_FRACTION_BITS) - mean
                if paused:
                    tally["mean_held"] += left != 0
                    continue
                part = left % (1 << shift) > 0
                tally["mean_falls_by_part"] += part and left < 0
                tally["mean_rises_by_part"] += part and left > 0
        if not paused:
            tally[f"mean_shift_{shift}"] += 1


#: By the fact that says that a rule of `specification` decides: a fact without which that is not
#: tried, and the function that another device has in its place.
_OTHER_DEVICES: dict[str, tuple[str, str, Callable[..., Any]]] = {
    **{
        f"mean_shift_{n}_decides": (
            f"mean_shift_{n}", "mean_shift", lambda moves, most=n - 1: min(mean_shift(moves), most)
        )
        for n in range(FIRST_SHIFT + 1, LAST_SHIFT + 1)
    },
    "last_shift_stays": (
        f"mean_shift_{LAST_SHIFT}", "mean_shift",
        lambda moves: mean_shift(moves % ((1 << LAST_SHIFT) - 16)),
    ),
    "large_sum_decides": (
        "sum_above_1023", "sums_of",
        lambda newest, number: [[n & 1023 for n in one] for one in sums_of(newest, number)],
    ),
    "silence_decides": (
        "silence_of_nothing", "is_pause", lambda counted, mean: counted * 2048 < mean
    ),
    "events_decide": (
        "events_above_16_bits", "activity_of",
        lambda counted, mean: activity_of(min(counted, 0xFFFF), mean),
    ),
    "decay_decides": (
        "busy_at_threshold", "mean_activity_after",
        lambda mean, counted: mean - (mean >> 10) if is_pause(counted, mean)
        else mean_activity_after(mean, counted),
    ),
}  # fmt: skip


@contextmanager
def replaced(name: str, other: Any) -> Iterator[None]:
    """Replace a function or a constant of the specification in the block."""
    kept = getattr(specification, name)
    setattr(specification, name, other)
    try:
        yield
    finally:
        setattr(specification, name, kept)


class _Bits(NamedTuple):
    """Bits of the distances of a window, and of what the specification makes of them."""

    distance: int = 0  #: Before the bias.
    total: int = 0  #: Of the biased distances to all places.
    deviations: int = 0  #: The same of their deviations from the mean.


class _Rule(NamedTuple):
    """What another filter does otherwise, to show that it matters."""

    #: gains, by their indices before and after, to which there is no change
    no_change: Callable[[int, int], bool] | None = None
    restarts_first: bool = False  #: Before gains change.
    keeps_reciprocals: bool = False
    most_shift: int = 6  #: Of the mean speed.
    first_speed: int = 0
    least_speed: int = -LOG_TOP << 4
    most_speed: int = LOG_TOP << 4
    most_activity: int = LOG_TOP
    few_below: int = FEW_BELOW
    evidence_top: int = EVIDENCE_TOP
    lacks: _Bits | None = None


#: by the fact that says that their rule decides
_OTHER_FILTERS = {
    "few_at_threshold": _Rule(few_below=FEW_BELOW - 1),
    "enough_at_threshold": _Rule(few_below=FEW_BELOW + 1),
    "evidence_limit_decides": _Rule(evidence_top=1 << 16),
    "large_evidence_decides": _Rule(evidence_top=EVIDENCE_TOP >> 1),
    "large_activity_decides": _Rule(most_activity=127),
    "change_up_decides": _Rule(lambda before, after: after > before),
    "change_down_decides": _Rule(lambda before, after: after < before),
    "change_by_one_decides": _Rule(lambda before, after: abs(after - before) == 1),
    "change_by_several_decides": _Rule(lambda before, after: abs(after - before) > 1),
    "change_by_five_decides": _Rule(lambda before, after: abs(after - before) == 5),
    "changes_before_restart_decide": _Rule(restarts_first=True),
    "low_gains_decide": _Rule(lambda before, after: after < before and after < 4),
    "forgetting_decides": _Rule(keeps_reciprocals=True),
    "slowness_decides": _Rule(most_shift=5),
    "first_speed_decides": _Rule(first_speed=16 << 4),
    "large_speed_decides": _Rule(most_speed=(1 << 10) - 1),
    "largest_speed_decides": _Rule(most_speed=(1 << 11) - 1),
    "lowest_speed_decides": _Rule(least_speed=-(1 << 10)),
    **{
        f"{name}_bit_{n}": _Rule(lacks=_Bits(**{name: 1 << n}))
        for name in _Bits._fields for n in _SUM_BITS if f"{name}_bit_{n}" in BITS
    },
}  # fmt: skip


class _Window:
    """A window, by which filters without a rule advance; `before` and `advanced` are of the model.

    A filter that was as the model before, and that its rule does not part from it, is not matched.
    """

    def __init__(
        self, filter_map: FilterMap, distances: Rows, before: Filter, advanced: Advanced
    ) -> None:
        self._map, self._distances, self._before = filter_map, distances, before
        self._advanced = advanced
        self._held: _Bits | None = None

    def holds(self, bits: _Bits) -> bool:
        """Return whether the distances of a sum that a gain looks at have one of these bits."""
        if self._held is None:
            self._held = _Bits()
            for i in set() if self._advanced.seen.paused else set(self._advanced.seen.looks):
                distances = np.array(self._distances[i])
                biased = distances + self._map.bias
                deviations = np.abs(biased - int(biased.sum()) // len(biased))
                self._held = _Bits(
                    self._held.distance | int(np.bitwise_or.reduce(distances)),
                    self._held.total | int(biased.sum()),
                    self._held.deviations | int(deviations.sum()),
                )
        return any(one & held for one, held in zip(bits, self._held, strict=True))

    def without(self, rule: _Rule, state: Filter) -> Advanced:
        """Advance another filter."""
        of_model = self._advanced
        if state.place is None and rule.first_speed:
            state = state._replace(speed=rule.first_speed)
        with replaced("FEW_BELOW", rule.few_below):
            seen = self._see(rule, state)
        rows = changed(state.metrics, rule.no_change)
        best = rows.min(axis=1)
        if rule.restarts_first:
            metrics = np.array(state.metrics)
            best = metrics.min(axis=1) - metrics.min()
        lacks, distances = rule.lacks or _Bits(), self._distances
        if lacks.distance:
            distances = [[d & ~lacks.distance for d in row] for row in distances]
        with (
            replaced("EVIDENCE_TOP", rule.evidence_top),
            replaced("spread_of", partial(_spread_without, lacks)),
        ):
            against = evidence(self._map, state, seen, distances)
        if rule.keeps_reciprocals:
            pairs = zip(against.reciprocals, state.reciprocals, strict=True)
            against = against._replace(reciprocals=[new or old for new, old in pairs])
        predicted = predictions(self._map, state, seen, rows, best)
        model = of_model.predicted, of_model.seen, of_model.evidence
        alike = state is self._before and (predicted, seen, against) == model
        return of_model if alike else decide(self._map, state, seen, predicted, against)

    def _see(self, rule: _Rule, state: Filter) -> Seen:
        of_model = self._advanced.seen
        activity = min(of_model.activity, rule.most_activity)
        seen = see(self._map, state, activity, of_model.paused)
        if seen.few or len(self._map.gains) == 1:
            return seen
        shift = min((1 + state.moved).bit_length() - 1, rule.most_shift)
        speed = state.speed + ((16 * activity - state.speed) >> shift)
        speed = min(max(speed, rule.least_speed), rule.most_speed)
        return seen._replace(
            speed=speed, looks=[which_sum(speed, gain) for gain in self._map.gains]
        )


def _spread_without(lacks: _Bits, distances: Sequence[int]) -> int:
    """Return what `spread_of` returns, of sums without some bits."""
    mean = (sum(distances) & ~lacks.total) // len(distances)
    deviations = sum(abs(d - mean) for d in distances) & ~lacks.deviations
    return max(deviations // len(distances), 1)


def _told(advanced: Advanced) -> tuple[int, tuple[int | None, ...], int]:
    """Return what a record says of a match: its best gain, for one, is in none."""
    return advanced.best.told, advanced.best.nearest[1:], advanced.trust.trust


_OF_RESIDUALS = (
    "residual_of_this_window", "residual_of_the_window_before", "residual_of_two_windows_before",
)  # fmt: skip


def _events_facts(before: Filter, seen: Seen) -> Iterator[str]:
    """Yield what the number of events says."""
    if not seen.paused:
        yield f"weight_{seen.weight}"
    if seen.few == 0 < before.few <= PATIENCE:
        yield "few_forgotten"
    if seen.stands:
        yield "standing_goes_on" if before.few > PATIENCE else "standing_begins"
    elif before.few > PATIENCE:
        yield "standing_ends"
