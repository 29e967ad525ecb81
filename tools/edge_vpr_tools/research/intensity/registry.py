"""Choice of the reader for a file of intensity images."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from importlib import import_module
from pathlib import Path

from edge_vpr.errors import RecordingError
from edge_vpr.recordings.recording import foreign_errors
from edge_vpr.recordings.registry import check_file_or_folder, sniff
from edge_vpr_tools.research.intensity.frames import IntensityFrame, IntensityFrames


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
        AEDAT 2, 3.1 or 4 with frames, a ROS bag with ``sensor_msgs/Image``, HDF5 with ``NAME`` and
        ``NAME_ts`` as in MVSEC, or a folder of PNG or ``.npy`` (see
        `edge_vpr_tools.research.intensity.images.ImageFolder` for its times).
    topic : str, optional
        Stream, camera, topic or data set of the images, if there are several.
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
    with foreign_errors(path):
        name = sniff(path)
        if name == "aedat4":
            module = import_module("edge_vpr_tools.research.intensity.aedat")
            return Guarded(path, module.Aedat4Frames(path, topic))
        if name == "aedat3":
            module = import_module("edge_vpr_tools.research.intensity.aedat")
            return Guarded(path, module.Aedat3Frames(path, topic))
        if name == "aedat2":
            module = import_module("edge_vpr_tools.research.intensity.aedat")
            return Guarded(path, module.Aedat2Frames(path))
        if name in ("rosbag1", "rosbag2"):
            module = import_module("edge_vpr_tools.research.intensity.images")
            return Guarded(path, module.BagImages(path, 1 if name == "rosbag1" else 2, topic))
        if name == "hdf5":
            module = import_module("edge_vpr_tools.research.intensity.images")
            return Guarded(path, module.Hdf5Images(path, topic))
        if name == "frames" and path.is_dir():
            module = import_module("edge_vpr_tools.research.intensity.images")
            return Guarded(path, module.ImageFolder(path, frame_period))
    raise RecordingError(
        f"{path} is {name}, which holds no images that are read: name an AEDAT file, a ROS bag, "
        "HDF5, or a folder of PNG or .npy"
    )
