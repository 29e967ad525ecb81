"""Formats and exact operations: every value of every small format, then any, then another library.

What must come out is said here in Fractions and by searching, not by the arithmetic of the package.
"""

from __future__ import annotations

import math
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from fixedpoint import kernels, ops
from fixedpoint.errors import FixedOverflowError, FixedPointError
from fixedpoint.formats import FixedFormat
from fixedpoint.rounding import Overflow, Rounding

SMALL = [FixedFormat(signed, width, 0) for signed in (False, True) for width in range(1, 7)]
HALF = Fraction(1, 2)
ROUNDED = {
    Rounding.FLOOR: math.floor,
    Rounding.CEIL: math.ceil,
    Rounding.ZERO: math.trunc,
    Rounding.NEAREST_UP: lambda x: math.floor(x + HALF),
    Rounding.NEAREST_EVEN: round,  # of a Fraction, to even
    Rounding.NEAREST_AWAY: lambda x: math.trunc(x + (HALF if x > 0 else -HALF)),
}


def raws(of: FixedFormat) -> range:
    """Every raw integer that so many bits can be, by what a bit is worth."""
    if of.signed:
        return range(-(2 ** (of.width - 1)), 2 ** (of.width - 1))
    return range(2**of.width)


@cache
def fitted(number: int, to: FixedFormat, overflow: Overflow) -> int | None:
    """What `fit` must give; None for an error."""
    if number in raws(to):
        return number
    if overflow is Overflow.ERROR:
        return None
    if overflow is Overflow.SATURATE:
        return min(raws(to), key=lambda raw: abs(raw - number))
    return next(raw for raw in raws(to) if (raw - number) % 2**to.width == 0)


def outcome(function, *arguments):
    """What a function gives; None for an overflow error."""
    try:
        return function(*arguments)
    except FixedOverflowError:
        return None


formats = st.builds(FixedFormat, st.booleans(), st.integers(1, 60), st.integers(-70, 70))
roundings, overflows = st.sampled_from(Rounding), st.sampled_from(Overflow)


def raws_of(of: FixedFormat):
    return st.integers(of.lowest, of.highest)


# Operations


@njit
def _resized(numbers, of, to, rounding, overflow, out):
    for i in range(numbers.size):
        out[i] = kernels.resize(numbers[i], of, to, rounding, overflow)


@pytest.mark.parametrize("shift", range(-2, 8))
def test_resize_of_every_value_of_every_small_format_in_every_mode(shift):
    """Both the Python function and the kernel, held to Fractions and to a search."""
    for of in SMALL:
        of = of._replace(frac=shift)
        numbers = np.array(raws(of), dtype=of.numpy_dtype())
        for rounding in Rounding:
            near = [ROUNDED[rounding](raw * of.step) for raw in raws(of)]
            for to in SMALL:
                for overflow in Overflow:
                    modes = (of, to, rounding, overflow)
                    expected = [fitted(number, to, overflow) for number in near]
                    assert [outcome(ops.resize, raw, *modes) for raw in raws(of)] == expected, modes
                    if overflow is not Overflow.ERROR:
                        out = np.zeros(numbers.size, dtype=to.numpy_dtype())
                        _resized(numbers, *modes, out)
                        assert out.tolist() == expected, modes


def test_fit_of_every_number_in_and_around_every_small_format_in_every_mode():
    for to in SMALL:
        for number in range(2 * to.lowest - 70, 2 * to.highest + 70):
            for overflow in Overflow:
                expected = fitted(number, to, overflow)
                assert outcome(ops.fit, number, to, overflow) == expected
                assert outcome(kernels.fit, number, to, overflow) == expected


@pytest.mark.parametrize("frac", [-1, 0, 3])
def test_quantize_of_every_quarter_step_in_and_around_every_small_format(frac):
    for to in SMALL:
        to = to._replace(frac=frac)
        for quarters in range(4 * to.lowest - 9, 4 * to.highest + 10):
            value = quarters * Fraction(2) ** -(frac + 2)
            for rounding in Rounding:
                near = ROUNDED[rounding](Fraction(quarters, 4))
                for overflow in Overflow:
                    expected = fitted(near, to, overflow)
                    for given_as in (value, float(value)):
                        found = outcome(ops.quantize, given_as, to, rounding, overflow)
                        assert found == expected, (given_as, to, rounding, overflow)
                    found = outcome(kernels.quantize, float(value), to, rounding, overflow)
                    assert found == expected, (value, to, rounding, overflow)


def test_sums_and_differences_of_every_pair_of_every_small_format():
    for of in SMALL:
        for a in raws(of):
            for b in raws(of):
                expected = min(max(a + b, min(raws(of))), max(raws(of)))
                assert ops.saturating_add(a, b, of) == expected
                assert kernels.saturating_add(a, b, of) == expected
                difference = a - b if a > b else b - a
                assert ops.absolute_difference(a, b) == difference
                assert kernels.absolute_difference(a, b) == difference
                assert difference in raws(ops.difference_format(of))
        # not one bit less would do
        assert max(raws(of)) - min(raws(of)) == ops.difference_format(of).highest


@given(of=formats, to=formats, rounding=roundings, overflow=overflows, data=st.data())
def test_resize_of_any_format_is_its_definition(of, to, rounding, overflow, data):
    raw = data.draw(raws_of(of))
    near = ROUNDED[rounding](raw * Fraction(2) ** (to.frac - of.frac))
    found = outcome(ops.resize, raw, of, to, rounding, overflow)
    if to.lowest <= near <= to.highest:
        assert found == near
    elif overflow is Overflow.ERROR:
        assert found is None
    elif overflow is Overflow.SATURATE:
        assert found == (to.lowest if near < 0 else to.highest)
    else:
        assert to.holds(found)
        assert (found - near) % 2**to.width == 0
    if abs(near) < 2**61 and abs(raw) < 2**61:
        assert outcome(kernels.resize, raw, of, to, rounding, overflow) == found


@given(
    value=st.floats(allow_nan=False, allow_infinity=False, width=64),
    to=formats,
    rounding=roundings,
    overflow=overflows,
)
def test_the_kernel_quantizes_any_double_as_exact_fractions_do(value, to, rounding, overflow):
    if abs(value) > 2.0**900:
        value /= 2.0**200
    expected = outcome(ops.quantize, value, to, rounding, overflow)
    assert outcome(kernels.quantize, value, to, rounding, overflow) == expected


@given(of=formats, rounding=roundings, data=st.data())
def test_a_format_keeps_its_own_numbers(of, rounding, data):
    raw = data.draw(raws_of(of))
    assert ops.resize(raw, of, of, rounding, Overflow.ERROR) == raw
    assert ops.quantize(of.value(raw), of, rounding, Overflow.ERROR) == raw


@pytest.mark.parametrize(
    ("value", "raw"),
    [
        (3, 12), (0.3, 1), (np.float32(0.3), 1), (np.int8(-3), -12), (Fraction(1, 3), 1),
        (Decimal("0.125"), 0), (Decimal("0.375"), 2), (True, 4), (np.uint64(2**60), 127),
    ],
)  # fmt: skip
def test_numbers_of_every_kind_are_quantized_exactly(value, raw):
    to = FixedFormat(True, 8, 2)
    assert ops.quantize(value, to, Rounding.NEAREST_EVEN, Overflow.SATURATE) == raw


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1", None, 1j])
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(FixedPointError, match="not a finite number"):
        ops.quantize(value, FixedFormat(True, 8, 2), Rounding.ZERO, Overflow.WRAP)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.uint32, np.int64, np.uint64])
def test_numpy_and_numba_integers_do_not_wrap_before_they_are_widened(dtype):
    """3 - 5 is 2 apart and 100 + 100 is 127 in 8 bits, whatever the operands are stored in."""
    byte = FixedFormat(True, 8, 0)
    for module in (ops, kernels):
        assert module.absolute_difference(dtype(3), dtype(5)) == 2
        assert module.saturating_add(dtype(100), dtype(100), byte) == 127
        assert module.resize(dtype(100), byte, byte._replace(frac=3), 0, Overflow.WRAP) == 32
        assert module.sad(np.array([3, 100], dtype), np.array([5, 0], dtype)) == 102
        assert module.exact_sum(np.full(1000, 100, dtype)) == 100_000


def test_kernels_are_inlined_with_format_and_modes_as_constants():
    """The loop that calls them gives what the Python functions give, element by element."""
    of, to = FixedFormat(False, 8, 4), FixedFormat(True, 6, 2)

    @njit
    def run(raws, out):
        for i in range(raws.size):
            out[i] = kernels.resize(raws[i], of, to, Rounding.NEAREST_EVEN, Overflow.SATURATE)

    values, out = np.arange(256, dtype=np.uint8), np.zeros(256, dtype=np.int8)
    run(values, out)
    modes = (of, to, Rounding.NEAREST_EVEN, Overflow.SATURATE)
    assert out.tolist() == [ops.resize(raw, *modes) for raw in range(256)]


# Growth


@given(of=formats.filter(lambda f: f.width < 40), n=st.integers(1, 10**6))
def test_a_sum_format_holds_every_sum_and_one_bit_less_does_not(of, n):
    found = ops.sum_format(of, n)
    assert (found.signed, found.frac) == (of.signed, of.frac)
    assert found.holds(n * of.lowest)
    assert found.holds(n * of.highest)
    if found.width > 1:
        less = found._replace(width=found.width - 1)
        assert not (less.holds(n * of.lowest) and less.holds(n * of.highest))


@pytest.mark.parametrize(("bits", "sad", "along"), [(4, 12, 15), (6, 14, 17), (8, 16, 19)])
def test_the_widths_of_the_design_of_150_pixels_and_sequences_of_ten(bits, sad, along):
    counter = FixedFormat(False, bits, 0)
    assert ops.sad_format(counter, 150).width == sad
    assert ops.sad_format(counter, 10 * 150).width == along


def test_the_sad_of_the_extremes_fills_its_format():
    low, high = [-128] * 3, [127] * 3
    assert ops.sad(low, high) == 3 * 255 == kernels.sad(np.array(low), np.array(high))
    assert ops.sad_format(FixedFormat(True, 8, 0), 3) == FixedFormat(False, 10, 0)


# Another implementation


def test_resize_and_sums_are_those_of_apytypes():
    """Every value of signed formats up to 6 bits, against an independent library."""
    apy = pytest.importorskip("apytypes", reason="apytypes has no wheel here")
    theirs = {
        Rounding.FLOOR: apy.QuantizationMode.TRN,
        Rounding.CEIL: apy.QuantizationMode.TRN_INF,
        Rounding.ZERO: apy.QuantizationMode.TRN_ZERO,
        Rounding.NEAREST_UP: apy.QuantizationMode.RND,
        Rounding.NEAREST_EVEN: apy.QuantizationMode.RND_CONV,
        Rounding.NEAREST_AWAY: apy.QuantizationMode.RND_INF,
    }
    modes = {Overflow.SATURATE: apy.OverflowMode.SAT, Overflow.WRAP: apy.OverflowMode.WRAP}
    signed = [of for of in SMALL if of.signed]
    for of in signed:
        of = of._replace(frac=3)
        for raw in raws(of):
            number = apy.APyFixed(raw % 2**of.width, of.width - of.frac, of.frac)
            for width in range(1, 7):
                for frac in range(-1, 5):
                    to = FixedFormat(True, width, frac)
                    for rounding, quantization in theirs.items():
                        for overflow, mode in modes.items():
                            cast = number.cast(width - frac, frac, quantization, mode)
                            found = ops.resize(raw, of, to, rounding, overflow)
                            assert found % 2**width == cast.to_bits(), (raw, of, to, rounding)
            for other in raws(of):
                second = apy.APyFixed(other % 2**of.width, of.width - of.frac, of.frac)
                difference = abs(number - second)
                assert ops.absolute_difference(raw, other) * of.step == Fraction(float(difference))
                total = (number + second).cast(
                    of.width - of.frac, of.frac, overflow=apy.OverflowMode.SAT
                )
                assert ops.saturating_add(raw, other, of) % 2**of.width == total.to_bits()


# Formats and notations


@given(formats)
def test_every_notation_is_read_back_as_the_format_that_wrote_it(of):
    for text in (of.matlab(), of.numerictype(), of.ap_fixed(), of.vhdl(), str(of)):
        assert FixedFormat.parse(text) == of
    for convention in ("ARM", "TI"):
        assert FixedFormat.parse(of.q(convention), q=convention) == of


@given(formats.filter(lambda f: f.width <= 60))
def test_the_container_is_the_narrowest_that_holds_the_format(of):
    held = np.iinfo(of.numpy_dtype())
    assert held.min <= of.lowest
    assert of.highest <= held.max
    assert held.bits == 8 or of.width > held.bits // 2
    assert FixedFormat.parse(of.c_type()) == FixedFormat.parse(of.numpy_dtype().name)
    assert FixedFormat.parse(of.c_type()) == FixedFormat(of.signed, held.bits, 0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # as their own documents explain them
        ("sfix16_En8", (True, 16, 8)),
        ("ufix8", (False, 8, 0)),
        ("sfix8_E3", (True, 8, -3)),
        ("numerictype(1, 16, 15)", (True, 16, 15)),
        ("numerictype(false,8,0)", (False, 8, 0)),
        ("ap_fixed<16,8>", (True, 16, 8)),
        ("ap_ufixed<8, 10>", (False, 8, -2)),
        ("ap_uint<12>", (False, 12, 0)),
        ("ap_int<12>", (True, 12, 0)),
        ("ufixed(7 downto -8)", (False, 16, 8)),
        ("sfixed (3 downto -4)", (True, 8, 4)),
        ("uint16_t", (False, 16, 0)),
        ("int8", (True, 8, 0)),
        ("UQ16", (False, 16, 16)),
        ("UQ8.8", (False, 16, 8)),
    ],
)
def test_notations_mean_what_their_field_means(text, expected):
    assert FixedFormat.parse(text) == FixedFormat(*expected)


def test_arm_counts_the_sign_and_ti_does_not():
    assert FixedFormat.parse("Q1.15", q="ARM") == FixedFormat(True, 16, 15)
    assert FixedFormat.parse("Q0.15", q="TI") == FixedFormat(True, 16, 15)
    assert FixedFormat.parse("Q15", q="ARM") == FixedFormat.parse("Q15", q="TI")
    assert FixedFormat(True, 16, 8).q("ARM") == "Q8.8"
    assert FixedFormat(True, 16, 8).q("TI") == "Q7.8"
    assert FixedFormat(False, 16, 8).q("ARM") == FixedFormat(False, 16, 8).q("TI") == "UQ8.8"


def test_a_q_without_its_convention_is_refused_with_both_readings():
    with pytest.raises(FixedPointError, match=r"Q8\.8 has 16 bits as ARM .* 17 as TI"):
        FixedFormat.parse("Q8.8")


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: FixedFormat(True, 0, 0),
        lambda: FixedFormat(1, 8, 0),
        lambda: FixedFormat(True, 8.0, 0),
        lambda: FixedFormat(True, 8, 0)._replace(width=-1),
        lambda: FixedFormat.parse("Q-8.8", q="ARM"),
        lambda: FixedFormat.parse("Q8.8", q="arm"),
        lambda: FixedFormat.parse("float32"),
        lambda: FixedFormat.parse("ap_fixed<16,8,AP_RND>"),
        lambda: FixedFormat.parse("ufixed(0 to 7)"),
        lambda: FixedFormat.parse("ufixed(0 downto 7)"),
        lambda: FixedFormat(True, 65, 0).c_type(),
        lambda: FixedFormat(True, 8, 0).value(128),
        lambda: FixedFormat(True, 8, 0).checked(1.0),
        lambda: ops.saturating_add(128, 0, FixedFormat(True, 8, 0)),
        lambda: ops.resize(-1, FixedFormat(False, 8), FixedFormat(False, 9), 0, 0),
        lambda: ops.sad([1, 2], [1]),
        lambda: ops.sum_format(FixedFormat(True, 8, 0), 0),
        lambda: ops.round_ratio(1, 0, Rounding.FLOOR),
        lambda: Rounding.parse("nearest"),
        lambda: Overflow.parse("clip"),
    ],
)
def test_wrong_use_is_told(wrong):
    with pytest.raises(FixedPointError):
        wrong()


@pytest.mark.parametrize("modes", [Rounding, Overflow])
def test_modes_are_read_by_the_words_they_are_written_with(modes):
    assert [modes.parse(str(mode)) for mode in modes] == list(modes)
    assert str(Rounding.NEAREST_EVEN) == "nearest-even"


def test_formats_and_operations_need_no_compiler():
    """Numba is loaded by the kernels only: a design tool need not wait for it."""
    code = "import fixedpoint, sys; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
