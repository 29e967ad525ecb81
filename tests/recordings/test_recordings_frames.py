"""Count frames as events: exactly as many as counted, spread evenly, in their frame."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.recordings import open_recording, parse_period, read_count_frames
from tests.streams import read_events

THIRTIETH = Fraction(1, 30)


def plain_expansion(frames, period):
    """The rule at the head of `frames.py`, in plain Python."""
    events = []
    for f, frame in enumerate(frames):
        lo, hi = math.floor(f * period * 10**6), math.floor((f + 1) * period * 10**6)
        in_frame = []
        for j, n in enumerate(int(n) for row in frame for n in row):
            phase = 40503 * (j + 1) % 65536
            for i in range(n):
                t = lo + (i * 65536 + phase) * (hi - lo) // (n * 65536)
                in_frame.append((t, j % len(frame[0]), j // len(frame[0]), True))
        events += sorted(in_frame, key=lambda e: (e[0], e[2], e[1]))
    return events


counts_strategy = arrays(
    st.sampled_from([np.uint8, np.uint16, np.int64, np.float32]),
    st.tuples(st.integers(1, 6), st.integers(1, 4), st.integers(1, 5)),
    elements=st.integers(0, 20),
)


@pytest.mark.filterwarnings("ignore::edge_vpr.EdgeVprWarning")  # of long frames
@given(
    frames=counts_strategy,
    period=st.sampled_from(
        [THIRTIETH, Fraction(1, 3), Fraction(1, 1000), Fraction(2), Fraction(7, 99)]
    ),
    chunk=st.integers(1, 50),
    compressed=st.booleans(),
)
def test_frames_become_the_events_that_plain_python_makes_of_them(
    frames, period, chunk, compressed, tmp_path_factory
):
    path = tmp_path_factory.mktemp("frames") / "a.npz"
    (np.savez_compressed if compressed else np.savez)(path, frames=frames)
    if not frames.any():
        with pytest.raises(RecordingError, match="holds no events"):
            open_recording(path, frame_period=period)
        return
    recording = open_recording(path, frame_period=period, chunk_events=chunk)
    events = join_events(list(recording))
    assert events.tolist() == plain_expansion(frames.tolist(), period)
    assert (recording.format, recording.start_us) == ("frames", 0)
    assert recording.sensor == Sensor(frames.shape[2], frames.shape[1])


def test_single_events_of_a_frame_are_no_burst_and_do_not_sweep_over_the_sensor(tmp_path):
    np.savez(tmp_path / "a.npz", frames=np.ones((1, 100, 100), np.uint8))
    events = read_events(tmp_path / "a.npz", frame_period=Fraction(1))
    per_centisecond = np.bincount(events["t"] // 10_000, minlength=100)
    assert per_centisecond.min() >= 90
    assert per_centisecond.max() <= 110
    rows = events["y"].astype(int)
    assert abs(rows[:5000].mean() - rows[5000:].mean()) < 1


def test_sparse_counts_become_events_at_their_pixels_with_the_period_of_the_file(tmp_path):
    counts = np.array([[2, 0, 1], [0, 3, 0]], np.uint8)
    facts = {
        "pixel_x": np.array([5, 6, 7]),
        "pixel_y": np.array([1, 2, 3]),
        "sensor_width": 346,
        "sensor_height": 260,
        "window_s": 1.0,
    }
    np.savez(tmp_path / "a.npz", counts=counts, **facts)
    events = read_events(tmp_path / "a.npz")
    first = events[events["t"] < 10**6]
    assert sorted((x, y) for _, x, y, _ in first.tolist()) == [(5, 1), (5, 1), (7, 3)]
    assert {(x, y) for _, x, y, _ in events[3:].tolist()} == {(6, 2)}
    assert events.size == 6
    with pytest.raises(UsageError, match="frames of 1 s, and 1/30 s was given"):
        open_recording(tmp_path / "a.npz", frame_period=THIRTIETH)

    frames = read_count_frames(tmp_path / "a.npz")
    assert np.array_equal(frames.load(), counts)
    assert (frames.n_frames, frames.n_pixels, frames.period) == (2, 3, Fraction(1))
    assert frames.sensor == Sensor(346, 260)
    assert frames.pixel_x.tolist() == [5, 6, 7]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_folder_of_png_is_read_in_the_order_of_its_numbers(dtype, tmp_path):
    from PIL import Image

    rng = np.random.default_rng(0)
    frames = rng.integers(0, 4, (12, 6, 8)).astype(dtype)
    frames[3, 2, 1] = np.iinfo(dtype).max
    for i, frame in enumerate(frames):
        Image.fromarray(frame).save(tmp_path / f"frame_{i}.png")  # frame_10 before frame_2
    np.savez(tmp_path / "a.npz", frames=frames)
    images = read_events(tmp_path, frame_period=THIRTIETH)
    assert np.array_equal(images, read_events(tmp_path / "a.npz", frame_period=THIRTIETH))
    assert np.array_equal(read_count_frames(tmp_path).load(), frames.reshape(12, -1))


def test_pictures_that_are_no_count_frames_say_why(tmp_path):
    from PIL import Image

    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "0.png")
    with pytest.raises(RecordingError, match="mode RGB: count frames are 8- or 16-bit grey"):
        read_events(tmp_path, frame_period=THIRTIETH)
    Image.fromarray(np.ones((4, 4), np.uint8)).save(tmp_path / "0.png")
    Image.fromarray(np.ones((4, 5), np.uint8)).save(tmp_path / "1.png")
    with pytest.raises(RecordingError, match="5x4 pixels and the first frame 4x4"):
        read_events(tmp_path, frame_period=THIRTIETH)
    (tmp_path / "1.png").write_bytes((tmp_path / "0.png").read_bytes()[:50])
    with pytest.raises(RecordingError, match=r"1\.png is damaged or no PNG"):
        read_events(tmp_path, frame_period=THIRTIETH)


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        ({"frames": np.zeros((3, 4))}, r"frames has shape \(3, 4\)"),
        ({"counts": np.zeros((3, 4, 2))}, r"counts has shape \(3, 4, 2\)"),
        ({"frames": np.zeros((0, 4, 4))}, r"frames has shape \(0, 4, 4\)"),
        ({"frames": np.full((1, 2, 2), -1)}, "frame 0 counts -1 events at pixel 0"),
        ({"frames": np.full((1, 2, 2), 0.5)}, "frame 0 counts 0.5 events at pixel 0"),
        ({"frames": np.full((1, 2, 2), np.nan)}, "frame 0 counts nan events"),
        ({"frames": np.full((1, 2, 2), 2**40)}, "do not fit a frame of"),
        ({"frames": np.ones((1, 2, 2)), "counts": np.ones((1, 2))}, "need the array frames"),
        ({"counts": np.ones((1, 2)), "pixel_x": [1], "pixel_y": [1]}, r"pixel_x \(1,\)"),
        ({"counts": np.ones((1, 1)), "pixel_x": [-1], "pixel_y": [1]}, "from 0 to 65535"),
        ({"frames": np.ones((1, 1, 1)), "window_s": np.nan}, "lasts more than 0 s"),
    ],
)
def test_frames_that_are_no_counts_say_why(contents, words, tmp_path):
    np.savez(tmp_path / "a.npz", **contents)
    with pytest.raises(RecordingError, match=words):
        read_events(tmp_path / "a.npz", frame_period=THIRTIETH, sensor=None)


def test_what_the_caller_has_to_say_is_asked_for(tmp_path):
    np.savez(tmp_path / "a.npz", frames=np.ones((1, 2, 2)))
    with pytest.raises(UsageError, match="frame_period='1/30'"):
        open_recording(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", counts=np.ones((1, 2)))
    with pytest.raises(UsageError, match="cannot become events: add the pixels, or use"):
        open_recording(tmp_path / "b.npz", frame_period=THIRTIETH)
    with pytest.raises(RecordingError, match="does not exist"):
        read_count_frames(tmp_path / "c.npz")


@pytest.mark.parametrize("text", ["0", "-1", "1/0", "fast", ""])
def test_a_period_is_a_positive_number(text):
    assert parse_period("1/30") == THIRTIETH
    assert parse_period("0.0333") == Fraction(333, 10_000)
    with pytest.raises(UsageError, match="no positive number: write for example 1/30"):
        parse_period(text)


def test_a_folder_of_float_arrays_is_read_as_its_png_would_be(tmp_path):
    rng = np.random.default_rng(3)
    frames = rng.integers(0, 4, (12, 6, 8)).astype(np.float32)
    np.savez(tmp_path / "a.npz", frames=frames)
    folder = tmp_path / "frames"
    folder.mkdir()
    for i, frame in enumerate(frames):
        np.save(folder / f"frame_{i}.npy", frame)  # frame_10 before frame_2
    # times of the frames, which lie in the same folder and are no frame
    np.save(folder / "event_frame_times_ticks.npy", np.arange(12))
    expected = read_events(tmp_path / "a.npz", frame_period=THIRTIETH)
    assert np.array_equal(read_events(folder, frame_period=THIRTIETH), expected)
    np.save(tmp_path / "stack.npy", frames)
    assert np.array_equal(read_events(tmp_path / "stack.npy", frame_period=THIRTIETH), expected)


@pytest.mark.parametrize("stacked", [False, True])
def test_on_and_off_counts_apart_are_added(stacked, tmp_path):
    frames = np.random.default_rng(4).integers(0, 5, (3, 4, 5, 2)).astype(np.float32)
    path = tmp_path / "stack.npy"
    if stacked:
        np.save(path, frames)
    else:
        path = tmp_path
        for i, frame in enumerate(frames):
            np.save(tmp_path / f"frame_{i}.npy", frame)
    assert np.array_equal(read_count_frames(path).load(), frames.sum(axis=3).reshape(3, -1))


def test_period_and_start_come_from_the_metadata_beside_the_frames(tmp_path):
    np.save(tmp_path / "frame_0.npy", np.ones((2, 3), np.float32))
    metadata = tmp_path / "metadata.json"
    metadata.write_text('{"start_tick": 7000000, "ticks_per_second": 1e9, "timewindow_ms": 66.6}')
    recording = open_recording(tmp_path)
    assert (recording.start_us, recording.sensor) == (7_000, Sensor(3, 2))
    assert read_count_frames(tmp_path).period == Fraction(666, 10_000)
    metadata.write_text('{"start_time_ns": 5000000000, "timewindow_ns": 100000000}')
    assert open_recording(tmp_path).start_us == 5_000_000
    assert read_count_frames(tmp_path).period == Fraction(1, 10)
    metadata.write_text('{"timewindow_ns": 0}')  # frames of a fixed number of events
    with pytest.raises(UsageError, match="does not say how long a frame lasts"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"timewindow_ms": "1"}', '{"timewindow_ns": -1}',
             '{"timewindow_ms": Infinity}', '{"start_tick": 1, "ticks_per_second": 0}',
             '{"start_time_ns": 1e300}', '{"timewindow_ms": true}', "[" * 100_000,
             f'{{"timewindow_ns": 1{"0" * 400}}}'],
)  # fmt: skip
def test_damaged_metadata_of_frames_is_one_clear_error(text, tmp_path):
    np.save(tmp_path / "frame_0.npy", np.ones((2, 3), np.float32))
    (tmp_path / "metadata.json").write_text(text)
    with pytest.raises(RecordingError, match="no readable metadata"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (np.ones((2, 3, 3)), "a count frame is numbers of shape"),
        (np.ones(3), "a count frame is numbers of shape"),
        (np.full((2, 3), 0.5, np.float32), "frame 1 counts 0.5 events at pixel 0"),
        (np.ones((3, 2)), "2x3 pixels and the first frame 3x2"),
    ],
)
def test_an_array_that_is_no_count_frame_says_why(frame, words, tmp_path):
    np.save(tmp_path / "frame_0.npy", np.ones((2, 3), np.float32))
    np.save(tmp_path / "frame_1.npy", frame)
    with pytest.raises(RecordingError, match=words):
        read_events(tmp_path, frame_period=THIRTIETH)
