"""Hot pixels and bursts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.cleaning import (
    BURST_SHARE,
    BURST_SLOT_US,
    HOT_FACTOR,
    BurstFilter,
    find_hot_pixels,
    load_hot_pixels,
)
from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor, join_events, make_events
from tests import naive
from tests.streams import as_tuples, cut_up, random_events, split_events

SENSOR = Sensor(4, 3)


@given(seed=st.integers(0, 2**32), shape=st.tuples(st.integers(1, 9), st.integers(1, 9)))
def test_hot_pixels_equal_the_oracle(seed, shape):
    rng = np.random.default_rng(seed)
    totals = rng.integers(0, 20, shape) * rng.choice([1, 1, 1, 40], shape)
    hot = find_hot_pixels(totals)
    expected = naive.hot_pixels(totals.tolist(), HOT_FACTOR)
    assert {(int(x), int(y)) for y, x in zip(*np.nonzero(hot), strict=True)} == set(expected)


def test_a_pixel_far_above_its_neighbours_is_hot_and_a_busy_region_is_not():
    totals = np.full((20, 20), 10)
    totals[:, 10:] = 1000
    totals[5, 5] = 5000
    assert np.argwhere(find_hot_pixels(totals)).tolist() == [[5, 5]]


@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 200),
    slots=st.integers(1, 60),
    pieces=st.integers(1, 300),
)
def test_bursts_equal_the_oracle_however_the_stream_is_cut(seed, n, slots, pieces):
    rng = np.random.default_rng(seed)
    events = random_events(rng, n, SENSOR, slots * BURST_SLOT_US)
    filter_ = BurstFilter(SENSOR)
    chunks = [filter_.update(chunk) for chunk in cut_up(rng, events, pieces)]
    kept = np.concatenate([*chunks, filter_.finish()])
    expected = naive.without_bursts(as_tuples(events), BURST_SLOT_US, SENSOR.pixels, BURST_SHARE)
    assert as_tuples(kept) == expected
    assert filter_.removed == n - len(expected)


@given(seed=st.integers(0, 2**32), n=st.integers(1, 80), slots=st.integers(1, 60))
def test_time_that_passes_lets_events_out_earlier_and_changes_none(seed, n, slots):
    rng = np.random.default_rng(seed)
    events = random_events(rng, n, SENSOR, slots * BURST_SLOT_US)
    filter_ = BurstFilter(SENSOR)
    parts = []
    for event in split_events(events, n):
        complete_us = filter_.complete_us
        now = int(event["t"][0])
        parts.append(filter_.advance(now))
        parts.append(filter_.update(event))
        assert all(part.size == 0 or part["t"][0] >= complete_us for part in parts[-2:])
        parts.append(filter_.advance(now))
    late = int(events["t"][-1]) // BURST_SLOT_US * BURST_SLOT_US + 2 * BURST_SLOT_US
    parts.append(filter_.advance(late - 1))
    assert parts[-1].size == 0
    parts.append(filter_.advance(late))
    assert filter_.finish().size == 0
    expected = naive.without_bursts(as_tuples(events), BURST_SLOT_US, SENSOR.pixels, BURST_SHARE)
    assert as_tuples(join_events(parts)) == expected


@pytest.mark.parametrize("pieces", [[], [12], [12, 13], range(1, 15)])
def test_a_burst_goes_also_if_events_of_two_later_slots_come_one_by_one(pieces):
    """It passed if the event after it was in no neighbouring slot."""
    y, x = np.divmod(np.arange(12), 4)
    burst = make_events(t=1_000 + 2 * np.arange(12), x=x, y=y)
    later = make_events(t=[11_000, 13_000, 15_000], x=[0, 0, 0], y=[0, 0, 0])
    filter_ = BurstFilter(SENSOR)
    parts = [
        filter_.update(part) for part in split_events(join_events([burst, later]), pieces or 1)
    ]
    assert join_events([*parts, filter_.finish()])["t"].tolist() == later["t"].tolist()
    assert filter_.removed == 12


def test_a_list_of_hot_pixels_is_read_as_the_data_set_writes_it(tmp_path):
    path = tmp_path / "hot.csv"
    path.write_text("# x, y\n1, 2\n\n3,0\n")
    assert np.argwhere(load_hot_pixels(path, SENSOR)).tolist() == [[0, 3], [2, 1]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("9, 0", r"line 1 .* the pixel \(9, 0\), off the 4x3"),
        ("1e300, 0", "off the 4x3"),
        ("x,y\n9,9", "line 2 .* off the 4x3"),
        ("1, 2\n1", "line 2 .* expected the"),
        ("1, 2\n1, 2, 3", "line 2 .* expected the"),
        ("1.0, 2\n1.5, 2", "line 2 .* expected the"),
        ("1, 2\ninf, 2", "line 2 .* expected the"),
        ("1, 2\nnan, 2", "line 2 .* expected the"),
    ],
)
def test_a_wrong_list_of_hot_pixels_names_its_line(tmp_path, text, message):
    path = tmp_path / "hot.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        load_hot_pixels(path, SENSOR)


def test_a_missing_list_of_hot_pixels_is_an_error(tmp_path):
    with pytest.raises(RecordingError, match="cannot read the list of hot pixels"):
        load_hot_pixels(tmp_path / "none.csv", SENSOR)


def test_the_published_lists_of_hot_pixels_can_be_read(shared_data):
    for name in ("sunset1", "sunset2"):
        path = shared_data / "brisbane_sparse49" / f"{name}_hot_pixels.csv"
        lines = [line for line in path.read_text().splitlines() if line.strip()]
        assert load_hot_pixels(path, Sensor(346, 260)).sum() == len(set(lines))
