"""What the place filter gives, of recorded windows and after every event, in plain Python.

Codes of a query are worked out here as well. All of it goes on from a state, or begins.
"""

from __future__ import annotations

from typing import NamedTuple

import naive

from edge_vpr.matching.place_filter import METRIC_TOP
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

Rows = list[list[int]]


class Begin(NamedTuple):
    """What is kept of the windows that are over."""

    windows: int
    mean_activity: int  # events of a window, times 256
    filtered: tuple[list[int], int, int, int, list[int]] | None = None  # `naive.place_filter`
    means: list[tuple[int, int]] | None = None  # of each counter, see `naive.running_means`


def begin_of(reference: ReferenceMap) -> Begin:
    """Before the first window: the usual number of events is the reference's mean.

    Places at half windows overlap: every second one counts.
    """
    activity = reference.places.selected_events.tolist()[:: reference.settings.places_per_window]
    mean_activity = 256 * sum(activity) // len(activity)
    return Begin(0, min(mean_activity, 256 * (2**23 - 1)))


def resumed(arrays) -> Begin:  # type: ignore[no-untyped-def]
    """What a saved state of a localiser says."""
    state = arrays["filter_state"].tolist()
    reciprocal, mean_activity, place, support, newer, older, *_, windows = state
    filtered = None
    if windows:
        metric = arrays["filter_metric"].tolist()
        filtered = (metric, reciprocal, place, support, [older, newer])
    means = None
    if "filter_mean" in arrays:
        seen = int(arrays["filter_mean_windows"][0])
        means = [(total, seen) for total in arrays["filter_mean"].tolist()]
    return Begin(windows, mean_activity, filtered, means)


def pauses(counted: Rows, mean_activity: int) -> list[bool]:
    """Whether each window is a pause."""
    paused = []
    for row in counted:
        paused.append(naive.is_pause(sum(row), mean_activity))
        mean_activity = naive.usual_after(mean_activity, sum(row))
    return paused


def place_activities(reference: ReferenceMap) -> list[int]:
    """Activity of each place, of a byte."""
    usual = begin_of(reference).mean_activity
    return [
        min(max(naive.log_activity(events) - naive.log_activity(usual // 256), -128), 127)
        for events in reference.places.selected_events.tolist()
    ]


def forward_costs(settings: Settings) -> tuple[int, ...] | None:
    """Costs of steps forward; None: by activity."""
    by_count = (1, 0, 0, 1) if settings.places_per_window == 1 else (1, 0, 0, 0, 0, 1)
    return settings.filter_steps or (None if settings.window == "time" else by_count)


def zone_of(settings: Settings) -> int:
    """Places on each side in the exclusion zone, which is given in windows."""
    return settings.exclusion * settings.places_per_window


def running_codes(reference: ReferenceMap, counted: Rows, begin: Begin) -> Rows:
    """Own-mean codes of windows, each against the mean of those before it."""
    code, paused = reference.own_mean_code, pauses(counted, begin.mean_activity)
    assert code is not None and reference.mean is not None
    coded: Rows = []
    levels: list[list[int]] = [[] for _ in reference.mean]
    for w, row in enumerate(counted):
        means = []
        for j, mean in enumerate(reference.mean.tolist()):
            start = begin.means[j] if begin.means else None
            means.append(naive.running_means(levels[j], mean, start)[-1])
            if not paused[w]:
                levels[j].append(naive.log_level(min(row[j], code.full_scale)))
        coded.append(naive.own_mean_codes(row, means, code.bits, code.full_scale, code.contrast))
    return coded


def drive_codes(reference: ReferenceMap, counted: Rows) -> Rows:
    """Own-mean codes of windows, all against the mean of the drive without its pauses."""
    code, paused = reference.own_mean_code, pauses(counted, begin_of(reference).mean_activity)
    assert code is not None
    moving = [row for row, pause in zip(counted, paused, strict=True) if not pause] or counted
    means = []
    for j in range(len(counted[0])):
        levels = [naive.log_level(min(row[j], code.full_scale)) for row in moving]
        means.append((2 * sum(levels) + len(levels)) // (2 * len(levels)))
    return [
        naive.own_mean_codes(row, means, code.bits, code.full_scale, code.contrast)
        for row in counted
    ]


def filtered(
    reference: ReferenceMap, coded: Rows, events: list[int], begin: Begin
) -> list[tuple[int, int, int, int, int]]:
    """Place, metric, second, its metric and trust after each window."""
    settings, places = reference.settings, reference.places.counts.tolist()
    forward = forward_costs(settings)
    matched = naive.place_filter(
        [[naive.sad(place, code) for place in places] for code in coded],
        events, forward, settings.filter_back, settings.filter_restart, zone_of(settings),
        begin.mean_activity, begin.filtered,
        [] if reference.jumps is None else reference.jumps.tolist(),
        places=place_activities(reference), per_window=settings.places_per_window,
    )  # fmt: skip
    return [
        (best, metric[best], second, metric[second] if second >= 0 else -1, trust)
        for metric, best, second, trust in matched
    ]


def smoothed(
    reference: ReferenceMap, coded: Rows, events: list[int]
) -> list[tuple[int, int, int, int, int]]:
    """Place, metric, second, its metric and trust of each window, by those before and after it.

    By all after it, or with a delay by so many.
    """
    settings, places = reference.settings, reference.places.counts.tolist()
    forward = forward_costs(settings)
    distances = [[naive.sad(place, code) for place in places] for code in coded]
    late = settings.match_delay

    def decided(known: int) -> tuple[Rows, list[set[tuple[int, int]]], Rows]:
        """Smooth the drive as far as it is known."""
        return naive.smoothed_filter(
            distances[:known], events[:known], forward, settings.filter_back,
            settings.filter_restart, begin_of(reference).mean_activity,
            [] if reference.jumps is None else reference.jumps.tolist(), [], [None] * known,
            place_activities(reference), settings.places_per_window,
        )  # fmt: skip

    matched, follow, evidence = decided(len(coded))
    if late:
        whole = len(coded)
        matched = [decided(min(j + late + 1, whole))[0][j] for j in range(whole)]
    rows, margins = [], []
    for metric in matched:
        best, second, _ = naive.best_and_second(metric, zone_of(settings))
        least = metric[second] if second >= 0 else -1
        margins.append(least - metric[best] if second >= 0 else METRIC_TOP)
        rows.append((best, metric[best], second, least))
    trust = naive.delayed_trust if late else naive.smoothed_trust
    trusts = trust([row[0] for row in rows], margins, follow, evidence)
    return [(*row, trust) for row, trust in zip(rows, trusts, strict=True)]
