"""Corner cases of the place filter and of own-mean codes: drives through small maps."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace
from itertools import product

import numpy as np

from firmware_model.design import Design
from firmware_model.largest_values import ACTIVITY_BITS, EVENTS_TOP
from firmware_model.memories import Memories
from firmware_model.running import PAUSE_SHIFT, QUIET_SHIFT, ActivityModel
from firmware_model.vectors.case import Case
from firmware_model.vectors.drives import PAUSE, counts_at, drive
from firmware_model.vectors.event_corners import adaptive_event_cases
from firmware_model.vectors.evidence_corners import evidence_cases
from firmware_model.vectors.ram_corners import ram_cases
from firmware_model.vectors.stimulus import Stream, choose_pixels, shown_codes
from fixedpoint.own_mean import FIRST_SHIFT, LAST_SHIFT, LEVEL_BITS, MEAN_BITS, RunningMean


def filter_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``filter``.

    Parameters
    ----------
    design : Design
        The cases change it to have the filter, own-mean codes, or both.
    """
    adaptive = replace(design, matching="filter", length=1, places=12)
    plain = adaptive
    if design.own_mean:
        plain = replace(adaptive, code="log", full_scales=(0,))
    else:
        bits = min(design.code_bits, 8)
        adaptive = replace(adaptive, code="own-mean", code_bits=bits, full_scales=(0,))
    return [
        *(drive(name, variant, route) for name, (variant, route) in _routes(plain).items()),
        *_pauses(plain),
        *_thresholds(plain),
        *_means(adaptive),
        *evidence_cases(plain),
        *ram_cases(plain, adaptive),
        *adaptive_event_cases(adaptive),
    ]


def _routes(design: Design) -> dict[str, tuple[Design, list[int]]]:
    """Return drives by name: a design, and the places that the windows show."""
    last = design.places - 1
    forward = replace(design, steps=(1, 0, 1), back=(), restart=16, exclusion=1)
    back = replace(forward, back=(2, 5), steps=(1, 0, 2, 3, 4, 6))
    dear = replace(forward, steps=(254,), back=(254,), restart=254)
    long = replace(forward, places=40)
    walk = [0, 1, 2, 2, 3, 4, 6, 7, 7, 9, 10, 11, last]
    jumps = [0, 1, 2, 2, 2, 8, 8, 8, 3, 3, 3, last, last, last, 0, 0, 0]
    backwards = [6, 5, 4, 4, 2, 1, 0, 0, 5, 5, 10, 10, 7, 7, 4, 4]
    return {
        "walk": (forward, walk),
        "walk_of_kept_distances": (replace(forward, keep_distances=True), walk),
        "jumps": (forward, jumps),
        "by_one_too_many": (forward, [0, 0, 3, 3, 3, 2, 2, 4, 4, 5, 5, 4, 4, 8, 8, 7, 7]),
        "backwards": (back, backwards),
        "backwards_of_kept_distances": (replace(back, keep_distances=True), backwards),
        "by_one_too_many_back": (back, [8, 8, 5, 5, 5, 4, 4, 2, 2, 8, 8, 8, 1, 1, 7, 7, 7]),
        "dear_steps": (dear, [0, 0, 5, 5, 11, 0, 3, 3]),
        "four_steps": (replace(forward, steps=(1, 0, 0, 1)), walk),
        "by_three_places": (replace(forward, steps=(1, 0, 0, 1)), [0, 3, 6, 9, 9, 0, 3, 3]),
        # only the longest step is free; the drives begin at the first place
        "by_four_places": (replace(forward, steps=(9, 9, 9, 9, 0)), [0, 4, 8, 8, 0, 4]),
        "by_five_places": (replace(forward, steps=(9, 9, 9, 9, 9, 0)), [0, 5, 10, 10, 0, 5]),
        "free_way_back": (replace(forward, back=(9, 0)), [0, 0, last - 1, last, last, last - 2]),
        "dear_near_steps": (replace(dear, back=()), [0, 0, 5, 5, 11, 0, 3, 3]),
        "free_steps": (replace(forward, steps=(0, 0, 0), restart=0), jumps),
        "sixteen_steps": (
            replace(long, steps=tuple(range(16)), back=tuple(range(16)), restart=40),
            [0, 10, 25, 39, 39, 24, 12, 12, 0],
        ),
        "several_blocks": (long, [*range(0, 40, 2), 39, 16, 17, 33, 32, 31, 15]),
        "one_place_of_a_filter": (replace(forward, places=1), [0, 0, 0]),
        "two_places": (replace(forward, places=2, exclusion=0), [0, 1, 1, 0]),
        "three_places": (replace(forward, places=3, exclusion=0), [0, 2, 1, 0, 2]),
        "four_places": (replace(forward, places=4, exclusion=0, steps=(1, 0, 1, 1)), [3, 0, 3, 1]),
        "zone_covers_the_filter": (replace(forward, exclusion=11), [0, 1, 2]),
        "by_margin": (replace(forward, accept="margin", margin=9), walk),
        "by_ratio": (replace(forward, accept="ratio", ratio=(1, 2)), walk),
    }


def _pauses(design: Design) -> list[Case]:
    forward = replace(design, exclusion=1)
    route = [PAUSE, PAUSE, 0, 1, PAUSE, PAUSE, 2, 2, PAUSE, 3, 4, 5]
    # usual activity so high that the first windows are pauses although they have events
    total = max(counts_at(forward, place)[1] for place in range(forward.places))
    busy = min((total << 12) + (total << 8), 0x7FFF_FF00)
    cases = [
        drive("usually_more_events", forward, list(range(12)), None, busy),
        drive("places_alike", forward, [0, 1, 2, 3], alike=True),
    ]
    # metrics of eight places fill their room in the RAM
    eight = replace(forward, places=8)
    cases.append(drive("pauses_of_eight_places", eight, list(range(8)), None, busy))
    # quiet windows of a map with all kinds of steps, which they do not make
    every_way = replace(forward, steps=(1, 0, 2, 1, 1, 1), back=(1, 1))
    usual = 3 * (total << (ACTIVITY_BITS + QUIET_SHIFT)) // 2
    for name, keeps in {"quiet": False, "quiet_of_kept_distances": True}.items():
        of_map = replace(every_way, keep_distances=keeps)
        cases.append(drive(name, of_map, [6, 6, 4, 4, 8, 8, 8, 7, 11, 0], None, usual))
    if design.window == "time":
        cases.append(drive("pauses", forward, route))
        kept = replace(forward, keep_distances=True, back=(1, 2))
        cases.append(drive("pauses_of_kept_distances", kept, route))
    return cases + _limits(forward)


def _limits(design: Design) -> list[Case]:
    """Make the cases with windows that have just enough events, and just too few."""
    cases, every = [], list(range(design.places))
    for shift, too_few, enough in (
        (PAUSE_SHIFT, "pause", "busy"),
        (QUIET_SHIFT, "quiet", "lively"),
    ):
        at = _activity_at_limit(design, 6, shift)
        # usual events whose lowest bits are not 0, but whose lowest bit is
        by_two = _activity_at_limit(design, 6, shift, above=2)
        cases += [
            drive(f"{too_few}_at_threshold", design, every, None, at),
            drive(f"{enough}_at_threshold", design, every, None, at - 1),
            drive(f"{too_few}_by_two", design, every, None, by_two),
        ]
        # the first window, whose usual number is the initial one
        first = counts_at(design, 0)[1]
        if design.window == "count":
            first = max(counts_at(design, place)[1] for place in every)
        at = min(first << (ACTIVITY_BITS + shift), 0x7FFF_FEFF)
        named = "pauses" if too_few == "pause" else too_few
        cases += [
            drive(f"first_{enough}", design, every[:3], None, at),
            drive(f"first_{named}", design, every[:3], None, at + 1),
        ]
    by_eight = _activity_at_limit(design, 6, PAUSE_SHIFT, above=8 << ACTIVITY_BITS)
    return [*cases, drive("pause_by_eight_events", design, every, None, by_eight)]


def _activity_at_limit(design: Design, window: int, shift: int, above: int = 1) -> int:
    """Find the lowest initial activity with which a window of a drive by all places has too few.

    Too few is less than ``1 / 2**shift`` of the usual number of events. That number is then `above`
    the one with which the window has enough, in 1/256 event.
    """
    events = [counts_at(design, place)[1] for place in range(design.places)]
    if design.window == "count":
        events = [max(events)] * len(events)

    def has_too_few(start: int) -> bool:
        activity = ActivityModel(start)
        for number in events[:window]:
            activity.update(number)
        return activity.usual >= (events[window] << (ACTIVITY_BITS + shift)) + above

    return bisect_left(range(EVENTS_TOP << ACTIVITY_BITS), True, key=has_too_few)


def _thresholds(design: Design) -> list[Case]:
    """Set the threshold of trust to a value that occurs, and to one above it."""
    forward = replace(design, exclusion=1, accept="margin", margin=0, trust=0)
    route = [0, 1, 2, 3, 4, 5, 6]
    told = [match.trust for match in drive("", forward, route).trace().matches]
    trust = min(max(told[4] or 0, 1), 0x3FEF)
    return [
        drive("trusted", replace(forward, trust=trust), route),
        drive("distrusted", replace(forward, trust=trust + 1), route),
    ]


def _means(design: Design) -> list[Case]:
    """Make the cases that move means by all shifts, up and down, past both ends of the code."""
    few = replace(design, places=4, exclusion=1)
    sequences = replace(few, matching="sequence", length=2, trust=0)
    slots = range(design.slots)
    high = [min(4 * 256, design.entry_max) * (slot % 2) for slot in slots]
    route = [0, 1, 2, 3]
    cases = [
        drive("own_means", design, [*range(12)] * 2, high),
        drive("own_means_of_sequences", sequences, route * 3, high),
        drive("all_shifts", few, route * 130, high),
        drive("means_from_the_top", few, route, [design.entry_max] * design.slots),
        *_halves(few),
        _late_shifts(few),
    ]
    if design.window == "time":
        cases.append(drive("means_and_pauses", few, [0, PAUSE, 1, PAUSE, PAUSE, 2, 3], high))
    return cases


def _halves(design: Design) -> list[Case]:
    """Make a case with means at half a unit of a logarithm, or just below, where rounding matters.

    With a full scale of 1 to 3 there is no such case, because no code depends on the rounding.
    """
    half = 1 << (MEAN_BITS - 1)
    ways = [way for end in (half, half - 1) if (way := _way_to_half(design, end)) is not None]
    if len(ways) < 2:
        return []
    chosen = [ways[slot % 2] for slot in range(design.slots)]
    means = [mean for mean, _ in chosen]
    windows = [[counts[i] for _, counts in chosen] for i in range(3)]
    return [_counted("means_of_halves", design, means, windows)]


def _way_to_half(design: Design, end: int) -> tuple[int, tuple[int, int, int]] | None:
    """Find a mean and two counts that move it to `end` above a whole unit, and a third count.

    Returns
    -------
    mean : int
    counts : tuple of int
        The third count has another code if the mean is rounded the other way.

    None is returned if there are none.
    """
    levels, unit = design.tables[0], 1 << LEVEL_BITS
    counts = range(1, min(60, len(levels)))  # higher counts have the level of the full scale
    pairs = list(product(counts[:7], counts[:7]))
    totals = np.empty((3 * unit, len(pairs)), np.int64)  # of all means at once
    for column, pair in enumerate(pairs):
        running = RunningMean(np.arange(3 * unit))
        for count in pair:
            running.update(np.array(levels[count]))
        totals[:, column] = running.total
    for mean, column in np.argwhere(totals % (1 << MEAN_BITS) == end).tolist():
        whole = int(totals[mean, column]) >> MEAN_BITS
        for count in counts:
            if (levels[count] - whole) % unit == unit // 2 and 0 <= levels[count] - whole < unit:
                return mean, (*pairs[column], count)
    return None


def _late_shifts(design: Design) -> Case:
    """Keep the means constant until the shift is the last one, then move them by several codes."""
    quiet = [[1] * design.slots] * ((1 << (LAST_SHIFT + 1)) - (1 << FIRST_SHIFT) + 20)
    # at these counts, the codes of 1 to 3 octaves change at different windows
    loud = [[(1, 6, 11, 40, 60)[slot % 5] for slot in range(design.slots)]] * 90
    return _counted("late_shifts", design, [design.tables[0][1]] * design.slots, quiet + loud)


def _counted(name: str, design: Design, means: list[int], windows: list[list[int]]) -> Case:
    """Show windows of these counts; the map holds the last windows, newest first."""
    pixels = choose_pixels(design)
    if design.window == "count":
        design = replace(design, window_events=max(map(sum, windows)))
    stream = Stream.showing(design, pixels, windows)
    codes = shown_codes(stream, mean=means)
    places = [codes[-1 - place % len(codes)] for place in range(design.places)]
    memories = Memories(design, pixels, places, None, None, means)
    return Case(name, memories, tuple(stream.events))
