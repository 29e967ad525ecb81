"""Intensity images of ROS bags and the simulator, against what was written."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from lab.intensity import MEAN_GREY, BagImages, IntensityFrame, exposed, frames_at, simulated_images

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.simulation import CAMERAS, QUERY, SimulatedRecording, World
from tests.recordings.recording_files import write_bag

rng = np.random.default_rng(0)
GREY = rng.integers(0, 256, (3, 4, 6), dtype=np.uint8)
COLOUR = rng.integers(0, 256, (4, 6, 3), dtype=np.uint8)


def luma(red, green, blue):
    return (299 * int(red) + 587 * int(green) + 114 * int(blue) + 500) // 1000


LUMA = np.array([[luma(*pixel) for pixel in row] for row in COLOUR])


def ros_image(encoding, pixels, stamp_us, padding=0):
    """`sensor_msgs/Image` of ROS 1, serialised; each row ends with some bytes of padding."""
    rows = [row.tobytes() + bytes(padding) for row in pixels]
    frame, name, data = (
        struct.pack("<I", len(octets)) + octets
        for octets in (b"camera", encoding.encode(), b"".join(rows))
    )
    stamp = struct.pack("<III", 3, stamp_us // 1_000_000, stamp_us % 1_000_000 * 1_000)
    size = struct.pack("<II", *pixels.shape[:2])
    return stamp + frame + size + name + struct.pack("<BI", 0, len(rows[0])) + data


START = 1_587_452_582_350_000
IMAGE = "sensor_msgs/msg/Image"


def test_images_of_a_bag_are_those_written_in_every_encoding(tmp_path):
    bgr = np.ascontiguousarray(COLOUR[..., ::-1])
    written = [
        ros_image("mono8", GREY[0], 7),  # before a DAVIS's driver has set its clock
        ros_image("mono8", GREY[0], START, padding=5),
        ros_image("bgr8", bgr, START + 40_000),
        ros_image("rgb8", COLOUR, START + 80_000, padding=2),
        ros_image("bayer_rggb8", GREY[2], START + 120_000),
    ]
    path, topic = tmp_path / "a.bag", "/dvs/image_raw"
    write_bag(path, 1, [(topic, data) for data in written], {topic: IMAGE})
    read = list(BagImages(path))
    assert [frame.time_us for frame in read] == [START + 40_000 * i for i in range(4)]
    expected = [GREY[0], LUMA, LUMA, GREY[2]]
    assert [frame.image.tolist() for frame in read] == [image.tolist() for image in expected]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (ros_image("yuv422", GREY[0], START), "encoding 'yuv422' is none of mono8"),
        (ros_image("rgb8", GREY[0], START), "cannot reshape"),
        (ros_image("mono8", GREY[0], START)[:-3], "record or copy the bag"),
    ],
)
def test_a_damaged_image_of_a_bag_names_its_number_and_topic(data, says, tmp_path):
    path = tmp_path / "a.bag"
    write_bag(path, 1, [("/image", data)], {"/image": IMAGE})
    with pytest.raises(RecordingError, match=rf"image 1 on /image cannot be read.*{says}"):
        list(BagImages(path))


def listed(times):
    """Return frames at these times, each of which shows its number."""
    return [IntensityFrame(t, np.full((1, 2), i, np.uint8)) for i, t in enumerate(times)]


@pytest.mark.parametrize("seed", range(20))
def test_the_frame_of_a_moment_is_the_nearest_one(seed):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.integers(0, 300, 40)) + 50
    wanted = np.sort(rng.integers(0, 300, 15))
    images = frames_at(listed(times.tolist()), wanted, 300, 50)
    for moment, image in zip(wanted.tolist(), images, strict=True):
        nearest = min(range(len(times)), key=lambda i: (abs(int(times[i]) - 50 - moment), i))
        assert times[image[0, 0]] == times[nearest]


def test_a_moment_without_a_frame_is_an_error():
    with pytest.raises(RecordingError, match=r"no image within 1e-05 s of 9e-05 s, nor of 1 other"):
        frames_at(listed([0, 40]), np.array([5, 90, 95]), 10, 0)
    with pytest.raises(UsageError, match="in ascending order"):
        frames_at(listed([0, 40]), np.array([5, 4]), 10, 0)
    several = [*listed([0]), IntensityFrame(1, np.zeros((2, 2), np.uint8))]
    with pytest.raises(RecordingError, match=r"shape \(2, 2\) and the first one \(1, 2\)"):
        frames_at(several, np.array([0]), 10, 0)


def test_simulated_images_show_the_light_that_makes_the_events():
    """Brightness that rises between two images has made more ON than OFF events, and conversely."""
    camera = replace(CAMERAS["tiny"], noise_hz=0.0, hot_pixels=0, bursts_per_minute=0.0)
    drive = SimulatedRecording(World(length_m=30.0), camera, QUERY, seed=3)
    first = next(iter(drive.light_at(np.array([0])))).copy()
    at = np.arange(0, drive.duration_us, 100_000)
    light = np.array([image.copy() for image in drive.light_at(at)])
    assert np.array_equal(light[0], first) and light.shape == (len(at), 32, 32)
    # one moment alone is what it is among others
    alone = next(iter(drive.light_at(at[7:8])))
    assert np.array_equal(alone, light[7])
    events = join_events(list(drive))
    sign = np.where(events["p"], 1, -1)
    change = np.zeros((len(at), 32, 32))
    step = np.searchsorted(at, events["t"], side="right") - 1
    np.add.at(change, (step, events["y"], events["x"]), sign)
    moved = np.diff(np.log(light), axis=0)
    assert np.corrcoef(moved.ravel(), change[:-1].ravel())[0, 1] > 0.8
    with pytest.raises(UsageError, match="the drive lasts from 0 to"):
        next(iter(drive.light_at(np.array([drive.duration_us + 1]))))


def test_an_image_is_exposed_to_a_mean_whatever_the_light():
    rng = np.random.default_rng(1)
    light = rng.uniform(0.2, 0.8, (64, 64))
    dim, bright = (exposed(light * factor, np.random.default_rng(2)) for factor in (0.01, 50.0))
    assert np.array_equal(dim, bright) and dim.mean() == pytest.approx(MEAN_GREY, abs=0.5)
    drive = SimulatedRecording(World(length_m=20.0), CAMERAS["tiny"], QUERY, seed=3)
    images = simulated_images(drive, np.array([0, 900_000]), rng)
    assert images.shape == (2, *reversed(Sensor(32, 32))) and images.std() > 10
