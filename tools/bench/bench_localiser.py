"""A match after every event at a selected pixel, against recomputing every distance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit
from table import OURS

from edge_vpr.descriptors.counting import count_events
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.events import Sensor, make_events
from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings

SENSOR = Sensor(346, 260)
J, N = 150, 450  # N: the released code's 3 J events in a window
PLACES = (256, 1_000, 8_000, 100_000)


def scene(places: int, length: int = 1) -> SimpleNamespace:
    """Make a map of Poisson counts, and a stream of events at selected pixels only."""
    rng = np.random.default_rng(places)
    flat = rng.choice(SENSOR.pixels, J, replace=False)
    pixels = PixelMap(SENSOR, flat % SENSOR.width, flat // SENSOR.width)
    counts = rng.poisson(3, (places, J)).astype(np.uint8)
    no_times = np.zeros(places, dtype=np.int64)
    image = np.zeros((SENSOR.height, SENSOR.width))
    settings = Settings(
        pixels=J, window="count", sequence_length=length, events_per_pixel=3.0, exclusion=3
    )
    reference = ReferenceMap(
        settings,
        pixels,
        Descriptors(counts, no_times, no_times, no_times),
        image.astype(np.float32),
        image > 0,
    )
    events = max(200, 10_000_000 // places)
    slots = rng.integers(0, J, length * N + events)
    # all at one time: windows of N events do not notice, and rounds can follow one another
    stream = make_events(np.zeros(slots.size), pixels.x[slots], pixels.y[slots])
    return SimpleNamespace(reference=reference, stream=stream, first=length * N, slots=slots)


@pytest.fixture(params=PLACES, scope="module")
def places(request):
    return scene(request.param)


def timed(race, s, what, library, update, expected, **how):
    """Time one contestant on the events after the first window."""
    events, places = s.stream.size - s.first, len(s.reference)
    work = f"{events:,} selected events, K = {places:,}: {what}"
    race(work, library, update, expected, **how)


@pytest.mark.parametrize(
    ("what", "every"),
    [
        ("best place after each", MatchSchedule(events=1, change=True)),
        ("match with runner-up after each", MatchSchedule(events=1)),
    ],
    ids=["best", "match"],
)
def bench_event_by_event(race, places, what, every):
    """Race with the same events in each round, so that the window is different at its start."""
    rest = places.stream[places.first :]
    fresh = Localiser(places.reference)
    fresh.update(places.stream[: places.first])
    np.testing.assert_array_equal(fresh.update(rest)["place"], _recomputed(places))
    localiser = Localiser(places.reference, every=every)
    localiser.update(places.stream[: places.first])
    timed(race, places, what, OURS, lambda: localiser.update(rest).size, None)


@pytest.mark.parametrize("what", ["best place after each", "match with runner-up after each"])
def bench_recomputing(race, places, what):
    """Race the peer: all distances anew after each event, with this project's own kernel."""
    target = 40 if len(places.reference) == 1_000 and what.startswith("best") else None
    expected = _recomputed(places)
    timed(
        race, places, what, "all distances anew", lambda: _recomputed(places), expected,
        rounds=1, target=target,
    )  # fmt: skip


def bench_reading(race, places):
    """Race the limit: read one column of the map and all sums, once an event."""
    columns = np.ascontiguousarray(places.reference.places.counts.T)
    sums = np.zeros(len(places.reference), dtype=np.uint16)
    events = places.stream.size - places.first
    timed(
        race,
        places,
        "best place after each",
        "reading column and sums once",
        lambda: _read(columns, sums, events),
        None,
        limit=True,
        target=0.6 if sums.size == 100_000 else None,
    )


@pytest.fixture(scope="module")
def unselected():
    """Make a million events that nobody selected: what remains is finding that out."""
    s = scene(1_000)
    table, n = s.reference.pixel_map.table(), 1_000_000
    flat = np.random.default_rng(0).choice(np.flatnonzero(table.ravel() < 0), n)
    events = make_events(np.zeros(n), flat % SENSOR.width, flat // SENSOR.width)
    return s.reference, table, events


def bench_unselected(race, unselected):
    reference, _, events = unselected
    localiser = Localiser(reference)
    race("1 M unselected events", OURS, lambda: localiser.update(events).size, 0)


def bench_unselected_counted(race, unselected):
    _, table, events = unselected
    counts = np.zeros(J, dtype=np.int64)
    race(
        "1 M unselected events",
        "counting alone",
        lambda: count_events(table, events.x, events.y, counts),
        0,
        limit=True,
        target=round(1 / 1.3, 2),
    )


def _recomputed(s: SimpleNamespace):
    """Count the window anew by one event each, and compare with every place."""
    index = ReferenceIndex(s.reference.places.counts)
    window = np.bincount(s.slots[: s.first], minlength=J)
    best = np.empty(s.slots.size - s.first, dtype=np.int64)
    for i in range(best.size):
        window[s.slots[s.first + i]] += 1
        window[s.slots[s.first + i - N]] -= 1
        best[i] = index.distances(window).argmin()
    return best


@njit
def _read(columns, sums, events):
    total = 0
    for event in range(events):
        column = columns[event % len(columns)]
        for k in range(sums.size):
            total += column[k]
        for k in range(sums.size):
            total += sums[k]
    return total
