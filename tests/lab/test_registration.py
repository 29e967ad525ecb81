"""A shifted camera is found against the oracle, and its map moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lab.experiments.mount_shift import CountedWindows
from lab.registration import SEQUENCE, estimate_shift, moved_map, reach_of, register

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from tests import naive

SENSOR = Sensor(32, 24)
TAU = 1_000_000
CHOSEN = Settings(
    pixels=20, sigma=0.0, tau_us=TAU, sequence_length=2, strategy="random", remove_bursts=False,
    remove_hot_pixels=False,
)  # fmt: skip
WINDOWS = 24


def scenes(rng, places=WINDOWS):
    """Images of places; half a pixel's counts are its own, at all of them."""
    own = rng.integers(0, 20, (SENSOR.height + 12, SENSOR.width + 12))
    return own + rng.integers(0, 12, (places, *own.shape))


def seen(world, dx, dy):
    """The world through a camera whose image is shifted."""
    return world[:, 6 - dy : 6 - dy + SENSOR.height, 6 - dx : 6 - dx + SENSOR.width]


def mapped_with(chosen, images):
    return ReferenceMap.build(CountedWindows(images, TAU), chosen)


@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (-2, 3), (3, -3)])
@pytest.mark.parametrize(
    "changes", [{}, {"counter_code": "contrast", "matching": "filter", "smooth": True}]
)
def test_the_shift_is_found_and_the_matches_are_as_without_it(shift, changes):
    rng = np.random.default_rng(3)
    world = scenes(rng)
    chosen = CHOSEN.replaced(changes, "test")
    mapped = mapped_with(chosen, seen(world, 0, 0))
    images = seen(world + rng.integers(0, 3, world.shape), *shift)
    moved, *found = register(mapped, images)
    assert tuple(found) == shift and (moved is mapped) == (shift == (0, 0))
    matches = moved.match(CountedWindows(images, TAU)).matches
    off = np.abs(matches.place.astype(np.int64) - matches.query)
    assert off.max() <= 1 and (off == 0).mean() > 0.9


def test_the_likeness_is_the_oracles_to_the_bit():
    rng = np.random.default_rng(4)
    world = scenes(rng, 18)
    mapped = mapped_with(CHOSEN, seen(world, 0, 0))
    images = seen(world + rng.integers(0, 9, world.shape), 2, 1)
    images[:, 3, 4] = 0  # a pixel that never fires
    dx, dy, likeness, unmoved = estimate_shift(mapped, images)
    reach = reach_of(SENSOR)
    pixels = [
        (x, y, j)
        for j, (x, y) in enumerate(zip(mapped.pixel_map.x.tolist(), mapped.pixel_map.y.tolist(),
                                       strict=True))
        if reach <= x < SENSOR.width - reach and reach <= y < SENSOR.height - reach
    ]  # fmt: skip
    places = [[row[j] for _, _, j in pixels] for row in mapped.places.counts.tolist()]
    for at, values in (((dx, dy), likeness), ((0, 0), unmoved)):
        counted = [[int(im[y + at[1], x + at[0]]) for x, y, _ in pixels] for im in images]
        assert values.tolist() == naive.likeness(places, counted, SEQUENCE)


def test_a_shift_that_is_not_clear_moves_nothing():
    rng = np.random.default_rng(5)
    mapped = mapped_with(CHOSEN, seen(scenes(rng), 0, 0))
    moved, dx, dy = register(mapped, seen(scenes(rng), 0, 0))  # another world
    assert moved is mapped and (dx, dy) == (0, 0)


def test_pixels_off_the_sensor_and_on_hot_pixels_are_dropped():
    rng = np.random.default_rng(8)
    chosen = CHOSEN.replaced({"counter_code": "linear"}, "test")
    mapped = mapped_with(chosen, seen(scenes(rng), 0, 0))
    x, y = mapped.pixel_map.x.astype(int), mapped.pixel_map.y.astype(int)
    first = int(np.flatnonzero((x < 29) & (y < 24 - 2))[0])
    hot = mapped.hot.copy()
    hot[y[first] + 2, x[first] + 3] = True
    moved = moved_map(replace(mapped, hot=hot), 3, 2)
    kept = (x + 3 < SENSOR.width) & (y + 2 < SENSOR.height)
    kept[first] = False
    assert moved.pixel_map.x.tolist() == (x + 3)[kept].tolist()
    assert moved.pixel_map.y.tolist() == (y + 2)[kept].tolist()
    assert np.array_equal(moved.places.counts, mapped.places.counts[:, kept])
    assert moved.settings.pixels == kept.sum()
    with pytest.raises(UsageError, match="no pixel of the map is left"):
        moved_map(mapped, SENSOR.width, 0)
