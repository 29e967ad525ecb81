"""The place filter: equal to the oracle, and right where the camera stands."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_vpr.confidence import OFF_MAP_MISFIT
from edge_vpr.descriptors.activity import (
    activity_of,
    activity_of_drive,
    find_pauses,
    log_activity,
    place_activity,
)
from edge_vpr.errors import MapError, UsageError
from edge_vpr.matching import drive as filtered_drive
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.place_filter import PATIENCE, PlaceFilter, WindowRows
from edge_vpr.matching.prediction import LANES, TransitionCosts, Transitions
from edge_vpr.matching.smoothing import add_cost_to_go
from edge_vpr.matching.trust import held_trust
from edge_vpr.odometry import MOST_MM, Odometer, Odometry
from edge_vpr.settings import PRESETS, Settings
from firmware_model import specification, specification_drive
from firmware_model.specification import distance, ilog
from firmware_model.specification_drive import (
    PATIENCE_SMOOTHED,
    advance_window,
    anchored,
    live_matches,
    misfit_of,
    most_weight,
    running_misfits,
    smoothed,
    smoothed_matches,
    smoothed_misfits,
    spacing_of,
    spread,
    typical_distances,
    windows_of,
)
from fixedpoint.activity import BANK_COSTS, EVENTS_TOP, LOG_TOP, bank_costs
from tests.filter_oracle import activities, drive_map, mean_activity_of, row_of_match
from tests.streams import descriptors

costs = st.builds(
    TransitionCosts,
    restart=st.integers(1, 30),
    places_per_window=st.sampled_from([1, 2]),
    by_activity=st.booleans(),
    gains=st.sampled_from([1, 7]),
)
#: with these, a path is followed at the pace of the reference, whatever the activity
STEADY = TransitionCosts(by_activity=False)
#: far below, about and above the mean activity of the tests, which is 0, 100 or 3,000
EVENTS = [0, 1, 3, 9, 12, 17, 25, 60, 90, 200, 800, 9_000, 2**23, 2**40]


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 30),
    windows=st.integers(1, 12),
    largest=st.sampled_from([1, 7, 300, 2**31]),
    steps=costs,
    exclusion=st.integers(0, 4),
    mean_activity=st.sampled_from([0, 256 * 100, 256 * 3000]),
    spacing=st.sampled_from([0, 1, 7, 1_000, MOST_MM // 100]),
)
def test_metrics_matches_and_trust_equal_the_oracle(
    seed, places, windows, largest, steps, exclusion, mean_activity, spacing
):
    rng = np.random.default_rng(seed)
    distances = rng.integers(0, largest + 1, (windows, 3, places))
    events = rng.choice(EVENTS, windows)
    along, driven = random_distances(rng, places, windows, spacing)
    seen = rng.integers(-128, 128, places).astype(np.int32)
    typical = rng.integers(-largest, largest + 1, places)
    transitions = Transitions(places, steps, seen, along, typical, exclusion)
    place_filter = PlaceFilter(transitions, mean_activity)
    page = drive_map(
        steps, seen.tolist(), typical.tolist(), mean_activity, exclusion,
        [] if along is None else along.tolist(),
    )  # fmt: skip
    distances = distances[:, : place_filter.sums]
    # before the first window, there is no place to go on from
    driven = [None, *driven[1:]]
    rows = windows_of(page, distances.tolist(), events.tolist(), driven)
    matches, misfits = live_matches(rows), running_misfits(misfits_of(rows, typical))
    counted_mm = anchored(driven, spacing_of(page.along)) if page.along else driven
    hypotheses = len(page.filter.gains)
    for w, (row, count, expected) in enumerate(zip(distances, events, matches, strict=True)):
        if driven[w] is not None:
            place_filter.predict_travelled(counted_mm[w], driven[w])
        match = place_filter.update(row, int(count))
        assert place_filter.state.metric[:, :hypotheses].T.tolist() == rows[w].metrics
        assert place_filter.place == rows[w].advanced.best.place
        second = -1 if match.second < 0 else match.second_distance
        told = match.place, match.distance, match.second, second, match.ties
        assert (*told, match.trust) == row_of_match(expected)
        assert match.misfit == misfits[w]


def misfits_of(rows, typical, bests=None):
    """Misfit of each window at its best place, of the window or of the whole drive."""
    bests = bests or [row.advanced.best for row in rows]
    return [
        misfit_of(row, one.gain, one.place, int(typical[one.place]))
        for row, one in zip(rows, bests, strict=True)
    ]


def test_after_a_spread_above_2_to_16_a_window_is_scaled_by_its_own():
    distances = np.array([[0, 10**6, 0, 0], [9, 5, 40, 7], [9, 5, 40, 7]])
    place_filter = PlaceFilter(Transitions(4, TransitionCosts()))
    page = drive_map(TransitionCosts(), [0] * 4, [0] * 4, 0, 3)
    rows = windows_of(page, [[row] for row in distances.tolist()], [50] * 3)
    for row, one, expected in zip(distances, rows, live_matches(rows), strict=True):
        match = place_filter.update(row, 50)
        assert place_filter.state.metric[:, :1].T.tolist() == one.metrics
        assert (match.place, match.trust) == (expected.place, expected.trust)
    assert len(set(rows[1].metrics[0])) > 1  # evidence counted, though the window before had none


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 20),
    windows=st.one_of(st.integers(1, 8), st.integers(30, 80)),
    steps=costs,
    spacing=st.sampled_from([0, 7, 1_000]),
    smooth=st.booleans(),
    gaps=st.sampled_from([0, 0.03, 0.4]),
)
@settings(max_examples=60)
def test_a_drive_has_the_cost_of_the_best_path_through_each_place(
    seed, places, windows, steps, spacing, smooth, gaps
):
    """Of the whole path where it is smoothed, else of the path until then."""
    rng = np.random.default_rng(seed)
    reference, queries = (rng.integers(0, 9, (n, 3)) for n in (places, windows))
    mapped = replace(descriptors(reference), selected=rng.choice(EVENTS, places))
    events = rng.choice(EVENTS, windows)
    along, travelled = random_distances(rng, places, windows, spacing)
    odometry, driven = None, [None] * windows
    if along is not None:
        odometry = readings(travelled)
        driven = [None, *np.diff(odometry.distance_mm).tolist()]
    chosen = Settings(
        matching="filter", pixels=3, smooth=smooth,
        filter_restart=steps.restart, exclusion=1, places_per_window=steps.places_per_window,
        window="time" if steps.by_activity else "count", events_per_pixel=1.0,
    )  # fmt: skip
    unseen = rng.choice([1, 4], windows) * (rng.random(windows) < gaps)
    seen = rng.random(windows) >= gaps / 2
    events = events * seen
    counted = replace(
        descriptors(queries), selected=events, events=np.maximum(events, seen), unseen=unseen
    )
    matches = match_descriptors(mapped, counted, chosen, along_mm=along, odometry=odometry)
    number, selected = steps.places_per_window, mapped.selected_events.tolist()
    mean_activity = mean_activity_of(selected, number)
    typical = typical_distances(reference.tolist())
    one_gain = replace(steps, gains=1)  # of counts
    page = drive_map(
        one_gain, activities(selected, mean_activity), typical, mean_activity, number,
        [] if along is None else along.tolist(),
    )  # fmt: skip
    rows = windows_of(
        page,
        [[[distance(p, q) for p in reference.tolist()]] for q in queries.tolist()],
        events.tolist(), driven, patience=PATIENCE_SMOOTHED if smooth else PATIENCE,
        unseen=unseen.tolist(), seen=seen.tolist(),
    )  # fmt: skip
    expected = smoothed_matches(page, rows) if smooth else live_matches(rows)
    best = [one for one, _ in smoothed(page, rows)] if smooth else None
    whole = [costs for _, costs in smoothed(page, rows)] if smooth else [r.metrics for r in rows]
    for w, match in enumerate(expected):
        second = -1 if match.second is None else match.second
        assert (matches.place[w], matches.second[w], matches.ties[w]) == (
            match.place, second, match.ties,
        )  # fmt: skip
        assert (matches.distance[w], matches.trust[w]) == (match.sum, match.trust)
        (metric,) = whole[w]
        nearest = sorted(range(places), key=lambda k: (metric[k], k))
        assert matches.candidates[w][: min(places, 25)].tolist() == nearest[:25]
    misfits = smoothed_misfits if smooth else running_misfits
    assert matches.misfit.tolist() == misfits(misfits_of(rows, typical, best))


@given(trust=st.lists(st.integers(0, 1_000), max_size=120))
def test_the_trust_of_stretches_is_that_of_the_page(trust):
    array = np.array(trust, dtype=np.int64)
    assert held_trust(array).tolist() == specification_drive.held_trust(trust)


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 20),
    windows=st.integers(1, 12),
    steps=costs,
    spacing=st.sampled_from([0, 7, 1_000]),
)
@settings(max_examples=60)
def test_the_cost_of_whole_paths_over_gains_equals_the_oracle(
    seed, places, windows, steps, spacing
):
    rng = np.random.default_rng(seed)
    along, driven = random_distances(rng, places, windows, spacing)
    transitions, page = random_map(rng, places, steps, along)
    events, driven = rng.choice(EVENTS, windows), [None, *driven[1:]]
    place_filter = PlaceFilter(transitions, page.mean_activity, PATIENCE_SMOOTHED)
    distances = rng.integers(0, 60, (windows, 3, places))[:, : place_filter.sums]
    rows = windows_of(page, distances.tolist(), events.tolist(), driven, patience=PATIENCE_SMOOTHED)
    counted_mm = anchored(driven, spacing_of(page.along)) if page.along else driven
    done = []
    for w, row in enumerate(distances):
        if driven[w] is not None:
            place_filter.predict_travelled(counted_mm[w], driven[w])
        done.append(place_filter.update_windows(row[None], events[w : w + 1].astype(np.int64)))
    results = WindowRows(*(np.concatenate(column) for column in zip(*done, strict=True)))
    to_go = np.zeros((places, LANES), dtype=np.int16)
    add_cost_to_go(to_go, transitions, results, counted_mm, [0] * windows)
    for w, (one, costs_of_paths) in enumerate(smoothed(page, rows)):
        assert results.best[w].tolist() == [one.place, one.gain]
        assert results.matches["place"][w] == one.told
        of_sum = results.sums[w, one.gain]
        assert results.evidence[w, of_sum, one.place] == rows[w].evidence(one.gain)[one.place]
        least = [min(column) for column in zip(*costs_of_paths, strict=True)]
        assert results.least[w].tolist() == least


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(2, 20),
    windows=st.integers(2, 8),
    steps=costs,
    spacing=st.sampled_from([1, 7, 1_000]),
)
@settings(max_examples=60)
def test_parts_of_windows_with_an_odometer_and_unseen_time_equal_the_oracle(
    seed, places, windows, steps, spacing
):
    """As of matches between the ends of windows; each part goes on from the window before."""
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.integers(1, 2 * spacing + 1, places))
    transitions, page = random_map(rng, places, steps, along)
    state, mean, most_before = page.begin(), page.mean_activity, 0
    kept, meter = PlaceFilter(transitions, mean).to_arrays(), Odometer(transitions.spacing_mm)
    per_window = page.filter.per_window
    for _ in range(windows):
        shown, step = meter.latest, int(rng.choice([0, 1, 2, 5, 9, 20])) * spacing * per_window // 8
        for share in np.sort(rng.random(rng.integers(1, 4))):
            part = PlaceFilter(transitions)
            part.resume(kept)
            if halves := int(rng.choice([0, 0, 0, 0, 1, 3])):
                part.unseen(halves)
                spread_out = [spread(row, halves * per_window) for row in state.metrics]
                state, kept = state._replace(metrics=spread_out, support=0, age=0), part.to_arrays()
            if rng.random() < 0.8:
                meter.read(shown + round(share * step))
            travelled, most = meter.travelled_mm, 0
            if travelled is not None:
                part.predict_travelled(travelled, meter.driven_mm)
                most = most_weight(page.along, meter.driven_mm, per_window)
            distances, count = rng.integers(0, 60, (part.sums, places)), int(rng.choice(EVENTS))
            match = part.update(distances, count)
            expected = advance_window(
                page, state,
                specification.activity_of(count, page.mean_activity if part.sums > 1 else mean),
                specification.is_pause(count, mean), distances.tolist(),
                driven=travelled, most=most, most_before=most_before,
            )  # fmt: skip
            hypotheses = len(page.filter.gains)
            assert part.state.metric[:, :hypotheses].T.tolist() == expected.metrics
            (told,) = live_matches([expected])
            assert (match.place, match.trust) == (told.place, told.trust)
        meter.end_window()
        kept, state, most_before = part.to_arrays(), expected.advanced.state, most
        mean = specification.mean_activity_after(mean, count)


def readings(travelled):
    """An odometer read once in each window of a millisecond."""
    driven = np.cumsum([0, *(step or 0 for step in travelled[1:])])
    times = np.arange(len(travelled)) * 1_000 + 500
    return Odometry(times, driven.astype(np.int64))


@pytest.mark.parametrize(("smooth", "first"), [(False, 5), (True, 25)])
def test_the_windows_after_decide_with(smooth, first):
    """Places 5 and 25 look alike: which of them it was is known when the drive goes on."""
    rng = np.random.default_rng(6)
    reference = rng.integers(0, 100, (40, 12))
    reference[5] = reference[25]
    reference[5, 0] -= 1
    queries = reference[25:35].copy()
    queries[0] = reference[5]
    chosen = Settings(matching="filter", pixels=12, smooth=smooth)
    matches = match_descriptors(descriptors(reference), descriptors(queries), chosen)
    assert matches.place.tolist() == [first, *range(26, 35)]


def test_a_smoothed_match_that_stays_at_one_place_loses_trust():
    """A path waits at the last place before a gap of the map, which is best for as long."""
    rng = np.random.default_rng(9)
    reference = rng.integers(0, 100, (90, 12))
    waits = reference[[*range(40), *[40] * 40, *range(41, 90)]]
    chosen = Settings(matching="filter", pixels=12, smooth=True)
    matches = match_descriptors(descriptors(reference), descriptors(waits), chosen)
    assert (matches.place[40:80] == 40).all()
    assert 4 * matches.trust[60] < min(matches.trust[10], matches.trust[110])


@pytest.mark.parametrize("values", [1, 40, 200])
def test_smoothing_a_drive_in_segments_gives_the_same_bits(values, monkeypatch):
    """The forward pass is repeated from the states between segments, also with odometry."""
    rng = np.random.default_rng(8)
    reference = rng.integers(0, 100, (20, 6))
    queries = np.clip(reference[2:18].repeat(3, axis=0) + rng.integers(-9, 9, (48, 6)), 0, 99)
    places, drive = descriptors(reference), descriptors(queries)
    along = np.arange(20) * 1_000
    readings = np.arange(0, 50_000_000, 2_500_000, dtype=np.int64)  # some windows have none
    odometry = Odometry(readings, (readings / 3_000).astype(np.int64))
    chosen = Settings(matching="filter", pixels=6, smooth=True)

    def matched():
        return match_descriptors(places, drive, chosen, along_mm=along, odometry=odometry)

    whole = matched()
    monkeypatch.setattr(filtered_drive, "_SEGMENT_VALUES", values)
    monkeypatch.setattr(filtered_drive, "BLOCK_DISTANCES", 60)
    monkeypatch.setattr(math, "isqrt", lambda n: 1)
    assert matched() == whole


def random_distances(rng, places, windows, spacing):
    """Distances to places about `spacing` mm apart, and those of a query; None if not known."""
    along = np.cumsum(rng.integers(0, 2 * spacing + 1, places))
    if places < 2 or along[-1] - along[0] < places - 1:
        return None, [None] * windows
    travelled = rng.integers(-spacing, 4 * spacing, windows).tolist()
    return along, [mm if rng.random() < 0.7 else None for mm in travelled]


def random_map(rng, places, steps, along):
    """Transitions of a map of 100 events in a window, and what its page says."""
    seen, typical = rng.integers(-60, 60, places).astype(np.int32), rng.integers(-40, 40, places)
    page = drive_map(
        steps, seen.tolist(), typical.tolist(), 256 * 100, 2,
        [] if along is None else along.tolist(),
    )  # fmt: skip
    return Transitions(places, steps, seen, along, typical, 2), page


def drive_through(places: int, path: list[int], rng) -> np.ndarray:
    """Distances of a drive: 0 at the true place, and about 20 elsewhere."""
    distances = rng.integers(15, 25, (len(path), places))
    distances[np.arange(len(path)), path] = rng.integers(0, 3, len(path))
    return distances


def test_one_wrong_window_does_not_move_the_match():
    path = list(range(20))
    distances = drive_through(40, path, np.random.default_rng(0))
    distances[10, 35] = 0  # for one window, another place looks best
    distances[10, 10] = 8
    place_filter = PlaceFilter(Transitions(40, STEADY))
    assert [place_filter.update(row, 1).place for row in distances] == path


def test_a_drive_along_the_map_has_no_misfit_and_another_one_has():
    rng = np.random.default_rng(2)
    along, elsewhere = (PlaceFilter(Transitions(60, STEADY)) for _ in range(2))
    for row in drive_through(60, list(range(50)), rng):
        assert along.update(row, 1).misfit == 0
    jumping = drive_through(60, rng.permutation(50).tolist(), rng)
    misfits = [elsewhere.update(row, 1).misfit for row in jumping]
    assert min(misfits[-20:]) >= OFF_MAP_MISFIT
    paused = elsewhere.update(np.full(60, 20), 0)  # which says nothing
    assert paused.misfit == misfits[-1]


def test_after_being_carried_off_it_finds_itself_again():
    path = [*range(15), *range(60, 80)]
    place_filter = PlaceFilter(Transitions(100, STEADY))
    distances = drive_through(100, path, np.random.default_rng(1))
    matches = [place_filter.update(row, 1) for row in distances]
    places = [match.place for match in matches]
    assert places[:15] == path[:15]
    jump = next(i for i in range(15, len(path)) if places[i] == path[i])
    assert jump <= 20 and places[jump:] == path[jump:]
    assert matches[jump].trust < matches[14].trust  # a jump is not trusted at once


def test_a_view_that_stays_the_same_wins_no_trust():
    """A camera that stands, off the map, may see what it saw at one place of it."""
    distances = drive_through(60, [*range(10), *([30] * 25)], np.random.default_rng(4))
    place_filter = PlaceFilter(Transitions(60, STEADY), mean_activity=256)
    moving = [place_filter.update(row, 1) for row in distances[:10]]
    standing = [place_filter.update(row, 1) for row in distances[10:]]
    assert [match.place for match in standing[-19:]] == [30] * 19
    assert max(match.trust for match in standing[3:]) < moving[-1].trust // 2


def test_a_path_along_places_that_do_not_fit_is_not_trusted():
    """Past the edge of a map the path goes on for a while, but other places fit better."""
    distances = drive_through(60, list(range(10, 30)), np.random.default_rng(5))
    distances[15:] = 20
    distances[15:, 45:50] = 20 - 12 * np.eye(5, dtype=np.int64)
    place_filter = PlaceFilter(Transitions(60, replace(STEADY, restart=30)))
    matches = [place_filter.update(row, 1) for row in distances]
    assert [match.place for match in matches[:16]] == list(range(10, 26))
    before, past = matches[14], matches[15]
    assert before.trust > 200 and past.second_distance - past.distance > 15
    assert past.trust == 0


def test_a_large_margin_is_not_remembered_for_long():
    """Trust falls as fast from a huge margin as from one of 23 units."""
    falls = []
    for contrast in (25, 250):
        distances = np.full((9, 40), contrast)
        distances[np.arange(9), np.arange(9)] = 0
        distances[6:] = contrast  # nothing is seen any more
        place_filter = PlaceFilter(Transitions(40, replace(STEADY, restart=30)))
        falls.append([place_filter.update(row, 1).trust for row in distances])
    assert falls[0] == falls[1] and falls[0][5] > 180


def test_while_the_camera_stands_the_match_stays():
    rng = np.random.default_rng(3)
    moving = drive_through(50, list(range(10)), rng)
    standing = rng.integers(0, 3, (6, 50))  # without events all places look alike
    place_filter = PlaceFilter(
        Transitions(50, TransitionCosts()), mean_activity=activity_of_drive(np.full(50, 160))
    )
    places = [place_filter.update(row, 160).place for row in moving]
    assert places == list(range(10))
    assert [place_filter.update(row, 9).place for row in standing] == [9] * 6
    after = drive_through(50, list(range(10, 15)), rng)
    assert [place_filter.update(row, 160).place for row in after] == list(range(10, 15))


def test_a_stop_of_hours_without_an_event_does_not_move_the_match():
    """The mean activity falls to 0; a window without events must still be a pause."""
    place_filter = PlaceFilter(Transitions(50, TransitionCosts()), mean_activity=256 * 160)
    for row in drive_through(50, list(range(10)), np.random.default_rng(3)):
        place_filter.update(row, 160)
    hours = np.zeros((30_000, 50), dtype=np.int64)
    rows = place_filter.update_windows(hours[:, None], np.zeros(30_000, dtype=np.int64))
    assert set(rows.matches["place"].tolist()) == {9}
    assert place_filter.state.numbers[0].mean_activity == 0


def test_a_slower_drive_is_followed_where_all_places_look_alike():
    """Evidence tells the first place; from there on, only the number of events does."""
    distances = np.full((7, 50), 9)
    distances[0] += 30 * (np.arange(50) != 4)
    place_filter = PlaceFilter(Transitions(50, TransitionCosts()), mean_activity=256 * 160)
    rows = place_filter.update_windows(
        distances[:, None], np.array([160, 160, 160, 40, 30, 40, 160])
    )
    assert rows.matches["place"].tolist() == [4, 5, 6, 6, 6, 6, 7]


def test_a_place_of_few_events_is_left_as_fast_with_few():
    """What counts is the activity against that of the place, not that of the drive."""
    seen = np.full(50, 160)
    seen[10:20] = 20
    queries = np.full(30, 160)
    queries[10:20] = 20
    distances = np.full((30, 50), 9)
    distances[0] += 30 * (np.arange(50) != 0)
    transitions = Transitions(50, TransitionCosts(), place_activity(seen))
    place_filter = PlaceFilter(transitions, mean_activity=256 * 160)
    assert place_filter.update_windows(distances[:, None], queries).matches[
        "place"
    ].tolist() == list(range(30))


@given(st.integers(0, 2**23 - 1) | st.integers(0, 400), st.integers(0, 256 * (2**23 - 1)))
def test_the_activity_of_a_window_equals_the_oracle(events, mean_activity):
    assert log_activity(events) == ilog(events) <= LOG_TOP
    assert activity_of(events, mean_activity) == specification.activity_of(events, mean_activity)
    assert log_activity(2**23 - 1) == log_activity(2**40) == LOG_TOP


@given(st.lists(st.integers(0, 2**24), min_size=1, max_size=20))
def test_the_activity_of_a_place_is_a_byte(events):
    mean_activity = min(256 * sum(events) // len(events), 256 * (2**23 - 1)) // 256
    expected = [min(max(ilog(min(n, EVENTS_TOP)) - ilog(mean_activity), -128), 127) for n in events]
    assert place_activity(np.array(events)).tolist() == expected
    # of half windows, those that do not overlap make the mean activity
    twice = np.repeat(events, 2)
    twice[1::2] = 7
    assert place_activity(twice, 2)[::2].tolist() == expected


@pytest.mark.parametrize("number", BANK_COSTS)
def test_the_costs_by_activity_are_those_of_their_formula(number):
    assert bank_costs(number).tolist() == [list(row) for row in BANK_COSTS[number]]


def test_a_pause_has_less_than_an_eighth_of_the_usual_events():
    assert find_pauses(np.array([20, 19, 0]), 256 * 160).tolist() == [False, True, True]


def test_the_mean_outlasts_a_stop_of_minutes_and_yet_follows_a_drive_in_the_dark():
    stopped = [160] * 20 + [3] * 300 + [160] * 20
    assert find_pauses(np.array(stopped), 256 * 160).tolist() == [n == 3 for n in stopped]
    dark = find_pauses(np.full(1_000, 9), 256 * 160)
    assert dark[:700].all() and not dark[900:].any()


def test_a_restart_that_does_not_fit_is_refused():
    with pytest.raises(UsageError, match="expected 0 to 30"):
        TransitionCosts(restart=31)


def test_distances_must_be_one_a_place_and_whole():
    with pytest.raises(UsageError, match="expected 1 sums of windows to 4 places"):
        PlaceFilter(Transitions(4, TransitionCosts())).update(np.zeros(3, dtype=np.int64), 1)
    with pytest.raises(UsageError, match="distances are float64: give whole numbers"):
        PlaceFilter(Transitions(3, TransitionCosts())).update(np.array([0.1, 0.5, 0.2]), 1)
    with pytest.raises(UsageError, match="map of 0 places"):
        Transitions(0, TransitionCosts())
    with pytest.raises(UsageError, match="activities of 0 to 128, of shape"):
        Transitions(2, TransitionCosts(), place_activity=np.array([0, 128], dtype=np.int32))


def test_costs_follow_the_kind_of_window_and_the_gains():
    half = Settings(matching="filter", places_per_window=2)
    by_count = TransitionCosts.of(replace(half, window="count")).by_step
    assert (by_count.T == [4, 0, 0, 0, 0, 4]).all()
    # the hypothesis of half an octave more has the row below
    for number, gains in ((1, 1), (2, 7)):
        costs = TransitionCosts(places_per_window=number, gains=gains).by_step
        assert (costs[:, :-1, 1:] == costs[:, 1:, :-1]).all()
        rows = np.concatenate([costs[:, :, 0], costs[:, -1, 1:]], axis=1).T.tolist()
        table = [list(row) for row in BANK_COSTS[number]]
        first = rows.index(table[-2]) - 1
        assert rows[first : first + 19] == table[::-1]


@given(seed=st.integers(0, 2**32), places=st.integers(1, 30), queries=st.integers(1, 10))
def test_matches_of_a_traverse_are_those_of_the_oracle(seed, places, queries):
    rng = np.random.default_rng(seed)
    reference, query = rng.integers(0, 8, (places, 6)), rng.integers(0, 8, (3, queries, 6))
    chosen = replace(PRESETS["default"], smooth=False)
    described = replace(descriptors(query[0]), summed=query[1:].swapaxes(0, 1).astype(np.uint8))
    matches = match_descriptors(descriptors(reference), described, chosen)
    events, typical = reference.sum(axis=1).tolist(), typical_distances(reference.tolist())
    mean_activity = mean_activity_of(events)
    page = drive_map(
        TransitionCosts(gains=7), activities(events, mean_activity), typical, mean_activity, 3
    )
    distances = [
        [[distance(p, q) for p in reference.tolist()] for q in of_sums]
        for of_sums in query.swapaxes(0, 1).tolist()
    ]
    rows = windows_of(page, distances, query[0].sum(axis=1).tolist())
    expected = live_matches(rows)
    assert matches.place.tolist() == [match.place for match in expected]
    assert matches.distance.tolist() == [match.sum for match in expected]
    assert matches.trust.tolist() == [match.trust for match in expected]
    assert matches.misfit.tolist() == running_misfits(misfits_of(rows, typical))
    assert matches.query.tolist() == list(range(queries))
    for i, row in enumerate(rows):
        least = [min(column) for column in zip(*row.metrics, strict=True)]
        nearest = sorted(range(places), key=lambda k: (least[k], k))[:25]
        assert matches.candidates[i][matches.candidates[i] >= 0].tolist() == nearest
    with pytest.raises(MapError, match="gains = 7 needs those of sums too"):
        match_descriptors(descriptors(reference), descriptors(query[0]), chosen)
