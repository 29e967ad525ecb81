"""Intensity images of a conventional camera, and the choice of images at given times."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

from edge_vpr.errors import RecordingError
from edge_vpr.recordings import check_file_or_folder, sniff
from edge_vpr.recordings.reading import foreign_errors
from edge_vpr_tools.research.intensity import aedat, images
from edge_vpr_tools.research.intensity.frames import IntensityFrame, IntensityFrames, frames_at

__all__ = ["IntensityFrames", "frames_at", "open_intensity"]


class Guarded:
    """Images whose reader raises only errors of this package, whatever libraries raise."""

    def __init__(self, path: Path, frames: IntensityFrames) -> None:
        self._path, self._frames = path, frames
        self.start_us, self.has_events = frames.start_us, frames.has_events

    def __iter__(self) -> Iterator[IntensityFrame]:
        with foreign_errors(self._path):
            yield from self._frames


def open_intensity(
    path: str | Path, *, topic: str | None = None, frame_period: Fraction | None = None
) -> IntensityFrames:
    """Open the intensity images of a recording, or of a folder.

    Parameters
    ----------
    path : str or Path
        AEDAT 4 with frames, a ROS bag with ``sensor_msgs/Image``, or a folder of PNG (see
        `edge_vpr_tools.research.intensity.images.ImageFolder` for its times).
    topic : str, optional
        Stream, camera or topic of the images, if there are several.
    frame_period : Fraction, optional
        Seconds from one image to the next, for folders that do not state it.

    Raises
    ------
    RecordingError
        If there are no images, or they cannot be read.
    UsageError
        If there are several streams of images, and `topic` is absent.
    """
    path = Path(path)
    check_file_or_folder(path)
    readers: dict[str, Callable[[], IntensityFrames]] = {
        "aedat4": lambda: aedat.Aedat4Frames(path, topic),
        "rosbag1": lambda: images.BagImages(path, 1, topic),
        "rosbag2": lambda: images.BagImages(path, 2, topic),
    }
    if path.is_dir():
        readers["frames"] = lambda: images.ImageFolder(path, frame_period)
    with foreign_errors(path):
        name = sniff(path)
        if name in readers:
            return Guarded(path, readers[name]())
    raise RecordingError(
        f"{path} is {name}, which holds no images that are read: name an AEDAT 4 file (DV converts "
        "older ones), a ROS bag, or a folder of PNG"
    )
