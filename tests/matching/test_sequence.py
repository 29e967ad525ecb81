"""Sequences of windows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.errors import UsageError
from edge_vpr.matching.sequences import sequence_sums
from tests import naive


@given(
    seed=st.integers(0, 2**32),
    shape=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    data=st.data(),
)
def test_sequence_sums_equal_the_oracle(seed, shape, data):
    distances = np.random.default_rng(seed).integers(0, 1000, shape, dtype=np.int32)
    length = data.draw(st.integers(1, min(shape)))
    sums = sequence_sums(distances, length)
    assert sums.tolist() == naive.sequence_sums(distances.tolist(), length)


def test_sums_beyond_32_bits_do_not_wrap():
    distances = np.full((3, 3), 2**31 - 1, dtype=np.int32)
    assert sequence_sums(distances, 3).tolist() == [[3 * (2**31 - 1)]]


@pytest.mark.parametrize("length", [0, 4])
def test_a_sequence_that_does_not_fit_is_wrong_use(length):
    with pytest.raises(UsageError, match="sequence length"):
        sequence_sums(np.zeros((3, 5), dtype=np.int32), length)
