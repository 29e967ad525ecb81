"""Intensity images of the camera of a published bag, or simulated, and those at given times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.recordings.reading import foreign_errors
from edge_vpr.recordings.rosbag import messages_of, opened_bag
from edge_vpr.simulation import SimulatedRecording

Image = npt.NDArray[np.uint8]
Times = npt.NDArray[np.int64]


class IntensityFrame(NamedTuple):
    """One image and its time."""

    time_us: int  #: Time on the clock of the image's source.
    image: Image  #: Shape (height, width): grey values, from black to white.


def frames_at(
    frames: Iterable[IntensityFrame], times_us: Times, most_apart_us: int, start_us: int
) -> npt.NDArray[np.uint8]:
    """Return the image nearest to each time, in one pass that stores only these images.

    Parameters
    ----------
    frames : iterable of IntensityFrame
        In the order of time.
    times_us : ndarray of int64, shape (n,)
        Ascending; 0 is the start of the recording.
    most_apart_us : int
        Largest allowed distance of an image from its time, in microseconds.
    start_us : int
        Time t = 0 on the clock of the images.

    Returns
    -------
    ndarray of uint8, shape (n, height, width)
        Of two images equally near, the earlier one.

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
    for time_us, image in frames:
        at = time_us - start_us
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
    return images


# Images of the published bags of ROS 1, as the driver of a DAVIS writes them.


_TYPE = "sensor_msgs/msg/Image"
#: A DAVIS's driver stamps its first images with the time since power-on, which is below this.
_FIRST_STAMP_US = 100 * 1_000_000
#: encodings of 8 bits with one channel; a colour mosaic (Bayer) is used as it is, since a pixel is
#: only compared with itself
_GREY = ("mono8", *(f"bayer_{order}8" for order in ("rggb", "bggr", "gbrg", "grbg")))
#: which channels are red, green and blue, of encodings of 8 bits with three
_COLOURS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0)}


class BagImages:
    """Images of the only topic of images of a ROS 1 bag; each ``iter()`` begins at the first one.

    Raises
    ------
    RecordingError
        If there is no such topic, there are several, or an image cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with opened_bag(path, 1) as reader:
            topics = {str(c.topic) for c in reader.connections if c.msgtype == _TYPE}
        if len(topics) != 1:
            raise RecordingError(
                f"{path} has sensor_msgs/Image on {', '.join(sorted(topics)) or 'no topic'}: "
                "record one topic of images"
            )
        (self._topic,) = topics

    def __iter__(self) -> Iterator[IntensityFrame]:
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC)
        with foreign_errors(self._path), opened_bag(self._path, 1) as reader:
            for number, data in enumerate(messages_of(reader, self._topic), 1):
                try:
                    frame = _frame(store.deserialize_ros1(data, _TYPE))
                except Exception as error:  # rosbags raises exceptions of many kinds
                    raise RecordingError(
                        f"{self._path}: image {number:,} on {self._topic} cannot be read "
                        f"({error}): record or copy the bag again"
                    ) from error
                if frame.time_us >= _FIRST_STAMP_US:
                    yield frame


def _frame(message: Any) -> IntensityFrame:
    """Return a ``sensor_msgs/Image`` as luma (ITU-R BT.601, rounded), or a grey one as it is."""
    stamp, encoding = message.header.stamp, message.encoding
    if encoding not in (*_GREY, *_COLOURS):
        raise ValueError(f"encoding {encoding!r} is none of {', '.join((*_GREY, *_COLOURS))}")
    time_us = stamp.sec * 1_000_000 + stamp.nanosec // 1_000
    height, width = message.height, message.width
    rows = message.data[: height * message.step].reshape(height, message.step)
    if encoding in _GREY:
        return IntensityFrame(time_us, rows[:, :width].reshape(height, width))
    pixels = rows[:, : 3 * width].reshape(height, width, 3).astype(np.uint32)
    red, green, blue = (pixels[..., channel] for channel in _COLOURS[encoding])
    luma = (299 * red + 587 * green + 114 * blue + 500) // 1000
    return IntensityFrame(time_us, luma.astype(np.uint8))


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
