"""The place filter: equal to the oracle, and right where the camera stands."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from streams import descriptors

from edge_vpr.descriptors.pauses import find_pauses, mean_activity
from edge_vpr.errors import UsageError
from edge_vpr.matching.matches import match_descriptors
from edge_vpr.matching.place_filter import METRIC_TOP, PlaceFilter, StepPrices
from edge_vpr.settings import PRESETS, Settings

prices = st.builds(
    StepPrices,
    forward=st.lists(st.integers(0, 6), min_size=1, max_size=5).map(tuple),
    back=st.lists(st.integers(0, 6), max_size=2).map(tuple),
    restart=st.integers(1, 40),
)


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 30),
    windows=st.integers(1, 12),
    largest=st.sampled_from([1, 7, 300, 2**31]),
    priced=prices,
    exclusion=st.integers(0, 4),
    usual=st.sampled_from([0, 256 * 100, 256 * 3000]),
)
def test_metrics_answers_and_trust_equal_the_oracle(
    seed, places, windows, largest, priced, exclusion, usual
):
    rng = np.random.default_rng(seed)
    distances = rng.integers(0, largest + 1, (windows, places))
    events = rng.choice([0, 3, 90, 200], windows)
    found = PlaceFilter(places, priced, exclusion, usual)
    told = naive.place_filter(
        distances.tolist(), events.tolist(), priced.forward, priced.back, priced.restart,
        exclusion, usual,
    )  # fmt: skip
    for row, count, (metric, best, second, trust) in zip(distances, events, told, strict=True):
        before = found.answer(row, int(count))
        answer = found.advance(row, int(count))
        assert before == answer  # asking changes nothing, and tells what advancing will
        assert found.metric.tolist() == metric
        assert (answer.place, answer.second, answer.trust) == (best, second, trust)
        assert answer.ties == metric.count(metric[best]) - 1
        assert max(metric) <= METRIC_TOP


def test_after_a_spread_above_2_to_16_a_window_is_scaled_by_its_own():
    distances = np.array([[0, 10**6, 0, 0], [9, 5, 40, 7], [9, 5, 40, 7]])
    found = PlaceFilter(4, StepPrices())
    told = naive.place_filter(distances.tolist(), [50] * 3, (1, 0, 1), (), 16, 3, 0)
    for row, (metric, best, _, trust) in zip(distances, told, strict=True):
        answer = found.advance(row, 50)
        assert found.metric.tolist() == metric
        assert (answer.place, answer.trust) == (best, trust)
    assert len(set(told[1][0])) > 1  # evidence counted, though the window before had none


def drive_through(places: int, path: list[int], rng, noise: int = 2) -> np.ndarray:
    """Distances of a drive: 0 at the true place, and about 20 elsewhere."""
    distances = rng.integers(15, 25, (len(path), places))
    distances[np.arange(len(path)), path] = rng.integers(0, noise + 1, len(path))
    return distances


def test_one_wrong_window_does_not_move_the_answer():
    path = list(range(20))
    distances = drive_through(40, path, np.random.default_rng(0))
    distances[10, 35] = 0  # for one window, another place looks best
    distances[10, 10] = 8
    found = PlaceFilter(40, StepPrices())
    assert [found.advance(row, 1).place for row in distances] == path


def test_after_being_carried_off_it_finds_itself_again():
    path = [*range(15), *range(60, 80)]
    found = PlaceFilter(100, StepPrices())
    distances = drive_through(100, path, np.random.default_rng(1))
    answers = [found.advance(row, 1) for row in distances]
    places = [answer.place for answer in answers]
    assert places[:15] == path[:15]
    jump = next(i for i in range(15, len(path)) if places[i] == path[i])
    assert jump <= 20 and places[jump:] == path[jump:]
    assert answers[jump].trust < answers[jump - 3].trust  # a jump is not trusted at once


def test_a_view_that_stays_the_same_wins_no_trust():
    """A camera that stands, off the map, may see what it saw at one place of it."""
    distances = drive_through(60, [*range(10), *([30] * 25)], np.random.default_rng(4))
    found = PlaceFilter(60, StepPrices(), activity=256)
    moving = [found.advance(row, 1) for row in distances[:10]]
    standing = [found.advance(row, 1) for row in distances[10:]]
    assert [match.place for match in standing[-20:]] == [30] * 20
    assert max(match.trust for match in standing[3:]) < moving[-1].trust // 2


def test_steps_back_are_followed_only_where_they_are_priced():
    path = [*range(10, 25), *range(24, 5, -1)]
    distances = drive_through(40, path, np.random.default_rng(2), noise=8)
    forward = PlaceFilter(40, StepPrices(restart=60))
    both = PlaceFilter(40, StepPrices(back=(0,), restart=60))
    assert [both.advance(row, 1).place for row in distances] == path
    assert [forward.advance(row, 1).place for row in distances] != path


def test_while_the_camera_stands_the_answer_stays():
    rng = np.random.default_rng(3)
    moving = drive_through(50, list(range(10)), rng)
    standing = rng.integers(0, 3, (6, 50))  # without events all places look alike
    found = PlaceFilter(50, StepPrices(), activity=mean_activity(np.full(50, 160)))
    places = [found.advance(row, 160).place for row in moving]
    assert places == list(range(10))
    assert [found.advance(row, 9).place for row in standing] == [9] * 6
    after = drive_through(50, list(range(10, 15)), rng)
    assert [found.advance(row, 160).place for row in after] == list(range(10, 15))


def test_a_pause_has_less_than_a_sixteenth_of_the_usual_events():
    assert find_pauses(np.array([10, 9, 0]), 256 * 160).tolist() == [False, True, True]
    # the usual number follows the drive: in dim light nothing pauses for long
    assert not find_pauses(np.full(400, 9), 256 * 160)[-1]


@pytest.mark.parametrize(
    "prices",
    [{"forward": ()}, {"forward": (-1,)}, {"back": (300,)}, {"restart": 255}],
)
def test_prices_that_do_not_fit_are_refused(prices):
    with pytest.raises(UsageError, match="expected 0 to 254"):
        StepPrices(**prices)


def test_distances_must_be_one_a_place():
    with pytest.raises(UsageError, match="3 distances to 4 places"):
        PlaceFilter(4, StepPrices()).advance(np.zeros(3, dtype=np.int64), 1)
    with pytest.raises(UsageError, match="map of 0 places"):
        PlaceFilter(0, StepPrices())


def test_prices_follow_the_kind_of_window_unless_they_are_given():
    assert StepPrices.of(Settings()).forward == (1, 0, 1)
    assert StepPrices.of(Settings(window="count")).forward == (1, 0, 0, 1)
    assert StepPrices.of(Settings(filter_steps=(2, 0))).forward == (2, 0)


@given(seed=st.integers(0, 2**32), places=st.integers(1, 30), queries=st.integers(1, 10))
def test_matches_of_a_traverse_are_those_of_the_oracle(seed, places, queries):
    rng = np.random.default_rng(seed)
    reference, query = rng.integers(0, 8, (places, 6)), rng.integers(0, 8, (queries, 6))
    found = match_descriptors(descriptors(reference), descriptors(query), PRESETS["default"])
    matrix = naive.distance_matrix(query.tolist(), reference.tolist())
    told = naive.place_filter(
        matrix, query.sum(axis=1).tolist(), (1, 0, 1), (), 16, 3,
        256 * int(reference.sum()) // places,
    )  # fmt: skip
    assert found.place.tolist() == [best for _, best, _, _ in told]
    assert found.distance_sum.tolist() == [metric[best] for metric, best, _, _ in told]
    assert found.trust.tolist() == [trust for *_, trust in told]
    assert found.query.tolist() == list(range(queries))
    for i, (metric, *_) in enumerate(told):
        nearest = sorted(range(places), key=lambda k: (metric[k], k))[:25]
        assert found.candidates[i][found.candidates[i] >= 0].tolist() == nearest
