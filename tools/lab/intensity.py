"""Intensity images of a conventional camera, recorded or simulated, and those at given times."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from fractions import Fraction
from io import TextIOWrapper
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.files import open_input
from edge_vpr.recordings import check_file_or_folder, open_recording, sniff
from edge_vpr.recordings.frames import MOST_PIXELS, number_key, read_metadata, read_png
from edge_vpr.recordings.reading import foreign_errors
from edge_vpr.recordings.rosbag import Bag, Cursor, read_preamble
from edge_vpr.simulation import SimulatedRecording

Image = npt.NDArray[np.uint8]
Times = npt.NDArray[np.int64]


class IntensityFrame(NamedTuple):
    """One image and its time."""

    time_us: int  #: Time on the clock of the image's source.
    image: Image  #: Shape (height, width): grey values, from black to white.


class IntensityFrames(Protocol):
    """Iterable of images in time order; each ``iter()`` begins at the first one."""

    #: Time t = 0 of the recording on the clock of the images: that of the first event in the same
    #: file, or of the first image if there are no events.
    start_us: int
    has_events: bool  #: Whether the same file holds events.

    def __iter__(self) -> Iterator[IntensityFrame]:
        """Yield the images."""
        ...


def to_grey(image: npt.NDArray[np.uint8], blue_first: bool) -> Image:
    """Return the luma of a colour image (ITU-R BT.601, rounded), or a grey image as it is.

    Parameters
    ----------
    image : ndarray of uint8, shape (height, width) or (height, width, 3 or 4)
        A fourth channel (alpha) is ignored.
    blue_first : bool
        Whether the channels are blue, green, red instead of red, green, blue.

    Examples
    --------
    >>> to_grey(np.array([[[255, 0, 0]]], np.uint8), blue_first=False)
    array([[76]], dtype=uint8)
    """
    if image.ndim == 2:
        return image
    red, green, blue = (
        image[..., i].astype(np.uint32) for i in ((2, 1, 0) if blue_first else (0, 1, 2))
    )
    return ((299 * red + 587 * green + 114 * blue + 500) // 1000).astype(np.uint8)


def frames_at(
    frames: IntensityFrames, times_us: Times, most_apart_us: int, start_us: int | None = None
) -> tuple[npt.NDArray[np.uint8], Times]:
    """Return the image nearest to each time, in one pass that stores only these images.

    Parameters
    ----------
    times_us : ndarray of int64, shape (n,)
        Ascending; 0 is the start of the recording.
    most_apart_us : int
        Largest allowed distance of an image from its time, in microseconds.
    start_us : int, optional
        Time t = 0 on the clock of the images; by default that of `frames`.

    Returns
    -------
    images : ndarray of uint8, shape (n, height, width)
    found_us : ndarray of int64, shape (n,)
        Times of the images. Of two images equally near, the earlier one is chosen.

    Raises
    ------
    RecordingError
        If there is no image near one of the times, or images differ in size.
    """
    wanted = np.asarray(times_us, dtype=np.int64)
    if not wanted.size or (np.diff(wanted) < 0).any():
        raise UsageError(f"{wanted.size} moments: give one or more, in ascending order")
    images: npt.NDArray[np.uint8] | None = None
    taken_us = np.full(wanted.size, np.iinfo(np.int64).min // 2)
    start = frames.start_us if start_us is None else start_us
    for time_us, image in frames:
        at = time_us - start
        if images is None:
            images = np.zeros((wanted.size, *image.shape), np.uint8)
        elif image.shape != images.shape[1:]:
            raise RecordingError(
                f"the image at {at / 1e6:g} s has shape {image.shape} and the first one "
                f"{images.shape[1:]}: all images need one size"
            )
        # times long before this image already have their nearest image
        first = int(np.searchsorted(wanted, at - most_apart_us))
        last = int(np.searchsorted(wanted, at + most_apart_us, side="right"))
        near = np.s_[first:last]
        better = first + np.flatnonzero(abs(wanted[near] - at) < abs(wanted[near] - taken_us[near]))
        images[better], taken_us[better] = image, at
    missing = np.flatnonzero(abs(taken_us - wanted) > most_apart_us)
    if images is None or missing.size:
        raise RecordingError(
            f"there is no image within {most_apart_us / 1e6:g} s of "
            f"{wanted[missing[0]] / 1e6:g} s, nor of {missing.size - 1} other moments: "
            "check the times of the images, and the clock of the events"
        )
    return images, taken_us


def open_intensity(path: str | Path) -> IntensityFrames:
    """Open the intensity images of a recording, or of a folder.

    Parameters
    ----------
    path : str or Path
        ROS bag with ``sensor_msgs/Image`` on one topic, or a folder of PNG (see `ImageFolder` for
        its times).

    Raises
    ------
    RecordingError
        If there are no images, or they cannot be read.
    """
    path = Path(path)
    check_file_or_folder(path)
    with foreign_errors(path):
        name = sniff(path)
        if name in ("rosbag1", "rosbag2"):
            return BagImages(path, 1 if name == "rosbag1" else 2)
        if name == "frames" and path.is_dir():
            return ImageFolder(path)
    raise RecordingError(
        f"{path} is {name}, which holds no images that are read: name a ROS bag, or a folder of PNG"
    )


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
    index of each image times the period in ``metadata.json``.

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

    def __init__(self, path: Path) -> None:
        self._files = sorted(path.glob("*.png"), key=number_key)
        if not self._files:
            raise RecordingError(f"{path} holds no *.png: name a folder of images")
        period, start_us = read_metadata(path)
        self._times = self._read_times(path, period)
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
    """Images of the only topic of images.

    Parameters
    ----------
    ros : {1, 2}
        Version of ROS that wrote the bag.
    """

    def __init__(self, path: Path, ros: int) -> None:
        self._bag = Bag(path, ros)
        with self._bag.errors(), self._bag.open() as reader:
            topics = {str(c.topic) for c in reader.connections if c.msgtype == _TYPE}
            self.has_events = any(str(c.msgtype).endswith(_EVENTS) for c in reader.connections)
        if len(topics) != 1:
            raise RecordingError(
                f"{path} has sensor_msgs/Image on {', '.join(sorted(topics)) or 'no topic'}: "
                "record one topic of images"
            )
        (self._topic,) = topics
        if self.has_events:
            self.start_us = open_recording(path).start_us
        else:
            self.start_us = next((frame.time_us for frame in self), 0)

    def __iter__(self) -> Iterator[IntensityFrame]:
        with foreign_errors(self._bag.path), self._bag.errors(), self._bag.open() as reader:
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


# Model of a conventional sensor: automatic exposure, read noise, and 8 bits.


#: mean of an image after exposure, and standard deviation of the noise of each pixel, both in grey
#: levels from 0 to 255
MEAN_GREY, NOISE_GREY = 90.0, 2.0


def exposed(light: npt.NDArray[np.floating], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return an image whose mean is `MEAN_GREY` before clipping."""
    gain = MEAN_GREY / max(float(light.mean()), 1e-9)
    grey = light * gain + rng.normal(0.0, NOISE_GREY, light.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def simulated_images(
    drive: SimulatedRecording, time_us: npt.NDArray[np.int64], rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Take intensity images during a simulated drive, at the position of the event camera.

    Each image has its own exposure, which is short enough for a sharp image.

    Parameters
    ----------
    time_us : ndarray of int64, shape (n,)
        Ascending, within the drive.
    rng : Generator
        Source of the noise.
    """
    images = np.empty((len(time_us), drive.sensor.height, drive.sensor.width), np.uint8)
    for image, light in zip(images, drive.light_at(time_us), strict=True):
        image[:] = exposed(light, rng)
    return images
