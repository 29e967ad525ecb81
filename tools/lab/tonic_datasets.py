"""The method's two data sets as `tonic.Dataset`s, with ground truth; needs the extra ``tonic``.

Nothing is downloaded, since the files are gigabytes, and the user must accept their licences.
`lab.datasets` states the pages, and the names and sizes of the files.

>>> drives = BrisbaneEventVPR("downloads", ["sunset2", "sunset1"])  # doctest: +SKIP
>>> (_, reference), (_, query) = drives  # doctest: +SKIP
>>> route = ReferenceMap.build(  # doctest: +SKIP
...     drives[0], sensor=drives.sensor_size, track=reference.track
... )
>>> result = route.match(drives[1])  # doctest: +SKIP
>>> result.evaluate((reference.track, query.track), tolerance_m=70)  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edge_vpr.descriptors.counting import CountPixels
from edge_vpr.errors import MissingExtraError, RecordingError, UsageError
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import EVENT_DTYPE, Events, join_events
from edge_vpr.recordings.reading import OnFault
from lab.datasets import (
    BRISBANE_TRAVERSES,
    KINDS,
    QCR_TRAVERSES,
    SENSOR,
    Files,
    Traverse,
    open_drive,
)

try:
    from tonic import Dataset
except ImportError as error:
    raise MissingExtraError("a tonic dataset", "tonic", "tonic") from error

__all__ = ["BrisbaneEventVPR", "CountPixels", "QCREventVPR", "Target"]

Transform = Callable[[Any], Any]


class Target(NamedTuple):
    """Name and track of a traverse."""

    traverse: str
    track: Track  #: Positions over the time of the events.


class _Traverses(Dataset):  # type: ignore[misc]  # tonic has no types
    """Events of each traverse from the beginning of its track to the end of it."""

    sensor_size = (*SENSOR, 2)
    dtype = EVENT_DTYPE
    ordering = EVENT_DTYPE.names

    _traverses: tuple[Traverse, ...]

    def __init__(
        self,
        folder: str | Path,
        traverses: Sequence[str] | None = None,
        *,
        files: Files = "parquet",
        on_fault: OnFault = "error",
        transform: Transform | None = None,
        target_transform: Transform | None = None,
        transforms: Callable[[Any, Any], tuple[Any, Any]] | None = None,
    ) -> None:
        super().__init__(str(folder), transform, target_transform, transforms)
        folder = Path(folder).expanduser()
        # tonic would append the class name, but the user put these files there
        self.location_on_system = str(folder)
        if files not in KINDS:
            raise UsageError(f"files={files!r} is unknown: use {' or '.join(KINDS)}")
        self._on_fault = on_fault
        by_name = {traverse.name: traverse for traverse in self._traverses}
        paths = {name: folder / traverse.file_name(files) for name, traverse in by_name.items()}
        page = self._traverses[0].pages[files]
        for name in traverses or ():
            if name not in by_name:
                raise UsageError(f"traverse {name!r} is unknown: choose from {', '.join(by_name)}")
            if not paths[name].is_file():
                raise RecordingError(
                    f"{folder} does not hold {paths[name].name}: download it from {page}"
                )
        if traverses is None:
            traverses = [name for name, path in paths.items() if path.is_file()]
        if not traverses:
            raise RecordingError(
                f"{folder} holds no recording such as {paths[self._traverses[0].name].name}: "
                f"download one or more from {page}, or name another folder"
            )
        self.traverses = tuple(traverses)
        self._chosen = [(by_name[name], paths[name]) for name in traverses]

    def __len__(self) -> int:
        return len(self._chosen)

    def __getitem__(self, index: int) -> tuple[Any, Any]:
        chunks, target = self.stream(index)
        # This briefly needs twice the 13 bytes of each event; `stream` needs the bytes of a chunk.
        events: Any = np.asarray(join_events(list(chunks)))
        labelled: Any = target
        if self.transform is not None:
            events = self.transform(events)
        if self.target_transform is not None:
            labelled = self.target_transform(labelled)
        if self.transforms is not None:
            events, labelled = self.transforms(events, labelled)
        return events, labelled

    def stream(self, index: int) -> tuple[Iterator[Events], Target]:
        """Read a traverse in bounded memory, without the transforms.

        Returns
        -------
        chunks : iterator of Events
            Time 0 is that of the track; events before it and after the end of the track are left
            out.
        target : Target

        Raises
        ------
        IndexError
            If there is no such traverse.
        RecordingError
            If the recording cannot be read, or has no events during the track.
        GroundTruthError
            If the track cannot be read.
        """
        drive = open_drive(*self._chosen[index], on_fault=self._on_fault)
        return iter(drive.recording), Target(drive.name, drive.track)


class BrisbaneEventVPR(_Traverses):
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

    _traverses = BRISBANE_TRAVERSES


class QCREventVPR(_Traverses):
    """QCR-Event-VPR: seven traverses of a 160 m indoor route at three speeds, with landmarks.

    Fischer and Milford, "How Many Events Do You Need?", RA-L 7(4), 2022. Matches are correct within
    3 m. The data set has 16 traverses; landmarks were published for these seven.

    Parameters
    ----------
    folder, traverses, files, on_fault, transform, target_transform, transforms
        As `BrisbaneEventVPR` takes them; the names are normal1 to normal4, fast1, fast2 and slow1.

    Raises
    ------
    RecordingError
        If a recording is missing.
    """

    _traverses = QCR_TRAVERSES
