"""Drives and saved states of a map, for the specification of the place filter and of codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from edge_vpr.matching.prediction import TransitionCosts
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from firmware_model.specification import (
    Costs,
    Filter,
    differences_of,
    distance,
    ilog,
    is_pause,
    mean_activity_after,
    mean_shift,
    means_after,
    own_mean_code,
    window_mean,
)
from firmware_model.specification_drive import Drive, DriveMatch, likelier, possible_starts
from fixedpoint.activity import COSTS_BY_ACTIVITY, EVENTS_TOP
from fixedpoint.own_mean import FULL_SCALE

Rows = list[list[int]]


@dataclass(frozen=True)
class Begin:
    """What is kept of the windows that are over."""

    windows: int
    mean_activity: int  # events of a window, times 256
    filter: Filter | None = None
    means: list[int] | None = None  # of each counter, in units of 1/65,536 octave
    moves: int = 0


def begin_of(reference: ReferenceMap) -> Begin:
    """Before the first window: the mean number of events is the reference's.

    Places at half windows overlap: every second one counts.
    """
    activity = reference.places.selected_events.tolist()[:: reference.settings.places_per_window]
    mean_activity = 256 * sum(activity) // len(activity)
    return Begin(0, min(mean_activity, 256 * EVENTS_TOP))


def pauses(counted: Rows, mean_activity: int) -> list[bool]:
    """Whether each window is a pause."""
    paused = []
    for row in counted:
        paused.append(is_pause(sum(row), mean_activity))
        mean_activity = mean_activity_after(mean_activity, sum(row))
    return paused


def place_activities(reference: ReferenceMap) -> list[int]:
    """Activity of each place, of a byte."""
    mean_activity = begin_of(reference).mean_activity
    return [
        min(max(ilog(min(events, EVENTS_TOP)) - ilog(mean_activity // 256), -128), 127)
        for events in reference.places.selected_events.tolist()
    ]


def costs_of(costs: TransitionCosts) -> Costs:
    """Return all costs with their fraction bits; those of windows by number in equal rows."""
    rows = COSTS_BY_ACTIVITY[costs.places_per_window]
    if not costs.by_activity:
        fixed = {1: (4, 0, 0, 4), 2: (4, 0, 0, 0, 0, 4)}[costs.places_per_window]
        rows = (fixed,) * len(rows)
    return Costs(rows, 4 * costs.restart)


def zone_of(settings: Settings) -> int:
    """Places on each side in the exclusion zone, which is given in windows."""
    return settings.exclusion * settings.places_per_window


def levels_of(reference: ReferenceMap, counted: Rows) -> Rows:
    """Logarithms of all counts."""
    assert reference.own_mean_code is not None
    return [[level_of(min(count, FULL_SCALE)) for count in row] for row in counted]


def level_of(count: int) -> int:
    """``round(256 log2(1 + count))``: 2**(2r - 1) <= (1 + count)**512, in integers."""
    return int(((1 + count) ** 512).bit_length()) // 2


def running_codes(reference: ReferenceMap, counted: Rows, begin: Begin) -> Rows:
    """Own-mean codes of windows, each against the mean of those before it."""
    code, paused = reference.own_mean_code, pauses(counted, begin.mean_activity)
    assert code is not None and reference.mean is not None
    means: Sequence[int] = begin.means or [256 * mean for mean in reference.mean.tolist()]
    moves, coded = begin.moves, []
    for levels, pause in zip(levels_of(reference, counted), paused, strict=True):
        differences = differences_of(levels, means)
        shared = window_mean(differences) if code.contrast else 0
        coded.append([own_mean_code(one - shared, code.bits) for one in differences])
        if not pause:
            means, moves = means_after(means, levels, mean_shift(moves)), moves + 1
    return coded


def drive_of(
    reference: ReferenceMap,
    coded: Rows,
    events: list[int],
    begin: Begin | None = None,
    unseen: Sequence[int] = (),
) -> Drive:
    """Match windows by the filter, without odometry."""
    settings, places = reference.settings, reference.places.counts.tolist()
    begin = begin or begin_of(reference)
    return Drive(
        costs_of(TransitionCosts.of(settings)), zone_of(settings),
        [[distance(place, code) for place in places] for code in coded],
        events, begin.mean_activity, place_activities(reference),
        per_window=settings.places_per_window,
        jumps=[] if reference.jumps is None else reference.jumps.tolist(), begin=begin.filter,
        unseen=unseen,
    )  # fmt: skip


def filtered(
    reference: ReferenceMap, coded: Rows, events: list[int], begin: Begin
) -> list[tuple[int, int, int, int, int, int]]:
    """Place, metric, second, its metric, ties and trust after each window."""
    return list(map(row_of_match, drive_of(reference, coded, events, begin).live()))


def smoothed(
    reference: ReferenceMap, coded: Rows, events: list[int]
) -> list[tuple[int, int, int, int, int, int]]:
    """The same of each window by all those before and after it."""
    begin = begin_of(reference)
    drives = [
        drive_of(reference, coded, events, replace(begin, mean_activity=start))
        for start in possible_starts(events, begin.mean_activity)
    ]
    return list(map(row_of_match, likelier(drives).smoothed()))


def row_of_match(match: DriveMatch) -> tuple[int, int, int, int, int, int]:
    """Place, metric, second, its metric, ties and trust; -1 for a second that there is not."""
    second = -1 if match.second is None else match.second
    second_sum = -1 if match.second_sum is None else match.second_sum
    return match.place, match.sum, second, second_sum, match.ties, match.trust
