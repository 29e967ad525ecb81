"""Count which corners of the place filter and of own-mean codes a case reaches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import product

from firmware_model.comparator import MatchResult
from firmware_model.descriptor import WindowResult
from firmware_model.largest_values import (
    ACTIVITY_BITS,
    EVIDENCE_TOP,
    FRACTION_BITS,
    METRIC_TOP,
    RECIPROCAL_BITS,
)
from firmware_model.machine import Machine
from firmware_model.place_filter import QUIET_STEPS, evidence, reciprocal_of_spread
from firmware_model.running import PAUSE_SHIFT, QUIET_SHIFT
from fixedpoint.own_mean import FIRST_SHIFT, LAST_SHIFT, LEVEL_BITS, MEAN_BITS

#: name of each corner, and what is counted as one occurrence of it
FILTER_CORNERS = {
    "first_window": "a first window that does not pause: its evidence is scaled by its own spread",
    "first_window_pauses": "a first window that pauses",
    "pause": "a window that pauses, and is not the first",
    "pause_with_events": "a window that pauses though it has events at selected pixels",
    "long_pause": "a window that pauses behind one that pauses",
    "pause_at_threshold": "a window that pauses, and would not if 1/256 event less were usual",
    "pause_by_two": "a window that pauses, and would not if 2/256 event less were usual",
    "pause_by_eight_events": "a window that pauses, and would not if 8 events less were usual",
    "busy_at_threshold": "a window that does not pause, and would if 1/256 event more were usual",
    "quiet": "a window that is quiet but no pause, and not the first",
    "first_window_quiet": "a first window that is quiet but no pause",
    "quiet_of_steps_back": "a window that is quiet but no pause, with a place that a step back "
    "would lead to for less",
    "quiet_of_long_steps": "a window that is quiet but no pause, with a place that a step of more "
    "than two places would lead to for less",
    "quiet_at_threshold": "a window that is quiet, and would not be if 1/256 event less were usual",
    "quiet_by_two": "a window that is quiet, and would not be if 2/256 event less were usual",
    "lively_at_threshold": "a window that is not quiet, and would if 1/256 event more were usual",
    "spread_of_nothing": "a window with the same distance to all places",
    "spread_of_one": "a window behind the first that is scaled by a spread of 1, of distances "
    "that differ to places of two words",
    "evidence_saturated": "a place whose evidence is at its largest, and would be above it",
    "metric_saturated": "a place whose metric is at its largest, and would be above it",
    "restarted": "a place that nothing leads to for less than a restart",
    "stood": "a match at the place of the one before",
    "stepped": "a match one place further",
    "largest_step": "a match that follows by the largest step that there is",
    "beyond_the_largest_step": "a match one place further than that, which does not follow",
    "smallest_step": "a match that follows by the smallest step: backwards, if there is such a one",
    "beyond_the_smallest_step": "a match one place lower than that, which does not follow",
    "filter_tie": "a match with another place at its metric",
    "filter_no_second": "a match of the filter without a second best",
    "several_blocks": "a window of a map of more than 32 places whose distances are not kept",
    "kept_distances": "a window of a map whose distances are kept",
    "trusted_at_threshold": "a match whose trust is the least that is accepted",
    "distrusted_at_threshold": "a match that is rejected for a trust less by one",
    "code_at_the_bottom": "an own-mean code of 0 that would be below it",
    "code_at_the_top": "the largest own-mean code, that would be above it",
    "mean_falls_by_part": "a running mean that falls by what the shift does not divide",
    "mean_rises_by_part": "a running mean that rises by what the shift does not divide",
    "mean_held": "a window that pauses and leaves other means as they are",
    **{f"mean_shift_{n}": f"a mean that moves by 1/{1 << n}" for n in range(FIRST_SHIFT, 9)},
}


class FilterCoverage:
    """Counts corners from the states of a machine, before each window changes them."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.found: Counter[str] = Counter(dict.fromkeys(FILTER_CORNERS, 0))
        self._paused = False
        self._last = -1

    def see_window(self, window: WindowResult, distances: list[int]) -> None:
        """Count the corners of a window, before it is matched and its counters are cleared."""
        if self.machine.design.own_mean:
            self._see_means(window)
        if self.machine.design.filters:
            self._see_metrics(window, distances)

    def _see_metrics(self, window: WindowResult, distances: list[int]) -> None:
        design, model, found = self.machine.design, self.machine.place_filter, self.found
        first, paused = window.number == 0, window.paused
        found["first_window"] += first and not paused
        found["first_window_pauses"] += first and paused
        found["pause"] += paused and not first
        found["pause_with_events"] += paused and self.machine.descriptor.counted > 0
        counted, usual = self.machine.descriptor.counted, self.machine.descriptor.activity.usual
        threshold = counted << (ACTIVITY_BITS + PAUSE_SHIFT)
        found["pause_at_threshold"] += counted > 0 and usual == threshold + 1
        found["pause_by_two"] += counted > 0 and usual == threshold + 2
        found["pause_by_eight_events"] += counted > 0 and (
            usual == threshold + (8 << ACTIVITY_BITS)
        )
        found["busy_at_threshold"] += counted > 0 and usual == threshold
        threshold = counted << (ACTIVITY_BITS + QUIET_SHIFT)
        found["first_window_quiet"] += first and window.quiet and not paused
        if window.quiet and not (first or paused):
            self._see_quiet()
        found["quiet_at_threshold"] += counted > 0 and usual == threshold + 1
        found["quiet_by_two"] += counted > 0 and usual == threshold + 2
        found["lively_at_threshold"] += counted > 0 and usual == threshold
        found["long_pause"] += paused and self._paused
        self._paused = paused
        if not first and design.restart:
            limit = design.restart << FRACTION_BITS
            found["restarted"] += limit in model.predictions(window.quiet)
        if paused:
            return
        found["several_blocks"] += design.places > 32 and not design.keep_distances
        found["kept_distances"] += design.keep_distances
        found["spread_of_nothing"] += design.places > 1 and len(set(distances)) == 1
        scale = model.reciprocal or reciprocal_of_spread(distances)
        least = min(distances)
        found["spread_of_one"] += (
            scale == 1 << RECIPROCAL_BITS
            and not first
            and max(distances) > least
            and design.words == 2
        )
        for distance, predicted in zip(distances, model.predictions(window.quiet), strict=True):
            against = evidence(distance - least, scale)
            found["evidence_saturated"] += against == EVIDENCE_TOP and (
                (distance - least) * scale >> 14 > EVIDENCE_TOP
            )
            found["metric_saturated"] += predicted + against > METRIC_TOP

    def _see_quiet(self) -> None:
        """Count the corners of a window that is quiet but no pause, and not the first."""
        design, model = self.machine.design, self.machine.place_filter
        least, quiet = min(model.metrics), model.predictions(True)

        def cheaper(moves: Iterable[tuple[int, int]]) -> bool:
            """Return whether a place can be reached for less by one of these steps and prices."""
            ways = product(moves, enumerate(model.metrics))
            return any(
                metric - least + (price << FRACTION_BITS) < quiet[origin + step]
                for (step, price), (origin, metric) in ways
                if 0 <= origin + step < design.places
            )

        self.found["quiet"] += 1
        self.found["quiet_of_steps_back"] += cheaper(
            (-number, price) for number, price in enumerate(design.back, 1)
        )
        longer = tuple(enumerate(design.steps))[len(QUIET_STEPS) :]
        self.found["quiet_of_long_steps"] += cheaper(longer)

    def see_match(self, match: MatchResult) -> None:
        """Count the corners of a match."""
        design, found, last = self.machine.design, self.found, self._last
        self._last = match.place
        found["filter_tie"] += match.ties > 0
        found["filter_no_second"] += match.second is None
        assert match.trust is not None, "a match of the filter has one"
        second = match.second is not None and design.trust > 0
        found["trusted_at_threshold"] += match.accepted and second and match.trust == design.trust
        found["distrusted_at_threshold"] += second and match.trust == design.trust - 1
        if last < 0:
            return
        step, largest = match.place - last, max(len(design.steps), len(QUIET_STEPS)) - 1
        found["stood"] += step == 0
        found["stepped"] += step == 1
        found["largest_step"] += step == largest
        found["beyond_the_largest_step"] += step == largest + 1
        found["smallest_step"] += step == -len(design.back)
        found["beyond_the_smallest_step"] += step == -len(design.back) - 1

    def _see_means(self, window: WindowResult) -> None:
        descriptor, found = self.machine.descriptor, self.found
        mean, top, shift = descriptor.mean, self.machine.design.code_max, descriptor.mean.shift
        for slot, count in enumerate(descriptor.counts):
            level = descriptor.memories.entry(slot, count)
            usual = (mean.total[slot] + (1 << (MEAN_BITS - 1))) >> MEAN_BITS
            octaves = (level - usual + (1 << (LEVEL_BITS - 1))) >> LEVEL_BITS
            found["code_at_the_bottom"] += octaves + (top + 1) // 2 < 0
            found["code_at_the_top"] += octaves + (top + 1) // 2 > top
            difference = (level << MEAN_BITS) - mean.total[slot]
            if window.paused:
                found["mean_held"] += difference != 0
                continue
            part = difference % (1 << shift) > 0
            found["mean_falls_by_part"] += part and difference < 0
            found["mean_rises_by_part"] += part and difference > 0
        if not window.paused:
            found[f"mean_shift_{min(shift, LAST_SHIFT)}"] += 1
