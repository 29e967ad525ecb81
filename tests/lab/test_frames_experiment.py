"""The experiment on conventional frames: simulated, and of the published drives."""

from __future__ import annotations

from functools import partial

import numpy as np
from lab.experiments import frames
from lab.loop import Draw

from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from tests.lab.test_datasets import brisbane, write_log
from tests.lab.test_intensity import IMAGE, ros_image
from tests.recordings import recording_files as files

SECOND = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2}, "test")


def test_simulated_frames_are_taken_in_the_middle_of_the_windows(monkeypatch):
    monkeypatch.setattr(frames, "simulate_pair", partial(simulate_pair, sensor="tiny"))
    monkeypatch.setattr(frames, "LENGTH_M", 30.0)
    pair = frames.simulated_frames(1)
    for counted, framed in (
        (pair.events.reference, pair.frames.reference),
        (pair.events.query, pair.frames.query),
    ):
        assert np.array_equal(counted.centre_us, framed.centre_us)
        assert framed.images.shape == counted.images.shape and framed.images.dtype == np.uint8
    systems = {(row["seen"], row["system"]) for row in frames.measure(Draw(pair, 1, False))}
    assert not {("events", "all pixels"), ("frames", "patch-normalised")} & systems


def test_frames_of_published_bags_are_taken_on_the_clock_of_their_tracks(tmp_path):
    """The GPS log begins 2 s after the recording; a frame is taken 0.4 s into each second."""
    images = np.random.default_rng(4).integers(0, 256, (14, 260, 346), dtype=np.uint8)
    for name in ("sunset1", "morning"):
        traverse = brisbane(name)
        start = round(traverse.complete_beginning_s * SECOND) - 2 * SECOND
        events = [(start + 10_000 * i, i % 346, i % 260, True) for i in range(1_400)]
        messages = [
            ("/dvs/events", files.event_array(part, 346, 260, 1))
            for part in (events[i : i + 100] for i in range(0, 1_400, 100))
        ]
        messages += [
            ("/dvs/image_raw", ros_image("mono8", image, start + i * SECOND + 400_000))
            for i, image in enumerate(images)
        ]
        path = tmp_path / traverse.file_name("bag")
        files.write_bag(path, 1, messages, {"/dvs/image_raw": IMAGE})
        write_log(tmp_path / f"{traverse.video}_concat.nmea", 12)
    _, published = frames.drives(tmp_path)
    assert published.name == "Brisbane, morning against sunset1"
    counted, framed = published.open(0)
    for drive in (framed.reference, framed.query):
        assert drive.centre_us.tolist() == [i * SECOND + SECOND // 2 for i in range(11)]
        assert np.array_equal(drive.images, images[2:13])
    assert np.array_equal(counted.query.centre_us, framed.query.centre_us)
