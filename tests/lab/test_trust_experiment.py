"""Quantile Transfer accepts the share that was right on a calibration drive."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from lab.experiments.trust import quantile_transfer
from lab.shipped_tables import Sample

MATCHES = st.lists(st.tuples(st.integers(-5, 20), st.booleans()), min_size=1, max_size=60)


def sampled(matches):
    trust, correct = (np.array(column) for column in zip(*matches, strict=True))
    every = np.ones(len(matches), bool)
    return Sample(trust.astype(np.int64), correct.astype(bool), every, ~every)


@given(MATCHES, st.sampled_from([0.5, 0.9, 1.0]))
def test_on_its_own_calibration_drive_it_reaches_the_precision_with_the_most_matches(
    matches, precision
):
    calibration = sampled(matches)
    accepted = quantile_transfer(calibration, calibration.trust, precision)
    tried = [calibration.trust >= level for level in np.unique(calibration.trust)]
    best = max(
        (int(each.sum()) for each in tried if calibration.correct[each].mean() >= precision),
        default=0,
    )
    assert accepted.sum() == best
    assert not accepted.any() or calibration.correct[accepted].mean() >= precision


@given(MATCHES, st.integers(1, 9), st.integers(-50, 50))
def test_scores_of_another_scale_are_accepted_alike(matches, factor, offset):
    calibration = sampled(matches)
    same = quantile_transfer(calibration, calibration.trust, 0.9)
    other = quantile_transfer(calibration, factor * calibration.trust + offset, 0.9)
    assert (same == other).all()
