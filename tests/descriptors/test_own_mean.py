"""Contrast codes: exact integers, and the same for a scene in other light or at other speed."""

from __future__ import annotations

import tracemalloc
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.activity import find_pauses
from edge_vpr.descriptors.codes import counted_events, encode, limits_of, saturated
from edge_vpr.descriptors.published import PublishedWindows
from edge_vpr.reference_map import ReferenceMap
from firmware_model.specification import (
    differences_of,
    mean_shift,
    means_after,
    own_mean_code,
    window_mean,
)
from fixedpoint.activity import SUMS
from fixedpoint.formats import FixedPointError
from fixedpoint.own_mean import ContrastCode, RunningMean
from tests.filter_oracle import level_of
from tests.streams import descriptors


def codes_of(counts, means, bits):
    """Codes of the specification; means are in units of 1/65,536 octave."""
    differences = differences_of([level_of(min(c, 1023)) for c in counts], means)
    shared = window_mean(differences)
    return [own_mean_code(one - shared, bits) for one in differences]


def means_before(levels, mean):
    """Means of all counters before each window, and after the last; `levels` are by counter."""
    means = [[256 * one for one in mean]]
    for w, row in enumerate(zip(*levels, strict=True)):
        means.append(means_after(means[-1], row, mean_shift(w)))
    return means


def rounded(means):
    return [[(mean + 128) >> 8 << 8 for mean in row] for row in means]


def test_the_table_of_logarithms_is_exact():
    code = ContrastCode()
    assert code.levels.size == 1_024
    for count, level in enumerate(code.levels.tolist()):
        assert level == level_of(count)
        # the nearest, from the middle up
        assert level == 0 or 2 ** (2 * level - 1) <= (1 + count) ** 512
        assert (1 + count) ** 512 < 2 ** (2 * level + 1)


@given(seed=st.integers(0, 2**32), counters=st.integers(1, 8), bits=st.integers(1, 8))
def test_codes_equal_the_oracle(seed, counters, bits):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, rng.choice([3, 300, 5000]), (6, counters))
    means = rng.integers(-300, 3000, counters)
    codes = ContrastCode(bits).encode(counts, means)
    assert codes.tolist() == [
        codes_of(row, (256 * means).tolist(), bits) for row in counts.tolist()
    ]
    assert codes.max() < 2**bits


def test_contrast_codes_are_those_of_a_drive_at_any_speed():
    rng = np.random.default_rng(2)
    fast = rng.integers(32, 256, (50, 40)) * 4 - 1  # log2(1 + c) falls by exactly 2 at low speed
    slow = (fast + 1) // 4 - 1
    mean = ContrastCode().mean(fast)
    codes = [ContrastCode().encode(counts, mean) for counts in (fast, slow)]
    assert np.array_equal(codes[0], codes[1])


@given(levels=st.lists(st.integers(0, 4096), max_size=300), mean=st.integers(0, 4096))
def test_the_running_mean_equals_the_oracle(levels, mean):
    running, means = RunningMean(np.array([mean])), []
    for level in levels:
        means.append(int(running.mean[0]))
        running.update(np.array([level]))
    expected = means_before([levels], [mean])
    assert [[256 * one] for one in (*means, int(running.mean[0]))] == rounded(expected)
    assert min([mean, *levels]) - 1 <= running.mean[0] <= max([mean, *levels]) + 1


def drive_codes(levels, pauses, contrast=True):
    """Codes of three bits of a recorded drive, against the means of its windows that do not pause.

    If all of them pause, all count. `levels` are by window, in units of 1/256 octave.
    """
    moving = [row for row, pause in zip(levels, pauses, strict=True) if not pause] or levels
    number = len(moving)
    # in units of 1/65,536 octave, as a device has them
    means = [
        256 * ((2 * sum(column) + number) // (2 * number)) for column in zip(*moving, strict=True)
    ]
    codes = []
    for row in levels:
        differences = differences_of(row, means)
        shared = window_mean(differences) if contrast else 0
        codes.append([own_mean_code(one - shared, 3) for one in differences])
    return codes


@given(seed=st.integers(0, 2**32), windows=st.integers(1, 20))
def test_a_recorded_drive_is_coded_against_its_own_mean(seed, windows):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 300, (windows, 4)) * (rng.random((windows, 1)) > 0.2)
    # the reference had as many events, more, or fewer
    code, mean_activity = ContrastCode(), 256 * int(rng.choice([600, 10_000, 20]))
    events = counts.sum(axis=1)
    own_mean = 256 * int(events.sum()) // windows
    far = 2 * own_mean <= mean_activity or own_mean >= 2 * mean_activity
    paused = find_pauses(events, own_mean if far else mean_activity).tolist()
    own = encode(descriptors(counts), code, mean_activity, 7)
    assert own.selected.tolist() == counts.sum(axis=1).tolist()
    for number, coded in zip(SUMS, (own.counts, *own.summed.swapaxes(0, 1)), strict=True):
        sums = [counts[max(w - number + 1, 0) : w + 1].sum(axis=0) for w in range(windows)]
        levels = [[level_of(min(c, 1023)) for c in row] for row in sums]
        assert coded.tolist() == drive_codes(levels, paused)
    one_gain = encode(descriptors(counts), code, mean_activity, 1)
    assert np.array_equal(one_gain.counts, own.counts) and one_gain.summed is None


@given(seed=st.integers(0, 2**32), windows=st.integers(1, 20), cut=st.integers(0, 20))
def test_a_robot_codes_each_window_by_what_came_before_it(seed, windows, cut):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 300, (windows, 3))
    mean, code = np.array([500, 900, 0], np.int32), ContrastCode()
    codes = encode(descriptors(counts), code, 0, 1, mean).counts
    levels = [[level_of(c) for c in column] for column in counts.T.tolist()]
    means = means_before(levels, mean.tolist())
    for row, coded, now in zip(counts.tolist(), codes.tolist(), means, strict=False):
        assert coded == codes_of(row, now, 3)
    # later windows change no earlier code
    first = encode(descriptors(counts[: max(cut, 1)]), code, 0, 1, mean).counts
    assert np.array_equal(first, codes[: len(first)])


def test_the_mean_of_levels_is_rounded_to_the_nearest():
    # levels of 0 and 256: 85.3 and 170.7
    assert ContrastCode().mean(np.array([[0, 0], [0, 1], [1, 1]])).tolist() == [85, 171]


@given(most=st.integers(1, 65_535), data=st.data())
def test_counters_saturate_whatever_the_dtype(most, data):
    row = data.draw(st.lists(st.integers(0, 255) | st.integers(0, 2**31 - 1), min_size=1))
    for dtype in (np.uint8, np.uint32, np.int64):
        counts = np.array([row]).astype(dtype)
        windows = descriptors(counts)
        expected = [min(count, most) for count in counts[0].tolist()]
        assert saturated(windows, most).counts.tolist() == [expected]
        assert saturated(windows, most).selected_events.tolist() == [sum(counts[0].tolist())]
        assert saturated(windows, None) is windows


@pytest.mark.parametrize("wrong", [{"bits": 0}, {"bits": 9}])
def test_codes_out_of_range_are_refused(wrong):
    with pytest.raises(FixedPointError, match="expected 1 to"):
        ContrastCode(**wrong)


def test_memory_of_a_map_of_windows_grows_by_few_bytes_a_code(tmp_path):
    """Of a million windows, counts of 8 bytes and their logarithms would take gigabytes."""

    def peak(windows):
        path = tmp_path / f"{windows}.npz"
        counts = np.random.default_rng(0).poisson(3, (windows, 150)).astype(np.uint8)
        x, y = np.arange(150) % 15, np.arange(150) // 15
        np.savez(path, counts=counts, pixel_x=x, pixel_y=y, sensor_width=15, sensor_height=10)
        tracemalloc.start()
        try:
            made = ReferenceMap.build(PublishedWindows(path, frame_period=Fraction(1)))
            return tracemalloc.get_traced_memory()[1], made.places.counts.nbytes
        finally:
            tracemalloc.stop()

    (few, few_codes), (many, codes) = peak(6_000), peak(18_000)
    assert codes == 18_000 * 150
    assert many - few < 6 * (codes - few_codes)


def test_pixels_that_are_hot_or_flicker_do_not_tell_the_speed():
    """One window in 50 of the reference may have more events at a pixel than count."""
    counts = np.full((100, 3), 4)
    counts[:2, 0], counts[:3, 1], counts[7, 2] = 90, 80, 2_000
    limits = limits_of(counts)
    assert limits.tolist() == [4, 80, 4]
    hot = np.array([[4, 4, 4], [4_000, 4, 4], [4, 2_000, 0]])
    assert counted_events(hot, limits).tolist() == [12, 12, 84]
    assert limits_of(np.array([[2_000]])).tolist() == [1_023]
