"""The suite ``filter``: corner cases of the place filter and of contrast codes."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from operator import sub

import numpy as np

from firmware_model.design import (
    ACTIVITY_FRACTION_BITS,
    LARGEST_SUM,
    LEVEL_TOP,
    LEVELS,
    TRUST_TOP,
    Design,
)
from firmware_model.memories import Memories
from firmware_model.specification import (
    activity_of,
    ilog,
    is_pause,
    mean_activity_after,
    row_of,
    weight_of,
)
from firmware_model.vectors.case import Case, Stream, choose_pixels
from firmware_model.vectors.corners import adaptive_event_cases
from fixedpoint.activity import (
    COST_ROW_SHIFT,
    EVENTS_TOP,
    LOG_TOP,
    PARTS,
    PAUSE_SHIFT,
    PLACE_LOW,
    SAME_ROW,
)
from fixedpoint.own_mean import (
    FIRST_SHIFT,
    LAST_SHIFT,
    LEVEL_FRACTION_BITS,
    MEAN_FRACTION_BITS,
    RunningMean,
)


def filter_cases(design: Design) -> list[Case]:
    """Make the cases of the suite ``filter``.

    Parameters
    ----------
    design : Design
        The cases change it to have the filter, and counts or contrast codes.
    """
    design = replace(
        design, matching="filter", length=1, places=12, places_per_window=1, largest_sum=LARGEST_SUM
    )
    # of so many bits that the counts of near places differ
    plain = replace(design, code="counts", code_bits=max(design.code_bits, 4))
    contrast = replace(design, code="contrast", code_bits=min(design.code_bits, 8))
    by_activity = replace(plain, restart=40, exclusion=1)
    half_places = replace(by_activity, places_per_window=2)
    return [
        *(drive(name, variant, route) for name, (variant, route) in _routes(plain).items()),
        *_pauses(plain),
        *_limits(replace(contrast, exclusion=1)),
        *_thresholds(plain),
        _view_of_another_place(plain),
        *_contrasts(contrast),
        *_activities(by_activity),
        _weights(by_activity),
        _weights_of_far_places(by_activity),
        *_tabulated_costs(by_activity),
        *evidence_cases(plain),
        *ram_cases(plain, contrast),
        *adaptive_event_cases(contrast),
        long_window(by_activity),
        *_half_places(half_places),
        *_tabulated_costs(half_places),
        *_logarithms(half_places),
    ]


# Drives through a small map: windows that show one place after another.


#: stands for a window without events at selected pixels
PAUSE = -1


def drive(
    name: str,
    design: Design,
    route: Sequence[int],
    mean: Sequence[int] | None = None,
    activity: int = 0,
    alike: bool = False,
    place_activity: Sequence[int] | None = None,
) -> Case:
    """Make a drive that shows places one after another; if `alike`, all places equal the first."""
    longest = max(counts_at(design, place)[1] for place in range(design.places))
    if design.window == "count":
        design = replace(design, window_events=longest)
    stream = Stream(design)
    for place in route:
        if place == PAUSE:
            stream.unselected()
            stream.end()
        else:
            stream.fill(counts_at(design, place)[0])
    stream.close()
    every = (counts_at(design, place)[0] for place in range(design.places))
    codes = Stream.showing(design, every).shown_codes(mean=mean)
    places = [codes[0 if alike else place] for place in range(design.places)]
    return stream.case(name, places, mean=mean, activity=activity, place_activity=place_activity)


def counts_at(design: Design, place: int) -> tuple[list[int], int]:
    """Return the counts of each slot at a place, and their sum; near places have other counts."""
    counts = [(place * (slot + 3) + slot * slot) % 7 for slot in range(design.slots)]
    # one slot always has events, so that no place is empty
    counts[place % design.slots] += 9
    return counts, sum(counts)


# Drives: each corner by a route, a design and where the means and activities start.


def _routes(design: Design) -> dict[str, tuple[Design, list[int]]]:
    """Return drives by name: a design, and the places that the windows show."""
    last = design.places - 1
    forward = replace(design, restart=16, exclusion=1)
    long = replace(forward, places=40)
    dear = replace(forward, restart=254)
    walk = [0, 1, 2, 2, 3, 4, 6, 7, 7, 9, 10, 11, last]
    jumps = [0, 1, 2, 2, 2, 8, 8, 8, 3, 3, 3, last, last, last, 0, 0, 0]
    return {
        "walk": (forward, walk),
        "jumps": (forward, jumps),
        "past_what_does_not_fit": (forward, [0, 1, 2, 3, 4, 5, 0, 1, 3, 4, 8, 0]),
        "by_one_too_many": (forward, [0, 0, 4, 4, 4, 3, 3, 6, 6, 7, 7, 6, 6, 10, 10, 9, 9]),
        "backwards": (forward, [6, 5, 4, 4, 2, 1, 0, 0, 5, 5, 10, 10, 7, 7, 4, 4]),
        "dear_restart": (dear, [0, 0, 5, 5, 11, 0, 3, 3]),
        "by_three_places": (forward, [0, 3, 6, 9, 9, 0, 3, 3]),
        # the cost is below the least metric, which a jump has raised
        "by_three_places_after_jumps": (forward, [0, 3, 6, 0, 3, 6, 11, 2, 5, 8]),
        "free_restart": (replace(forward, restart=0), jumps),
        "forty_places": (long, [*range(0, 40, 2), 39, 16, 17, 33, 32, 31, 15]),
        "one_place_of_a_filter": (replace(forward, places=1), [0, 0, 0]),
        "two_places": (replace(forward, places=2, exclusion=0), [0, 1, 1, 0]),
        "three_places": (replace(forward, places=3, exclusion=0), [0, 2, 1, 0, 2]),
        "four_places": (replace(forward, places=4, exclusion=0), [3, 0, 3, 1]),
        "zone_covers_the_filter": (replace(forward, exclusion=11), [0, 1, 2]),
    }


def _pauses(design: Design) -> list[Case]:
    forward = replace(design, exclusion=1)
    route = [PAUSE, PAUSE, 0, 1, PAUSE, PAUSE, 2, 2, PAUSE, 3, 4, 5]
    # a mean activity so high that at least three windows are pauses although they have events: each
    # takes 1/1024 of it, which is 2 for each event of the threshold
    total = max(counts_at(forward, place)[1] for place in range(forward.places))
    busy = min((total << PAUSE_SHIFT + ACTIVITY_FRACTION_BITS) + 6 * total, 0x7FFF_FF00)
    cases = [
        drive("usually_more_events", forward, list(range(12)), None, busy),
        drive("places_alike", forward, [0, 1, 2, 3], alike=True),
        # a restart for nothing leads to the first place
        drive(
            "usually_more_events_and_free_restart", replace(forward, restart=0), [2, 3], None, busy
        ),
    ]
    # metrics of eight places fill their room in the RAM
    eight = replace(forward, places=8)
    cases.append(drive("pauses_of_eight_places", eight, list(range(8)), None, busy))
    if design.window == "time":
        cases.append(drive("pauses", forward, route))
        # in a pause, a restart for nothing leads to the first place
        free = replace(forward, restart=0)
        cases.append(drive("pauses_of_free_restart", free, route))
    return cases


#: events of a window, more than 16 bits can count
LONG_WINDOW = 65_540


def long_window(design: Design) -> Case:
    """Make a case whose second window has 65,540 events, four more than 16 bits can count.

    Were they taken for four, the window would be a pause.
    """
    design = replace(design, places=4, exclusion=1)
    if design.window == "count":
        design = replace(design, window_events=LONG_WINDOW)
    rest = [3] * (design.slots - 1)
    shown = [[20, *rest], [LONG_WINDOW - sum(rest), *rest], [20, *rest], [1, *rest]]
    if design.window == "count":  # as many events in each window
        shown = [
            [LONG_WINDOW - count * (design.slots - 1), *[count] * (design.slots - 1)]
            for count in (3, 1)
        ]
    stream = Stream.showing(design, shown)
    places = stream.shown_codes()[-2:] * 2
    return stream.case("long_window", places, activity=100 << ACTIVITY_FRACTION_BITS)


def _limits(design: Design) -> list[Case]:
    """Make the cases with windows that have just enough events, and just too few.

    Evidence has no weight in either, but the means move in the first alone.
    """
    every = list(range(design.places))
    at = _activity_at_limit(design, 6)
    # the first window, whose mean activity is the initial one
    first = counts_at(design, 0)[1]
    if design.window == "count":
        first = max(counts_at(design, place)[1] for place in every)
    at_first = min(first << (ACTIVITY_FRACTION_BITS + 4), 0x7FFF_FEFF)
    return [
        drive("pause_at_threshold", design, every, None, at),
        drive("busy_at_threshold", design, every, None, at - 1),
        # mean activity whose lowest bits are not 0, but whose lowest bit is
        drive("pause_by_two", design, every, None, _activity_at_limit(design, 6, above=2)),
        drive("first_busy", design, every, None, at_first),
        drive("first_pauses", design, every, None, at_first + 1),
        drive(
            "pause_by_eight_events", design, every, None,
            _activity_at_limit(design, 6, above=8 << ACTIVITY_FRACTION_BITS),
        ),
    ]  # fmt: skip


def _activity_at_limit(design: Design, window: int, above: int = 1) -> int:
    """Find the lowest initial activity with which a window of a drive by all places pauses.

    The mean activity is then `above`, in units of 1/256 event, above the largest without a pause.
    """
    events = [counts_at(design, place)[1] for place in range(design.places)]
    if design.window == "count":
        events = [max(events)] * len(events)

    def pauses(start: int) -> bool:
        mean_activity = start
        for number in events[:window]:
            mean_activity = mean_activity_after(mean_activity, number)
        return is_pause(events[window], mean_activity - above + 1)

    return bisect_left(range(EVENTS_TOP << ACTIVITY_FRACTION_BITS), True, key=pauses)


def _activities(design: Design) -> list[Case]:
    """Make drives whose steps cost what the activity says, among places of any activity."""
    last = design.places - 1
    walk, jumps = [0, 1, 2, 2, 3, 4, 6, 9, 9, 10, 11, last], [0, 1, 2, 8, 8, 3, 3, last, 0, 0]
    long = replace(design, places=40)
    variants = {
        "by_activity": (design, walk),
        "jumps_by_activity": (design, jumps),
        "backwards_by_activity": (design, [6, 5, 4, 4, 2, 1, 0, 0, 5, 5, 10, 7, 4]),
        # by three places the match follows, by four it does not
        "by_three_and_four": (replace(design, restart=1), [0, 3, 6, 9, 9, 0, 4, 8, 8]),
        "forty_places_by_activity": (long, [*range(0, 40, 2), 39, 16, 17, 33, 32, 31, 15]),
        "free_restart_by_activity": (replace(design, restart=0), jumps),
        "dear_restart_by_activity": (replace(design, restart=254), jumps),
        **{
            f"{n}_places_by_activity": (replace(design, places=n, exclusion=0), [0, n - 1, 0])
            for n in (1, 2, 3, 4, 5)
        },
    }
    if design.window == "time":
        paused = [PAUSE, 0, 1, PAUSE, PAUSE, 2, 2, PAUSE, 6]
        variants["pauses_by_activity"] = design, paused
        variants["pauses_of_free_restart_by_activity"] = replace(design, restart=0), paused
    return _among_any_activity(design, variants)


def _half_places(design: Design) -> list[Case]:
    """Make the same for places at half windows, by all steps and at both ends of the map."""
    design = replace(design, places=16)
    last = design.places - 1
    walk = [0, 2, 4, 5, 5, 8, 10, 14, last, last, 0, 5, 11, last, 9]
    long = replace(design, places=40)
    jumps = [0, 2, 3, 11, 11, 4, 4, last, 0, 0]
    variants = {
        "half_places": (design, walk),
        "half_places_backwards": (design, [6, 5, 4, 4, 2, 1, 0, 0, 5, 7, 13, 10, 7]),
        "jumps_of_half_places": (design, jumps),
        # by six places the match follows, by seven it does not
        "by_six_and_seven": (replace(design, restart=1), [0, 6, 12, 12, 1, 8, 15, 15]),
        "forty_half_places": (long, [*range(0, 40, 3), 39, 16, 18, 33, 32, 31, 15]),
        "free_restart_of_half_places": (replace(design, restart=0), jumps),
        "dear_restart_of_half_places": (replace(design, restart=254), jumps),
        **{
            f"{n}_half_places": (replace(design, places=n, exclusion=0), [0, n - 1, n // 2, 0])
            for n in (1, 3, 6, 7, 8)
        },
    }
    if design.window == "time":
        variants["pauses_of_half_places"] = design, [PAUSE, 0, 2, PAUSE, PAUSE, 4, 4, PAUSE, 12]
    return _among_any_activity(design, variants)


def _among_any_activity(
    design: Design, variants: Mapping[str, tuple[Design, list[int]]]
) -> list[Case]:
    """Make a drive of each design and route, among places of any activity."""
    mean_activity = (
        max(counts_at(design, place)[1] for place in range(design.places)) << ACTIVITY_FRACTION_BITS
    )
    cases = []
    for name, (variant, route) in variants.items():
        # both ends, and about the activity of the windows
        spread = [-128, 127, *(8 - 23 * k % 64 for k in range(2, variant.places))]
        activity = spread[: variant.places]
        cases.append(drive(name, variant, route, None, mean_activity, place_activity=activity))
    return cases


def _weights(design: Design) -> Case:
    """Show windows of as many events while the mean activity falls: evidence has every weight."""
    design = replace(design, code="counts", code_bits=5, window_events=24)
    design = replace(design, exclusion=0)
    events, mean_activity = 24, 24 * 8 << ACTIVITY_FRACTION_BITS
    shown = [[events - number % 3, *[0] * (design.slots - 1)] for number in range(110)]
    if design.slots > 1:
        for number, counts in enumerate(shown):
            counts[1] = number % 3
    stream = Stream.showing(design, shown)
    rest = [0] * (design.slots - 1)
    places = [[min(18 + place, design.code_max), *rest] for place in range(design.places)]
    return stream.case("weights", places, activity=mean_activity)


#: count that one place of 80 has, in the only slot that counts, and the others have not: the
#: evidence against them is the most there is; and the events that windows usually have
_APART, _APART_COUNT, _APART_EVENTS = 40, 63, 420


def _place_apart(design: Design, activity: int, apart: dict[int, int]) -> Memories:
    """Make the tables of a map with one place apart, and its and some others' own activities."""
    design = replace(
        design, window="time", tau_us=max(design.tau_us, 4), code="counts", code_bits=6,
        places=80,
    )  # fmt: skip
    rest, places = [0] * (design.slots - 1), range(design.places)
    codes = [[_APART_COUNT if place == _APART else 0, *rest] for place in places]
    return Memories(
        design, choose_pixels(design), codes, activity=_APART_EVENTS << ACTIVITY_FRACTION_BITS,
        place_activity=[apart.get(place, activity) for place in places],
    )  # fmt: skip


def _numbers(name: str, memories: Memories, shown: Sequence[int]) -> Case:
    """Show windows of so many events, all of the first slot."""
    design, rest = memories.design, [0] * (memories.design.slots - 1)
    stream = Stream.showing(design, [[events, *rest] for events in shown])
    return Case(name, memories, tuple(stream.events))


def _weights_of_far_places(design: Design) -> Case:
    """Show the place apart in windows of many weights; the others have the most evidence."""
    mean_activity, shown = _APART_EVENTS << ACTIVITY_FRACTION_BITS, []
    for weight in (8, 3, 8, 4, 5, 6, 7, 8):
        numbers = range(_APART_COUNT, 4 * _APART_EVENTS)
        shown.append(next(n for n in numbers if weight_of(activity_of(n, mean_activity)) == weight))
        mean_activity = mean_activity_after(mean_activity, shown[-1])
    # a place may cost more than 8 bits hold
    memories = _place_apart(replace(design, exclusion=4, restart=254), 0, {})
    return _numbers("weights_of_far_places", memories, shown)


def _view_of_another_place(design: Design) -> Case:
    """Show a place that is far from all others, while the path goes on: much evidence against it.

    The match has much support before, so that its trust tells every bit of this evidence.
    """
    design = replace(design, places=40, restart=254, exclusion=1)
    places, last = [], design.places - 1
    for place in range(last):
        raised = {
            (7 * place + i * i * (1 + place // design.slots)) % design.slots for i in range(9)
        }
        places.append([6 if slot in raised else 1 for slot in range(design.slots)])
    places.append([15] * design.slots)
    if design.window == "count":
        design = replace(design, window_events=max(map(sum, places)))
    codes = Stream.showing(design, places).shown_codes()
    route = [*range(9), last, *range(10, 18), last, last, 21]
    stream = Stream.showing(design, [places[place] for place in route])
    return stream.case("view_of_another_place", codes)


def _tabulated_costs(design: Design) -> list[Case]:
    """Make cases that show every entry of the table of costs as the metric of a match.

    Windows show the place apart, and between them have so few events that evidence has no weight.
    Then the best place is this one, and the second best another to which a step leads from it, by
    as many places as the exclusion zone leaves; or the other way round, if the step costs less. The
    number of events tells the row of the table.
    """
    cases, half = [], "half_" if design.places_per_window == 2 else ""
    for zone, reached in enumerate(((0, 1), *((step,) for step in range(2, design.steps)))):
        for name, rows, activity in (("low", range(9), -22), ("high", range(8, 17), -84)):
            apart = {_APART: 0} | {_APART + step: activity for step in reached}
            memories = _place_apart(replace(design, exclusion=zone), 127, apart)
            mean_activity, shown = memories.activity, []
            for row, which in product(rows, (0, -1)):
                shown.append(max(_APART_COUNT, mean_activity >> (ACTIVITY_FRACTION_BITS + 2)))
                mean_activity = mean_activity_after(mean_activity, shown[-1])
                fitting = [
                    events
                    for events in range(1, _APART_COUNT)
                    if row_of(activity_of(events, mean_activity) - activity) == row
                    and weight_of(activity_of(events, mean_activity)) == 0
                ]
                shown.append(fitting[which])
                mean_activity = mean_activity_after(mean_activity, shown[-1])
            cases.append(_numbers(f"{half}costs_of_{zone + 1}_places_{name}", memories, shown))
    return cases


def _logarithms(design: Design) -> Iterator[Case]:
    """Make cases of the largest mean numbers of events, over 5 octaves.

    At every third logarithm of it, a window has the least events with which staying at the only
    place costs what the next row of the table says, and one less: the cost tells an error of one.
    """
    design = replace(design, window="time", places=1, exclusion=0)
    staying = [steps[0] for steps in design.step_costs]
    row = next(row for row, cost in enumerate(staying) if cost > staying[0])
    edge = ((row - SAME_ROW) << COST_ROW_SHIFT) - (1 << COST_ROW_SHIFT - 1) + PLACE_LOW
    for log in range(LOG_TOP - 1, LOG_TOP - 5 * PARTS, -3):
        least = bisect_left(range(EVENTS_TOP), log, key=ilog) << ACTIVITY_FRACTION_BITS
        # so that the first pause, which takes 1/1024, leaves the least mean of this logarithm, or
        # one unit less
        mean = -(-least * 1024 // 1023) - log % 2
        memories = Memories(
            design, choose_pixels(design), [[0] * design.slots],
            activity=mean, place_activity=[PLACE_LOW],
        )  # fmt: skip
        shown = [1]
        for less in (1, 0):
            mean = mean_activity_after(mean, shown[-1])
            log_of_mean = ilog(mean >> ACTIVITY_FRACTION_BITS)
            shown.append(bisect_left(range(EVENTS_TOP), log_of_mean + edge, key=ilog) - less)
        yield _numbers(f"logarithm_{log}", memories, shown)
    yield _rounded_decay(design, edge - PLACE_LOW)


def _rounded_decay(design: Design, edge: int) -> Case:
    """Make a pause that takes 1/1024 of a mean of 1,024 k + 1 units, which is k + 1, rounded up.

    The window behind it moves the mean to one unit below a logarithm, or onto it if that was k.
    """
    least = bisect_left(range(EVENTS_TOP), 6 * PARTS, key=ilog) << ACTIVITY_FRACTION_BITS

    def after(mean: int, *shown: int) -> int:
        for events in shown:
            mean = mean_activity_after(mean, events)
        return mean

    start, events = next(
        (start, events)
        for start, events in product(range(1025, least, 1024), range(least))
        if after(start, 0, events) == least - 1
        and mean_activity_after(after(start, 0) + 1, events) == least
    )
    log_of_mean = ilog(least - 1 >> ACTIVITY_FRACTION_BITS)
    last = bisect_left(range(EVENTS_TOP), log_of_mean + edge, key=ilog)
    memories = Memories(
        design, choose_pixels(design), [[0] * design.slots], activity=start, place_activity=[0]
    )
    return _numbers("rounded_decay", memories, [0, events, last])


def _contrasts(design: Design) -> list[Case]:
    """Make the cases of contrast codes: all shifts, both ends, and the window's rounded mean."""
    four = replace(design, places=4, exclusion=1)
    sequences = replace(four, matching="sequence", length=2, trust=0)
    # of so few bits that deviations of half the largest level are beyond both ends
    few = replace(four, code_bits=min(four.code_bits, 3))
    top = LEVEL_TOP
    high = [4 * 256 * (slot % 2) for slot in range(design.slots)]
    cases = [
        drive("contrasts", design, [*range(12)] * 2, high),
        drive("contrasts_of_sequences", sequences, [0, 1, 2, 3] * 3, high),
        drive("contrasts_from_the_top", four, [0, 1, 2, 3], [top] * design.slots),
        drive("contrasts_of_half", few, [0, 1, 2, 3], [top * (s % 2) for s in range(design.slots)]),
        drive("all_shifts", four, [0, 1, 2, 3] * 130, high),
        *_rounded_means(four),
        *_halves(four),
        _delayed_shifts(four),
    ]
    if design.window == "time":
        cases.append(drive("contrasts_and_pauses", design, [0, PAUSE, 1, PAUSE, 2, 3], high))
        cases.append(drive("means_and_pauses", four, [0, PAUSE, 1, PAUSE, PAUSE, 2, 3], high))
    return cases


def _rounded_means(design: Design) -> list[Case]:
    """Make windows whose mean is at the edge of being rounded otherwise, which changes a code."""
    slots, level = design.slots, LEVELS[20]
    cases = []
    for name, total, first in (
        ("up", -(-slots // 2), 128),
        ("down", -(-slots // 2) - 1, 128),
        ("up_to_nothing", -(slots // 2), 127),
        ("down_below_nothing", -(slots // 2) - 1, 127),
    ):
        means = [level - first, level - total + first, *[level] * (slots - 2)]
        if slots == 1:  # the mean is its difference
            continue
        cases.append(_counted(f"contrast_rounded_{name}", design, means, [[20] * slots] * 2))
    return cases


def _thresholds(design: Design) -> list[Case]:
    """Set the threshold to the least trust of a drive, to one above it, and above 8 bits."""
    forward, route = replace(design, exclusion=1, trust=0), range(design.places)
    matches = drive("", forward, route).trace().matches
    trust = min((match.trust for match in matches if match.trust), default=1)
    return [
        drive("trusted", replace(forward, trust=trust), route),
        drive("distrusted", replace(forward, trust=min(trust + 1, TRUST_TOP)), route),
        # of whose lower 8 bits there is more
        drive("distrusted_by_far", replace(forward, trust=min(trust + 256, TRUST_TOP)), route),
    ]


def _halves(design: Design) -> list[Case]:
    """Make a case with means at half a unit of a logarithm, or just below, where rounding matters.

    A third slot, an octave below its mean in the last window, takes what the two add to the mean of
    the window, which is then 0. With fewer slots it is not, and windows by count cannot show it.
    """
    if design.slots < 4 or design.window == "count":
        return []
    half = 1 << (MEAN_FRACTION_BITS - 1)
    # the others are always at their means
    octave, rest = (LEVELS[3], (3, 3, 1)), (LEVELS[3], (3, 3, 3))
    chosen = [_counts_to_half(half), _counts_to_half(half - 1), octave]
    chosen += [rest] * (design.slots - 3)
    means = [mean for mean, _ in chosen]
    windows = [[counts[i] for _, counts in chosen] for i in range(3)]
    return [_counted("means_of_halves", design, means, windows)]


def _counts_to_half(end: int) -> tuple[int, tuple[int, int, int]]:
    """Find a mean and two counts that move it to `end` above a whole unit, and a third count.

    The third count has another code if the mean is rounded to the other side.
    """
    levels, unit, counts = LEVELS, 1 << LEVEL_FRACTION_BITS, range(1, 60)
    pairs = list(product(counts[:7], counts[:7]))
    totals = np.empty((3 * unit, len(pairs)), np.int64)  # of all means at once
    for column, pair in enumerate(pairs):
        running = RunningMean(np.arange(3 * unit))
        for count in pair:
            running.update(np.array(levels[count]))
        totals[:, column] = running.total
    for mean, column in np.argwhere(totals % (1 << MEAN_FRACTION_BITS) == end).tolist():
        whole = int(totals[mean, column]) >> MEAN_FRACTION_BITS
        for count in counts:
            if (levels[count] - whole) % unit == unit // 2 and 0 <= levels[count] - whole < unit:
                return mean, (*pairs[column], count)
    raise AssertionError("no mean ends there")


def _delayed_shifts(design: Design) -> Case:
    """Keep the means constant until the shift is the last one, then move them by several codes."""
    quiet = [[1] * design.slots] * ((1 << (LAST_SHIFT + 1)) - (1 << FIRST_SHIFT) + 20)
    # at these counts, the codes of 1 to 3 octaves change at different windows
    loud = [[(1, 6, 11, 40, 60)[slot % 5] for slot in range(design.slots)]] * 90
    return _counted("late_shifts", design, [LEVELS[1]] * design.slots, quiet + loud)


def _counted(name: str, design: Design, means: list[int], windows: list[list[int]]) -> Case:
    """Show windows of these counts; the map holds the last windows, newest first."""
    if design.window == "count":
        design = replace(design, window_events=max(map(sum, windows)))
    stream = Stream.showing(design, windows)
    codes = stream.shown_codes(mean=means)
    places = [codes[-1 - place % len(codes)] for place in range(design.places)]
    return stream.case(name, places, mean=means)


# Corner cases of the place filter's evidence: large and small distances, and their spread.


def evidence_cases(design: Design) -> list[Case]:
    """Make the corner cases of the evidence.

    Parameters
    ----------
    design : Design
        With the place filter and counts.
    """
    return [
        _far(design),
        _beyond_a_byte(design),
        *_small_spreads(design),
        _wide_sums(design),
        _largest_second(design),
        *_wide_evidence(design),
    ]


def _wide_evidence(design: Design) -> list[Case]:
    """Show the same distance to all places, then one that has evidence of 17 bits unsaturated.

    In 16 bits it would be 40. The design needs 66 slots for such a distance.
    """
    if not 66 <= design.slots <= 257:
        return []
    wide = replace(
        design, code="counts", code_bits=8, exclusion=1, restart=254,
        window_events=64 * 128 + 40,
    )  # fmt: skip
    rest = wide.slots - 65
    near, far = [0] * wide.slots, [255] * 64 + [74] + [0] * rest
    between = [127] * 32 + [128] * 32 + [37] + [0] * rest
    # few events, but enough for evidence of full weight
    nothing = [0] * (wide.slots - 1) + [20]
    if wide.window == "count":
        nothing[-1] = wide.window_events
        far[-1] = near[-1] = 0
    stream = Stream.showing(wide, [between, nothing, between])
    rows = [near if place == wide.places // 2 else far for place in range(wide.places)]
    return [stream.case("evidence_above_16_bits", rows)]


def _wide_sums(design: Design) -> Case:
    """Show windows of few events to places of many, with sums of distances above 16 bits.

    Both the sum of the distances and that of the deviations from their mean are above, over all
    places.
    """
    slots = design.slots
    bits = max(n for n in range(1, 9) if n == 1 or slots * ((1 << n) - 1) <= 0xFFFF)
    top = (1 << bits) - 1
    # a third of the places at half of the largest distance, and the others at the largest: the
    # deviations are on average 2/9 of the largest distance
    places = max(12, -(-6 * 0x10000 // (slots * top)))
    wide = replace(
        design, code="counts", code_bits=bits, places=places, exclusion=1,
        restart=254, window_events=2,
    )  # fmt: skip
    counts = [2, *[0] * (slots - 1)]
    stream = Stream.showing(wide, [counts] * 4)
    half = [top] * (slots // 2) + [0] * (slots - slots // 2) if slots > 1 else [top // 2]
    rows = [half if place % 3 == 1 else [top] * slots for place in range(places)]
    rows[places // 2] = list(stream.shown_codes()[0])
    return stream.case("wide_sums", rows)


def _largest_second(design: Design) -> Case:
    """Show the last place of a map whose only place beyond the exclusion zone is far.

    Each window has the largest evidence against it, until its metric is the largest.
    """
    slots = design.slots
    bits = max(n for n in range(1, 9) if n == 1 or slots * ((1 << n) - 1) <= 0xFFFF)
    zone = 128
    wide = replace(
        design, code="counts", code_bits=bits, places=zone + 2, exclusion=zone,
        restart=254, window_events=2,
    )  # fmt: skip
    stream = Stream.showing(wide, [[2, *[0] * (slots - 1)]] * 6)
    shown = stream.shown_codes()[0]
    far = [wide.code_max if 2 * code <= wide.code_max else 0 for code in shown]
    # so near that the spread is small, and not so near that they match as well
    near, left = list(shown), max(1, sum(map(abs, map(sub, far, shown))) // 64)
    for slot, code in enumerate(far):
        step = max(-left, min(left, code - near[slot]))
        near[slot] += step
        left -= abs(step)
    return stream.case("largest_second", [far, *[near] * zone, shown])


def _far(design: Design) -> Case:
    """Show a count that is equally far from all places, then the places' own counts."""
    design = replace(design, code="counts", code_bits=8, window_events=210)
    rest = [0] * (design.slots - 1)
    stream = Stream.showing(design, [[count, *rest] for count in (101, 1, 201, 1)])
    shown = stream.shown_codes()
    # only one place is near, so that the second best is a far one
    places = [shown[1 if k == design.places // 2 else 2] for k in range(design.places)]
    return stream.case("far", places)


def _beyond_a_byte(design: Design) -> Case:
    """Show places whose distances need more than eight bits, if the design has two slots.

    Truncated to eight bits, the largest distance would be smaller than the others.
    """
    design = replace(design, code="counts", code_bits=8)
    # the exclusion zone is as wide as a block of equal places
    design = replace(design, exclusion=design.places // 4 - 1)
    design = replace(design, window_events=411, restart=0)
    rest = [0] * max(0, design.slots - 2)
    kinds = [[counts, counts][: design.slots] + rest for counts in (1, 101, 181, 201)]
    stream = Stream.showing(design, kinds * 2)
    shown = stream.shown_codes()
    places = [shown[(0, 2, 1, 3)[place * 4 // design.places]] for place in range(design.places)]
    return stream.case("distances_beyond_a_byte", places)


def _small_spreads(design: Design) -> list[Case]:
    """Show windows a few units of code from all places, so that the spread is 1 or 0.

    The reciprocal of both is 2^16, which has one bit more than any other. A place takes two words
    of memory, if the design has enough slots.
    """
    lanes = -(-design.slots // 2)
    near = replace(design, lanes=lanes, exclusion=1)
    near = replace(near, window_events=max(near.window_events, 20 + 3 * near.slots))
    rest = [3] * (near.slots - 1)
    stream = Stream.showing(near, [[first, *rest] for first in (20, 20, 20, 1, 20, 20)])
    shown = stream.shown_codes()[0]
    apart = _at_distances(near, shown, lambda place: 1 + place * 5 % 4)
    alike = _at_distances(near, shown, lambda _: 1)
    return [
        stream.case("spread_of_one", apart),
        stream.case("spread_of_none", alike),
    ]


def _at_distances(
    design: Design, shown: Sequence[int], distance_of: Callable[[int], int]
) -> list[list[int]]:
    """Make places at these distances, in units of code; the middle place equals `shown`."""
    places = []
    for place in range(design.places):
        # only one place is nearest, so that the second best has evidence against it
        distance = 0 if place == design.places // 2 else distance_of(place)
        codes = list(shown)
        for slot in range(min(distance, design.slots)):
            codes[-1 - slot] += 1 if codes[-1 - slot] < design.code_max else -1
        places.append(codes)
    return places


# Corner cases of the RAM: arrays that reach up to the next one or to the end of the RAM.


def ram_cases(plain: Design, contrast: Design) -> list[Case]:
    """Make the corner cases of the RAM.

    Parameters
    ----------
    plain, contrast : Design
        Both have the place filter, and the second has contrast codes.
    """
    route = [0, 1, 2, 3, 4, 5, 6, 7]
    eight = replace(plain, places=8, exclusion=1)
    # the means take a multiple of 16 bytes, if there are enough pixels
    full = replace(contrast, pixels=contrast.pixels // 4 * 4 or contrast.pixels, exclusion=1)
    sequences = replace(full, matching="sequence", length=2, trust=0)
    variants = {
        "means_fill_the_ram": full,
        # four sums fill their room, five need more
        "means_behind_four_sums": replace(sequences, exclusion=3),
        "means_behind_five_sums": replace(sequences, exclusion=4),
    }
    # no mean is zero, so that a mean that another array overwrites is noticed
    high = [2 * 256 + 128 * (slot % 3) for slot in range(full.slots)]
    return [
        drive("distances_fill_the_ram", eight, route),
        *(drive(name, variant, route, high) for name, variant in variants.items()),
    ]
