"""Folder of images, one a file: PNG, or ``.npy`` arrays, with a time for each."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.intensity.frames import Image, IntensityFrame, to_grey
from edge_vpr.recordings.array_stream import ArrayStream
from edge_vpr.recordings.count_arrays import read_metadata
from edge_vpr.recordings.count_images import MOST_PIXELS, number_key, read_png
from edge_vpr.recordings.guard import foreign_errors

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

    Parameters
    ----------
    path : Path
    period : Fraction, optional
        Time from one image to the next in seconds.

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
        self._files = sorted(path.glob("*.png"), key=number_key) or sorted(
            path.glob("*.npy"), key=number_key
        )
        if not self._files:
            raise RecordingError(f"{path} holds no *.png and no *.npy: name a folder of images")
        stated, start_us = read_metadata(path)
        self._times = self._read_times(path, stated or period)
        order = np.argsort(self._times, kind="stable")
        self._files = [self._files[i] for i in order]
        self._times = self._times[order]
        self.start_us = start_us or int(self._times[0])

    def __iter__(self) -> Iterator[IntensityFrame]:
        for time_us, path in zip(self._times.tolist(), self._files, strict=True):
            with foreign_errors(path):
                yield IntensityFrame(time_us, _read(path))

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
    with foreign_errors(listing), listing.open(encoding="utf-8") as file:
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


def _read(path: Path) -> Image:
    if path.suffix == ".png":
        return to_grey(read_png(path), blue_first=False)
    with path.open("rb") as file:
        stream = ArrayStream(file, str(path))
        shape, dtype = stream.shape, stream.dtype
        colours = len(shape) == 3 and shape[2] in (3, 4)
        if not (len(shape) == 2 or colours) or 0 in shape or dtype.kind not in "uif":
            raise RecordingError(
                f"{path} has shape {shape} and dtype {dtype}: an image is numbers of shape "
                "(height, width), or (height, width, 3) with red, green, blue"
            )
        if math.prod(shape[:2]) > MOST_PIXELS:
            raise RecordingError(
                f"{path} has {math.prod(shape[:2]):,} pixels, and the most is {MOST_PIXELS:,}"
            )
        return to_grey(_eight_bits(stream.load(MOST_PIXELS * 32), path), blue_first=False)


def _eight_bits(values: npt.NDArray[Any], path: Path) -> npt.NDArray[np.uint8]:
    """Return values from 0 to 255: floats are multiplied by 255, 16 bits cut to the upper 8."""
    if values.dtype == np.uint8:
        return values
    if values.dtype == np.uint16:
        return (values >> 8).astype(np.uint8)
    full = 1.0 if values.dtype.kind == "f" else 255.0
    with np.errstate(invalid="ignore"):
        if not ((values >= 0) & (values <= full)).all():
            raise RecordingError(
                f"{path} has values outside 0 to {full:g}: write 8 or 16 bits, or floats up to 1"
            )
    return np.rint(values * (255.0 / full)).astype(np.uint8)
