"""Sequence of intensity images with their times, and the choice of the nearest ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.recordings import open_recording
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
    found = np.full(wanted.size, np.iinfo(np.int64).min // 2)
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
        better = first + np.flatnonzero(abs(wanted[near] - at) < abs(wanted[near] - found[near]))
        images[better], found[better] = image, at
    missing = np.flatnonzero(abs(found - wanted) > most_apart_us)
    if images is None or missing.size:
        raise RecordingError(
            f"there is no image within {most_apart_us / 1e6:g} s of "
            f"{wanted[missing[0]] / 1e6:g} s, nor of {missing.size - 1} other moments: "
            "check the times of the images, and the clock of the events"
        )
    return images, found


# Time t = 0 of images that were recorded beside events.


def start_of(frames: IntensityFrames, path: Path, topic: str | None = None) -> int:
    """Return the time of a file's first event, or of its first frame if it holds no events.

    Parameters
    ----------
    frames : IntensityFrames
        Its `has_events` says whether the file holds events.
    topic : str, optional
        Camera of the events, if there are several.
    """
    if frames.has_events:
        return open_recording(path, topic=topic).start_us
    return next((frame.time_us for frame in frames), 0)


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
