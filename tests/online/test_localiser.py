"""A match after every event, held to a recomputation after every event."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from edge_vpr.confidence import NO_MISFIT
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import EventError, MapError, UsageError
from edge_vpr.events import Sensor, make_events
from edge_vpr.map_making import describe
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.match import MATCH_DTYPE
from edge_vpr.online.localiser import Localiser, check_extent
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_windows import recount, with_distances
from edge_vpr.settings import Settings
from tests import naive
from tests.maps.saved_files import map_of as saved_map_of
from tests.streams import (
    Drive,
    as_tuples,
    cut_up,
    map_of_counts,
    random_events,
    resumed,
    split_events,
    with_sums,
)

SENSOR = Sensor(6, 5)
PIXELS = [(0, 0), (5, 4), (2, 3), (1, 0), (4, 1)]
PIXEL_MAP = PixelMap(SENSOR, *np.array(PIXELS, dtype=np.uint16).T)


def map_of(counts, **changes):
    chosen = Settings(pixels=len(PIXELS), remove_bursts=False).replaced(changes, "test")
    return map_of_counts(PIXEL_MAP, counts, chosen)


def feed(localiser, chunks):
    return np.concatenate([localiser.update(chunk) for chunk in chunks])


def check_state(localiser):
    """Counters and distances are those of the events in the windows, without any drift."""
    windows = localiser.settled()
    anew = with_distances(windows, localiser.places)
    places = anew.totals["places"][0]
    assert np.array_equal(recount(windows), windows.counts)
    assert np.array_equal(anew.sums[:, :places], windows.sums[:, :places])
    assert np.array_equal(anew.totals["common"], windows.totals["common"])


def feed_checked(localiser, chunks):
    parts = []
    for chunk in chunks:
        parts.append(localiser.update(chunk))
        check_state(localiser)
    return np.concatenate(parts)


def expected_after_each_event(reference, events):
    """The oracle's matches: everything is counted and compared anew after each selected event."""
    chosen = reference.settings
    by_time = chosen.window == "time"
    tau = chosen.tau_us if by_time else 0
    n = 0 if by_time else chosen.events_per_window
    length = chosen.sequence_length
    counters = reference.places.counts.shape[1]
    slot_of = {pixel: slot for slot, pixel in enumerate(PIXELS)}
    selected, rows = [], []
    for t, x, y, _ in as_tuples(events):
        if (x, y) not in slot_of:
            continue
        selected.append((t, slot_of[x, y]))
        if (t + 1 < length * tau) if by_time else (len(selected) < length * n):
            continue
        lags = naive.lagged_counts(selected, t + 1, length, counters, tau, n)
        if chosen.counter_code == "linear":
            lags = [[min(c, 2**chosen.counter_bits - 1) for c in lag] for lag in lags]
        match = naive.online_match(reference.places.counts.tolist(), lags, chosen.exclusion)
        rows.append((t, *match, sum(naive.lagged_counts(selected, t + 1, 1, counters, tau, n)[0])))
    return rows


def without_ratio(matches, length=1):
    derived = ("ratio", "start_us", "trust", "misfit", "probability", "lost")
    assert (matches["misfit"] == NO_MISFIT).all()
    names = [name for name in MATCH_DTYPE.names if name not in derived]
    return [tuple(int(match[name]) for name in names) for match in with_sums(matches, length)]


#: whether and where counts saturate
CODED = [{}, *({"counter_code": "linear", "counter_bits": bits} for bits in (1, 2, 8))]


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 120),
    places=st.integers(4, 90),
    largest=st.sampled_from([0, 2, 9, 300]),
    length=st.integers(1, 4),
    window=st.sampled_from(["time", "count"]),
    tau=st.sampled_from([1, 40, 500]),
    per_pixel=st.sampled_from([0.2, 1.0, 3.0]),
    code=st.sampled_from(CODED),
    exclusion=st.integers(0, 4),
    pieces=st.integers(1, 7),
)
@settings(max_examples=120)
def test_every_match_equals_the_oracle_however_the_stream_is_cut(
    seed, n, places, largest, length, window, tau, per_pixel, code, exclusion, pieces
):
    rng = np.random.default_rng(seed)
    reference = map_of(
        rng.integers(0, largest + 1, (places, len(PIXELS))),
        window=window,
        tau_us=tau,
        events_per_pixel=per_pixel,
        sequence_length=length,
        exclusion=exclusion,
        **code,
    )
    events = random_events(rng, n, SENSOR, 2_000)
    localiser = Localiser(reference)
    matches = feed_checked(localiser, cut_up(rng, events, pieces))
    expected = expected_after_each_event(reference, events)
    assert without_ratio(matches, length) == expected
    for match in with_sums(matches, length):
        if match["second"] < 0:
            assert np.isnan(match["ratio"])
        elif match["second_distance"] == 0:
            assert match["ratio"] == 1.0
        else:
            assert match["ratio"] == match["distance"] / match["second_distance"]


@given(
    seed=st.integers(0, 2**32),
    window=st.sampled_from(["time", "count"]),
    length=st.integers(1, 4),
    code=st.sampled_from(CODED),
    pieces=st.integers(1, 7),
)
def test_at_the_ends_of_windows_the_matches_are_those_of_the_main_job(
    seed, window, length, code, pieces
):
    """With non-overlapping windows, the online matches are those of a recording, to the bit.

    They belong to the newest window of the sequence, and those of a recording to the middle one.
    """
    shift = length - 1 - length // 2
    rng = np.random.default_rng(seed)
    reference = map_of(
        rng.integers(0, 6, (40, len(PIXELS))),
        window=window,
        tau_us=100,
        events_per_pixel=2.0,
        sequence_length=length,
        **code,
    )
    events = random_events(rng, 400, SENSOR, 3_000)
    online = Localiser(reference, every=MatchSchedule.window(reference.settings))
    matches = feed(online, cut_up(rng, events, pieces))

    drive = Drive(events, SENSOR)
    queries = describe(drive, PIXEL_MAP, reference.settings)
    batch = match_descriptors(reference.places, queries, reference.settings)
    assert matches["place"].tolist() == (batch.place + shift).tolist()
    assert matches["distance"].tolist() == batch.distance.tolist()
    second = np.where(batch.second < 0, -1, batch.second + shift)
    assert matches["second"].tolist() == second.tolist()
    assert np.array_equal(matches["second_distance"], batch.second_distance, equal_nan=True)
    assert np.array_equal(matches["ratio"], batch.ratio, equal_nan=True)
    assert matches["time_us"].tolist() == queries.end_us[batch.query + shift].tolist()


#: events at each pixel of the map in turn
EVERYWHERE = np.array(PIXELS * 12).T
HOURS_APART = np.cumsum([0, 1, 1, 3_600_000_000, 1, 36_000_000_000, 1, 1])
ODDITIES = {
    "one pixel": make_events(np.arange(60), [5] * 60, [4] * 60),
    "equal times": make_events([7] * 60, *EVERYWHERE),
    "hours apart": make_events(HOURS_APART, *EVERYWHERE[:, :8]),
    "everywhere": make_events(np.arange(60), *EVERYWHERE),
}


@pytest.mark.parametrize("name", ODDITIES)
@pytest.mark.parametrize("window", ["time", "count"])
@pytest.mark.parametrize("size", [1, 4, 1_000_000])
@pytest.mark.parametrize("places", [1, 5, 64, 65, 5_000])
def test_odd_streams_equal_the_oracle(name, window, size, places):
    rng = np.random.default_rng(0)
    reference = map_of(
        rng.integers(0, 3, (places, len(PIXELS))),
        window=window,
        tau_us=size,
        events_per_pixel=size / 5,
        sequence_length=1,
    )
    events = ODDITIES[name] if places < 5_000 else ODDITIES[name][:6]
    cuts = [0, *range(1, events.size, 3)]
    matches = feed_checked(Localiser(reference), split_events(events, cuts))
    assert without_ratio(matches) == expected_after_each_event(reference, events)


def test_a_chunk_of_a_million_events_equals_the_same_events_in_small_chunks():
    rng = np.random.default_rng(0)
    reference = map_of(rng.integers(0, 60, (100, 5)), tau_us=1_000, sequence_length=2)
    n = 20_000 if config.DISABLE_JIT else 1_000_000
    events = random_events(rng, n, SENSOR, 3 * n)
    every = MatchSchedule(events=n // 2_000)
    whole = Localiser(reference, every=every).update(events)
    cut = feed(Localiser(reference, every=every), split_events(events, 777))
    assert whole.size > 300
    assert whole.tobytes() == cut.tobytes()


def test_the_ring_grows_when_a_window_holds_more_events_than_it():
    rng = np.random.default_rng(0)
    reference = map_of(rng.integers(0, 6, (30, 5)), tau_us=10**6, sequence_length=2)
    events = random_events(rng, 60_000, SENSOR, 3 * 10**6)
    localiser = Localiser(reference, every=MatchSchedule(events=2_000))
    feed_checked(localiser, split_events(events, 3))
    selected = sum((x, y) in PIXELS for x, y in zip(events["x"], events["y"], strict=True))
    assert 2 * 4096 / 3 < localiser.settled().counts.sum() < selected


def test_a_match_at_every_interval_sees_the_events_before_it_and_not_after():
    reference = map_of(np.eye(20, 5, dtype=int), tau_us=10, sequence_length=1)
    events = make_events(t=[9, 10, 40], x=[0, 0, 0], y=[0, 0, 0])
    localiser = Localiser(reference, every=MatchSchedule(interval_us=10))
    matches = localiser.update(events)
    assert matches["time_us"].tolist() == [10, 20, 30, 40]
    assert matches["events"].tolist() == [1, 1, 0, 0]
    assert localiser.advance(60)["events"].tolist() == [1, 0]


def test_on_change_only_other_places_are_told():
    rng = np.random.default_rng(0)
    reference = map_of(rng.integers(0, 4, (50, 5)), tau_us=100, sequence_length=1)
    events = random_events(rng, 2_000, SENSOR, 2_000)
    every = Localiser(reference).update(events)
    change = Localiser(reference, every=MatchSchedule(events=1, change=True)).update(events)
    differs = np.concatenate([[True], every["place"][1:] != every["place"][:-1]])
    assert change.tobytes() == every[differs].tobytes()
    assert 1 < change.size < every.size


@given(
    seed=st.integers(0, 2**32),
    cut=st.integers(0, 300),
    window=st.sampled_from(["time", "count"]),
    code=st.sampled_from(CODED),
)
@settings(max_examples=40)
def test_a_saved_state_goes_on_bit_for_bit(seed, cut, window, code):
    rng = np.random.default_rng(seed)
    reference = map_of(
        rng.integers(0, 6, (30, 5)), window=window, tau_us=200, sequence_length=3, **code
    )
    events = random_events(rng, 300, SENSOR, 2_000)
    every = MatchSchedule(events=2, interval_us=70, change=True)
    whole = Localiser(reference, every=every).update(events)
    first = Localiser(reference, every=every)
    before = first.update(events[:cut])
    second = resumed(first)
    after = second.update(events[cut:])
    assert np.concatenate([before, after]).tobytes() == whole.tobytes()
    check_state(second)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: MatchSchedule(),
        lambda: MatchSchedule(events=-1),
        lambda: Localiser(map_of(np.zeros((3, 5)), sequence_length=5)),
    ],
)
def test_wrong_use_is_told(wrong):
    with pytest.raises(UsageError):
        wrong()


def test_a_selected_event_earlier_than_the_stream_is_refused_wherever_it_stands_in_its_chunk():
    reference = map_of(np.zeros((50, 5)), tau_us=2, sequence_length=1)
    localiser = Localiser(reference)
    localiser.update(make_events([70, 80], [0, 0], [0, 0]))
    with pytest.raises(EventError, match="backwards"):
        localiser.update(make_events([100, 50, 200], [3, 0, 3], [0, 0, 0]))


def test_time_that_has_passed_without_events_cannot_be_filled_later():
    reference = map_of(np.zeros((50, 5)), tau_us=2, sequence_length=1)
    localiser = Localiser(reference, every=MatchSchedule(interval_us=10))
    localiser.update(make_events([100], [0], [0]))
    assert localiser.advance(100).size == 0
    assert localiser.advance(120)["time_us"].tolist() == [110, 120]
    with pytest.raises(EventError, match="backwards, from 120 to 119"):
        localiser.update(make_events([119], [0], [0]))
    with pytest.raises(EventError, match="backwards, from 120 to 119"):
        localiser.advance(119)
    localiser.update(make_events([120], [0], [0]))


def test_distances_beyond_32_bits_are_refused_instead_of_wrapping():
    counts = np.zeros((9, 5), dtype=np.int64)
    counts[3] = 2**31
    with pytest.raises(UsageError, match="do not fit 32 bits"):
        Localiser(map_of(counts, sequence_length=1))


def test_a_map_that_is_changed_in_memory_is_refused_by_the_localiser():
    reference = saved_map_of({}, np.random.default_rng(0))
    object.__setattr__(reference.places, "counts", reference.places.counts[:, :3].copy())
    with pytest.raises(MapError, match=r"counts is .*expected"):
        Localiser(reference)


def test_a_read_only_map_is_followed_like_any_other():
    reference = saved_map_of({}, np.random.default_rng(0), largest=20)
    events = random_events(np.random.default_rng(1), 80, SENSOR, 600)
    expected = Localiser(reference).update(events)
    reference.places.counts.setflags(write=False)
    assert Localiser(reference).update(events).tobytes() == expected.tobytes()
    assert expected.size


def test_windows_and_sequences_that_no_integer_holds_are_wrong_use():
    with pytest.raises(UsageError, match="make windows of more than"):
        Settings(window="count", events_per_pixel=1e15)
    with pytest.raises(UsageError, match="take shorter windows"):
        check_extent(10**6, 1, 2_000, FixedTime(10**15))
    with pytest.raises(UsageError, match="take a shorter sequence"):
        check_extent(10**6, 150, 10**5, FixedTime(1))
    check_extent(100_000, 150, 100, FixedTime(10**6))


def test_time_cannot_be_let_pass_beyond_its_range():
    localiser = Localiser(saved_map_of({}, np.random.default_rng(0)))
    with pytest.raises(EventError, match="lies beyond"):
        localiser.advance(2**70)
