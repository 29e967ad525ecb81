"""Widths of integers and of their sums, by the largest value that can occur."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fixedpoint.formats import FixedPointError, UnsignedFormat, packed_bytes


@given(width=st.integers(1, 40), n=st.integers(1, 10**6))
def test_a_sum_format_holds_every_sum_and_one_bit_less_does_not(width, n):
    largest = n * (2**width - 1)
    of_sum = UnsignedFormat(width).sum_of(n)
    assert 2**of_sum.width > largest
    assert of_sum.width == 1 or 2 ** (of_sum.width - 1) <= largest


@pytest.mark.parametrize(("bits", "sad", "along"), [(4, 12, 15), (6, 14, 17), (8, 16, 19)])
def test_the_widths_of_the_design_of_150_pixels_and_sequences_of_ten(bits, sad, along):
    counter = UnsignedFormat(bits)
    assert counter.sum_of(150).width == sad
    assert counter.sum_of(10 * 150).width == along


@given(st.integers(0, 2**64 - 1))
def test_a_format_holds_the_largest_value_that_it_is_made_for(largest):
    holding = UnsignedFormat.holding(largest)
    assert holding.highest >= largest
    assert holding.width == 1 or UnsignedFormat(holding.width - 1).highest < largest


def test_codes_are_packed_without_gaps():
    assert [packed_bytes(150, bits) for bits in (1, 3, 4, 8)] == [19, 57, 75, 150]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: UnsignedFormat(0), "width 0: expected 1 bit or more"),
        (lambda: UnsignedFormat(1.5), "width 1.5: expected a number of bits"),
        (lambda: UnsignedFormat(8).sum_of(0), "sum of 0 numbers: expected 1 or more"),
    ],
)
def test_wrong_use_is_told(wrong, message):
    with pytest.raises(FixedPointError, match=message):
        wrong()


def test_formats_and_codes_need_no_compiler():
    """A design tool need not wait for Numba."""
    code = "import fixedpoint.formats, fixedpoint.own_mean, sys; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
