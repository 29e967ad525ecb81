"""Codes that no profile has: tables held to their definition in exact arithmetic, and own means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from lab.codes import OwnMean, TableCode, _logarithm, usual_scales

from edge_vpr.descriptors.activity import activity_of_drive, find_pauses, mean_of_query
from edge_vpr.descriptors.codes import counted_events, limits_of
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.events import Sensor
from edge_vpr.settings import PRESETS
from fixedpoint.own_mean import ContrastCode
from tests import naive
from tests.descriptors.test_own_mean import drive_codes
from tests.filter_oracle import level_of
from tests.streams import descriptors, map_of_counts

KINDS = ("linear", "sqrt", "log")
kinds = st.sampled_from(KINDS)


def map_of(counts):
    """A map of counts, one row a place."""
    pixels = np.arange(counts.shape[1], dtype=np.uint16)
    pixel_map = PixelMap(Sensor(len(pixels), 1), pixels, 0 * pixels)
    chosen = PRESETS["paper"].replaced({"pixels": len(pixels), "tau_us": 1_000}, "test")
    return map_of_counts(pixel_map, counts, chosen)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bits", [1, 2, 3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize("full", [1, 2, 3, 7, 15, 63, 100, 127, 255])
def test_every_entry_of_every_small_table_is_the_nearest_code(kind, bits, full):
    expected = [naive.counter_code(kind, bits, full, count) for count in range(full + 1)]
    assert TableCode(kind, bits).table(full).tolist() == expected


def test_ties_of_logarithms_are_decided_in_integers():
    """log 3 is half of log 9, to the last bit: (1 + 2)**2 = 1 + 8, so that code 1/2 becomes 1."""
    assert TableCode("log", 1).table(8).tolist() == [0, 0, 1, 1, 1, 1, 1, 1, 1]
    # 2**k counts lie at the ends of half-open intervals all along the table
    ends = 2 ** np.arange(9) - 1
    assert _logarithm(ends, 4, 255).tolist() == [0, 1, 1, 2, 2, 3, 3, 4, 4]


def test_the_widest_logarithm_is_built_and_is_exact_where_doubles_are_closest():
    table = TableCode("log", 16).table(65_535)
    assert (np.diff(table) >= 0).all()
    assert (table[0], table[-1]) == (0, 65_535)
    exact = 65_535 * np.log1p(np.arange(65_536)) / math.log(65_536)
    assert (np.abs(table - exact) <= 0.5 + 1e-6).all()


@example(seed=21, kind="linear", bits=9, counters=1, per_pixel=False)  # a scale beyond 8-bit counts
@given(
    seed=st.integers(0, 2**32),
    kind=kinds,
    bits=st.integers(1, 9),
    counters=st.integers(1, 6),
    per_pixel=st.booleans(),
)
def test_places_and_query_have_the_codes_of_their_counts(seed, kind, bits, counters, per_pixel):
    rng = np.random.default_rng(seed)
    places, query = rng.integers(0, rng.choice([3, 300, 2_000]), (2, 5, counters))
    reference, code = map_of(places), TableCode(kind, bits, per_pixel)
    scale = {"linear": 2**bits - 1, "sqrt": 63, "log": 127}[kind]
    scales = [
        naive.usual_full_scale(column) if per_pixel else scale for column in places.T.tolist()
    ]
    coded = code.coded(reference, descriptors(query))
    for windows, counts in zip(coded, (places, query), strict=True):
        assert windows.counts.T.tolist() == [
            [naive.counter_code(kind, bits, full, count) for count in column]
            for full, column in zip(scales, counts.T.tolist(), strict=True)
        ]
        assert windows.selected_events.tolist() == counts.sum(axis=1).tolist()
    # counts in the middle of a code have this code
    blurred = code.blurred(reference)
    assert blurred.places.selected_events.tolist() == places.sum(axis=1).tolist()
    if not per_pixel:
        again, _ = code.coded(blurred, descriptors(query))
        assert np.array_equal(again.counts, coded[0].counts)


@given(st.lists(st.integers(0, 2**18), min_size=1, max_size=40))
def test_a_usual_scale_holds_nine_of_ten_counts_and_no_smaller_one_does(counts):
    (scale,) = usual_scales(np.array(counts)[:, None]).tolist()
    assert scale == naive.usual_full_scale(counts)


@given(seed=st.integers(0, 2**32), windows=st.integers(1, 20))
def test_own_means_are_those_of_each_drive_where_it_moves(seed, windows):
    rng = np.random.default_rng(seed)
    both = rng.integers(0, 300, (2, windows, 4)) * (rng.random((2, windows, 1)) > 0.2)
    limits = limits_of(both[0])
    events = [counted_events(counts, limits) for counts in both]
    activity = activity_of_drive(events[0])
    coded = OwnMean().coded(map_of(both[0]), descriptors(both[1]))
    for windows_of, counts, counted in zip(coded, both, events, strict=True):
        assert windows_of.counted_events.tolist() == counted.tolist()
        assert windows_of.selected_events.tolist() == counts.sum(axis=1).tolist()
        paused = find_pauses(counted, mean_of_query(counted, activity)).tolist()
        levels = [[level_of(c) for c in row] for row in counts.tolist()]
        assert windows_of.counts.tolist() == drive_codes(levels, paused, contrast=False)


def test_other_light_moves_the_mean_and_not_the_codes_and_another_speed_does():
    rng = np.random.default_rng(0)
    bright = rng.integers(32, 256, (50, 5)) * 4 - 1  # log2(1 + c) falls by exactly 2 in dim light
    dim = (bright + 1) // 4 - 1
    code = OwnMean()
    codes = [code.encode(c, code.mean(c)) for c in (bright, dim)]
    assert np.count_nonzero(codes[0] != codes[1]) <= 2  # one unit of 1/256 may round otherwise
    mean = code.mean(bright)
    assert not np.array_equal(*(code.encode(c, mean) for c in (bright, dim)))
    assert np.array_equal(*(ContrastCode().encode(c, mean) for c in (bright, dim)))
