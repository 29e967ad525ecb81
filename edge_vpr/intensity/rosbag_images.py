"""Images of ROS 1 and ROS 2 bags: ``sensor_msgs/Image``, as the drivers of a DAVIS write them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.intensity.first_event import start_of
from edge_vpr.intensity.frames import Image, IntensityFrame, to_grey
from edge_vpr.recordings.count_images import MOST_PIXELS
from edge_vpr.recordings.event_packet import Cursor, read_preamble
from edge_vpr.recordings.rosbag_file import Bag

_TYPE = "sensor_msgs/msg/Image"
_EVENTS = ("EventArray", "EventPacket")
#: A DAVIS's driver stamps its first images with the time since power-on, which is below this.
_FIRST_STAMP_US = 100 * 1_000_000


class _Encoding(NamedTuple):
    """Bytes of a channel, number of channels, and whether blue is the first of them."""

    size: int
    channels: int
    blue_first: bool = False


#: a colour mosaic (Bayer) is used as it is, since a pixel is only compared with itself
_ENCODINGS = {
    "mono8": _Encoding(1, 1),
    "8UC1": _Encoding(1, 1),
    "mono16": _Encoding(2, 1),
    "16UC1": _Encoding(2, 1),
    "rgb8": _Encoding(1, 3),
    "rgba8": _Encoding(1, 4),
    "bgr8": _Encoding(1, 3, True),
    "8UC3": _Encoding(1, 3, True),
    "bgra8": _Encoding(1, 4, True),
    **{f"bayer_{order}8": _Encoding(1, 1) for order in ("rggb", "bggr", "gbrg", "grbg")},
}


class BagImages:
    """Images of one topic.

    Parameters
    ----------
    path : Path
    ros : {1, 2}
    topic : str, optional
        Name of the topic, if there are several.

    Attributes
    ----------
    start_us : int
        Start of the events of the same bag, or time of the first image without events.
    has_events : bool
    """

    def __init__(self, path: Path, ros: int, topic: str | None = None) -> None:
        self._bag = Bag(path, ros)
        with self._bag.errors(), self._bag.open() as reader:
            self._topic = _choose(reader.connections, topic, path)
            self.has_events = any(str(c.msgtype).endswith(_EVENTS) for c in reader.connections)
        self.start_us = start_of(self, path)

    def __iter__(self) -> Iterator[IntensityFrame]:
        number = 0
        with self._bag.errors(), self._bag.open() as reader:
            for number, data in enumerate(self._bag.messages(reader, self._topic), 1):
                try:
                    frame = _image(data, self._bag.ros)
                except (struct.error, ValueError) as error:
                    raise RecordingError(
                        f"{self._bag.path}: image {number:,} on {self._topic} cannot be read "
                        f"({error}): record or copy the bag again"
                    ) from error
                if frame.time_us >= _FIRST_STAMP_US:
                    yield frame


def _choose(connections: Any, wanted: str | None, path: Path) -> str:
    names = list(dict.fromkeys(c.topic for c in connections if c.msgtype == _TYPE))
    listed = ", ".join(names) or "none"
    if wanted is not None:
        if wanted not in names:
            raise RecordingError(
                f"{path} has no images on {wanted}; topics of images are: {listed}: name one"
            )
        return wanted
    if not names:
        raise RecordingError(f"{path} has no topic of sensor_msgs/Image: record the images too")
    if len(names) > 1:
        raise UsageError(f"{path} has images on {listed}: name one topic")
    return str(names[0])


def _image(data: bytes, ros: int) -> IntensityFrame:
    cursor = Cursor(data, ros)
    stamp = read_preamble(cursor, ros)
    name = cursor.text()
    big_endian, step = cursor.number("B"), cursor.number("I")
    octets = cursor.octets()
    if name not in _ENCODINGS:
        raise ValueError(f"encoding {name!r} is none of {', '.join(_ENCODINGS)}")
    size, channels, blue_first = _ENCODINGS[name]
    height, width = stamp.height, stamp.width
    if not 0 < height * width <= MOST_PIXELS or step < width * channels * size:
        raise ValueError(f"{width}x{height} pixels in rows of {step} bytes")
    if len(octets) < step * height:
        raise ValueError(f"{len(octets):,} bytes for {height} rows of {step} bytes")
    rows = np.frombuffer(octets, np.uint8, step * height).reshape(height, step)
    rows = np.ascontiguousarray(rows[:, : width * channels * size])
    image: Image = rows
    if size == 2:
        image = (rows.view(">u2" if big_endian else "<u2") >> 8).astype(np.uint8)
    elif channels > 1:
        image = to_grey(rows.reshape(height, width, channels), blue_first)
    return IntensityFrame(stamp.stamp_us, image)
