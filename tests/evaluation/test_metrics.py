"""Metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate, precision_recall
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.settings import Settings
from tests import naive
from tests.streams import descriptors

DENOMINATORS = ("rejected-correct", "all-with-place")


def truth_of(correct, has_truth=None):
    correct = np.asarray(correct, dtype=bool)
    has_truth = (
        np.ones(correct.shape[1], dtype=bool) if has_truth is None else np.asarray(has_truth)
    )
    return GroundTruth(correct & has_truth, has_truth, "test")


@given(
    queries=st.lists(
        st.tuples(st.integers(0, 6), st.booleans(), st.booleans()), min_size=1, max_size=30
    ),
    denominator=st.sampled_from(DENOMINATORS),
)
def test_precision_and_recall_equal_the_oracle_at_every_threshold(queries, denominator):
    scores = [float(s) for s, _, _ in queries]
    correct = [c for _, c, _ in queries]
    has_place = [c or h for _, c, h in queries]
    curve = precision_recall(
        np.array(scores), np.array(correct), np.array(has_place), recall_denominator=denominator
    )
    expected = naive.precision_recall(scores, correct, has_place, denominator)
    assert list(zip(curve.tp.tolist(), curve.fp.tolist(), curve.fn.tolist(), strict=True)) == (
        expected
    )
    recalls = [tp / (tp + fn) for tp, fp, fn in expected if tp and 100 * tp >= 99 * (tp + fp)]
    assert curve.recall_at_precision(99) == max(recalls, default=0.0)


def test_ninety_nine_of_a_hundred_are_ninety_nine_per_cent():
    scores, correct = np.arange(100.0), np.arange(100) != 99
    curve = precision_recall(scores, correct, correct)
    assert curve.recall_at_precision(99) == 1.0
    assert curve.recall_at_precision(100) == 1.0  # at the threshold before the wrong one
    wrong_first = precision_recall(scores, np.arange(100) != 0, correct)
    assert wrong_first.recall_at_precision(99) == 1.0
    assert wrong_first.recall_at_precision(100) == 0.0


def test_average_precision_is_the_sum_of_steps():
    curve = precision_recall(
        np.array([1.0, 2.0, 3.0]), np.array([True, False, True]), np.ones(3, dtype=bool)
    )
    assert curve.average_precision == pytest.approx(0.5 * 1.0 + 0.5 * 2 / 3)


def test_a_match_without_a_second_is_the_least_sure_by_ratio():
    curve = precision_recall(
        np.array([np.nan, 0.5]), np.array([False, True]), np.ones(2, dtype=bool)
    )
    assert curve.threshold.tolist() == [0.5, np.inf]
    assert curve.tp.tolist() == [1, 1]


@given(seed=st.integers(0, 2**32), places=st.integers(1, 40), length=st.integers(1, 3))
def test_an_evaluation_equals_the_oracle(seed, places, length):
    rng = np.random.default_rng(seed)
    places += length
    queries = 12
    reference = rng.integers(0, 4, (places, 3))
    query = rng.integers(0, 4, (queries, 3))
    correct = rng.random((places, queries)) < 0.1
    has_truth = rng.random(queries) < 0.8
    has_truth[length // 2] = True
    settings = Settings(sequence_length=length)
    matches = match_descriptors(descriptors(reference), descriptors(query), settings)
    truth = truth_of(correct, has_truth)
    evaluation = evaluate(matches, truth)

    sums = naive.sequence_sums(naive.distance_matrix(reference.tolist(), query.tolist()), length)
    offset = length // 2
    rows = range(offset, offset + len(sums))
    columns = [j for j in range(len(sums[0])) if has_truth[j + offset]]
    best = [naive.best_and_second([row[j] for row in sums], 3)[0] + offset for j in columns]
    right = [bool(correct[k, j + offset]) for k, j in zip(best, columns, strict=True)]
    assert evaluation.queries == len(columns)
    assert evaluation.queries_unknown == len(sums[0]) - len(columns)
    placeless = sum(not correct[:, j + offset].any() for j in columns)
    assert evaluation.queries_without_place == placeless
    assert evaluation.precision_at_100_recall == sum(right) / len(right)
    # places that no whole sequence is centred on can never be found, but queries may be there
    reachable = [j for j in columns if correct[:, j + offset].any()]
    for n, recall in evaluation.recall_at.items():
        hits, _ = (
            naive.recall_at(
                [[row[j] for j in reachable] for row in sums],
                [[bool(correct[k, j + offset]) for j in reachable] for k in rows],
                n,
            )
            if reachable
            else (0, 0)
        )
        assert recall == hits / max(len(reachable), 1)


def test_a_truth_of_another_traverse_is_refused():
    matches = match_descriptors(
        descriptors([[0], [5]]), descriptors([[0]]), Settings(sequence_length=1)
    )
    with pytest.raises(GroundTruthError, match="covers 3 places and 1 queries, the matches 2"):
        evaluate(matches, truth_of(np.ones((3, 1))))
    with pytest.raises(GroundTruthError, match="map with places_per_window=1 if it is for whole"):
        evaluate(matches, truth_of(np.ones((1, 1))))


def test_a_truth_known_for_no_query_is_refused():
    same = descriptors([[0], [5]])
    matches = match_descriptors(same, same, Settings(sequence_length=1))
    with pytest.raises(GroundTruthError, match="known for none"):
        evaluate(matches, truth_of(np.eye(2), [False, False]))


def test_unknown_choices_are_wrong_use():
    same = descriptors([[0], [5]])
    matches = match_descriptors(same, same, Settings(sequence_length=1))
    with pytest.raises(UsageError, match="choose from distance, ratio"):
        evaluate(matches, truth_of(np.eye(2)), score="likelihood")
    with pytest.raises(UsageError, match="choose from rejected-correct, all-with-place"):
        evaluate(matches, truth_of(np.eye(2)), recall_denominator="all")


def test_a_query_is_missed_where_a_near_place_has_no_position():
    """The figure's denominator is the same for each number of nearest places."""
    places, queries = descriptors([[0], [5], [9], [10], [11], [12], [13]]), descriptors([[0], [8]])
    matches = match_descriptors(places, queries, Settings(sequence_length=1))
    correct = np.zeros((7, 2), dtype=bool)
    correct[0] = True  # the sixth nearest of the second query
    placed = np.arange(7) != 3
    evaluation = evaluate(matches, replace(truth_of(correct), placed=placed))
    assert (evaluation.recall_at[1], evaluation.recall_at[5], evaluation.recall_at[10]) == (
        0.5,
        0.5,
        1.0,
    )
