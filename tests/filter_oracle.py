"""Drives of a map, for the specification of the place filter and of codes."""

from __future__ import annotations

from collections.abc import Sequence

from edge_vpr.matching.prediction import TransitionCosts
from edge_vpr.reference_map import ReferenceMap
from firmware_model.specification import gains_of, ilog, is_pause, mean_activity_after
from firmware_model.specification_drive import (
    DriveMap,
    DriveMatch,
    Window,
    codes_of_sums,
    distance,
    typical_distances,
    windows_of,
)
from fixedpoint.activity import EVENTS_TOP, SUMS

Rows = list[list[int]]


def drive_map(
    costs: TransitionCosts,
    activity: Sequence[int],
    typical: Sequence[int],
    mean_activity: int,
    exclusion: int,
    along: Sequence[int] = (),
) -> DriveMap:
    """What a map with these costs says."""
    return DriveMap.of(
        activity, typical, mean_activity, costs.places_per_window, 4 * costs.restart, exclusion,
        along, gains_of(costs.gains), not costs.by_activity,
    )  # fmt: skip


def mean_activity_of(events: Sequence[int], per_window: int = 1) -> int:
    """Mean of the windows of places, those that do not overlap, in units of 1/256 event."""
    some = list(events)[::per_window]
    return min(256 * sum(some) // len(some), 256 * EVENTS_TOP)


def activities(events: Sequence[int], mean_activity: int) -> list[int]:
    """Activity of each place, of a byte."""
    of_mean = ilog(mean_activity // 256)
    return [min(max(ilog(min(n, EVENTS_TOP)) - of_mean, -128), 127) for n in events]


def of_reference(reference: ReferenceMap) -> DriveMap:
    """What a reference map says; its places have the events that count."""
    settings, events = reference.settings, reference.places.counted_events.tolist()
    per_window = settings.places_per_window
    mean_activity = mean_activity_of(events, per_window)
    return drive_map(
        TransitionCosts.of(settings), activities(events, mean_activity),
        typical_distances(reference.places.counts.tolist()), mean_activity,
        settings.exclusion * per_window,
    )  # fmt: skip


def events_that_count(reference: ReferenceMap, counted: Rows) -> list[int]:
    """Events of each window, of which a pixel gives no more than its limit."""
    assert reference.limits is not None
    limits = reference.limits.tolist()
    return [sum(min(n, most) for n, most in zip(row, limits, strict=True)) for row in counted]


def level_of(count: int) -> int:
    """``round(256 log2(1 + count))``: 2**(2r - 1) <= (1 + count)**512, in integers."""
    return ((1 + int(count)) ** 512).bit_length() // 2


LEVELS = [level_of(count) for count in range(1024)]


def running_codes(reference: ReferenceMap, counted: Rows, newest: Rows) -> list[Rows]:
    """Contrast codes of the sums at each window, against the mean of those before it.

    The sums of the last window are given, as a window that is not over may have others.
    """
    code, paused = reference.settings.contrast_code, []
    mean_activity = of_reference(reference).mean_activity
    assert code is not None and reference.mean is not None
    for events in events_that_count(reference, counted):
        paused.append(is_pause(events, mean_activity))
        mean_activity = mean_activity_after(mean_activity, events)
    number, coded = len(newest), []
    for i, of_sum in enumerate(newest):
        before = counted[max(len(counted) - SUMS[i], 0) : -1]
        last = [total - sum(column) for total, *column in zip(of_sum, *before, strict=True)]
        all_windows = codes_of_sums(
            [*counted[:-1], last], LEVELS, reference.mean.tolist(), code.bits, paused, number
        )
        coded.append([one[i] for one in all_windows])
    return [list(of_window) for of_window in zip(*coded, strict=True)]


def drive_of(
    reference: ReferenceMap, coded: Sequence[Rows], events: list[int], unseen: Sequence[int]
) -> list[Window]:
    """Match windows by the filter, without odometry."""
    places = reference.places.counts.tolist()
    distances = [[[distance(place, code) for place in places] for code in sums] for sums in coded]
    return windows_of(of_reference(reference), distances, events, unseen=unseen)


def row_of_match(match: DriveMatch) -> tuple[int, int, int, int, int, int]:
    """Place, metric, second, its metric, ties and trust; -1 for a second that there is not."""
    second = -1 if match.second is None else match.second
    second_sum = -1 if match.second_sum is None else match.second_sum
    return match.place, match.sum, second, second_sum, match.ties, match.trust
