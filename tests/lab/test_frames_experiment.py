"""The experiment on conventional frames: simulated, and of the published drives."""

from __future__ import annotations

from functools import partial

import numpy as np
from lab import drives
from lab.experiments import frames
from lab.loop import Draw
from lab.pairs import SIMULATED, CountedDrive, CountedPair

from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from tests.lab.test_datasets import brisbane, write_log
from tests.lab.test_intensity import IMAGE, ros_image
from tests.lab.test_intensity import write_bag as write_messages
from tests.lab.test_rivals import TRUTHS
from tests.recordings import recording_files as files

SECOND = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2}, "test")


def images_of_places(places=14, seed=0, side=96):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (places, side, side), dtype=np.uint8)


def small_pair():
    """A pair as windows of events and as frames, both easily matched."""
    images = images_of_places()
    times = np.arange(len(images), dtype=np.int64) * SECOND + SECOND // 2
    drive = CountedDrive(images, times)
    pair = CountedPair("streets", drive, drive, SETTINGS, TRUTHS)
    return frames.FramedPair(pair, pair)


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
            ("/dvs/events", "dvs_msgs/msg/EventArray", files.event_array(part, 346, 260, 1))
            for part in (events[i : i + 100] for i in range(0, 1_400, 100))
        ]
        messages += [
            ("/dvs/image_raw", IMAGE, ros_image("mono8", image, start + i * SECOND + 400_000))
            for i, image in enumerate(images)
        ]
        write_messages(tmp_path / traverse.file_name("bag"), messages)
        write_log(tmp_path / f"{traverse.video}_concat.nmea", 12)
    _, published = frames.drives(tmp_path)
    assert published.name == "Brisbane, morning against sunset1"
    counted, framed = published.open(0)
    for drive in (framed.reference, framed.query):
        assert drive.centre_us.tolist() == [i * SECOND + SECOND // 2 for i in range(11)]
        assert np.array_equal(drive.images, images[2:13])
    assert np.array_equal(counted.query.centre_us, framed.query.centre_us)


def test_events_and_frames_are_compared_by_every_system_and_draw():
    draws = [Draw(small_pair(), 0, True, ("all-pixels@1,2",)), Draw(small_pair(), 1, False)]
    first, second = (
        {(row["seen"], row["system"]): row["P@100R"] for row in frames.measure(draw)}
        for draw in draws
    )
    for seen in ("events", "frames"):
        for system in ("all pixels", "all-pixels@1,2", "150 by variance"):
            assert first[seen, system] == 1
        # pixels are drawn twice, and all pixels are the same for both draws
        assert second[seen, "25 at random"] == 1 and (seen, "all pixels") not in second


def test_a_folder_without_drives_has_streets_only(tmp_path):
    for folder in (tmp_path, None):
        assert [each.name for each in frames.drives(folder)] == [SIMULATED]
        assert [each.name for each in drives.counted_drives(folder)] == [SIMULATED]
    assert drives.whole_pairs(tmp_path) == []
