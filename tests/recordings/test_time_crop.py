"""A part of a recording has the events of that part, and its time begins with it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_vpr.descriptors.published import PublishedWindows
from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.recordings import TimeCrop, open_recording, write_recording
from edge_vpr.recordings.reading import seconds_us
from tests.streams import random_events, read_events

SENSOR = Sensor(16, 12)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("crop") / "drive.npz"
    events = random_events(np.random.default_rng(0), 60, SENSOR, 1_000_000)
    write_recording(path, [events], sensor=SENSOR, start_us=5_000_000)
    return path


@given(
    start=st.integers(0, 900_000),
    length=st.none() | st.integers(82_000, 2_000_000),  # the longest gap between events: 81,644
    on_events=st.booleans(),
    chunk=st.sampled_from([1, 7, 1_000, 10_000]),
)
def test_a_part_has_the_events_of_that_part_in_its_own_time(start, length, on_events, chunk, drive):
    whole = read_events(drive)
    end = None if length is None else start + length
    if on_events:  # an event lies exactly at each end
        times = whole["t"]
        start = int(times[max(np.searchsorted(times[:-1], start) - 1, 0)])
        end = None if end is None else int(times[min(np.searchsorted(times, end), len(times) - 1)])
    recording = open_recording(drive, chunk_events=chunk)
    part = recording.cropped(TimeCrop(start_us=start, end_us=end))
    expected = [
        (t - start, x, y, p)
        for t, x, y, p in whole.tolist()
        if start <= t and (end is None or t < end)
    ]
    for _ in range(2):  # a recording can be walked again
        assert join_events(list(part)).tolist() == expected
    assert part.start_us == recording.start_us + start
    assert np.array_equal(join_events(list(recording)), whole)


def test_a_part_of_a_part_counts_from_the_part(drive):
    recording = open_recording(drive)
    outer = recording.cropped(TimeCrop(start_us=200_000, end_us=800_000))
    inner = outer.cropped(TimeCrop(start_us=100_000, end_us=900_000))
    once = recording.cropped(TimeCrop(start_us=300_000, end_us=800_000))
    assert np.array_equal(join_events(list(inner)), join_events(list(once)))
    assert inner.start_us == once.start_us


def test_an_offset_is_on_the_clock_of_the_file(drive):
    recording = open_recording(drive)
    by_clock = recording.cropped(
        TimeCrop(offset_us=recording.start_us + 250_000, start_us=50_000, end_us=100_000)
    )
    plain = recording.cropped(TimeCrop(start_us=300_000, end_us=350_000))
    assert np.array_equal(join_events(list(by_clock)), join_events(list(plain)))
    # what lies before the recording is not there to be read
    early = recording.cropped(TimeCrop(offset_us=recording.start_us - 10_000, end_us=60_000))
    plain = recording.cropped(TimeCrop(end_us=50_000))
    assert early.start_us == recording.start_us
    assert np.array_equal(join_events(list(early)), join_events(list(plain)))
    with pytest.raises(UsageError, match="before the recording begins"):
        recording.cropped(TimeCrop(offset_us=0, end_us=60_000))


def test_frames_as_windows_keep_the_whole_frames_of_a_part(tmp_path):
    frames = np.arange(10 * 12, dtype=np.uint8).reshape(10, 3, 4)
    np.savez(tmp_path / "a.npz", frames=frames, window_s=0.1)
    crop = TimeCrop(start_us=150_000, end_us=650_000)
    windows = PublishedWindows(tmp_path / "a.npz", crop=crop)
    assert f"PublishedWindows({len(list(windows.windows()))} frames of " in repr(windows)
    counts = np.array([window.counts for window in windows.windows()])
    assert np.array_equal(counts, frames[2:6].reshape(4, -1))
    assert (windows.start_us, next(windows.windows()).start_us) == (200_000, 0)
    with pytest.raises(UsageError, match="no whole frame in the part"):
        PublishedWindows(tmp_path / "a.npz", crop=TimeCrop(start_us=10_000, end_us=110_000))


def test_a_part_without_events_and_wrong_flags_are_errors_with_a_remedy(drive):
    recording = open_recording(drive)
    with pytest.raises(RecordingError, match="holds no events from 7 s to its end: give another"):
        list(recording.cropped(TimeCrop(start_us=7_000_000)))
    with pytest.raises(UsageError, match="not after the start"):
        TimeCrop(start_us=5, end_us=5)
    with pytest.raises(UsageError, match="negative"):
        TimeCrop(start_us=-1)
    for text in ("", "x", "1e999999999", "1/0", "nan", "9" * 60):
        with pytest.raises(UsageError, match="no number of seconds"):
            seconds_us(text, "--start")
    assert seconds_us("1587452582.35", "--start-offset") == 1_587_452_582_350_000
    assert seconds_us("1/30", "--start") == round(Fraction(10**6, 30))


def test_every_reading_command_takes_a_part(drive, tmp_path, run):
    output = tmp_path / "part.npz"
    run("convert", drive, output, "--start", "0.25", "--end", "0.75")
    expected = open_recording(drive).cropped(TimeCrop(start_us=250_000, end_us=750_000))
    assert np.array_equal(read_events(output), join_events(list(expected)))
    n = sum(events.size for events in expected)
    assert f"{n:,}" in run("info", drive, "--start", "0.25", "--end", "0.75").out
