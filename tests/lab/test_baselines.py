"""Baselines behind one interface, each against plain Python; and matches of a matrix."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from lab.baselines import baseline_names, compare, match_distances, open_baseline

from edge_vpr.errors import MissingExtraError, UsageError
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.settings import PRESETS
from tests import naive
from tests.streams import descriptors

SETTINGS = PRESETS["paper"].replaced({"sequence_length": 3}, "test")
BUILT_IN = [
    *("paper", "seed-code", "all-pixels", "patch-normalised", "active-pixels"),
    *("hog", "patch-normalised@1,2,4", "all-pixels+hog"),
]


def places_of(rng, n=12):
    """Images of places, each with a pattern of its own."""
    rough = rng.gamma(0.6, 6.0, (n, 32, 32))
    return rng.poisson(rough.repeat(4, axis=1).repeat(4, axis=2)).astype(np.uint16)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_baseline_finds_places_that_it_saw(name):
    rng = np.random.default_rng(1)
    reference = places_of(rng)
    queries = rng.binomial(reference, 0.9).astype(np.uint16)
    compared = compare(open_baseline(name, 3), reference, queries)
    matches = match_distances(compared.distances, np.arange(12), SETTINGS)
    assert np.array_equal(matches.place, matches.query)
    assert compared.bytes_per_place > 0 and compared.operations > 0
    assert compared.query_us > 0


def test_all_baselines_are_named_and_an_unknown_one_is_refused():
    assert set(baseline_names()) >= set(BUILT_IN[:6])
    with pytest.raises(UsageError, match=r"'netvlad' is unknown: choose one of paper, seed-code"):
        open_baseline("netvlad")


def test_hog_without_its_library_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.feature", None)
    with pytest.raises(MissingExtraError, match=r"baseline hog.*scikit-image.*lab"):
        open_baseline("hog")


def test_absolute_differences_and_selected_pixels_are_the_oracles():
    rng = np.random.default_rng(2)
    images = places_of(rng, 6)
    for name, count, clip in (("all-pixels", 128 * 128, None), ("seed-code", 100, 10)):
        baseline = open_baseline(name, 5)
        baseline.prepare(images)
        places = baseline.describe(images)
        assert places.shape == (6, count) and (clip is None or places.max() <= clip)
        rows = places.tolist()
        expected = [[naive.sad(a, b) for b in rows] for a in rows]
        assert baseline.distances(places, places).tolist() == expected
        assert baseline.bits_per_place(places) == 8 * count
    with pytest.raises(UsageError, match="prepare with the reference first"):
        open_baseline("paper").describe(images)


def test_active_pixels_are_the_cosine_of_sets():
    rng = np.random.default_rng(3)
    images = rng.integers(0, 2, (5, 9, 7))
    images[4] = 0
    baseline = open_baseline("active-pixels")
    places = baseline.describe(images)
    sets = [set(np.flatnonzero(image.ravel()).tolist()) for image in images]
    for i, row in enumerate(baseline.distances(places, places)):
        for j, value in enumerate(row):
            both = len(sets[i]) * len(sets[j])
            like = len(sets[i] & sets[j]) / math.sqrt(both) if both else 0.0
            assert value == max(1 - like, 0)
    assert baseline.bits_per_place(places) == 64  # 63 pixels, in whole bytes
    assert baseline.operations_per_place(places) == 1


def test_patches_are_normalised_each_by_itself():
    """More light on one patch changes nothing; on a small sensor pixels repeat."""
    rng = np.random.default_rng(4)
    image = rng.integers(0, 9, (1, 64, 64))
    brighter = image.copy()
    brighter[:, :16, :16] = 3 * brighter[:, :16, :16] + 5
    baseline = open_baseline("patch-normalised")
    a, b = baseline.describe(image), baseline.describe(brighter)
    assert a.shape == (1, 1024) and np.array_equal(a, b) and a.std() > 20
    cells = image[0].reshape(32, 2, 32, 2).mean(axis=(1, 3))
    patch = cells[8:16, 24:32]
    expected = np.clip(np.rint(128 + 32 * (patch - patch.mean()) / patch.std()), 0, 255)
    assert np.array_equal(a.reshape(32, 32)[8:16, 24:32], expected)
    assert (baseline.describe(np.ones((2, 5, 3), np.uint16)) == 128).all()


def test_matches_of_a_matrix_are_those_of_the_descriptors():
    rng = np.random.default_rng(5)
    places, queries = (descriptors(rng.integers(0, 30, (n, 8))) for n in (15, 12))
    expected = match_descriptors(places, queries, SETTINGS)
    matrix = np.array(
        [[naive.sad(a, b) for b in queries.counts.tolist()] for a in places.counts.tolist()], float
    )
    matches = match_distances(matrix, queries.centre_us, SETTINGS)
    for name in ("query", "time_us", "place", "second", "ties", "candidates"):
        assert np.array_equal(getattr(matches, name), getattr(expected, name)), name
    assert matches.ratio == pytest.approx(expected.ratio, abs=1e-6)
