"""The method's two data sets as `tonic.Dataset`s, with ground truth; needs the extra ``tonic``.

Nothing is downloaded, since the files are gigabytes, and the user must accept their licences.
`edge_vpr_tools.research.datasets` states the pages, and the names and sizes of the files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from edge_vpr.descriptors.counting import CountPixels
from edge_vpr.errors import MissingExtraError, RecordingError, UsageError
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import EVENT_DTYPE, Events
from edge_vpr.recordings import open_recording
from edge_vpr.recordings.reading import cropped_events
from edge_vpr_tools.research.datasets import (
    BRISBANE_TRAVERSES,
    QCR_TRAVERSES,
    SENSOR,
    TIME_UNITS,
    BrisbaneTraverse,
    Files,
    Landmarks,
    QCRTraverse,
)

try:
    from tonic import Dataset
except ImportError as error:
    raise MissingExtraError("a tonic dataset", "tonic", "tonic") from error

__all__ = ["BrisbaneEventVPR", "CountPixels", "QCREventVPR", "Target"]

Transform = Callable[[Any], Any]
Traverse = TypeVar("Traverse", bound=BrisbaneTraverse | QCRTraverse)


class Target(NamedTuple):
    """Name and track of a traverse."""

    traverse: str
    track: Track  #: Positions over the time of the events.


class _Traverses(Dataset, Generic[Traverse]):  # type: ignore[misc]  # tonic has no types
    """Events of each traverse from the beginning of its track to the end of it."""

    sensor_size = (*SENSOR, 2)
    dtype = EVENT_DTYPE
    ordering = EVENT_DTYPE.names

    _known: tuple[Traverse, ...]

    def __init__(
        self,
        folder: str | Path,
        traverses: Sequence[str] | None = None,
        *,
        files: Files = "parquet",
        on_fault: str = "error",
        transform: Transform | None = None,
        target_transform: Transform | None = None,
        transforms: Callable[[Any, Any], tuple[Any, Any]] | None = None,
    ) -> None:
        super().__init__(str(folder), transform, target_transform, transforms)
        self._folder = Path(folder).expanduser()
        # tonic would append the class name, but the user put these files there
        self.location_on_system = str(self._folder)
        if files not in ("parquet", "bag"):
            raise UsageError(f"files={files!r} is unknown: use parquet or bag")
        self._files: Files = files
        self._on_fault = on_fault
        known = {traverse.name: traverse for traverse in self._known}
        page = self._known[0].pages[files]
        for name in traverses or ():
            if name not in known:
                raise UsageError(f"traverse {name!r} is unknown: choose from {', '.join(known)}")
            if not self._path(known[name]).is_file():
                raise RecordingError(
                    f"{self._folder} does not hold {self._path(known[name]).name}: "
                    f"download it from {page}"
                )
        if traverses is None:
            traverses = [name for name in known if self._path(known[name]).is_file()]
        if not traverses:
            raise RecordingError(
                f"{self._folder} holds no recording such as {self._path(self._known[0]).name}: "
                f"download one or more from {page}, or name another folder"
            )
        self.traverses = tuple(traverses)
        self._chosen: list[Traverse] = [known[name] for name in traverses]
        #: by name, where they are not those that the traverse has by itself
        self._tracks: dict[str, Track] = {}

    def _path(self, traverse: Traverse) -> Path:
        return self._folder / traverse.file_name(self._files)

    def __len__(self) -> int:
        return len(self._chosen)

    def __getitem__(self, index: int) -> tuple[Any, Any]:
        chunks, target = self.stream(index)
        # This briefly needs twice the 13 bytes of each event; `stream` needs the bytes of a chunk.
        events: Any = np.concatenate([np.empty(0, EVENT_DTYPE), *chunks])
        found: Any = target
        if self.transform is not None:
            events = self.transform(events)
        if self.target_transform is not None:
            found = self.target_transform(found)
        if self.transforms is not None:
            events, found = self.transforms(events, found)
        return events, found

    def stream(self, index: int) -> tuple[Iterator[Events], Target]:
        """Read a traverse in bounded memory, without the transforms.

        Returns
        -------
        chunks : iterator of ndarray of EVENT_DTYPE
            Time 0 is that of the track; events before it and after the end of the track are left
            out.
        target : Target

        Raises
        ------
        IndexError
            If there is no such traverse.
        RecordingError
            If the recording cannot be read, or ends before the track begins.
        GroundTruthError
            If the track cannot be read.
        """
        traverse = self._chosen[index]
        path = self._path(traverse)
        unit = TIME_UNITS.get(path.suffix)
        recording = open_recording(path, sensor=SENSOR, on_fault=self._on_fault, time_unit=unit)
        track, beginning_us = traverse.origin(self._folder, recording.start_us)
        zero_us = beginning_us - recording.start_us
        target = Target(traverse.name, self._tracks.get(traverse.name, track))
        return _between(recording, zero_us, int(track.time_us[-1]), path), target


def _between(recording: Iterable[Events], zero: int, end: int, path: Path) -> Iterator[Events]:
    """Keep ``zero <= t < zero + end``, and count times from `zero`."""
    found = False
    for events in cropped_events(iter(recording), zero, zero + end):
        found = True
        yield events
    if not found:
        raise RecordingError(
            f"{path} has no event in the {end / 1e6:g} s of the traverse, which begins "
            f"{zero / 1e6:g} s after the recording: download both again, and do not rename files"
        )


class BrisbaneEventVPR(_Traverses[BrisbaneTraverse]):
    """Brisbane-Event-VPR: six drives of an 8 km route, with GPS.

    Fischer and Milford, "Event-Based Visual Place Recognition With Ensembles of Temporal Windows",
    RA-L 5(4), 2020. Matches are correct within 70 m (see
    `edge_vpr.evaluation.ground_truth.from_tracks`).

    Parameters
    ----------
    folder : str or Path
        Holds recordings and GPS logs under their published names:
        parquet files and logs from Hugging Face, or bags and logs from Zenodo.
    traverses : sequence of str, optional
        Names from sunset1, sunset2, daytime, night, morning, sunrise; by default all in the folder.
    files : {"parquet", "bag"}
        Parquet files are without hot pixels, bursts and noise; bags are as recorded.
    on_fault : {"error", "drop"}
        How to handle faulty events; see `edge_vpr.open_recording`.
    transform, target_transform, transforms : callable, optional
        As for every tonic dataset.

    Raises
    ------
    RecordingError
        If a recording is missing.

    Examples
    --------
    An item is the event array of a traverse, and a `Target` with its name and GPS track::

        events, target = BrisbaneEventVPR("downloads", ["sunset1"])[0]
    """

    _known = BRISBANE_TRAVERSES


class QCREventVPR(_Traverses[QCRTraverse]):
    """QCR-Event-VPR: seven traverses of a 160 m indoor route at three speeds, with landmarks.

    Fischer and Milford, "How Many Events Do You Need?", RA-L 7(4), 2022. Matches are correct within
    3 m. The data set has 16 traverses; landmarks were published for these seven.

    Parameters
    ----------
    landmarks : {"common", "released-code"}
        Positions of the landmarks; see `edge_vpr_tools.research.datasets.QCRTraverse.track`.
    folder, traverses, files, on_fault, transform, target_transform, transforms
        As `BrisbaneEventVPR` takes them; the names are normal1 to normal4, fast1, fast2 and slow1.

    Raises
    ------
    RecordingError
        If a recording is missing.
    """

    _known = QCR_TRAVERSES

    def __init__(self, *given: Any, landmarks: Landmarks = "common", **options: Any) -> None:
        super().__init__(*given, **options)
        self._tracks = {each.name: each.track(landmarks) for each in self._chosen}
