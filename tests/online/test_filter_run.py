"""The place filter event by event: the oracle after every event, and the batch at window ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from edge_vpr.drive_inputs import opened
from edge_vpr.errors import UsageError
from edge_vpr.events import join_events, make_events
from edge_vpr.match_result import describe_query
from edge_vpr.matching.drive import match_query
from edge_vpr.odometry import Odometry
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.odometry_feed import OdometryFeed
from edge_vpr.online.schedule import MatchSchedule
from firmware_model.specification_drive import (
    live_matches,
    misfit_of,
    running_misfits,
    typical_distances,
)
from fixedpoint.activity import SUMS
from tests import naive
from tests.filter_oracle import drive_of, events_that_count, row_of_match, running_codes
from tests.online.test_localiser import PIXELS, SENSOR, feed_checked
from tests.online.test_localiser import map_of as matched_in_sequence
from tests.streams import Drive, as_tuples, cut_up, random_events, resumed, with_sums

#: in plain Python, which takes a hundred times as long, the same properties with fewer draws
EXAMPLES = 10 if config.DISABLE_JIT else 40


def map_of(counts, **changes):
    filtered = {"matching": "filter", "counter_code": "contrast"}
    return matched_in_sequence(counts, **filtered | changes)


def oracle_after_each_event(reference, events):
    """Everything counted, coded, compared and filtered anew after each selected event."""
    chosen, places = reference.settings, reference.places.counts.tolist()
    tau, counters = chosen.tau_us, len(PIXELS)
    selected, rows = [], []
    for t, x, y, _ in as_tuples(events):
        if (x, y) not in PIXELS:
            continue
        selected.append((t, PIXELS.index((x, y))))
        if t + 1 < tau:
            continue
        # windows that are over: an event at the end of a window is in the next one
        spans = [[e for e in selected if e[0] // tau == w] for w in range(t // tau)]
        counted = [naive.lagged_counts(span, 0, 1, counters, 0, 10**9)[0] for span in spans]
        lags = naive.lagged_counts(selected, t + 1, SUMS[-1], counters, tau, 0)
        number = len(SUMS) if chosen.hypotheses > 1 else 1
        sums = [list(map(sum, zip(*lags[:windows], strict=True))) for windows in SUMS[:number]]
        counted.append(sums[0])
        coded = running_codes(reference, counted, sums)
        seen = [one[0] for one in as_tuples(events) if one[0] <= t]
        unseen = naive.unseen_halves(seen, tau, len(counted), t)
        drive = drive_of(reference, coded, events_that_count(reference, counted), unseen)
        typical = typical_distances(places)
        of_windows = [
            misfit_of(window, one.gain, one.place, typical[one.place])
            for window in drive
            for one in [window.advanced.best]
        ]
        *match, trust = row_of_match(live_matches(drive)[-1])
        misfit = running_misfits(of_windows)[-1]
        rows.append((t, *match, sum(counted[-1]), trust, misfit))
    return rows


def without_ratio(matches):
    derived = ("ratio", "start_us", "probability", "lost")
    names = [name for name in matches.dtype.names if name not in derived]
    return [tuple(int(match[name]) for name in names) for match in with_sums(matches)]


def random_map(rng, places, largest, **changes):
    return map_of(rng.integers(0, largest + 1, (places, len(PIXELS))), **changes)


@given(
    seed=st.integers(0, 2**32),
    n=st.integers(0, 90),
    places=st.integers(1, 80),
    largest=st.sampled_from([2, 9, 300]),
    tau=st.sampled_from([40, 300, 700]),
    bits=st.integers(1, 8),
    exclusion=st.integers(0, 4),
    per_window=st.sampled_from([1, 2]),
    pieces=st.integers(1, 7),
)
@settings(max_examples=40)
def test_every_match_equals_the_oracle_however_the_stream_is_cut(
    seed, n, places, largest, tau, bits, exclusion, per_window, pieces
):
    rng = np.random.default_rng(seed)
    reference = random_map(
        rng, places, largest, tau_us=tau, counter_bits=bits, exclusion=exclusion,
        places_per_window=per_window,
    )  # fmt: skip
    events = random_events(rng, n, SENSOR, 2_000)
    matches = feed_checked(Localiser(reference), cut_up(rng, events, pieces))
    assert without_ratio(matches) == oracle_after_each_event(reference, events)


@pytest.mark.parametrize("with_odometry", [False, True])
@given(seed=st.integers(0, 2**32), per_window=st.sampled_from([1, 2]), pieces=st.integers(1, 5))
@settings(max_examples=EXAMPLES)
def test_at_window_ends_it_says_what_the_batch_says(with_odometry, seed, per_window, pieces):
    rng = np.random.default_rng(seed)
    reference = random_map(rng, 30, 9, tau_us=100, places_per_window=per_window)
    # from time to time the camera stands
    times = np.sort(rng.choice(rng.choice(2_000, 1_200, replace=False), 800))
    # or sees nothing, for less than a window or for more
    for begin in rng.integers(0, 800, int(rng.integers(0, 4))).tolist():
        times[begin:] += int(rng.integers(10, 600))
    events = make_events(
        times, rng.integers(0, SENSOR.width, 800), rng.integers(0, SENSOR.height, 800), [0] * 800
    )
    queries = describe_query(reference, opened(Drive(events, SENSOR)))
    odometry = None
    if with_odometry:
        reference, odometry = with_ways(rng, reference), random_odometry(rng, int(times[-1]) + 1)
    batch = match_query(reference, queries, odometry)
    localiser = Localiser(reference, every=MatchSchedule.window(reference.settings))
    fed = OdometryFeed(localiser, odometry)
    rows = [row for piece in cut_up(rng, events, pieces) for row in fed.update(piece)]
    live = np.concatenate(rows)[: len(batch)]
    for theirs, ours in (
        (batch.place, live["place"]),
        (batch.distance, live["distance"]),
        (batch.second, live["second"]),
        (batch.trust, live["trust"]),
        (batch.misfit, live["misfit"]),
        (batch.probability, live["probability"]),
        (queries.selected, live["events"]),
    ):
        assert theirs.tolist() == ours.tolist()


def random_odometry(rng, until):
    """Readings at odd times, with windows without any, and a robot that also rolls back."""
    times = np.sort(rng.choice(until, int(rng.integers(1, 40)), replace=False))
    return Odometry(times, np.cumsum(rng.integers(-200, 900, times.size)))


def with_ways(rng, reference):
    """A map with a distance to each place."""
    way = np.cumsum(rng.integers(1, 999, len(reference))).astype(np.int64)
    return replace(reference, odometer_mm=way)


@pytest.mark.parametrize("per_window", [1, 2])
@pytest.mark.parametrize("driven", [False, True])
def test_the_cut_of_the_stream_and_a_saved_state_change_nothing(driven, per_window):
    rng = np.random.default_rng(8)
    reference = random_map(rng, 20, 9, tau_us=130, places_per_window=per_window)
    reference = with_ways(rng, reference)
    events, read = random_events(rng, 900, SENSOR, 2_000), random_odometry(rng, 2_000)

    def readings(after_us):
        later = read.time_us > after_us
        return Odometry(read.time_us[later], read.distance_mm[later]) if later.any() else None

    odometry = read if driven else None
    whole = np.concatenate(OdometryFeed(Localiser(reference), odometry).update(events))
    fed = OdometryFeed(Localiser(reference), odometry)
    parts = [row for piece in cut_up(rng, events, 9) for row in fed.update(piece)]
    assert without_ratio(np.concatenate(parts)) == without_ratio(whole)
    for cut in (0, 1, 333, 600, 899):
        first = Localiser(reference)
        begin = OdometryFeed(first, odometry).update(events[:cut])
        left = readings(events["t"][cut - 1] if cut else -1) if driven else None
        rest = OdometryFeed(resumed(first), left).update(events[cut:])
        assert without_ratio(np.concatenate([*begin, *rest])) == without_ratio(whole)
    if driven:
        first.odometer.before = 7
        assert vars(resumed(first).odometer) == vars(first.odometer)


def test_a_reading_without_a_use_is_refused():
    rng = np.random.default_rng(9)
    bare = random_map(rng, 5, 9, tau_us=100)
    with pytest.raises(UsageError, match="map does not say how far its places"):
        Localiser(bare).read_odometer(0, 1.0)
    still = replace(bare, odometer_mm=np.zeros(5, dtype=np.int64))
    with pytest.raises(UsageError, match="did not move by its odometry"):
        Localiser(still).read_odometer(0, 1.0)
    moving = with_ways(rng, bare)
    with pytest.raises(UsageError, match="odometer at nan m"):
        Localiser(moving).read_odometer(0, float("nan"))
    by_sequence = replace(bare.settings.uncoded, matching="sequence", sequence_length=1)
    with pytest.raises(UsageError, match="odometry is for the place filter"):
        Localiser(replace(bare, settings=by_sequence)).read_odometer(0, 1.0)


def test_a_silence_of_a_year_is_passed_over_at_once():
    rng = np.random.default_rng(6)
    reference = random_map(rng, 20, 9, tau_us=100)
    before = random_events(rng, 500, SENSOR, 1_000)
    after = random_events(rng, 500, SENSOR, 1_000)
    year = 365 * 24 * 3600 * 10**6
    after.t += year
    localiser = Localiser(reference)
    localiser.update(before)
    place = localiser.advance(year)
    assert place.size == 0
    assert localiser.update(after).size > 50
    # windows after the silence end where they would have ended
    assert localiser.filled == 1


def test_a_silence_says_the_same_whether_it_is_passed_over_or_not():
    """A tick within the silence ends what is passed over, and says what the windows say."""
    rng = np.random.default_rng(7)
    reference = random_map(rng, 20, 9, tau_us=100)
    events = join_events([random_events(rng, 500, SENSOR, 1_000) for _ in range(2)])
    events.t[500:] += 300_000
    expected = [
        without_ratio(localiser.update(events))
        for localiser in (
            Localiser(reference, every=MatchSchedule(events=1)),
            Localiser(reference, every=MatchSchedule(events=1, interval_us=299_950)),
        )
    ]
    ticks = [row for row in expected[1] if row not in expected[0]]
    assert len(ticks) <= 1
    assert [row for row in expected[1] if row not in ticks] == expected[0]


def test_ticks_that_are_skipped_give_no_match():
    rng = np.random.default_rng(9)
    reference = random_map(rng, 20, 9, tau_us=100)
    localiser = Localiser(reference, every=MatchSchedule(interval_us=10))
    localiser.update(random_events(rng, 200, SENSOR, 1_000))
    later = random_events(rng, 200, SENSOR, 1_000)
    later.t += 10**9
    localiser.skip_ticks(int(later["t"][0]))
    assert localiser.next_match_us == int(later["t"][0]) // 10 * 10
    assert 90 < localiser.update(later).size < 110


def test_settings_of_neither_profile_are_refused_with_what_to_change():
    reference = map_of(np.ones((9, len(PIXELS)), dtype=np.int64), window="count")
    with pytest.raises(UsageError, match=r"two profiles: .* map with window = time for robot,"):
        Localiser(reference)
