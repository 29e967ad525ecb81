"""Intensity images of ROS bags, folders and the simulator, against what was written."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from lab.intensity import (
    MEAN_GREY,
    IntensityFrame,
    exposed,
    frames_at,
    open_intensity,
    simulated_images,
)
from PIL import Image

from edge_vpr.errors import EdgeVprError, RecordingError, UsageError
from edge_vpr.events import Sensor, join_events
from edge_vpr.simulation import CAMERAS, QUERY, SimulatedRecording, World
from tests.recordings import recording_files as files

rng = np.random.default_rng(0)
GREY = rng.integers(0, 256, (3, 4, 6), dtype=np.uint8)
COLOUR = rng.integers(0, 256, (4, 6, 3), dtype=np.uint8)


def luma(red, green, blue):
    return (299 * int(red) + 587 * int(green) + 114 * int(blue) + 500) // 1000


LUMA = np.array([[luma(*pixel) for pixel in row] for row in COLOUR])


def times_and_images(frames):
    listed = list(frames)
    return [f.time_us for f in listed], [f.image.tolist() for f in listed]


def ros_image(ros, encoding, pixels, stamp_us, big_endian=False, padding=0):
    """`sensor_msgs/Image`, serialised."""
    out = bytearray()

    def put(kind, value):
        if ros == 2:
            out.extend(bytes(-len(out) % struct.calcsize(kind)))
        out.extend(struct.pack("<" + kind, value))

    def text(value):
        value = value.encode() + (b"\0" if ros == 2 else b"")
        put("I", len(value))
        out.extend(value)

    if ros == 1:
        put("I", 3)
    put("I", stamp_us // 1_000_000)
    put("I", stamp_us % 1_000_000 * 1_000)
    text("camera")
    put("I", pixels.shape[0])
    put("I", pixels.shape[1])
    text(encoding)
    put("B", big_endian)
    rows = [row.tobytes() + bytes(padding) for row in pixels]
    put("I", len(rows[0]))
    put("I", sum(map(len, rows)))
    return (b"\0\1\0\0" if ros == 2 else b"") + bytes(out) + b"".join(rows)


def write_bag(path, ros, messages):
    """A bag of (topic, type, serialised message)."""
    module = pytest.importorskip(f"rosbags.rosbag{ros}", reason="rosbags is not installed")
    with module.Writer(path) if ros == 1 else module.Writer(path, version=9) as writer:
        connections = {}
        for i, (topic, kind, data) in enumerate(messages):
            if topic not in connections:
                digest = {"md5sum": "0" * 32} if ros == 1 else {"rihs01": "RIHS01_" + "0" * 64}
                connections[topic] = writer.add_connection(
                    topic, kind, msgdef="uint8 x\n", **digest
                )
            writer.write(connections[topic], 10**18 + i, data)
    return path


START = 1_587_452_582_350_000
IMAGE = "sensor_msgs/msg/Image"


@pytest.mark.parametrize("ros", [1, 2])
def test_images_of_a_bag_are_those_written_in_every_encoding(ros, tmp_path):
    bgr = np.ascontiguousarray(COLOUR[..., ::-1])
    wide = GREY[1].astype(np.uint16) << 8 | 0x7F
    written = [
        ros_image(ros, "mono8", GREY[0], 7),  # before a DAVIS's driver has set its clock
        ros_image(ros, "mono8", GREY[0], START, padding=5),
        ros_image(ros, "bgr8", bgr, START + 40_000),
        ros_image(ros, "rgb8", COLOUR, START + 80_000),
        ros_image(ros, "mono16", wide.astype("<u2"), START + 120_000),
        ros_image(ros, "mono16", wide.astype(">u2"), START + 160_000, big_endian=True),
        ros_image(ros, "bayer_rggb8", GREY[2], START + 200_000),
    ]
    messages = [("/dvs/image_raw", IMAGE, data) for data in written]
    path = write_bag(tmp_path / ("a.bag" if ros == 1 else "a"), ros, messages)
    intensity = open_intensity(path)
    times, images = times_and_images(intensity)
    assert times == [START + 40_000 * i for i in range(6)] and intensity.start_us == START
    expected = [GREY[0], LUMA, LUMA, GREY[1], GREY[1], GREY[2]]
    assert images == [image.tolist() for image in expected]


def test_images_beside_events_count_from_the_first_event(tmp_path):
    events = files.event_array([(START + 5, 1, 2, True)], 6, 4, 1)
    image = ros_image(1, "mono8", GREY[0], START + 30)
    path = write_bag(
        tmp_path / "a.bag",
        1,
        [("/dvs/events", "dvs_msgs/msg/EventArray", events), ("/dvs/image_raw", IMAGE, image)],
    )
    intensity = open_intensity(path)
    assert intensity.has_events and intensity.start_us == START + 5


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (ros_image(1, "yuv422", GREY[0], START), "encoding 'yuv422' is none of mono8"),
        (ros_image(1, "rgb8", GREY[0], START), "6x4 pixels in rows of 6 bytes"),
        (ros_image(1, "mono8", GREY[0], START)[:-3], "24 bytes announced, 21 there"),
    ],
)
def test_a_damaged_image_of_a_bag_names_its_number_and_topic(data, says, tmp_path):
    path = write_bag(tmp_path / "a.bag", 1, [("/image", IMAGE, data)])
    with pytest.raises(RecordingError, match=f"image 1 on /image cannot be read.*{says}"):
        list(open_intensity(path))


def test_a_bag_needs_one_topic_of_images(tmp_path):
    image = ros_image(1, "mono8", GREY[0], START)
    for name, messages, says in (
        ("two", [("/left", IMAGE, image), ("/right", IMAGE, image)], "Image on /left, /right: "),
        ("none", [("/other", "std_msgs/msg/Empty", b"")], "Image on no topic: record one"),
    ):
        path = write_bag(tmp_path / f"{name}.bag", 1, messages)
        with pytest.raises(RecordingError, match=says):
            open_intensity(path)


def test_a_folder_of_png_named_by_their_seconds_is_read_in_their_order(tmp_path):
    for i, name in enumerate(("1587452593.4", "1587452593.35", "1587452602.000001")):
        Image.fromarray(GREY[i]).save(tmp_path / f"{name}.png")
    intensity = open_intensity(tmp_path)
    times, images = times_and_images(intensity)
    assert times == [1_587_452_593_350_000, 1_587_452_593_400_000, 1_587_452_602_000_001]
    assert images == [GREY[i].tolist() for i in (1, 0, 2)]
    assert intensity.start_us == times[0] and not intensity.has_events


def test_a_folder_takes_its_times_from_a_list(tmp_path):
    for i, image in enumerate([*GREY, COLOUR]):
        Image.fromarray(image).save(tmp_path / f"image_{i + 8}.png")  # 10 is after 9
    with pytest.raises(RecordingError, match=r"does not say when .* write timestamps.txt"):
        open_intensity(tmp_path)
    (tmp_path / "timestamps.txt").write_text("0.5\n0.75\n1.0\n1.125\n")
    expected = [*(image.tolist() for image in GREY), LUMA.tolist()]
    times = [500_000, 750_000, 1_000_000, 1_125_000]
    assert times_and_images(open_intensity(tmp_path)) == (times, expected)
    (tmp_path / "metadata.json").write_text(json.dumps({"start_time_ns": 250_000_000}))
    assert open_intensity(tmp_path).start_us == 250_000
    for text, says in (("0.5\n", "1 times for 4 images"), ("1\n2\nx\n3", "'x' is no time")):
        (tmp_path / "timestamps.txt").write_text(text)
        with pytest.raises(RecordingError, match=says):
            open_intensity(tmp_path)


def test_what_holds_no_images_is_refused(tmp_path):
    for name, says in (("none", "does not exist"), ("events.csv", "holds no images that are read")):
        if name != "none":
            (tmp_path / name).write_text("t,x,y,p\n1,0,0,1\n")
        with pytest.raises(EdgeVprError, match=says):
            open_intensity(tmp_path / name)


class Listed:
    """Frames out of a list."""

    has_events = False

    def __init__(self, times, start_us=0):
        self.start_us = start_us
        self._frames = [
            IntensityFrame(t, np.full((1, 2), i, np.uint8)) for i, t in enumerate(times)
        ]

    def __iter__(self):
        return iter(self._frames)


@pytest.mark.parametrize("seed", range(20))
def test_the_frame_of_a_moment_is_the_nearest_one(seed):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.integers(0, 300, 40)) + 50
    wanted = np.sort(rng.integers(0, 300, 15))
    images, nearest_us = frames_at(Listed(times.tolist(), 50), wanted, 300)
    for moment, image, at in zip(wanted.tolist(), images, nearest_us.tolist(), strict=True):
        nearest = min(range(len(times)), key=lambda i: (abs(int(times[i]) - 50 - moment), i))
        assert abs(at - moment) == abs(int(times[nearest]) - 50 - moment)
        assert times[image[0, 0]] - 50 == at == times[nearest] - 50


def test_a_moment_without_a_frame_is_an_error():
    with pytest.raises(RecordingError, match=r"no image within 1e-05 s of 9e-05 s, nor of 1 other"):
        frames_at(Listed([0, 40]), np.array([5, 90, 95]), 10)
    with pytest.raises(UsageError, match="in ascending order"):
        frames_at(Listed([0, 40]), np.array([5, 4]), 10)
    several = Listed([0, 1])
    several._frames[1] = IntensityFrame(1, np.zeros((2, 2), np.uint8))
    with pytest.raises(RecordingError, match=r"shape \(2, 2\) and the first one \(1, 2\)"):
        frames_at(several, np.array([0]), 10)


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


@pytest.mark.parametrize("kind", ["bag", "png"])
def test_damaged_images_raise_our_errors_alone(kind, tmp_path):
    """Bytes of a good file changed at random, some hundred times."""
    path = tmp_path / f"a.{kind}"
    if kind == "bag":
        images = [ros_image(1, "mono8", GREY[0], START), ros_image(1, "rgb8", COLOUR, START)]
        write_bag(path, 1, [("/image", IMAGE, image) for image in images])
    else:
        (tmp_path / "folder").mkdir()
        path = tmp_path / "folder" / "1.5.png"
        Image.fromarray(COLOUR).save(path)
    good = path.read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(150):
        data = bytearray(good[: rng.integers(1, len(good))] if rng.random() < 0.1 else good)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.choice([0, 1, 0x7F, 0xFF, rng.integers(256)])
        path.write_bytes(data)
        try:
            frames = list(open_intensity(path.parent if kind == "png" else path))
            assert all(frame.image.dtype == np.uint8 for frame in frames)
        except EdgeVprError:
            refused += 1
    assert refused > 10
