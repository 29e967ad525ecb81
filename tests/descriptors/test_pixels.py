"""The draw of pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.pixels import REJECTION_RADIUS, PixelMap, select_pixels
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.settings import STRATEGIES
from tests import naive


def pairs(pixel_map):
    return list(zip(pixel_map.x.tolist(), pixel_map.y.tolist(), strict=True))


class Replay:
    """A generator that gives known numbers, so that the oracle sees the same draws."""

    def __init__(self, draws):
        self._draws = iter(draws)

    def random(self):
        return next(self._draws)


@given(
    seed=st.integers(0, 2**32),
    width=st.integers(1, 12),
    height=st.integers(1, 9),
    sigma=st.sampled_from([0.5, 2.0, 7.0]),
    data=st.data(),
)
def test_varying_pixels_equal_the_oracle_to_the_bit(seed, width, height, sigma, data):
    rng = np.random.default_rng(seed)
    saliency = rng.random((height, width)) * rng.integers(0, 2, (height, width))
    saliency[rng.integers(height), rng.integers(width)] = 1.0
    pixels = data.draw(st.integers(1, int(np.count_nonzero(saliency))))
    draws = rng.random(pixels).tolist()
    selected = select_pixels(saliency, pixels, sigma=sigma, rng=Replay(draws))
    assert pairs(selected) == naive.select_pixels(saliency.tolist(), pixels, sigma, draws)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_seed_makes_each_strategy_reproducible_and_no_pixel_comes_twice(strategy):
    saliency = np.random.default_rng(1).random((40, 50))
    first, second = (
        select_pixels(saliency, 20, strategy=strategy, rng=np.random.default_rng(7))
        for _ in range(2)
    )
    assert first == second
    assert len(set(pairs(first))) == 20


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_excluded_pixels_are_never_chosen(strategy):
    saliency = np.ones((30, 30))
    exclude = np.ones((30, 30), dtype=bool)
    exclude[5:25, 5:12] = False
    selected = select_pixels(
        saliency, 3, strategy=strategy, rng=np.random.default_rng(0), exclude=exclude
    )
    assert not exclude[selected.y, selected.x].any()


def test_top_takes_the_most_salient_and_the_first_of_equals():
    saliency = np.array([[1.0, 3.0, 2.0], [3.0, 0.0, 2.0]])
    selected = select_pixels(saliency, 3, strategy="top", rng=np.random.default_rng(0))
    assert pairs(selected) == [(1, 0), (0, 1), (2, 0)]


def test_random_upper_leaves_the_bottom_third_of_the_rows_out():
    selected = select_pixels(
        np.zeros((9, 9)), 54, strategy="random-upper", sigma=0, rng=np.random.default_rng(0)
    )
    assert sorted(pairs(selected)) == sorted((x, y) for x in range(9) for y in range(6))


def test_pixels_of_the_released_code_keep_their_distance_and_outliers_weigh_a_hundredth():
    saliency = np.full((60, 60), 100.0)
    saliency[30, 30] = 1e6  # above mean + 2 std: made 0.01 of 100, so practically never drawn
    selected = select_pixels(saliency, 25, strategy="seed-code", rng=np.random.default_rng(3))
    points = np.array(pairs(selected))
    apart = np.hypot(*(points[:, None] - points[None, :]).transpose(2, 0, 1))
    assert apart[np.triu_indices(25, 1)].min() > REJECTION_RADIUS
    assert (30, 30) not in pairs(selected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pixels": 5}, "only 4 of 16 pixels can be drawn and 5 were asked for"),
        ({"pixels": 0}, "ask for at least 1"),
        ({"sigma": -1.0}, "expected 0 or more"),
        ({"strategy": "best"}, "choose from variance, seed-code, random, random-upper, top"),
    ],
)
def test_what_cannot_be_drawn_is_an_error_that_says_what_to_do(arguments, message):
    saliency = np.zeros((4, 4))
    saliency[0] = 1.0
    with pytest.raises(UsageError, match=message):
        select_pixels(saliency, **({"pixels": 2, "rng": np.random.default_rng(0)} | arguments))


def test_surrounds_that_cover_the_sensor_are_an_error():
    with pytest.raises(UsageError, match="only 1 pixels can be drawn before the surrounds cover"):
        select_pixels(np.ones((5, 5)), 3, strategy="seed-code", rng=np.random.default_rng(0))


@pytest.mark.parametrize("bad", [np.array([[np.nan, 1.0]]), np.array([[-1.0, 1.0]])])
def test_a_saliency_that_is_no_saliency_is_refused(bad):
    with pytest.raises(UsageError, match="negative or non-finite"):
        select_pixels(bad, 1, rng=np.random.default_rng(0))


def test_the_table_gives_each_selected_pixel_its_slot_and_the_others_none():
    pixel_map = PixelMap(Sensor(3, 2), np.array([2, 0]), np.array([1, 0]))
    assert pixel_map.table().tolist() == [[1, -1, -1], [-1, -1, 0]]
    assert pixel_map.table().dtype == np.int16


def test_all_pixels_of_a_large_sensor_need_a_wide_table():
    table = PixelMap.all_of(Sensor(346, 260)).table()
    assert table.dtype == np.int32
    assert np.array_equal(table, np.arange(89_960).reshape(260, 346))


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [([3], [0], "off the 3x2 sensor"), ([0, 0], [1, 1], "twice"), ([], [], "give J of each")],
)
def test_a_pixel_map_is_checked(x, y, message):
    with pytest.raises(UsageError, match=message):
        PixelMap(Sensor(3, 2), np.array(x, dtype=int), np.array(y, dtype=int))


@pytest.mark.parametrize("sensor", [(0, 5), (65_537, 1), (-6, 5), (6.0, 5), (True, 5), (2**40, 2)])
def test_a_sensor_has_sides_of_1_to_65536(sensor):
    with pytest.raises(UsageError, match="no number from 1 to 65536"):
        PixelMap(Sensor(*sensor), np.array([0]), np.array([0]))
