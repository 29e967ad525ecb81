"""Images of folders and ROS bags."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from fractions import Fraction
from io import TextIOWrapper
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.files import open_input
from edge_vpr.recordings.frames import MOST_PIXELS, number_key, read_metadata, read_png
from edge_vpr.recordings.reading import foreign_errors
from edge_vpr.recordings.rosbag import Bag, Cursor, read_preamble
from edge_vpr_tools.research.intensity.frames import Image, IntensityFrame, start_of, to_grey

# Folder of images, one PNG each, with a time for each.


#: file with one line of seconds for each image, in the order of the images' names
TIMES = "timestamps.txt"
_LONGEST_TIMES = 1 << 26
#: name that is a time in seconds, as the exporter of Brisbane-Event-VPR writes it
_SECONDS = re.compile(r"\d+\.\d+")


class ImageFolder:
    """Images of a folder, and the time of each.

    The times are taken from the first of these that is present: the lines of ``timestamps.txt``, in
    seconds; the names, if each is a number of seconds with a point (``1587452593.35.png``); the
    index of each image times the period in ``metadata.json`` or of the caller.

    Attributes
    ----------
    start_us : int
        Start in ``metadata.json``, else the time of the first image.
    has_events : bool
        False.

    Raises
    ------
    RecordingError
        If there are no images, or their times are not known.
    """

    has_events = False

    def __init__(self, path: Path, period: Fraction | None = None) -> None:
        self._files = sorted(path.glob("*.png"), key=number_key)
        if not self._files:
            raise RecordingError(f"{path} holds no *.png: name a folder of images")
        stated, start_us = read_metadata(path)
        self._times = self._read_times(path, stated or period)
        order = np.argsort(self._times, kind="stable")
        self._files = [self._files[i] for i in order]
        self._times = self._times[order]
        self.start_us = start_us or int(self._times[0])

    def __iter__(self) -> Iterator[IntensityFrame]:
        for time_us, path in zip(self._times.tolist(), self._files, strict=True):
            with foreign_errors(path):
                yield IntensityFrame(time_us, to_grey(read_png(path), blue_first=False))

    def _read_times(self, path: Path, period: Fraction | None) -> npt.NDArray[np.int64]:
        listing = path / TIMES
        if listing.is_file():
            return _listed(listing, len(self._files))
        if all(_SECONDS.fullmatch(file.stem) for file in self._files):
            return np.array([_microseconds(file.stem, file) for file in self._files])
        if period is None:
            raise RecordingError(
                f"{path} does not say when its images were taken: write {TIMES} with a line of "
                "seconds for each"
            )
        return np.array([round(i * period * 1_000_000) for i in range(len(self._files))])


def _listed(listing: Path, images: int) -> npt.NDArray[np.int64]:
    with foreign_errors(listing), TextIOWrapper(open_input(listing), encoding="utf-8") as file:
        lines = file.read(_LONGEST_TIMES).split()
    if len(lines) != images:
        raise RecordingError(
            f"{listing} has {len(lines)} times for {images} images: write a line for each"
        )
    return np.array([_microseconds(line, listing) for line in lines], dtype=np.int64)


def _microseconds(text: str, path: Path) -> int:
    try:
        # exact: a float of seconds since 1970 has errors of some tenths of a microsecond
        time_us = round(Fraction(text) * 1_000_000) if len(text) < 64 else TIME_LIMIT_US
    except (ValueError, ZeroDivisionError):
        time_us = TIME_LIMIT_US
    if abs(time_us) >= TIME_LIMIT_US:
        raise RecordingError(f"{path}: {text[:40]!r} is no time in seconds: write it again")
    return time_us


def _chosen(names: list[str], wanted: str | None, path: Path, kind: str) -> str:
    """Return the wanted one of the data sets or topics with images, or the only one."""
    names = list(dict.fromkeys(names))
    listed = ", ".join(names) or "none"
    if wanted is not None:
        if wanted not in names:
            raise RecordingError(
                f"{path} has no images on {wanted}; each {kind} there: {listed}: name one"
            )
        return wanted
    if not names:
        raise RecordingError(f"{path} has no {kind}: record the images too")
    if len(names) > 1:
        raise UsageError(f"{path} has images on {listed}: name one")
    return names[0]


# Images of ROS 1 and ROS 2 bags: ``sensor_msgs/Image``, as the drivers of a DAVIS write them.


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
    ros : {1, 2}
        Version of ROS that wrote the bag.
    """

    def __init__(self, path: Path, ros: int, topic: str | None = None) -> None:
        self._bag = Bag(path, ros)
        with self._bag.errors(), self._bag.open() as reader:
            topics = [c.topic for c in reader.connections if c.msgtype == _TYPE]
            self._topic = _chosen(topics, topic, path, "topic of sensor_msgs/Image")
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


def _image(data: bytes, ros: int) -> IntensityFrame:
    cursor = Cursor(data, ros)
    stamp = read_preamble(cursor)
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
