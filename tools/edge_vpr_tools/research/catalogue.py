"""Catalogue of the drives that experiments read: addresses, files, sizes and hashes.

Sizes and hashes are those that the pages of the data sets state. Nothing is downloaded, since the
files are gigabytes, and the user must accept their licences.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

#: problem of a file that is not there
MISSING = "missing"


@dataclass(frozen=True)
class PublishedFile:
    """A file of a data set."""

    name: str  #: Path in the folder of the data.
    size: int | None = None  #: In bytes; None if it is not known.
    about: str = ""  #: Rounded size, where no other is known; empty if none is.
    sha256: str = ""  #: In hexadecimal digits; empty if it is not known.

    @property
    def size_text(self) -> str:
        """Published size for messages."""
        if self.size is None:
            return self.about or "size not known"
        return f"{self.size / 1e9:.2f} GB" if self.size >= 1e9 else f"{self.size / 1e6:.2f} MB"

    def problem(self, folder: Path, *, hashed: bool = False) -> str:
        """Return what is wrong with the file in a folder; empty if nothing is.

        Parameters
        ----------
        hashed : bool
            Also compare the hash, for which the whole file is read.
        """
        path = folder / self.name
        if not path.is_file():
            return MISSING
        found = path.stat().st_size
        if self.size is not None and found != self.size:
            return f"{found:,} bytes, of {self.size:,} published: download it again"
        if hashed and self.sha256:
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != self.sha256:
                    return "another SHA-256 than published: download it again"
        return ""


@dataclass(frozen=True)
class Download:
    """Files of one drive, or of the drives of one folder, from one address."""

    title: str  #: Data set, and drive.
    address: str
    files: tuple[PublishedFile, ...]
    #: What is not known, and why the drives are not opened; empty for those that experiments read.
    note: str = ""

    @property
    def names(self) -> str:
        """Names and sizes of the files for messages."""
        return ", ".join(
            f"{file.name} ({file.size_text})" if file.size or file.about else file.name
            for file in self.files
        )


def _rounded(*files: tuple[str, str]) -> tuple[PublishedFile, ...]:
    """Return files by their names, and their sizes as a page rounds them."""
    return tuple(PublishedFile(name, about=about) for name, about in files)


BRISBANE_PAGE = "https://huggingface.co/datasets/TobiasRobotics/brisbane-event-vpr"
BRISBANE_BAGS_PAGE = "https://zenodo.org/records/4302805"
QCR_PAGE = "https://zenodo.org/records/10494919"
NSAVP_PAGE = "https://umautobots.github.io/nsavp"
FAST_SLOW_PAGE = "https://huggingface.co/datasets/gokulbnr/QCR-Fast-Slow-Event-Dataset"
NYC_PAGE = "https://huggingface.co/datasets/ai4ce/NYC-Event-VPR"

#: sizes and SHA-256 of the parquet files of Brisbane-Event-VPR by the drive's day and time, from
#: commit 4e0e9bf of its page, or the sizes that the page's list of files rounds
_BRISBANE_PARQUET = {
    "2020-04-21-17-03-03": (
        1_925_019_428, "", "f22ab3da46fc87263649d13d71a586ffcdddefb9a5af81279e95084dd6dcfeb9"
    ),
    "2020-04-22-17-24-21": (
        2_779_116_068, "", "8c71331cb09732b0a89591ba258982f6b7bbdfc4fec331c17a480006843068b8"
    ),
    "2020-04-24-15-12-03": (
        2_082_849_662, "", "5931a88e5a995e97f0785ad8de23ac8ddb0bb5c59bde7e153a3f955bdd3c6ae1"
    ),
    "2020-04-28-09-14-11": (None, "1.3 GB", ""),
    "2020-04-29-06-20-23": (None, "", ""),
}  # fmt: skip
#: rounded sizes of the GPS logs beside them
_BRISBANE_LOGS = dict(
    zip(_BRISBANE_PARQUET, ("395 kB", "350 kB", "381 kB", "372 kB", "365 kB"), strict=True)
)


def nsavp_download(name: str) -> Download:
    """Return the files of a drive of NSAVP."""
    names = f"{name}_dvxplorer_left.h5", f"{name}_applanix.h5"
    return Download(f"NSAVP, {name}", NSAVP_PAGE, tuple(map(PublishedFile, names)))


def brisbane_download(title: str, recording: str) -> Download:
    """Return the files of a drive of Brisbane-Event-VPR in parquet, by the stem of their names."""
    day = recording.removeprefix("dvs_vpr_")
    size, about, sha256 = _BRISBANE_PARQUET[day]
    return Download(
        f"Brisbane-Event-VPR, {title}",
        BRISBANE_PAGE,
        (
            PublishedFile(
                f"{recording}_no_hot_pixels_nobursts_denoised.parquet", size, about, sha256
            ),
            PublishedFile(f"{recording}.nmea", about=_BRISBANE_LOGS[day]),
        ),
    )


#: folders of counts and short frames that were made of published files, by their name; the sizes
#: are those of the folders that the pages of results were made with
STAND_INS = {
    "brisbane_sparse49": Download(
        "event counts at 49 pixels of Brisbane-Event-VPR, sunset 1 and 2",
        BRISBANE_BAGS_PAGE,
        _rounded(
            ("sunset1.npz", "30 kB"),
            ("sunset2.npz", "29 kB"),
            ("sunset1.nmea", "408 kB"),
            ("sunset2.nmea", "356 kB"),
        ),
    ),
    "brisbane_lens49": Download(
        "the same drives at 49 other pixels, and weights of LENS trained with them (A. D. Hines, "
        "M. Milford and T. Fischer, 2025)",
        "https://github.com/AdamDHines/LENS",
        _rounded(("sunset1.npz", "27 kB"), ("sunset2.npz", "26 kB")),
    ),
    "speck_indoor": Download(
        "two walks with a Speck, 80 x 80, one frame a second (A. D. Hines, M. Milford and T. "
        "Fischer)",
        "https://github.com/AdamDHines/LENS",
        _rounded(("reference.npz", "871 kB"), ("query.npz", "901 kB")),
    ),
    "speck_walks": Download(
        "two walks with a Speck, 128 x 128, in short frames (A. D. Hines, M. Milford and T. "
        "Fischer)",
        "https://github.com/AdamDHines/LENS",
        _rounded(
            ("reference.npz", "5.7 MB"), ("query.npz", "5.9 MB"), ("ground_truth.csv", "1 kB")
        ),
    ),
}

#: data sets that no experiment opens
NOT_OPENED = (
    Download(
        "QCR-Fast-and-Slow",
        FAST_SLOW_PAGE,
        _rounded(
            *(
                (f"main_experiments/{name}.tar.gz", f"{size} GB")
                for name, size in (
                    ("default_params", "29.2"), ("Fast_Slow", "12.7"), ("PxBw", "15.7"),
                    ("PxTh", "9.44"), ("RfPr", "17.2"),
                )
            )
        ),
        "each archive has events of a DAVIS346 (N/aedats/*_{h,m,l}_{ref,qry}.aedat, AEDAT 2.0) and "
        "poses (N/bags/*.bag, the transforms map to odom to base_footprint of /tf). How the clock "
        "of the events, which AEDAT 2.0 starts anywhere, relates to that of the poses is in no "
        "document, and the authors read the events by a private branch of tonic. map and evaluate "
        "take the AEDAT files with tracks of your own",
    ),
    Download(
        "NYC-Event-VPR",
        NYC_PAGE,
        _rounded(
            *(
                (f"sensor_data_2023-{day}/{name}", size)
                for day, *files in (
                    ("04-20_15-53-26", ("data_2023-04-20_15-53-29.zip", "26.5 GB"),
                     ("GPS_data_2023-04-20_15-53-27.csv", "297 kB")),
                    ("04-20_17-10-01", ("data_2023-04-20_17-10-04.zip", "36.9 GB"),
                     ("GPS_data_2023-04-20_17-10-02.csv", "335 kB")),
                    ("02-14_18-20-40", ("data_2023-02-14_18-20-44.zip", "15.3 GB"),
                     ("GPS_data_2023-02-14_18-20-42.csv", "374 kB")),
                )
                for name, size in files
            )
        ),
        "15 drives through New York with events (1280 x 720, several RAW files in EVT3 in each "
        "archive) and positions once a second (columns Timestamp, Latitude, Longitude, HeadMotion; "
        "local time). The drives follow no common route, no pair of a reference and a query was "
        "published, and the time of the first event is known to a second, from the header of its "
        "RAW file. map and evaluate take the RAW files with tracks of your own",
    ),
)  # fmt: skip


def stand_in_text(folder: str) -> str:
    """Return the content, the address and the files of a stand-in's folder for messages."""
    found = STAND_INS[folder]
    return f"{found.title} (made from {found.address}; files {found.names})"


def damaged_files(
    folder: Path, downloads: Iterable[Download], *, hashed: bool = False
) -> Iterator[str]:
    """Yield a sentence on each file that is there and is not the published one; see `problem`."""
    for download in downloads:
        for file in download.files:
            problem = file.problem(folder, hashed=hashed)
            if problem not in ("", MISSING):
                yield f"{folder / file.name}: {problem} from {download.address}"


def listing(downloads: Iterable[Download], folder: Path | None) -> Iterator[str]:
    """Yield a line on each file: whether it is in a folder, its size and its address."""
    for download in downloads:
        yield f"{download.title} ({download.address})"
        for file in download.files:
            problem = MISSING if folder is None else file.problem(folder)
            yield f"  {problem or 'there'}: {file.name} ({file.size_text})"
        if download.note:
            yield f"  not opened: {download.note}"
