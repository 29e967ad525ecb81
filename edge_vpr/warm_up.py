"""Warm-up: call every kernel that is needed later, so that no work waits for a compiler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from edge_vpr.compile_report import kernels_shown
from edge_vpr.descriptors.cleaning import BurstFilter
from edge_vpr.descriptors.counting import cleaned
from edge_vpr.errors import EdgeVprError
from edge_vpr.events import Events, Sensor, make_events
from edge_vpr.map_making import describe_query, map_traverse
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import CHUNK_EVENTS
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import Settings


class WarmUpStep(NamedTuple):
    """Part of a warm-up."""

    name: str  #: What its kernels do, for a line on the terminal.
    call: Callable[[], object]  #: Calls them.


def warm_up(steps: Sequence[WarmUpStep], show: Callable[[str], object] = lambda text: None) -> None:
    """Compile the kernels of all steps, or load those that were compiled before.

    Parameters
    ----------
    steps : sequence of WarmUpStep
        In the order of the work, so that errors in arguments appear early.
    show : callable
        Takes a text when a step begins, and when a kernel of it is compiled.
    """
    for k, step in enumerate(steps, 1):
        part = f"{step.name} ({k} of {len(steps)})"
        show(f"kernels: {part}")
        with kernels_shown(partial(_show_kernel, show, part)):
            step.call()


def _show_kernel(show: Callable[[str], object], part: str, name: str) -> None:
    show(f"compiling kernels: {part}, {name}")


class _Drive(NamedTuple):
    """A recording of few events."""

    sensor: Sensor
    events: Events

    def __iter__(self) -> Iterator[Events]:
        return iter([self.events])


#: size of a sensor and number of pixels for mapping; kernels are the same for all sizes
_SENSOR, _PIXELS = Sensor(32, 32), 100
#: events of a drive; in the 4 ms of a burst are fewer than half of the pixels
_EVENTS, _LEAST_STEP_US = 8_000, 8


def mapping_steps(settings: Settings) -> list[WarmUpStep]:
    """Return the warm-up of making a map with these settings."""
    small = settings.replaced({"pixels": min(settings.pixels, _PIXELS)}, "the warm-up")
    step_us = max(4 * settings.tau_us // _EVENTS, _LEAST_STEP_US)
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, _SENSOR.width, (2, _EVENTS))
    drive = _Drive(_SENSOR, make_events(np.arange(_EVENTS) * step_us, x, y))

    def make() -> None:
        with suppress(EdgeVprError):  # windows can be too long for these events
            map_traverse(drive, small)

    return [
        WarmUpStep("burst filter", lambda: list(cleaned(drive, small))),
        WarmUpStep("pixels and windows", make),
    ]


#: windows that are matched in a warm-up
_WINDOWS = 32


def matching_steps(reference: ReferenceMap, *, odometry: bool = False) -> list[WarmUpStep]:
    """Return the warm-up of matching a recording with a map.

    Parameters
    ----------
    odometry : bool
        Whether the query has odometry.
    """
    settings, pixels = reference.settings, reference.pixel_map
    number = 2 * settings.events_per_window if settings.window == "count" else 64
    t = np.linspace(0, 3 * settings.tau_us, number).astype(np.int64)
    x, y = (np.full(number, side[0]) for side in (pixels.x, pixels.y))
    events = make_events(t, x, y, np.zeros(number))
    drive = _Drive(pixels.sensor, events)
    # Places of the map are windows too. Those with the lowest and the highest count are among them,
    # since kernels differ by the range of the counts.
    counts = reference.places.counts
    ends = np.array([counts.argmin(), counts.argmax()]) // counts.shape[1]
    first = np.arange(min(max(_WINDOWS, settings.windows_per_match), len(counts)))
    few = np.unique([*first, *ends])
    windows = reference.places.take(few)
    if settings.hypotheses > 1:  # codes are codes, whatever they sum up
        windows = replace(windows, summed=np.stack([windows.counts] * 2, axis=1))
    driven = None
    if odometry:
        times = np.unique(windows.centre_us)  # a reading in each window
        driven = Odometry(times, np.arange(times.size, dtype=np.int64))

    def match() -> None:
        with suppress(EdgeVprError):  # of settings that do not suit the map, which is said later
            match_descriptors(
                windows,
                windows,
                settings,
                reference.confidence,
                along_mm=None if reference.along_mm is None else reference.along_mm[few],
                odometry=driven,
            )

    def count() -> None:
        with suppress(EdgeVprError):
            describe_query(reference, drive)

    name = "place filter" if settings.matching == "filter" else "sequences"
    return [
        WarmUpStep("burst filter", lambda: list(cleaned(drive, settings))),
        WarmUpStep("counters", count),
        WarmUpStep(name, match),
    ]


def localising_steps(
    reference: ReferenceMap,
    every: str | MatchSchedule | None,
    bursts: BurstFilter,
    *,
    odometry: bool = False,
) -> list[WarmUpStep]:
    """Return the warm-up of matching event by event.

    Parameters
    ----------
    every : str or MatchSchedule or None
        When to give a match.
    bursts : BurstFilter
        A new one, which is used up.
    odometry : bool
        Whether readings of an odometer are to come.
    """
    # if there are more than a few, the last part is processed by columns
    events = synthetic_events(2 * CHUNK_EVENTS)
    # for Numba an array of one event has another layout: contiguous, and aligned or not
    chunks = (events[:1], events[1:2], events[2:])

    @cache
    def localiser() -> Localiser:
        return Localiser(reference, every=every)

    def windows() -> None:
        """End windows that are no pause: they run code of their own, the second needs the first."""
        settings, last_us = reference.settings, int(events.t[-1])
        n = int(reference.places.selected_events.max())
        if settings.window == "count":
            n = max(n, settings.events_per_window)
        pixel = reference.pixel_map  # of one alone, few events count
        x, y = np.resize(pixel.x, n), np.resize(pixel.y, n)
        for _ in range(3 if odometry else 2):  # a distance is known after two readings
            localiser().update(make_events(np.full(n, last_us), x, y))
            if odometry:
                localiser().read_odometer(last_us, 0.0)
            last_us += settings.tau_us
            localiser().advance(last_us)

    return [
        WarmUpStep("burst filter", lambda: [bursts.update(some) for some in chunks]),
        WarmUpStep("localiser", lambda: [localiser().update(some) for some in chunks]),
        WarmUpStep("ends of windows", windows),
    ]


def synthetic_events(n: int = 1_000) -> Events:
    """Make events that fit any sensor."""
    return make_events(np.arange(n) * 10, np.zeros(n), np.zeros(n), np.arange(n) % 2)
