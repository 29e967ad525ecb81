"""Counting 20 million events of a 346 x 260 sensor at 150 selected pixels."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit
from table import OURS

from edge_vpr.descriptors.counting import count_events
from edge_vpr.events import Sensor, make_events

SENSOR = Sensor(346, 260)
EVENTS, J = 20_000_000, 150


@pytest.fixture(scope="module")
def drive():
    """Make events at random pixels, the hardest case for the caches; those of a camera cluster."""
    rng = np.random.default_rng(2022)
    x = rng.integers(0, SENSOR.width, EVENTS).astype(np.uint16)
    y = rng.integers(0, SENSOR.height, EVENTS).astype(np.uint16)
    events = make_events(np.arange(EVENTS), x, y, rng.integers(0, 2, EVENTS))
    pixels = rng.choice(SENSOR.pixels, J, replace=False)
    table = np.full((SENSOR.height, SENSOR.width), -1, dtype=np.int16)
    table.flat[pixels] = np.arange(J)
    everywhere = np.bincount(y.astype(np.int64) * SENSOR.width + x, minlength=SENSOR.pixels)
    return SimpleNamespace(
        x=x, y=y, events=events, pixels=pixels, table=table, expected=everywhere[pixels]
    )


def ours(drive, x, y):
    def run():
        counts = np.zeros(J, dtype=np.int32)
        count_events(drive.table, x, y, counts)
        return counts

    return run


def by_numpy(drive):
    """Look every event up, and let `bincount` count the slots; 1 makes room for -1."""
    slots = drive.table.astype(np.int64) + 1
    return lambda: np.bincount(slots[drive.y, drive.x], minlength=J + 1)[1:]


def by_tonic(drive):
    tonic = pytest.importorskip("tonic.functional", reason="tonic is not installed")
    size, records = (*SENSOR, 2), np.asarray(drive.events)

    def run():
        frames = tonic.to_frame_numpy(records, size, n_time_bins=1)
        return frames[0].sum(axis=0, dtype=np.int64).flat[drive.pixels]

    return run


@njit
def look_up(table, x, y):
    """Add up what each event finds at its pixel: the least that a counter by look-up does."""
    total = 0
    for i in range(x.size):
        total += table[y[i], x[i]]
    return total


WORKS = {
    "count 20 M events in columns": (
        (OURS, lambda d: ours(d, d.x, d.y), {}),
        ("NumPy look-up + bincount", by_numpy, {"rounds": 5, "target": 8}),
        ("tonic to_frame_numpy", by_tonic, {"rounds": 3, "target": 60}),
        ("one look-up an event", lambda d: lambda: look_up(d.table, d.x, d.y), {"limit": True}),
    ),
}


@pytest.mark.parametrize(
    ("work", "library", "make", "how"),
    [(work, *contestant) for work, field in WORKS.items() for contestant in field],
)
def bench_counting(race, drive, work, library, make, how):
    limit = how.get("limit")
    expected = int(drive.table[drive.y, drive.x].sum(dtype=np.int64)) if limit else drive.expected
    race(work, library, make(drive), expected, **how)
