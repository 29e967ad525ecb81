"""Descriptors of windows that slide."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from streams import as_tuples, cut_up, random_events
from test_windows import PIXEL_MAP, PIXELS, SENSOR

from edge_vpr.descriptors.windows import DescriptorStream, FixedCount, FixedTime, join
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import make_events
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_window import SlidingWindow

WINDOWS = st.one_of(
    st.builds(FixedTime, st.sampled_from([7, 40, 500])),
    st.builds(FixedCount, st.integers(1, 30)),
)


@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 200),
    window=WINDOWS,
    polarity=st.booleans(),
    pieces=st.integers(1, 7),
)
def test_after_every_event_the_window_is_what_the_oracle_counts(seed, n, window, polarity, pieces):
    rng = np.random.default_rng(seed)
    events = random_events(rng, n, SENSOR, 2_000)
    sliding = SlidingWindow(PIXEL_MAP, window, every=MatchSchedule(events=1), polarity=polarity)
    found = join([sliding.update(chunk) for chunk in cut_up(rng, events, pieces)])

    slot_of = {pixel: slot for slot, pixel in enumerate(PIXELS)}
    tau = window.tau_us if isinstance(window, FixedTime) else 0
    size = 0 if tau else window.events
    selected, expected = [], []
    for t, x, y, p in as_tuples(events):
        if (x, y) in slot_of:
            off = len(PIXELS) if polarity and not p else 0
            selected.append((t, slot_of[x, y] + off))
            if (t + 1 >= tau) if tau else (len(selected) >= size):
                counters = len(PIXELS) * (2 if polarity else 1)
                counts = naive.lagged_counts(selected, t + 1, 1, counters, tau, size)[0]
                expected.append((counts, t + 1 if tau else t))
    assert found.counts.tolist() == [counts for counts, _ in expected]
    assert found.end_us.tolist() == [end for _, end in expected]
    assert found.events.tolist() == [sum(counts) for counts, _ in expected]


@given(seed=st.integers(0, 2**32), window=WINDOWS, pieces=st.integers(1, 7))
def test_one_descriptor_a_window_gives_the_windows_of_the_main_job(seed, window, pieces):
    rng = np.random.default_rng(seed)
    events = random_events(rng, 200, SENSOR, 2_000)
    if isinstance(window, FixedTime):
        every = MatchSchedule(interval_us=window.tau_us)
    else:
        every = MatchSchedule(events=window.events)
    sliding = SlidingWindow(PIXEL_MAP, window, every=every)
    found = join([sliding.update(chunk) for chunk in cut_up(rng, events, pieces)])
    apart = DescriptorStream(PIXEL_MAP, window).update(events)
    assert found.counts.tolist() == apart.counts.tolist()
    assert found.end_us.tolist() == apart.end_us.tolist()


def test_a_window_may_hold_more_events_than_the_ring_begins_with():
    events = make_events(np.arange(10_000), np.zeros(10_000), np.zeros(10_000))
    sliding = SlidingWindow(PIXEL_MAP, FixedTime(9_000), every=MatchSchedule(interval_us=9_500))
    assert sliding.update(events).counts[:, 0].tolist() == [9_000]
    assert sliding.counts[0] == 9_000


def test_time_that_runs_backwards_is_refused_and_changes_nothing():
    sliding = SlidingWindow(PIXEL_MAP, FixedTime(10), every=MatchSchedule(events=1))
    sliding.update(make_events([5], [0], [0]))
    with pytest.raises(EventError, match="backwards"):
        sliding.update(make_events([3], [0], [0]))
    assert sliding.counts[0] == 1


def test_descriptors_name_no_place_so_that_a_change_of_it_is_wrong_use():
    with pytest.raises(UsageError, match="leave change out"):
        SlidingWindow(PIXEL_MAP, FixedTime(9_000), every=MatchSchedule(events=1, change=True))
