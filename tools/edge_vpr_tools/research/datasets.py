"""The published traverses of Brisbane-Event-VPR, QCR-Event-VPR and NSAVP: clocks and positions.

Addresses, sizes and hashes of the files are in `research.catalogue`, with the data sets that are
not opened. The figures are facts stated by the data sets' authors in

- https://github.com/Tobias-Fischer/sparse-event-vpr, ``src/sparse_event_vpr/constants.py``
- https://github.com/Tobias-Fischer/ensemble-event-vpr,
  ``correspondence-event-camera-frame-camera.py``
- https://github.com/umautobots/nsavp_tools, ``documentation/data_format.md``

A file belongs to a traverse if its name is exactly one of the traverse's names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from edge_vpr.errors import GroundTruthError, UsageError
from edge_vpr.evaluation.tracks import MAX_GAP_S, Track, load_track
from edge_vpr.events import Sensor
from edge_vpr.recordings import Recording, TimeCrop, open_recording
from edge_vpr.recordings.hdf5 import CheckedDataset, load_h5py
from edge_vpr_tools.research.catalogue import (
    BRISBANE_BAGS_PAGE,
    BRISBANE_PAGE,
    NSAVP_PAGE,
    QCR_PAGE,
    Download,
    PublishedFile,
    brisbane_download,
    nsavp_download,
)

#: DAVIS346 of Brisbane-Event-VPR and QCR-Event-VPR, and DVXplorer of NSAVP.
SENSOR, NSAVP_SENSOR = Sensor(346, 260), Sensor(640, 480)

#: Length of the route of QCR-Event-VPR in metres (How Many Events Do You Need?, section I).
QCR_ROUTE_M = 160.0

Files = Literal["parquet", "bag", "hdf5"]
#: in order of preference
_EVERY_KIND: tuple[Files, ...] = ("parquet", "bag", "hdf5")
#: of files that do not state theirs
TIME_UNITS = {".parquet": "us", ".h5": "ns"}
Landmarks = Literal["common", "released-code"]


@dataclass(frozen=True)
class BrisbaneTraverse:
    """One drive of the 8 km route of Brisbane-Event-VPR.

    The GPS logs come from a second camera, whose first frame and first GPS second coincide. The
    time of this beginning on the event camera's clock was published twice, with two editions of the
    logs: the complete logs on Zenodo (``*_concat.nmea``), and others on Hugging Face, which have
    the names of the recordings and lack the first seconds. Each beginning belongs to its own
    edition: for sunset 1 the two beginnings differ by 11 s, and the published logs by exactly 11 s
    of sentences.
    """

    name: str
    recording: str  #: Stem of the recording's file names.
    video: str  #: Stem of the complete log's file name.
    #: Unix time at the first second of the log on Hugging Face; None if there is no such log.
    beginning_s: float | None
    complete_beginning_s: float  #: Unix time at the first second of the log on Zenodo.

    sensor = SENSOR
    kinds: ClassVar[tuple[Files, ...]] = ("parquet", "bag")

    def file_name(self, kind: Files) -> str:
        """Return the published name of the recording's file."""
        if kind == "bag":
            return f"{self.recording}.bag"
        return f"{self.recording}_no_hot_pixels_nobursts_denoised.parquet"

    @property
    def downloads(self) -> tuple[Download, ...]:
        """Files of the traverse from each page, any of which will do."""
        title, bag = f"Brisbane-Event-VPR, {self.name}", PublishedFile(self.file_name("bag"))
        log = PublishedFile(f"{self.video}_concat.nmea")
        bags = Download(title, BRISBANE_BAGS_PAGE, (bag, log))
        return (bags,) if self.beginning_s is None else (
            brisbane_download(self.name, self.recording), bags
        )  # fmt: skip

    @property
    def logs(self) -> dict[str, float]:
        """Return the published GPS logs by name, each with the Unix time at its first second."""
        logs = {f"{self.video}_concat.nmea": self.complete_beginning_s}
        if self.beginning_s is not None:
            logs = {f"{self.recording}.nmea": self.beginning_s, **logs}
        return logs

    def origin(self, folder: Path, start_us: int) -> tuple[Track, int]:
        """Return the GPS log, and the Unix time of its time 0 on the event camera's clock.

        Raises
        ------
        GroundTruthError
            If the folder holds none of the traverse's logs.
        """
        for log, beginning_s in self.logs.items():
            if (folder / log).is_file():
                return load_track(folder / log), round(beginning_s * 1e6)
        raise GroundTruthError(
            f"{folder} holds no GPS log of {self.name} ({' or '.join(self.logs)}): download it "
            f"from {BRISBANE_PAGE if self.beginning_s else BRISBANE_BAGS_PAGE}"
        )


@dataclass(frozen=True)
class QCRTraverse:
    """One traverse of the 160 m indoor route of QCR-Event-VPR, with the camera facing sideways."""

    name: str
    recording: str  #: Stem of the recording's file names.
    start_s: float  #: Time at which the robot set off, in seconds after the first event.
    #: Times at which it passed each of the eleven landmarks, in seconds after it set off.
    landmarks_s: tuple[float, ...]

    sensor = SENSOR
    kinds: ClassVar[tuple[Files, ...]] = ("parquet", "bag")

    def file_name(self, kind: Files) -> str:
        """Return the published name of the recording's file."""
        return f"{self.recording}.bag" if kind == "bag" else f"{self.recording}_denoised.parquet"

    @property
    def downloads(self) -> tuple[Download, ...]:
        """Files of the traverse, any of which will do."""
        title = f"QCR-Event-VPR, {self.name}"
        return tuple(
            Download(title, QCR_PAGE, (PublishedFile(self.file_name(kind)),)) for kind in self.kinds
        )

    def origin(self, folder: Path, start_us: int) -> tuple[Track, int]:
        """Return the landmarks as a track, and the time at which the robot set off."""
        return self.track(), start_us + round(self.start_s * 1e6)

    def track(self, landmarks: Landmarks = "common") -> Track:
        """Return the metres along the route, from the times at which the landmarks were passed.

        Parameters
        ----------
        landmarks : {"common", "released-code"}
            Positions of the landmarks, which were not published. "common": the same for all
            traverses, the median over traverses of the landmark's share of time, times 160 m.
            "released-code": each traverse's own share of time, so that the landmarks in between
            have no effect; the positions of a landmark then differ by up to 13 m, although the
            tolerance is 3 m.

        Returns
        -------
        Track
            Metric, one coordinate; time 0 is when the robot set off.
        """
        time_s = np.array(self.landmarks_s)
        if landmarks == "common":
            route = QCR_LANDMARKS_M
        elif landmarks == "released-code":
            route = QCR_ROUTE_M * time_s / time_s[-1]
        else:
            raise UsageError(f"landmarks {landmarks!r} is unknown: use common or released-code")
        # the times were set by hand, tens of seconds apart: no gap is too long
        return Track(np.round(time_s * 1e6).astype(np.int64), route[:, None])


@dataclass(frozen=True)
class NSAVPTraverse:
    """One drive of NSAVP, by the left event camera (DVXplorer), with poses of the vehicle.

    Events and poses have one clock (TAI, in nanoseconds). The poses are those of the vehicle's rear
    axle in an Earth-fixed frame; the camera, which looks forward, is some metres ahead, in all
    drives of one direction alike.
    """

    name: str

    sensor = NSAVP_SENSOR
    kinds: ClassVar[tuple[Files, ...]] = ("hdf5",)

    def file_name(self, kind: Files) -> str:
        """Return the published name of the recording's file, which is of one kind."""
        return f"{self.name}_dvxplorer_left.h5"

    @property
    def downloads(self) -> tuple[Download, ...]:
        """Files of the traverse."""
        return (nsavp_download(self.name),)

    def origin(self, folder: Path, start_us: int) -> tuple[Track, int]:
        """Return the poses as a track of three metric coordinates, and the time of its time 0.

        Time 0 is that of the first pose.

        Raises
        ------
        GroundTruthError
            If the file of poses is missing or of another form.
        """
        path = folder / f"{self.name}_applanix.h5"
        if not path.is_file():
            raise GroundTruthError(
                f"{folder} holds no poses of {self.name} ({path.name}): download them from "
                f"{NSAVP_PAGE}"
            )
        with _poses_of(path) as file:
            try:
                group = file["pose_base_link"]
                position, time_ns = (
                    CheckedDataset(path, group[name]).read(slice(0, len(group[name])))
                    for name in ("positions", "timestamps")
                )
                time_us = time_ns.astype(np.int64) // 1_000
            except (KeyError, TypeError, ValueError, OSError) as error:
                raise GroundTruthError(
                    f"{path} has no poses as NSAVP has them ({error}): download it again"
                ) from error
        zero = int(time_us[0]) if time_us.size else start_us
        kept = np.diff(time_us, prepend=-1) > 0
        track = Track(time_us[kept] - zero, position[kept], max_gap_us=round(MAX_GAP_S * 1e6))
        return track, zero


@contextmanager
def _poses_of(path: Path) -> Iterator[Any]:
    """Open a file of poses."""
    try:
        file = load_h5py().File(path, "r", locking=False)
    except OSError as error:
        raise GroundTruthError(f"{path} cannot be read ({error}): download it again") from error
    with file:
        yield file


BRISBANE_TRAVERSES = (
    BrisbaneTraverse("sunset1", "dvs_vpr_2020-04-21-17-03-03", "20200421_170039-sunset1",
                     1587452593.35, 1587452582.35),
    BrisbaneTraverse("sunset2", "dvs_vpr_2020-04-22-17-24-21", "20200422_172431-sunset2",
                     1587540271.65, 1587540271.65),
    BrisbaneTraverse("daytime", "dvs_vpr_2020-04-24-15-12-03", "20200424_151015-daytime",
                     1587705136.80, 1587705130.80),
    # published only as a bag, and not evaluated in either paper
    BrisbaneTraverse("night", "dvs_vpr_2020-04-27-18-13-29", "20200427_181204-night",
                     None, 1587975221.10),
    BrisbaneTraverse("morning", "dvs_vpr_2020-04-28-09-14-11", "20200428_091154-morning",
                     1588029271.73, 1588029265.73),
    BrisbaneTraverse("sunrise", "dvs_vpr_2020-04-29-06-20-23", "20200429_061912-sunrise",
                     1588105240.91, 1588105232.91),
)  # fmt: skip

QCR_TRAVERSES = (
    QCRTraverse("normal1", "bags_2021-08-19-08-25-42", 2.0,
                (0, 6, 13, 31, 58, 77, 101.5, 124, 148, 157.7, 163)),
    QCRTraverse("normal2", "bags_2021-08-19-08-28-43", 0.0,
                (0, 6, 13, 31.5, 58, 76, 100.5, 123, 148.5, 156.5, 162)),
    QCRTraverse("normal3", "bags_2021-08-19-09-45-28", 2.0,
                (0, 6.5, 13.5, 31.5, 58.5, 77.5, 102.5, 126, 150, 158.5, 165)),
    QCRTraverse("normal4", "bags_2022-03-28-11-51-26", 8.0,
                (0, 6.7, 13.2, 31, 57, 74, 97, 119, 141, 148, 154)),
    QCRTraverse("fast1", "bags_2022-03-28-12-01-42", 7.7,
                (0, 2.9, 5.8, 12.9, 23.5, 32, 41.5, 50, 59.3, 62, 64.5)),
    QCRTraverse("fast2", "bags_2021-08-20-10-19-45", 0.0,
                (0, 2.5, 5, 12.7, 23.7, 33.6, 43, 52.4, 62.3, 65.4, 68)),
    QCRTraverse("slow1", "bags_2022-03-28-12-03-44", 12.0,
                (0, 15.5, 30, 63.5, 110, 141, 185, 217, 246.5, 256, 263)),
)  # fmt: skip

#: forward and reverse along one route, in the afternoon, at sunset and at night
NSAVP_FORWARD = tuple(NSAVPTraverse(f"R0_F{light}0") for light in "ASN")
NSAVP_REVERSE = tuple(NSAVPTraverse(f"R0_R{light}0") for light in "ASN")

#: Metres along the route of each landmark; see `QCRTraverse.track`.
QCR_LANDMARKS_M = QCR_ROUTE_M * np.median(
    [np.array(t.landmarks_s) / t.landmarks_s[-1] for t in QCR_TRAVERSES], axis=0
)
QCR_LANDMARKS_M.setflags(write=False)


# Pairs of published traverses that lie in a folder, as in the paper of the method.
#
# tonic is not needed. The first traverse of each data set is the reference, and the other traverses
# of the paper are matched against it.


#: largest distance of a correct match in metres (paper, IV-B)
BRISBANE_M, QCR_M = 70.0, 3.0
#: in NSAVP: its tools evaluate 5 to 30 m
NSAVP_M = 25.0
Traverse = BrisbaneTraverse | QCRTraverse | NSAVPTraverse
#: not evaluated in either paper
_LEFT_OUT = ("night",)
DATA_SETS: Mapping[str, tuple[tuple[Traverse, ...], float]] = {
    "Brisbane": (BRISBANE_TRAVERSES, BRISBANE_M),
    "QCR": (QCR_TRAVERSES, QCR_M),
    "NSAVP forward": (NSAVP_FORWARD, NSAVP_M),
    "NSAVP reverse": (NSAVP_REVERSE, NSAVP_M),
}


@dataclass(frozen=True, eq=False)
class PublishedDrive:
    """Traverse from the beginning of its track to the end of it."""

    name: str
    path: Path
    recording: Recording  #: On the clock of the track.
    track: Track


@dataclass(frozen=True, eq=False)
class PublishedPair:
    """Two traverses of one data set."""

    name: str
    reference: PublishedDrive
    query: PublishedDrive
    tolerance_m: float


def published_pairs(
    folder: Path, files: tuple[Files, ...] = _EVERY_KIND
) -> Iterator[PublishedPair]:
    """Open the pairs whose files are in a folder, one after another.

    Parameters
    ----------
    folder : Path
        Holds recordings and GPS logs under their published names.
    files : tuple of {"parquet", "bag", "hdf5"}
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
                DATA_SETS[title][1],
            )


def found_traverses(
    folder: Path, files: tuple[Files, ...] = _EVERY_KIND
) -> dict[str, list[tuple[Traverse, Path]]]:
    """Return the traverses whose recordings are in a folder, in order, by their data set.

    Returns
    -------
    dict of str to list of (traverse, path)
        Of `DATA_SETS`; the lists may be empty.
    """
    return {
        title: [
            (traverse, path)
            for traverse in traverses
            if traverse.name not in _LEFT_OUT and (path := find_file(traverse, folder, files))
        ]
        for title, (traverses, _) in DATA_SETS.items()
    }


def find_file(traverse: Traverse, folder: Path, files: tuple[Files, ...]) -> Path | None:
    """Return the recording of a traverse; None if the folder does not hold it."""
    for kind in files:
        if kind in traverse.kinds and (path := folder / traverse.file_name(kind)).is_file():
            return path
    return None


def open_drive(traverse: Traverse, path: Path) -> PublishedDrive:
    """Open the recording of a traverse, cut to the track that lies in the same folder.

    Times count from the beginning of the track, or of the recording if this is later.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    GroundTruthError
        If the GPS log or the poses are missing or cannot be read.
    """
    unit = TIME_UNITS.get(path.suffix)
    recording = open_recording(path, sensor=traverse.sensor, on_fault="drop", time_unit=unit)
    track, beginning_us = traverse.origin(path.parent, recording.start_us)
    late_us = max(0, recording.start_us - beginning_us)
    if late_us:
        track = replace(track, time_us=track.time_us - late_us, start_utc=None)
    crop = TimeCrop(end_us=int(track.time_us[-1]), offset_us=beginning_us + late_us)
    return PublishedDrive(traverse.name, path, recording.cropped(crop), track)
