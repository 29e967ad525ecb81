"""Pixels chosen by what they say of the place: held to determinants, and used by map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from edge_vpr.descriptors import pixels as module
from edge_vpr.descriptors.pixels import NOISE, PixelMap, informative_pixels, shortlist
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from fixedpoint.own_mean import ContrastCode


def information(levels, pixels):
    """Twice what these pixels say of the place, by the determinant."""
    spread = np.atleast_2d(np.cov(levels[:, pixels].T, bias=True))
    return np.linalg.slogdet(np.eye(len(pixels)) + spread / NOISE)[1]


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32),
    windows=st.integers(2, 40),
    listed=st.integers(1, 12),
    largest=st.sampled_from([3, 60, 5_000]),
)
def test_each_pixel_says_most_beyond_those_before_it(seed, windows, listed, largest):
    rng = np.random.default_rng(seed)
    common = rng.integers(0, largest + 1, (windows, 3))
    counts = common[:, rng.integers(0, 3, listed)] + rng.poisson(2.0, (windows, listed))
    counts = counts.astype(np.uint16)
    sensor = Sensor(listed, 1)
    pixel_map = PixelMap(sensor, np.arange(listed, dtype=np.uint16), np.zeros(listed, np.uint16))
    levels = ContrastCode().level(counts).astype(float)
    varying = int(np.count_nonzero(levels.std(axis=0)))
    if varying == 0:
        return
    chosen = informative_pixels(pixel_map, counts, min(varying, 5)).x.tolist()
    assert len(set(chosen)) == len(chosen)
    for n, pixel in enumerate(chosen):
        others = [p for p in range(listed) if p not in chosen[:n]]
        best = max(information(levels, [*chosen[:n], p]) for p in others)
        assert information(levels, [*chosen[:n], pixel]) == pytest.approx(best, abs=1e-6)


def test_a_copy_of_a_pixel_says_less_than_a_weaker_one_of_its_own():
    rng = np.random.default_rng(0)
    strong, weak = rng.integers(0, 200, 100), rng.integers(0, 20, 100)
    counts = np.stack([strong, strong, weak], axis=1).astype(np.uint8)
    three = PixelMap(Sensor(3, 1), np.arange(3, dtype=np.uint16), np.zeros(3, dtype=np.uint16))
    assert informative_pixels(three, counts, 2).x.tolist() == [0, 2]


def test_more_pixels_than_vary_are_refused():
    counts = np.array([[1, 5, 5], [2, 5, 5]], dtype=np.uint8)
    three = PixelMap(Sensor(3, 1), np.arange(3, dtype=np.uint16), np.zeros(3, dtype=np.uint16))
    with pytest.raises(UsageError, match="1 pixels vary and 2 were asked for"):
        informative_pixels(three, counts, 2)
    with pytest.raises(UsageError, match="3 pixels vary and 4 were asked for"):
        informative_pixels(three, counts, 4)


@pytest.mark.parametrize(("width", "height"), [(7, 5), (128, 128), (346, 260), (1280, 720)])
def test_the_shortlist_has_the_most_salient_pixel_of_every_cell(width, height):
    rng = np.random.default_rng(3)
    saliency = rng.random((height, width))
    exclude = rng.random((height, width)) < 0.1
    exclude.flat[saliency.argmax()] = True
    listed = shortlist(saliency, exclude)
    assert len(listed) <= module.MOST_PIXELS
    assert not exclude[listed.y, listed.x].any()
    side = next(
        side for side in range(1, 99)
        if -(-height // side) * -(-width // side) <= module.MOST_PIXELS
    )  # fmt: skip
    best: dict[tuple[int, int], float] = {}
    usable = np.where(exclude, 0.0, saliency)
    for y in range(height):
        for x in range(width):
            cell = y // side, x // side
            best[cell] = max(best.get(cell, 0.0), usable[y, x])
    kept = {
        (y // side, x // side): usable[y, x]
        for y, x in zip(listed.y.tolist(), listed.x.tolist(), strict=True)
    }
    assert kept == {cell: value for cell, value in best.items() if value > 0}


def test_a_map_has_them_and_needs_no_seed(monkeypatch):
    length_m = 15.0 if config.DISABLE_JIT else 80.0
    recording, _ = (drive.keep() for drive in simulate_pair(1, "tiny", length_m=length_m))
    chosen = PRESETS["default"].replaced({"strategy": "information", "pixels": 25}, "test")
    reference = ReferenceMap.build(recording, chosen)
    other = ReferenceMap.build(recording, chosen.replaced({"seed": 5}, "test"))
    assert reference.pixel_map == other.pixel_map
    assert len(reference.pixel_map) == 25
    assert not reference.hot[reference.pixel_map.y, reference.pixel_map.x].any()
    # where the images of all windows do not fit a temporary file, events are read again
    monkeypatch.setattr("edge_vpr.descriptors.pixels.PixelStatistics.descriptors", lambda *_: None)
    assert ReferenceMap.build(recording, chosen).pixel_map == reference.pixel_map
