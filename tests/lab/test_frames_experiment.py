"""The experiment on conventional frames: simulated, of the user, and of the published drives."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from lab import drives
from lab.experiments import frames
from lab.loop import Draw
from lab.pairs import SIMULATED, CountedDrive, CountedPair
from PIL import Image

from edge_vpr.errors import UsageError
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from tests.lab.in_process import rows_of
from tests.lab.test_datasets import brisbane, write_log
from tests.lab.test_intensity import IMAGE, ros_image
from tests.lab.test_intensity import write_bag as write_messages
from tests.lab.test_rivals import TRUTHS
from tests.recordings import recording_files as files

SECOND = 1_000_000
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 2}, "test")


def read_pairs(folder):
    return [each.open(0) for each in frames.framed_pairs(folder)]


def images_of_places(places=14, seed=0, side=96):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (places, side, side), dtype=np.uint8)


def own_drives(data, seconds=14):
    """The same places twice in two folders of images, the second with noise."""
    folder = data / frames.FRAMES
    noise = np.random.default_rng(1)
    for side in ("reference", "query"):
        (folder / side).mkdir(parents=True)
        for i, image in enumerate(images_of_places(seconds)):
            shown = (
                image if side == "reference" else image // 2 + noise.integers(0, 30, image.shape)
            )
            # at the middle of each second, on a clock that does not begin at 0
            Image.fromarray(shown.astype(np.uint8)).save(folder / side / f"{100 + i}.5.png")
        lines = "".join(f"{t},{10 * t}\n" for t in range(-1, seconds + 1))
        (folder / f"{side}_track.csv").write_text("time_s,position_m\n" + lines)
    return folder


def test_frames_of_the_user_are_matched_and_drawn(tmp_path, monkeypatch):
    own_drives(tmp_path)
    monkeypatch.setattr(frames, "simulated_frames", lambda seed: small_pair())
    rows = rows_of(frames, tmp_path, 2)
    right = {(row["drives"], row["seen"], row["system"], row["seed"]): row for row in rows}
    for seen in ("events", "frames"):
        assert right[SIMULATED, seen, "all pixels", 0]["P@100R"] == 1
    own = {key[1:]: row["P@100R"] for key, row in right.items() if key[0] == "own frames"}
    assert {seen for seen, _, _ in own} == {"frames"}
    assert own["frames", "150 by variance", 0] == 1
    # drawn twice, and all pixels are the same for both draws
    assert own["frames", "25 at random", 1] == 1 and ("frames", "all pixels", 1) not in own


def small_pair():
    """A pair as windows of events and as frames, both easily matched."""
    images = images_of_places()
    times = np.arange(len(images), dtype=np.int64) * SECOND + SECOND // 2
    drive = CountedDrive(images, times)
    pair = CountedPair("streets", drive, drive, SETTINGS, TRUTHS)
    return frames.FramedPair("streets", pair, pair)


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


def test_own_drives_that_are_incomplete_say_what_is_missing(tmp_path):
    folder = own_drives(tmp_path)
    (folder / "query_track.csv").unlink()
    with pytest.raises(UsageError, match=r"0 files of the query track.*query_track.csv"):
        read_pairs(tmp_path)


def test_frames_and_events_of_one_recording_share_a_clock(tmp_path):
    """Events begin 2 s before the first frame; frames are chosen for the windows of the events."""
    folder = own_drives(tmp_path)
    start = 1_600_000_000 * SECOND
    images = images_of_places(9, side=40)
    for side in ("reference", "query"):
        times = start + np.arange(0, 9 * SECOND, 1_000)
        events = [(int(t), int(i % 40), int(i // 40 % 40), True) for i, t in enumerate(times)]
        messages = [("/events", "dvs_msgs/msg/EventArray", files.event_array(events, 40, 40, 1))]
        messages += [
            # half a second into each second, 0.1 s late
            ("/image", IMAGE, ros_image(1, "mono8", image, start + i * SECOND + 600_000))
            for i, image in enumerate(images)
        ]
        write_messages(folder / f"{side}.bag", 1, messages)
        for file in (folder / side).iterdir():
            file.unlink()
        (folder / side).rmdir()
    ((_, counted, framed),) = read_pairs(tmp_path)
    assert counted.reference.centre_us.tolist() == [i * SECOND + SECOND // 2 for i in range(8)]
    assert np.array_equal(framed.reference.images, images[:8])
    assert counted.reference.images.sum(axis=(1, 2)).tolist() == [1000] * 8


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
            ("/dvs/image_raw", IMAGE, ros_image(1, "mono8", image, start + i * SECOND + 400_000))
            for i, image in enumerate(images)
        ]
        write_messages(tmp_path / traverse.file_name("bag"), 1, messages)
        write_log(tmp_path / f"{traverse.video}_concat.nmea", 12)
    ((name, counted, framed),) = read_pairs(tmp_path)
    assert name == "Brisbane, morning against sunset1"
    for drive in (framed.reference, framed.query):
        assert drive.centre_us.tolist() == [i * SECOND + SECOND // 2 for i in range(11)]
        assert np.array_equal(drive.images, images[2:13])
    assert np.array_equal(counted.query.centre_us, framed.query.centre_us)


def test_frames_are_compared_with_further_systems():
    draw = Draw(small_pair(), 0, True, ("all-pixels@1,2",))
    rows = {(row["seen"], row["system"]): row for row in frames.measure(draw)}
    for seen in ("events", "frames"):
        assert rows[seen, "all-pixels@1,2"]["P@100R"] == 1


def test_a_folder_without_drives_has_streets_only(tmp_path):
    for folder in (tmp_path, None):
        assert [each.name for each in frames.drives(folder)] == [SIMULATED]
        assert [each.name for each in drives.counted_drives(folder)] == [SIMULATED]
    assert drives.whole_pairs(tmp_path) == []
