"""One call of compiled code an event: the same matches as of chunks, and what it refuses."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from edge_vpr.confidence import Acceptance, Confidence
from edge_vpr.errors import EventError, UsageError
from edge_vpr.events import EVENT_DTYPE, Events, make_events
from edge_vpr.online.kernels import process_events
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_windows import ContrastCodes, write_codes
from edge_vpr.online.state import MATCHES_AT_ONCE
from fixedpoint.own_mean import ContrastCode
from tests.online.test_filter_run import map_of as filtered_map
from tests.online.test_filter_run import with_ways
from tests.online.test_localiser import CODED, PIXELS, SENSOR, check_state, feed, map_of
from tests.streams import random_events, split_events, with_sums

TABLE = Confidence(
    np.array([-5, 0, 4, 30], dtype=np.int64),
    np.array([0.1, 0.1, 0.5, 0.9]),
    np.array([9, 9, 9, 9], dtype=np.int64),
)
SCHEDULES = [
    MatchSchedule(events=1),
    MatchSchedule(events=3, interval_us=7),
    MatchSchedule(interval_us=130),
    MatchSchedule(events=1, change=True),
]


def a_map(rng, kind, window, code, **changes):
    counts = rng.integers(0, 6, (30, len(PIXELS)))
    changes |= {"window": window, "tau_us": 90, "events_per_pixel": 2.0}
    if kind == "filter":  # of windows of fixed time and contrast codes
        return with_ways(rng, filtered_map(counts, **changes | {"window": "time"}))
    return map_of(counts, sequence_length=2, **changes, **code)


def of_another_layout(events):
    other = np.zeros(events.size, [("p", "?"), ("x", "<u2"), ("y", "<u2"), ("t", "<i8")])
    for name in EVENT_DTYPE.names:
        other[name] = events[name]
    return other


@given(
    seed=st.integers(0, 2**32),
    kind=st.sampled_from(["sequence", "filter"]),
    window=st.sampled_from(["time", "count"]),
    code=st.sampled_from(CODED),
    every=st.sampled_from(SCHEDULES),
    step=st.sampled_from([1, 2, 63, 499]),
)
@settings(max_examples=40)
def test_events_one_by_one_give_the_matches_of_one_chunk(seed, kind, window, code, every, step):
    """A chunk of another layout goes another way, by columns, as one of more than a few does."""
    rng = np.random.default_rng(seed)
    reference = a_map(rng, kind, window, code)
    events = random_events(rng, 500, SENSOR, 2_500)
    whole = Localiser(reference, every=every).update(of_another_layout(events))
    cut = Localiser(reference, every=every)
    matches = feed(cut, [events[i : i + step] for i in range(0, events.size, step)])
    assert whole.size > 0
    assert matches.tobytes() == whole.tobytes()
    check_state(cut)


@pytest.mark.parametrize("kind", ["sequence", "filter"])
@pytest.mark.parametrize(
    ("table", "precision"), [(None, None), (None, 0.8), (TABLE, None), (TABLE, 0.6)]
)
def test_the_kernel_judges_matches_as_the_table_of_the_map_does(kind, precision, table):
    rng = np.random.default_rng(4)
    if table is None and kind == "sequence":
        precision = None  # nothing is known of them
    reference = a_map(rng, kind, "time", {}, precision=precision)
    object.__setattr__(reference, "confidence", table)
    matches = Localiser(reference).update(random_events(rng, 900, SENSOR, 5_000))
    acceptance = Acceptance(reference.acceptance.confidence, precision)
    probability, lost = acceptance.accept(matches["trust"], matches["misfit"])
    assert len(set(matches["trust"].tolist())) > 5
    assert np.array_equal(matches["probability"], probability, equal_nan=True)
    assert matches["lost"].tolist() == lost.tolist()
    if precision is not None:
        assert 0 < lost.sum() < lost.size
    if kind == "sequence":  # the margin
        sums = with_sums(matches, reference.settings.windows_per_match)
        margin = sums["second_distance"] - sums["distance"]
        assert matches["trust"].tolist() == np.where(matches["second"] < 0, 0, margin).tolist()


@pytest.mark.parametrize("kind", ["sequence", "filter"])
@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        (make_events([300, 299], [0, 0], [0, 0]), EventError, "backwards within the chunk|from"),
        (make_events([99], [0], [0]), EventError, "backwards, from 100 to 99"),
        (make_events([200], [SENSOR.width], [0]), EventError, "lies off the 6x5 sensor"),
        (make_events([200], [0], [SENSOR.height]), EventError, "lies off the 6x5 sensor"),
        (make_events([2**60 + 1], [0], [0]), EventError, "check the unit of its clock"),
        (make_events([2**59], [0], [0]), UsageError, "check the recording's clock"),
    ],
    ids=["order", "before", "column", "row", "unit", "jump"],
)
def test_a_few_events_that_are_refused_change_nothing(kind, wrong, error, says):
    rng = np.random.default_rng(4)
    reference = a_map(rng, kind, "time", {})
    first, rest = random_events(rng, 300, SENSOR, 100), random_events(rng, 300, SENSOR, 900)
    first.t[-1], rest.t = 100, rest.t + 100
    every = MatchSchedule(events=1, interval_us=40)
    whole, tried = Localiser(reference, every=every), Localiser(reference, every=every)
    before = [whole.update(first), tried.update(first)]
    with pytest.raises(error, match=says):
        tried.update(wrong)
    assert before[0].tobytes() == before[1].tobytes()
    assert whole.update(rest).tobytes() == tried.update(rest).tobytes()


def test_a_few_events_of_any_memory_layout_are_the_same_events():
    rng = np.random.default_rng(5)
    reference = a_map(rng, "sequence", "time", {})
    events = random_events(rng, 200, SENSOR, 1_500)
    expected = Localiser(reference).update(events)
    spread = np.zeros(2 * events.size, dtype=EVENT_DTYPE)
    spread[::2] = events
    read_only = events.copy()
    for column in read_only.columns:
        column.setflags(write=False)
    other = of_another_layout(events)
    apart = Events(*(np.repeat(column, 2)[::2] for column in events.columns))
    for layout in (spread[::2], read_only, apart, np.asarray(events), other):
        pieces = split_events(layout, range(10, events.size, 10))
        matches = feed(Localiser(reference), pieces)
        assert matches.tobytes() == expected.tobytes()


def test_a_silence_with_more_ticks_than_the_kernel_gives_at_once_has_them_all():
    rng = np.random.default_rng(6)
    reference = a_map(rng, "filter", "time", {})
    ticks = 2 * MATCHES_AT_ONCE + 5
    localiser = Localiser(reference, every=MatchSchedule(interval_us=10))
    localiser.update(random_events(rng, 300, SENSOR, 1_000))
    last = localiser.next_match_us + 10 * (ticks - 1)
    matches = localiser.update(make_events([last], [0], [0]))
    assert matches["time_us"].tolist() == list(range(last - 10 * (ticks - 1), last + 1, 10))
    # one match is not the memory of another
    matches["place"] = -7
    assert (localiser.advance(last + 20)["place"] >= 0).all()


@given(seed=st.integers(0, 2**32), bits=st.integers(1, 8))
@settings(max_examples=20)
def test_codes_are_written_in_place_as_windows_are_coded(seed, bits):
    code, rng = ContrastCode(bits), np.random.default_rng(seed)
    counts, mean = rng.integers(0, 2_000, 6), rng.integers(0, 4_000, 6).astype(np.int32)
    written = np.full(6, 999, dtype=np.int64)
    contrast = ContrastCodes(code.levels.copy(), mean[None], np.zeros((2, 6), dtype=np.int64), bits)
    write_codes(counts, contrast, 0, written)
    assert written.tolist() == code.encode(counts, mean).tolist()


def test_the_cache_of_a_kernel_names_no_class_of_its_state():
    """A later version without that name could not read the cache, and would not start."""
    if config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    Localiser(a_map(np.random.default_rng(8), "filter", "time", {})).update(
        make_events([1], [0], [0])
    )
    (signature,) = process_events.signatures[:1]
    assert "KernelStateType" in str(signature)
    assert b"edge_vpr.online" not in pickle.dumps(signature)
