"""Pixels chosen by what they say of the place: held to determinants."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lab.informative_pixels import MOST_PIXELS, NOISE, informative_pixels, shortlist

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from fixedpoint.own_mean import ContrastCode


def information(levels, pixels):
    """Twice what these pixels say of the place, by the determinant."""
    spread = np.atleast_2d(np.cov(levels[:, pixels].T, bias=True))
    return np.linalg.slogdet(np.eye(len(pixels)) + spread / NOISE)[1]


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
    pixel_map = PixelMap(Sensor(listed, 1), np.arange(listed), np.zeros(listed, np.uint16))
    levels = ContrastCode().level(counts).astype(float)
    varying = int(np.count_nonzero(levels.std(axis=0)))
    chosen = informative_pixels(pixel_map, counts, min(varying, 5)).x.tolist() if varying else []
    assert len(set(chosen)) == len(chosen)
    for n, pixel in enumerate(chosen):
        others = [p for p in range(listed) if p not in chosen[:n]]
        best = max(information(levels, [*chosen[:n], p]) for p in others)
        assert information(levels, [*chosen[:n], pixel]) == pytest.approx(best, abs=1e-6)
    with pytest.raises(UsageError, match="pixels vary and 13 were asked for"):
        informative_pixels(pixel_map, counts, 13)


@pytest.mark.parametrize(("width", "height"), [(7, 5), (346, 260)])
def test_the_shortlist_has_the_most_salient_pixel_of_every_cell(width, height):
    saliency = np.random.default_rng(3).random((height, width))
    saliency[saliency < 0.1] = 0
    listed = shortlist(saliency)
    assert len(listed) <= MOST_PIXELS
    side = next(s for s in range(1, 99) if -(-height // s) * -(-width // s) <= MOST_PIXELS)
    best = {
        (y, x): saliency[y : y + side, x : x + side].max()
        for y in range(0, height, side)
        for x in range(0, width, side)
    }
    kept = {
        (y // side * side, x // side * side): saliency[y, x]
        for y, x in zip(listed.y.tolist(), listed.x.tolist(), strict=True)
    }
    assert kept == {cell: value for cell, value in best.items() if value > 0}
