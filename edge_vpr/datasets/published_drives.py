"""Pairs of published traverses that lie in a folder, as in the paper of the method.

tonic is not needed. The first traverse of each data set is the reference, and the other traverses
of the paper are matched against it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from edge_vpr.datasets.catalogue import (
    BRISBANE_TRAVERSES,
    QCR_TRAVERSES,
    SENSOR,
    BrisbaneTraverse,
    Files,
    QCRTraverse,
)
from edge_vpr.evaluation.tracks import Track
from edge_vpr.recordings import Recording, open_recording
from edge_vpr.recordings.time_crop import TimeCrop

#: largest distance of a correct match in metres (paper, IV-B)
BRISBANE_M, QCR_M = 70.0, 3.0
#: not evaluated in either paper
_LEFT_OUT = ("night",)
_DATA_SETS: Mapping[str, tuple[tuple[BrisbaneTraverse | QCRTraverse, ...], float]] = {
    "Brisbane": (BRISBANE_TRAVERSES, BRISBANE_M),
    "QCR": (QCR_TRAVERSES, QCR_M),
}


@dataclass(frozen=True, eq=False)
class PublishedDrive:
    """Traverse from the beginning of its track to the end of it.

    Attributes
    ----------
    name : str
    path : Path
    recording : Recording
        Its time 0 is that of the track.
    track : Track
    """

    name: str
    path: Path
    recording: Recording
    track: Track


@dataclass(frozen=True, eq=False)
class PublishedPair:
    """Two traverses of one data set."""

    name: str
    reference: PublishedDrive
    query: PublishedDrive
    tolerance_m: float


def published_pairs(
    folder: Path, files: tuple[Files, ...] = ("parquet", "bag")
) -> Iterator[PublishedPair]:
    """Open the pairs whose files are in a folder, one after another.

    Parameters
    ----------
    folder : Path
        Holds recordings and GPS logs under their published names (`edge_vpr.datasets.catalogue`).
    files : tuple of {"parquet", "bag"}
        Kinds of files to use, in order of preference.

    Raises
    ------
    RecordingError
        If a recording cannot be read.
    GroundTruthError
        If the GPS log of a recording is missing or cannot be read.
    """
    for title, found in found_traverses(folder, files).items():
        for traverse, path in found[1:]:
            reference, query = open_drive(*found[0]), open_drive(traverse, path)
            yield PublishedPair(
                f"{title}, {query.name} against {reference.name}",
                reference,
                query,
                _DATA_SETS[title][1],
            )


def found_traverses(
    folder: Path, files: tuple[Files, ...] = ("parquet", "bag")
) -> dict[str, list[tuple[BrisbaneTraverse | QCRTraverse, Path]]]:
    """Return the traverses whose recordings are in a folder, in order, by their data set.

    Parameters
    ----------
    folder : Path
    files : tuple of {"parquet", "bag"}
        Kinds of files to use, in order of preference.

    Returns
    -------
    dict of str to list of (traverse, path)
        Brisbane and QCR; the lists may be empty.
    """
    return {
        title: [
            (traverse, path)
            for traverse in traverses
            if traverse.name not in _LEFT_OUT and (path := find_file(traverse, folder, files))
        ]
        for title, (traverses, _) in _DATA_SETS.items()
    }


def find_file(
    traverse: BrisbaneTraverse | QCRTraverse, folder: Path, files: tuple[Files, ...]
) -> Path | None:
    """Return the recording of a traverse; None if the folder does not hold it."""
    for kind in files:
        if (path := folder / traverse.file_name(kind)).is_file():
            return path
    return None


def open_drive(traverse: BrisbaneTraverse | QCRTraverse, path: Path) -> PublishedDrive:
    """Open the recording of a traverse, cut to its track.

    Parameters
    ----------
    traverse : BrisbaneTraverse or QCRTraverse
    path : Path
        Path of its recording; the GPS log must lie in the same folder.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    GroundTruthError
        If the GPS log is missing or cannot be read.
    """
    recording = open_recording(
        path, sensor=SENSOR, on_fault="drop", time_unit="us" if path.suffix == ".parquet" else None
    )
    if isinstance(traverse, BrisbaneTraverse):
        track, beginning_us = traverse.track(path.parent)
    else:
        track = traverse.track()
        beginning_us = recording.start_us + round(traverse.start_s * 1e6)
    crop = TimeCrop(end_us=int(track.time_us[-1]), offset_us=beginning_us)
    return PublishedDrive(traverse.name, path, recording.cropped(crop), track)
