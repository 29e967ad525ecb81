"""Windows and the descriptors they make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, FixedCount, FixedTime, collect
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, make_events
from tests import naive
from tests.streams import as_tuples, cut_up, random_events

SENSOR = Sensor(7, 5)
PIXELS = [(0, 0), (6, 4), (3, 2), (1, 0)]
PIXEL_MAP = PixelMap(SENSOR, *np.array(PIXELS, dtype=np.uint16).T)


def descriptors(stream, chunks):
    parts = [stream.update(chunk) for chunk in chunks]
    parts = [replace(part, unseen=unseen_of(part)).to_arrays() for part in parts]
    return Descriptors(
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    )


def unseen_of(windows):
    """The halves of each window, also where there are none."""
    return np.zeros(len(windows), dtype=np.int64) if windows.unseen is None else windows.unseen


@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 300),
    duration=st.sampled_from([1, 50, 1_000, 10_000]),
    window=st.one_of(
        st.builds(FixedTime, st.integers(1, 400)).filter(lambda w: w.tau_us > 3),
        st.builds(FixedCount, st.integers(1, 30)),
    ),
    pieces=st.integers(1, 9),
)
def test_descriptors_equal_the_oracle_however_the_stream_is_cut(seed, n, duration, window, pieces):
    rng = np.random.default_rng(seed)
    events = random_events(rng, n, SENSOR, duration)
    stream = DescriptorStream(PIXEL_MAP, window)
    described = descriptors(stream, cut_up(rng, events, pieces))

    if isinstance(window, FixedTime):
        expected = naive.fixed_time_windows(as_tuples(events), window.tau_us)
        assert described.start_us.tolist() == [k * window.tau_us for k in range(len(expected))]
        assert described.end_us.tolist() == [(k + 1) * window.tau_us for k in range(len(expected))]
        times, tau = events["t"].tolist(), window.tau_us
        last = times[-1] if times else 0
        unseen = naive.unseen_halves(times, tau, last // tau + 1, last)
        assert described.unseen.tolist() == unseen[: len(expected)]
    else:
        expected = naive.fixed_count_windows(as_tuples(events), PIXELS, window.events)
        assert described.start_us.tolist() == [w[0][0] for w in expected]
        assert described.end_us.tolist() == [w[-1][0] for w in expected]
        assert all(row.sum() == window.events for row in described.counts)
    assert described.counts.tolist() == [naive.count(w, PIXELS) for w in expected]
    assert described.events.tolist() == [len(w) for w in expected]
    # nothing is lost: what the windows do not hold is the incomplete one
    rest = stream.finish()
    assert described.events.sum() + rest.events.sum() == n


def test_an_event_on_the_boundary_belongs_to_the_window_that_starts_there():
    events = make_events(t=[9, 10], x=[0, 0], y=[0, 0])
    stream = DescriptorStream(PIXEL_MAP, FixedTime(10))
    assert stream.update(events).counts[:, 0].tolist() == [1]
    assert stream.finish().counts[:, 0].tolist() == [1]


def test_windows_without_events_are_descriptors_of_zeros():
    events = make_events(t=[0, 45], x=[0, 0], y=[0, 0])
    described = DescriptorStream(PIXEL_MAP, FixedTime(10)).update(events)
    assert described.counts[:, 0].tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(
    ("largest", "dtype"), [(255, np.uint8), (256, np.uint16), (65_536, np.uint32)]
)
def test_counts_are_stored_in_the_narrowest_dtype_that_holds_them(largest, dtype):
    t = np.append(np.zeros(largest, dtype=np.int64), 10)
    events = make_events(t, np.zeros(t.size), np.zeros(t.size))
    described = DescriptorStream(PIXEL_MAP, FixedTime(10)).update(events)
    assert described.counts.dtype == dtype
    assert described.counts[0, 0] == largest


def test_a_clock_that_jumps_by_years_is_an_error_and_not_a_flood_of_windows():
    events = make_events(t=[0, 2**60], x=[0, 0], y=[0, 0])
    with pytest.raises(UsageError, match=r"time_unit= of open_recording. and its clock"):
        DescriptorStream(PIXEL_MAP, FixedTime(1)).update(events)


def test_no_windows_make_an_empty_set_of_descriptors():
    assert collect([], 4).counts.shape == (0, 4)


@pytest.mark.parametrize("window", [FixedTime, FixedCount])
@pytest.mark.parametrize("length", [0, -1, 2**63, 10**30])
def test_a_window_has_a_length_that_fits_the_kernels(window, length):
    with pytest.raises(UsageError, match="expected 1"):
        window(length)
