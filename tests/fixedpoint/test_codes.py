"""Counter codes: the tables, held to their definition in exact arithmetic."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fixedpoint.codes import (
    KINDS,
    CounterCode,
    PixelCodes,
    _logarithm,
    learn_full_scale,
    packed_bytes,
)
from fixedpoint.errors import FixedPointError
from tests import naive

kinds = st.sampled_from(KINDS)
codes = st.builds(CounterCode, kinds, st.integers(1, 16), st.integers(0, 700))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bits", [1, 2, 3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize("full", [1, 2, 3, 7, 15, 63, 100, 127, 255])
def test_every_entry_of_every_small_table_is_the_nearest_code(kind, bits, full):
    code = CounterCode(kind, bits, full)
    top = min(2**bits - 1, full)
    assert code.top == top
    expected = [naive.counter_code(kind, bits, full, count) for count in range(full + 1)]
    assert code.table.tolist() == expected


@given(codes)
@settings(max_examples=60)
def test_a_table_does_not_decrease_and_goes_from_zero_to_the_top(code):
    table = code.table.astype(int)
    assert (np.diff(table) >= 0).all()
    assert (table[0], table[-1]) == (0, code.top)
    assert code.top <= code.format.highest
    assert table.size == code.full_scale + 1


def test_ties_of_logarithms_are_decided_in_integers():
    """log 3 is half of log 9, to the last bit: (1 + 2)**2 = 1 + 8, so that code 1/2 becomes 1."""
    assert CounterCode("log", 1, 8).table.tolist() == [0, 0, 1, 1, 1, 1, 1, 1, 1]
    # 2**k counts lie at the ends of half-open intervals all along the table
    ends = 2 ** np.arange(9) - 1
    assert _logarithm(ends, 4, 255).tolist() == [0, 1, 1, 2, 2, 3, 3, 4, 4]


def test_the_widest_logarithm_is_built_and_is_exact_where_doubles_are_closest():
    code = CounterCode("log", 16, 65_535)
    table = code.table.astype(int)
    assert (np.diff(table) >= 0).all()
    assert (table[0], table[-1]) == (0, 65_535)
    exact = 65_535 * np.log1p(np.arange(65_536)) / math.log(65_536)
    assert (np.abs(table - exact) <= 0.5 + 1e-6).all()


@pytest.mark.parametrize("limit", [1, 2, 10, 15, 16, 255, 300, 65_535])
def test_a_linear_code_that_fits_its_bits_is_a_saturating_counter(limit):
    code = CounterCode.saturating(limit)
    counts = np.array([0, 1, limit - 1, limit, limit + 1, 10**9])
    assert code.encode(counts).tolist() == np.minimum(counts, limit).tolist()
    assert limit <= code.format.highest
    assert CounterCode("linear", 4) == CounterCode.saturating(15)


@given(code=codes, data=st.data())
@settings(max_examples=60)
def test_encode_looks_up_whatever_the_dtype_and_decode_comes_back_to_the_same_code(code, data):
    counts = np.array(data.draw(st.lists(st.integers(0, 2**31 - 1), max_size=9)), dtype=np.int64)
    table = code.table.tolist()
    expected = [table[min(count, code.full_scale)] for count in counts.tolist()]
    for dtype in (np.int64, np.uint32, np.uint64):
        assert code.encode(counts.astype(dtype)).tolist() == expected
    low = (counts % 256).astype(np.uint8)
    assert code.encode(low).tolist() == [table[min(c, code.full_scale)] for c in low.tolist()]
    used = np.unique(code.table)
    assert code.encode(code.decode(used)).tolist() == used.tolist()
    everything = code.decode(np.arange(code.top + 1))
    assert (np.diff(everything) >= 0).all()
    assert everything[-1] == code.full_scale


@given(seed=st.integers(0, 2**32), kind=kinds, bits=st.integers(1, 9), counters=st.integers(1, 6))
def test_pixel_codes_are_one_code_a_counter(seed, kind, bits, counters):
    rng = np.random.default_rng(seed)
    full_scale = 2 ** rng.integers(1, 11, counters) - 1
    counts = rng.integers(0, 2000, (5, counters))
    pixel_codes = PixelCodes.scaled(kind, bits, full_scale)
    single = [CounterCode(kind, bits, int(full)) for full in full_scale]
    expected = [[code.encode(c) for code, c in zip(single, row, strict=True)] for row in counts]
    assert pixel_codes.encode(counts).tolist() == expected
    assert [pixel_codes.codes[r] for r in pixel_codes.row] == single
    codes = pixel_codes.encode(counts)
    assert np.array_equal(pixel_codes.encode(pixel_codes.decode(codes)), codes)
    for j, code in enumerate(single):
        row = pixel_codes.tables[pixel_codes.row[j]]
        assert row[: code.full_scale + 1].tolist() == code.table.tolist()
        assert set(row[code.full_scale :].tolist()) == {code.top}


def test_shared_codes_are_the_code():
    code, counts = CounterCode("log", 4), np.arange(300).reshape(3, 100)
    assert np.array_equal(PixelCodes.shared(code, 100).encode(counts), code.encode(counts))


@given(st.lists(st.integers(0, 2**18), min_size=1, max_size=40))
def test_a_learned_full_scale_holds_nine_of_ten_counts_and_no_smaller_one_does(counts):
    (full_scale,) = learn_full_scale(np.array(counts)[:, None]).tolist()
    assert full_scale == naive.usual_full_scale(counts)


def test_codes_are_packed_without_gaps():
    assert [packed_bytes(150, bits) for bits in (1, 3, 4, 8)] == [19, 57, 75, 150]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: CounterCode("cubic", 4),
        lambda: CounterCode("log", 0),
        lambda: CounterCode("log", 17),
        lambda: CounterCode("log", 4, -1),
        lambda: CounterCode("log", 4, 65_536),
        lambda: CounterCode.saturating(65_536),
        lambda: PixelCodes((), np.zeros(3)),
        lambda: PixelCodes((CounterCode("log", 4),), np.ones(3)),
        lambda: PixelCodes((CounterCode("log", 4), CounterCode("log", 3)), np.zeros(3)),
    ],
)
def test_wrong_use_is_told(wrong):
    with pytest.raises(FixedPointError):
        wrong()


def test_more_different_scales_than_a_byte_can_name_are_refused():
    with pytest.raises(FixedPointError, match="257 different full scales"):
        PixelCodes.scaled("linear", 4, range(1, 258))
    codes = PixelCodes.scaled("linear", 4, range(1, 257))
    assert codes.row[-1] == 255
    with pytest.raises(FixedPointError, match="expected 0 to 255"):
        PixelCodes(codes.codes, np.array([256]))
