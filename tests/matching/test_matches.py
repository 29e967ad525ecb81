"""Matching a query traverse, whole or in blocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import MapError, UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.evaluation.tracks import Track
from edge_vpr.matching import sequences
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.search import CANDIDATES
from edge_vpr.settings import Settings
from tests import naive
from tests.maps import saved_files
from tests.streams import descriptors


@given(
    seed=st.integers(0, 2**32),
    places=st.integers(1, 40),
    queries=st.integers(1, 12),
    pixels=st.integers(1, 6),
    largest=st.sampled_from([1, 3, 300]),
    exclusion=st.integers(0, 5),
    block=st.sampled_from([1, 100, 10_000]),
    data=st.data(),
)
def test_matches_equal_the_oracle_in_blocks_of_any_size(
    seed, places, queries, pixels, largest, exclusion, block, data
):
    rng = np.random.default_rng(seed)
    reference = rng.integers(0, largest + 1, (places, pixels))
    query = rng.integers(0, largest + 1, (queries, pixels))
    length = data.draw(st.integers(1, min(places, queries)))
    settings = Settings(sequence_length=length, exclusion=exclusion)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequences, "BLOCK_DISTANCES", block)
        matches = match_descriptors(descriptors(reference), descriptors(query), settings)

    offset = length // 2
    sums = naive.sequence_sums(naive.distance_matrix(reference.tolist(), query.tolist()), length)
    assert matches.query.tolist() == list(range(offset, offset + queries - length + 1))
    for i in range(len(matches)):
        column = [row[i] for row in sums]
        best, second, ties = naive.best_and_second(column, exclusion)
        assert matches.place[i] == best + offset
        assert matches.distance[i] == column[best] / length
        assert matches.ties[i] == ties
        assert matches.second[i] == (-1 if second < 0 else second + offset)
        if second >= 0:
            assert matches.second_distance[i] == column[second] / length
        nearest = sorted(range(len(column)), key=lambda k: (column[k], k))[:CANDIDATES]
        kept = matches.candidates[i][matches.candidates[i] >= 0]
        assert kept.tolist() == [k + offset for k in nearest]


def test_sums_beyond_32_bits_do_not_wrap():
    distances = np.full((3, 3), 2**31 - 1, dtype=np.int32)
    assert sequences.sequence_sums(distances, 3).tolist() == [[3 * (2**31 - 1)]]


def test_the_ratio_is_one_in_doubt_and_not_a_number_without_a_second():
    settings = Settings(sequence_length=1, exclusion=1)
    reference = descriptors([[0], [9], [9], [0]])
    matches = match_descriptors(reference, descriptors([[0], [9]]), settings)
    assert matches.place.tolist() == [0, 1]
    assert matches.second.tolist() == [3, 3]
    assert matches.ratio.tolist() == [1.0, 0.0]
    alone = match_descriptors(descriptors([[4]]), descriptors([[5]]), settings)
    assert alone.second.tolist() == [-1]
    assert np.isnan(alone.ratio).all()
    assert np.isnan(alone.second_distance).all()


def test_descriptors_of_other_lengths_are_refused():
    with pytest.raises(MapError, match="describe both with the same map"):
        match_descriptors(descriptors([[1, 2]]), descriptors([[1]]), Settings(sequence_length=1))


def test_a_sequence_longer_than_the_traverse_is_wrong_use():
    with pytest.raises(UsageError, match="longer than the traverse"):
        match_descriptors(descriptors([[1]]), descriptors([[1], [2]]), Settings(sequence_length=2))


def test_what_is_printed_of_results_is_one_short_line_whatever_their_size():
    rng = np.random.default_rng(0)
    reference = saved_files.map_of({"matching": "filter"}, rng)
    matches = match_descriptors(reference.places, reference.places, reference.settings)
    n = len(reference)
    truth = GroundTruth(np.eye(n, dtype=np.bool_), np.ones(n, dtype=np.bool_), "the test")
    result = evaluate(matches, truth)
    times = np.arange(n, dtype=np.int64)
    shown = [
        *(reference, reference.places, reference.pixel_map, reference.confidence, reference.route),
        *(matches, truth, result, result.curve, Track(times, times[:, None] * 1.0)),
    ]
    for each in shown:
        assert repr(each).startswith(f"{type(each).__name__}(")
        assert len(repr(each)) < 120
        assert "array" not in repr(each)
    assert "place filter" in repr(matches) and "L =" not in repr(matches)
