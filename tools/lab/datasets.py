"""The drives that experiments read: files, addresses, clocks and positions.

Nothing is downloaded, since the files are gigabytes, and the user must accept their licences. The
figures of Brisbane-Event-VPR and QCR-Event-VPR are facts stated by the data sets' authors in

- https://github.com/Tobias-Fischer/sparse-event-vpr, ``src/sparse_event_vpr/constants.py``
- https://github.com/Tobias-Fischer/ensemble-event-vpr,
  ``correspondence-event-camera-frame-camera.py``

A file belongs to a traverse if its name is exactly one of the traverse's names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Sensor
from edge_vpr.recordings import Recording, TimeCrop, open_recording
from edge_vpr.recordings.reading import OnFault, TimeUnit

# Published files.


BRISBANE_PAGE = "https://huggingface.co/datasets/TobiasRobotics/brisbane-event-vpr"
BRISBANE_BAGS_PAGE = "https://zenodo.org/records/4302805"
QCR_PAGE = "https://zenodo.org/records/10494919"


class PublishedFile(NamedTuple):
    """A file of a data set."""

    name: str  #: Path in the folder of the data.
    size: int | None = None  #: In bytes; None if it is not known.
    sha256: str = ""  #: In hexadecimal digits; empty if it is not known.

    @property
    def text(self) -> str:
        """Name and published size for messages."""
        return self.name if self.size is None else f"{self.name} ({self.size / 1e9:.2f} GB)"

    def is_in(self, folder: Path) -> bool:
        """Return whether a folder holds a file of this name."""
        return (folder / self.name).is_file()

    def damage(self, folder: Path, *, hashed: bool = False) -> str:
        """Return how the file in a folder differs from the published one; empty if it does not.

        Parameters
        ----------
        hashed : bool
            Also compare the hash, for which the whole file is read.
        """
        path = folder / self.name
        size = path.stat().st_size
        if self.size is not None and size != self.size:
            return f"{size:,} bytes, of {self.size:,} published"
        if hashed and self.sha256:
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != self.sha256:
                    return "another SHA-256 than published"
        return ""


class Download(NamedTuple):
    """Files of one drive, or of the drives of one folder, from one address."""

    title: str  #: Data set, and drive.
    address: str
    files: tuple[PublishedFile, ...]

    @property
    def text(self) -> str:
        """Names and sizes of the files, and the address, for messages."""
        return f"{', '.join(file.text for file in self.files)} of {self.address}"


def damaged_files(
    folder: Path, downloads: Iterable[Download], *, hashed: bool = False
) -> Iterator[str]:
    """Yield a sentence on each file that is there and is not the published one."""
    for download in downloads:
        for file in download.files:
            if file.is_in(folder) and (damage := file.damage(folder, hashed=hashed)):
                yield f"{folder / file.name}: {damage}: download it again from {download.address}"


def listing(downloads: Iterable[Download], folder: Path | None) -> Iterator[str]:
    """Yield a line on each file: whether it is in a folder, its size and its address."""
    for download in downloads:
        yield f"{download.title} ({download.address})"
        for file in download.files:
            there = folder is not None and file.is_in(folder)
            yield f"  {'there' if there else 'missing'}: {file.text}"


_LENS_PAGE = "https://github.com/AdamDHines/LENS"
#: folders of counts and short frames that were made of published files, by their name
STAND_INS = {
    folder: Download(title, address, tuple(PublishedFile(f"{folder}/{name}") for name in names))
    for folder, title, address, names in (
        ("brisbane_sparse49", "event counts at 49 pixels of Brisbane-Event-VPR, sunset 1 and 2",
         BRISBANE_BAGS_PAGE, ("sunset1.npz", "sunset2.npz", "sunset1.nmea", "sunset2.nmea")),
        ("brisbane_lens49", "the same drives at 49 other pixels, and weights of LENS trained with "
         "them", _LENS_PAGE, ("sunset1.npz", "sunset2.npz")),
        ("speck_indoor", "two walks with a Speck, 80 x 80, one frame a second",
         _LENS_PAGE, ("reference.npz", "query.npz")),
        ("speck_walks", "two walks with a Speck, 128 x 128, in short frames",
         _LENS_PAGE, ("reference.npz", "query.npz", "ground_truth.csv")),
    )
}  # fmt: skip

# Traverses: clocks and positions.


#: DAVIS346 of both data sets
SENSOR = Sensor(346, 260)

#: Length of the route of QCR-Event-VPR in metres (How Many Events Do You Need?, section I).
QCR_ROUTE_M = 160.0

Files = Literal["parquet", "bag"]
#: in order of preference
KINDS: tuple[Files, ...] = ("parquet", "bag")
#: of files that do not state theirs
TIME_UNITS: dict[str, TimeUnit] = {".parquet": "us"}


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
    #: size, sha256: of the parquet file of commit 4e0e9bf of its page, if they were published.
    size: int | None = None
    sha256: str = ""

    pages: ClassVar[Mapping[Files, str]] = {"parquet": BRISBANE_PAGE, "bag": BRISBANE_BAGS_PAGE}

    def file_name(self, kind: Files) -> str:
        """Return the published name of the recording's file."""
        if kind == "bag":
            return f"{self.recording}.bag"
        return f"{self.recording}_no_hot_pixels_nobursts_denoised.parquet"

    @property
    def downloads(self) -> tuple[Download, ...]:
        """Files of the traverse from each page, any of which will do."""
        title = f"Brisbane-Event-VPR, {self.name}"
        bag, log = self.file_name("bag"), f"{self.video}_concat.nmea"
        bags = Download(title, BRISBANE_BAGS_PAGE, (PublishedFile(bag), PublishedFile(log)))
        if self.beginning_s is None:
            return (bags,)
        parquet = PublishedFile(self.file_name("parquet"), self.size, self.sha256)
        log = f"{self.recording}.nmea"
        return Download(title, BRISBANE_PAGE, (parquet, PublishedFile(log))), bags

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

    pages: ClassVar[Mapping[Files, str]] = {"parquet": QCR_PAGE, "bag": QCR_PAGE}

    def file_name(self, kind: Files) -> str:
        """Return the published name of the recording's file."""
        return f"{self.recording}.bag" if kind == "bag" else f"{self.recording}_denoised.parquet"

    @property
    def downloads(self) -> tuple[Download, ...]:
        """Files of the traverse, any of which will do."""
        title = f"QCR-Event-VPR, {self.name}"
        return tuple(
            Download(title, QCR_PAGE, (PublishedFile(self.file_name(kind)),)) for kind in KINDS
        )

    def origin(self, folder: Path, start_us: int) -> tuple[Track, int]:
        """Return the landmarks as a track, and the time at which the robot set off."""
        return self.track(), start_us + round(self.start_s * 1e6)

    def track(self) -> Track:
        """Return the metres along the route, from the times at which the landmarks were passed.

        The positions of the landmarks were not published. The released code takes each traverse's
        own share of time, by which a landmark moves by up to 13 m; here it is one place.

        Returns
        -------
        Track
            Metric, one coordinate; time 0 is when the robot set off.
        """
        # the times were set by hand, tens of seconds apart: no gap is too long
        time_us = np.round(np.array(self.landmarks_s) * 1e6).astype(np.int64)
        return Track(time_us, QCR_LANDMARKS_M[:, None], max_gap_us=int(np.diff(time_us).max()))


BRISBANE_TRAVERSES = (
    BrisbaneTraverse("sunset1", "dvs_vpr_2020-04-21-17-03-03", "20200421_170039-sunset1",
                     1587452593.35, 1587452582.35, 1_925_019_428,
                     "f22ab3da46fc87263649d13d71a586ffcdddefb9a5af81279e95084dd6dcfeb9"),
    BrisbaneTraverse("sunset2", "dvs_vpr_2020-04-22-17-24-21", "20200422_172431-sunset2",
                     1587540271.65, 1587540271.65, 2_779_116_068,
                     "8c71331cb09732b0a89591ba258982f6b7bbdfc4fec331c17a480006843068b8"),
    BrisbaneTraverse("daytime", "dvs_vpr_2020-04-24-15-12-03", "20200424_151015-daytime",
                     1587705136.80, 1587705130.80, 2_082_849_662,
                     "5931a88e5a995e97f0785ad8de23ac8ddb0bb5c59bde7e153a3f955bdd3c6ae1"),
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

#: Metres along the route of each landmark: the median over traverses of its share of time.
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
Traverse = BrisbaneTraverse | QCRTraverse
#: not evaluated in either paper
_LEFT_OUT = ("night",)
DATA_SETS: Mapping[str, tuple[tuple[Traverse, ...], float]] = {
    "Brisbane": (BRISBANE_TRAVERSES, BRISBANE_M),
    "QCR": (QCR_TRAVERSES, QCR_M),
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


def published_pairs(folder: Path, files: tuple[Files, ...] = KINDS) -> Iterator[PublishedPair]:
    """Open the pairs whose files are in a folder, one after another.

    Parameters
    ----------
    folder : Path
        Holds recordings and GPS logs under their published names.
    files : tuple of {"parquet", "bag"}
        Kinds of files to use, in order of preference.

    Raises
    ------
    RecordingError
        If a recording cannot be read.
    GroundTruthError
        If the GPS log of a recording is missing or cannot be read.
    """
    for title, traverses in traverses_in(folder, files).items():
        for traverse, path in traverses[1:]:
            reference, query = open_drive(*traverses[0]), open_drive(traverse, path)
            yield PublishedPair(
                f"{title}, {query.name} against {reference.name}",
                reference,
                query,
                DATA_SETS[title][1],
            )


def traverses_in(
    folder: Path, files: tuple[Files, ...] = KINDS
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
        if (path := folder / traverse.file_name(kind)).is_file():
            return path
    return None


def open_drive(traverse: Traverse, path: Path, *, on_fault: OnFault = "drop") -> PublishedDrive:
    """Open the recording of a traverse, cut to the track that lies in the same folder.

    Times count from the beginning of the track, or of the recording if this is later.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    GroundTruthError
        If the GPS log is missing or cannot be read.
    """
    unit = TIME_UNITS.get(path.suffix)
    recording = open_recording(path, sensor=SENSOR, on_fault=on_fault, time_unit=unit)
    track, beginning_us = traverse.origin(path.parent, recording.start_us)
    late_us = max(0, recording.start_us - beginning_us)
    if late_us:
        track = replace(track, time_us=track.time_us - late_us, start_utc=None)
    crop = TimeCrop(end_us=int(track.time_us[-1]), offset_us=beginning_us + late_us)
    return PublishedDrive(traverse.name, path, recording.cropped(crop), track)
