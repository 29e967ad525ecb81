"""Images of HDF5 files: a data set ``NAME`` and one ``NAME_ts`` of their times, as in MVSEC."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.intensity.frames import IntensityFrame, to_grey
from edge_vpr.recordings.count_images import MOST_PIXELS
from edge_vpr.recordings.hdf5_files import checked_dataset, load_h5py, open_hdf5

_TIMES = "_ts"


class Hdf5Images:
    """Images of one data set of 8 bits, shape (n, height, width) or (n, height, width, 3).

    Colours are red, green, blue. Times are seconds on the clock of the file.

    Parameters
    ----------
    path : Path
    topic : str, optional
        Name of the data set, if there are several.

    Attributes
    ----------
    start_us : int
        Time of the first image.
    has_events : bool
        False: the reader does not search for events in the same file.
    """

    has_events = False

    def __init__(self, path: Path, topic: str | None = None) -> None:
        self._path = path
        with open_hdf5(path) as file:
            self._name = _choose(_image_sets(file), topic, path)
            times = file[self._name + _TIMES]
            seconds = checked_dataset(path, times).read(slice(0, times.shape[0]))
        seconds = np.asarray(seconds, dtype=np.float64)
        if not (np.abs(seconds) * 1e6 < TIME_LIMIT_US).all():
            raise RecordingError(
                f"{path}: {self._name}{_TIMES} has times that are no seconds: write it again"
            )
        self._times = np.round(seconds * 1e6).astype(np.int64)
        self.start_us = int(self._times[0])

    def __iter__(self) -> Iterator[IntensityFrame]:
        with open_hdf5(self._path) as file:
            images = checked_dataset(self._path, file[self._name])
            for i, time_us in enumerate(self._times.tolist()):
                image = images.read(slice(i, i + 1))[0]
                yield IntensityFrame(time_us, to_grey(image, blue_first=False))


def _image_sets(file: Any) -> list[str]:
    """Return the names of data sets that hold images and have times."""
    h5py = load_h5py()
    found = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.dtype != np.uint8 or 0 in item.shape:
            return
        grey, coloured = item.ndim == 3, item.ndim == 4 and item.shape[3] in (3, 4)
        if not (grey or coloured) or item.shape[1] * item.shape[2] > MOST_PIXELS:
            return
        last = name.rsplit("/", 1)[-1] + _TIMES
        if isinstance(item.parent.get(last, getlink=True), h5py.HardLink):
            times = item.parent[last]
            if isinstance(times, h5py.Dataset) and times.shape == item.shape[:1]:
                found.append(name)

    file.visititems(visit)  # does not follow links
    return found


def _choose(names: list[str], wanted: str | None, path: Path) -> str:
    listed = ", ".join(names) or "none"
    if wanted is not None:
        names = [name for name in names if name == wanted.strip("/")]
    if not names:
        raise RecordingError(
            f"{path} has no images of 8 bits with times beside them (NAME and NAME{_TIMES})"
            + (f" called {wanted}" if wanted else "")
            + f"; such are: {listed}: write them so, or name one"
        )
    if len(names) > 1:
        raise UsageError(f"{path} has images in {listed}: name one data set")
    return names[0]
