"""Counting equals the oracle for any chunking and layout, and reaches no memory but its tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.counting import _BLOCK, count_events, count_frame, count_until
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import Sensor, make_events
from tests import naive
from tests.streams import as_tuples, cut_up, random_events

SEEDS = st.integers(0, 2**32)


def random_table(rng, sensor: Sensor, J: int, dtype=np.int16):
    """Table of J different pixels, and the pixels in the order of their slots."""
    flat = rng.choice(sensor.pixels, J, replace=False)
    table = np.full((sensor.height, sensor.width), -1, dtype=dtype)
    table.flat[flat] = np.arange(J)
    return table, [(int(i) % sensor.width, int(i) // sensor.width) for i in flat]


@pytest.mark.slow
@given(
    seed=SEEDS,
    n=st.integers(0, 400),
    J=st.integers(1, 35),
    dtype=st.sampled_from([np.int16, np.int32]),
    counter=st.sampled_from([np.int32, np.int64]),
    pieces=st.integers(1, 9),
)
def test_counts_equal_the_oracle_however_the_stream_is_cut(seed, n, J, dtype, counter, pieces):
    rng = np.random.default_rng(seed)
    sensor = Sensor(7, 5)
    table, pixels = random_table(rng, sensor, J, dtype)
    events = random_events(rng, n, sensor, 1000)
    counts = np.zeros(J, dtype=counter)
    counted = 0
    for chunk in cut_up(rng, events, pieces):
        counted += count_events(table, chunk.x, chunk.y, counts)
    assert counts.tolist() == naive.count(as_tuples(events), pixels)
    assert counted == counts.sum()


@pytest.mark.parametrize("n", [_BLOCK - 1, _BLOCK, 2 * _BLOCK + 17])
def test_counts_equal_the_oracle_across_blocks(n):
    """The kernel works through blocks and groups; their ends lose no event and double none."""
    rng = np.random.default_rng(n)
    sensor = Sensor(40, 30)
    table, pixels = random_table(rng, sensor, 25)
    events = random_events(rng, n, sensor, 1000)
    counts = np.zeros(25, dtype=np.int32)
    count_events(table, events.x, events.y, counts)
    assert counts.tolist() == naive.count(as_tuples(events), pixels)


@given(seed=SEEDS, n=st.integers(0, 300), budget=st.integers(1, 40))
def test_a_budget_ends_the_count_right_after_the_event_that_spends_it(seed, n, budget):
    rng = np.random.default_rng(seed)
    sensor = Sensor(7, 5)
    table, pixels = random_table(rng, sensor, 6)
    events = random_events(rng, n, sensor, 1000)
    counts = np.zeros(6, dtype=np.int32)
    consumed, counted = count_until(table, events.x, events.y, counts, budget)

    tuples = as_tuples(events)
    selected = [i for i, event in enumerate(tuples) if event[1:3] in pixels]
    if len(selected) < budget:
        assert (consumed, counted) == (n, len(selected))
    else:
        assert (consumed, counted) == (selected[budget - 1] + 1, budget)
    assert counts.tolist() == naive.count(tuples[:consumed], pixels)


def test_a_budget_is_found_in_a_later_block():
    """Position `consumed` counts from the chunk's start, not from the block's."""
    n = _BLOCK + 100
    x = np.zeros(n, dtype=np.uint16)
    x[[10, _BLOCK + 50, _BLOCK + 60]] = 3
    table = np.array([[-1, -1, -1, 0]], dtype=np.int16)
    counts = np.zeros(1, dtype=np.int32)
    assert count_until(table, x, np.zeros_like(x), counts, 2) == (_BLOCK + 51, 2)
    assert counts.tolist() == [2]


@given(seed=SEEDS, n=st.integers(0, 300), pieces=st.integers(1, 5))
def test_a_count_image_holds_every_event(seed, n, pieces):
    rng = np.random.default_rng(seed)
    sensor = Sensor(6, 4)
    events = random_events(rng, n, sensor, 1000)
    frame = np.zeros((4, 6), dtype=np.int32)
    for chunk in cut_up(rng, events, pieces):
        count_frame(chunk.x, chunk.y, frame)
    pixels = [(x, y) for y in range(4) for x in range(6)]
    assert frame.reshape(-1).tolist() == naive.count(as_tuples(events), pixels)


@pytest.mark.parametrize("pixel", [(7, 0), (0, 5), (65535, 65535), (8, 4)])
@pytest.mark.parametrize("position", [0, 15, 16, 399, _BLOCK, 2 * _BLOCK + 4])
def test_an_event_off_the_sensor_is_an_error_and_not_another_pixel(pixel, position):
    """(8, 4) would be another pixel's address in a flat table, and is refused all the same."""
    n = 2 * _BLOCK + 5
    events = make_events(np.arange(n), np.zeros(n), np.zeros(n))
    events["x"][position], events.y[position] = pixel
    x, y = events.x, events.y
    table = np.full((5, 7), -1, dtype=np.int16)
    with pytest.raises(EventError, match="lies off the 7x5 sensor"):
        count_events(table, x, y, np.zeros(1, dtype=np.int32))
    with pytest.raises(EventError, match="lies off the 7x5 sensor"):
        count_frame(x, y, np.zeros((5, 7), dtype=np.int32))


def test_a_slot_without_a_counter_is_an_error_and_not_a_stray_write():
    table = np.array([[0, 3]], dtype=np.int16)
    x, y = np.array([0, 1], dtype=np.uint16), np.zeros(2, dtype=np.uint16)
    memory = np.zeros(8, dtype=np.int32)
    with pytest.raises(UsageError, match="names slot 3"):
        count_events(table, x, y, memory[:3])
    assert memory.tolist() == [1, 0, 0, 0, 0, 0, 0, 0]


X = np.zeros(3, dtype=np.uint16)
TABLE = np.zeros((2, 2), dtype=np.int16)
COUNTS = np.zeros(2, dtype=np.int32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((TABLE.astype(np.int64), X, X, COUNTS), "table is int64"),
        ((TABLE[0], X, X, COUNTS), "table is int16 of shape"),
        ((TABLE[:, ::-1], X, X, COUNTS), "give a contiguous"),
        ((TABLE[:0], X, X, COUNTS), "give a contiguous"),
        ((TABLE, X.astype(np.int64), X, COUNTS), "column x is int64"),
        ((TABLE, X, X.astype(np.int16), COUNTS), "column y is int16"),
        ((TABLE, X, X[:2], COUNTS), "one value per event"),
        ((TABLE, X[:, None], X[:, None], COUNTS), "one value per event"),
        ((TABLE, X, X, COUNTS.astype(np.uint8)), "counters are uint8"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(UsageError, match=message):
        count_events(*arguments)
