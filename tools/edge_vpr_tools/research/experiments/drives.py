"""Pairs of drives: recorded ones that lie in a folder, published ones, simulated ones."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.cleaning import find_hot_pixels
from edge_vpr.descriptors.counting import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime, PublishedWindows, Window
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth, from_alignment
from edge_vpr.evaluation.tracks import Track, load_nmea
from edge_vpr.pipeline import EventSource, WindowSource, cleaned
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import SimulatedRecording, simulate_pair
from edge_vpr_tools.research.catalogue import NOT_OPENED, STAND_INS, Download
from edge_vpr_tools.research.datasets import (
    DATA_SETS,
    PublishedPair,
    found_traverses,
    published_pairs,
)
from edge_vpr_tools.research.experiments import SOURCES, brisbane, speck_walks
from edge_vpr_tools.research.experiments.experiment import Drives
from edge_vpr_tools.research.experiments.simulated import (
    FIRST_SEED,
    SIMULATED,
    TOLERANCE_M,
    truth_of_pair,
)
from edge_vpr_tools.research.experiments.trial import Times, TruthOf, truth_of_tracks

# Pairs of recorded drives that lie in a folder: the stand-ins, and the published traverses.


PAPER = PRESETS["paper"]
#: numbers of pixels with which each pair of drives is matched
NUMBERS = (25, PAPER.pixels)
_INDOOR = "speck_indoor"

# No ground truth was published for speck_indoor. Matches of all pixels with long sequences show the
# query 8 frames ahead, from query frame 20 on (data set's README).
_INDOOR_LAG, _INDOOR_FROM, _INDOOR_TOLERANCE = 8, 20, 3
_INDOOR_PERIOD = Fraction(1)


class Tracks(NamedTuple):
    """Tracks of a pair of drives."""

    reference: Track
    query: Track


@dataclass(frozen=True, eq=False)
class Pair:
    """Two drives, and how they are matched.

    Parameters
    ----------
    drives : str
        Name of the drives.
    truth_of : callable
        Makes the ground truth from the times of places and queries.
    drawn : bool
        Whether pixels are drawn, so that several draws differ.
    tracks : Tracks, optional
        Tracks of the drives, where the truth comes from them.
    files : tuple of path
        Files and folders of the drives.
    """

    drives: str
    reference: EventSource | WindowSource
    query: EventSource | WindowSource
    settings: Settings
    truth_of: TruthOf
    drawn: bool = True
    tracks: Tracks | None = None
    files: tuple[Path, ...] = ()

    @property
    def name(self) -> str:
        """Name of the drives, with the number of pixels."""
        some = self.query.counted.sum() if isinstance(self.query, WindowSource) else 0
        of_all = f" of {some}" if not self.has_images and some > self.settings.pixels else ""
        return f"{self.drives}, {self.settings.pixels}{of_all} px"

    @property
    def has_images(self) -> bool:
        """Whether every pixel of the query was counted, or can be."""
        return not isinstance(self.query, WindowSource) or bool(self.query.counted.all())


def pairs(data: Path | None, *, needed: bool = True) -> Iterator[Pair]:
    """Open the pairs of drives in a folder, one after another, each with some numbers of pixels.

    Parameters
    ----------
    data : path, optional
        Folder that holds ``speck_indoor``, ``speck_walks``, ``brisbane_sparse49``, published
        traverses (`edge_vpr_tools.research.datasets`), or some of them.
    needed : bool
        Whether at least one pair must be there.

    Raises
    ------
    UsageError
        If `needed`, and no pair is there.
    GroundTruthError
        If the GPS log of a published traverse is missing.
    RecordingError
        If a recording cannot be read.
    """
    if needed:
        check_data(data)
    if data is None:
        return
    for folder, open_pairs in _STAND_INS.items():
        if (data / folder).is_dir():
            for stand_in in open_pairs(data / folder):
                yield replace(stand_in, files=(data / folder,))
    for pair in published_pairs(data):
        tracks = Tracks(pair.reference.track, pair.query.track)
        truth_of = truth_of_tracks(*tracks, pair.tolerance_m)
        drives = pair.reference.recording, pair.query.recording
        files = pair.reference.path, pair.query.path
        for pixels in NUMBERS:
            settings = PAPER.replaced({"pixels": pixels}, "published traverses")
            yield Pair(pair.name, *drives, settings, truth_of, tracks=tracks, files=files)


class EventPair(NamedTuple):
    """Two drives whose events were recorded, matched by the settings of the paper."""

    name: str
    reference: EventSource
    query: EventSource
    settings: Settings
    truth_of: TruthOf
    tracks: Tracks | None
    files: tuple[Path, ...] = ()


def event_pairs(data: Path | None) -> Iterator[EventPair]:
    """Open the pairs of `pairs` whose events were recorded, each once; perhaps none."""
    for pair in _pairs(data) if data is not None else ():
        if isinstance(pair.reference, WindowSource) or isinstance(pair.query, WindowSource):
            continue
        if pair.settings.pixels == PAPER.pixels:  # else the same drives with other pixels
            yield EventPair(
                pair.drives, pair.reference, pair.query, pair.settings, pair.truth_of, pair.tracks,
                pair.files,
            )  # fmt: skip


def check_data(data: Path | None) -> None:
    """Check that a folder holds a pair of drives.

    Raises
    ------
    UsageError
        If it holds none.
    """
    if data is not None:
        if any((data / folder).is_dir() for folder in _STAND_INS):
            return
        if any(len(traverses) > 1 for traverses in found_traverses(data).values()):
            return
    raise UsageError(without_pairs(data))


def check_logs(data: Path) -> None:
    """Check that the positions of every published traverse of a pair in a folder are there.

    Raises
    ------
    GroundTruthError
        If those of one are missing or cannot be read.
    """
    for traverses in found_traverses(data).values():
        for traverse, path in traverses:
            if len(traverses) > 1:
                traverse.origin(path.parent, 0)


def downloads(data: Path | None) -> list[Download]:
    """Return the files of all data sets, those of a traverse in the kind that a folder has."""
    found = []
    for traverses, _ in DATA_SETS.values():
        for traverse in traverses:
            kinds = traverse.downloads
            there = [
                one for one in kinds
                if data is not None and (data / one.files[0].name).is_file()
            ]  # fmt: skip
            found.append(there[0] if there else kinds[0])
    for folder, one in STAND_INS.items():
        files = tuple(replace(file, name=f"{folder}/{file.name}") for file in one.files)
        found.append(replace(one, files=files))
    return [*found, *NOT_OPENED]


def without_pairs(data: Path | None, folders: Collection[str] = tuple(SOURCES)) -> str:
    """Return a sentence on why there is no pair of drives, and where drives come from.

    Parameters
    ----------
    data : path, optional
        Folder that the user gave.
    folders : collection of str
        The `SOURCES` that would do.
    """
    where = "no folder was given with --data" if data is None else f"{data} holds no pair"
    lone = [] if data is None else [
        f"{title} {traverses[0][0].name}"
        for title, traverses in found_traverses(data).items()
        if len(traverses) == 1
    ]  # fmt: skip
    alone = f", only {' and '.join(lone)}" if lone else ""
    return (
        f"{where}{alone}: name a folder with two traverses or more of "
        f"{_published_text()} under their published names, or with one of the folders "
        f"{', '.join(folders)}; --dry-run lists all files, with sizes and addresses"
    )


def _published_text() -> str:
    """Return files of the first traverse of each data set, with sizes and addresses."""
    found: dict[str, str] = {}
    for traverses, _ in DATA_SETS.values():
        one = traverses[0].downloads[0]
        found.setdefault(one.title.partition(",")[0], f"{one.names} of {one.address}")
    return ", ".join(f"{title} (such as {files})" for title, files in found.items())


def _indoor(folder: Path) -> Iterator[Pair]:
    reference, query = (
        PublishedWindows(folder / f"{name}.npz", period=_INDOOR_PERIOD)
        for name in ("reference", "query")
    )
    for pixels in NUMBERS:
        settings = PAPER.replaced({"pixels": pixels, "sequence_length": 15}, "indoor")
        yield Pair("Speck indoor", reference, query, settings, _truth_indoor)


def _walks(folder: Path) -> Iterator[Pair]:
    reference, query = speck_walks.open_walks(folder)
    truth_of = speck_walks.truth_of_walks(folder)
    for pixels in NUMBERS:
        settings = speck_walks.SETTINGS.replaced({"pixels": pixels}, "walks")
        yield Pair("Speck walks", reference, query, settings, truth_of)


def _brisbane(folder: Path) -> Iterator[Pair]:
    names = ("sunset2", "sunset1")
    reference, query = (PublishedWindows(folder / f"{name}.npz") for name in names)
    tracks = Tracks(*(load_nmea(folder / f"{name}.nmea") for name in names))
    truth_of = truth_of_tracks(*tracks, brisbane.TOLERANCE_M)
    drawn = brisbane.SETTINGS.replaced({"pixels": 25, "strategy": "variance"}, "Brisbane")
    yield Pair("Brisbane", reference, query, drawn, truth_of, tracks=tracks)
    yield Pair(
        "Brisbane", reference, query, brisbane.SETTINGS, truth_of, drawn=False, tracks=tracks
    )


_STAND_INS = {_INDOOR: _indoor, speck_walks.FOLDER: _walks, brisbane.FOLDER: _brisbane}


def _truth_indoor(places_us: Times, queries_us: Times) -> GroundTruth:
    period_us = float(_INDOOR_PERIOD * 1_000_000)
    places, queries = (np.floor(times / period_us) for times in (places_us, queries_us))
    first, last = float(_INDOOR_FROM), float(queries.max())
    alignment = np.array([[first, first - _INDOOR_LAG], [last, last - _INDOOR_LAG]])
    return from_alignment(alignment, queries, places, _INDOOR_TOLERANCE, "frames")


# Pairs of drives whose windows are counted at every pixel, as every system to compare gets them.
#
# On simulated streets, whose drives differ in speed, a window is a number of events of the whole
# sensor; on recorded drives it is a period of time.


#: length of the simulated streets in metres
LENGTH_M = 450.0


@dataclass(frozen=True, eq=False)
class CountedDrive:
    """Windows of a drive, counted at every pixel.

    Attributes
    ----------
    images : ndarray of int, shape (n, height, width)
        Counts of events at each pixel, for n windows.
    centre_us : ndarray of int64, shape (n,)
        Centre of each window.
    """

    images: npt.NDArray[np.integer]
    centre_us: Times

    @property
    def activity(self) -> npt.NDArray[np.int64]:
        """Events of each window, shape (n,)."""
        return self.images.sum(axis=(1, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class CountedPair:
    """Two drives as windows, and how they are matched."""

    name: str
    reference: CountedDrive
    query: CountedDrive
    settings: Settings
    truth_of: TruthOf


def count_drive(drive: EventSource | WindowSource, window: Window) -> CountedDrive:
    """Count a drive's windows at every pixel, without bursts."""
    if isinstance(drive, WindowSource):
        windows = drive.windows()
    else:
        stream = DescriptorStream(PixelMap.all_of(drive.sensor), window)
        windows = (
            one for events in cleaned(drive, PRESETS["paper"]) for one in stream.windows(events)
        )
    size = (drive.sensor.height, drive.sensor.width)
    images, centres = [], []
    for one in windows:
        images.append(np.minimum(one.counts, 65_535).astype(np.uint16).reshape(size))
        centres.append(one.start_us + (one.end_us - one.start_us) // 2)
    return CountedDrive(np.array(images), np.array(centres, dtype=np.int64))


def count_pair(
    name: str,
    reference: EventSource | WindowSource,
    query: EventSource | WindowSource,
    settings: Settings,
    truth_of: TruthOf,
) -> CountedPair:
    """Count both drives without hot pixels, by number of events if the settings ask for it."""
    window: Window = FixedTime(settings.tau_us)
    first = count_drive(reference, window)
    if settings.window == "count":
        window = FixedCount(max(1, int(first.images.sum(dtype=np.int64)) // len(first.images)))
        first = count_drive(reference, window)
    second = count_drive(query, window)
    hot = find_hot_pixels(first.images.sum(axis=0, dtype=np.int64))
    for drive in (first, second):
        drive.images[:, hot] = 0
    return CountedPair(name, first, second, settings, truth_of)


def simulated_pair(seed: int, length_m: float = LENGTH_M, sensor: str = "default") -> CountedPair:
    """Simulate and count the pair of this seed."""
    return count_simulated(*(d.keep() for d in simulate_pair(seed, sensor, length_m=length_m)))


def count_simulated(reference: SimulatedRecording, query: SimulatedRecording) -> CountedPair:
    """Count two simulated drives of one street, in windows of a number of events."""
    settings = PRESETS["paper"].replaced({"window": "count"}, "pairs")
    return count_pair(SIMULATED, reference, query, settings, truth_of_pair(reference, query))


def recorded_pairs(data: Path) -> Iterator[CountedPair]:
    """Yield the recorded pairs with counts at every pixel, each pair once.

    Parameters
    ----------
    data : Path
        Folder of the drives; see `drive_pairs.pairs`. Absent data are skipped.
    """
    for pair in _pairs(data):
        if pair.has_images and pair.settings.pixels == PAPER.pixels:  # each pair of drives once
            yield count_pair(pair.drives, pair.reference, pair.query, pair.settings, pair.truth_of)


# Drives as experiments declare them.


def recorded_drives(data: Path | None, *, images: bool = False) -> list[Drives]:
    """Return the recorded pairs of a folder, each with some numbers of pixels.

    Parameters
    ----------
    images : bool
        Leave out those of which only some pixels were published.

    Raises
    ------
    UsageError
        If the folder holds none.
    """
    check_data(data)
    assert data is not None
    return [
        Drives(pair.name, partial(_opened, data, pair.name), pair.files, drawn=pair.drawn)
        for pair in _pairs(data)
        if pair.has_images or not images
    ]


def counted_drives(data: Path | None) -> list[Drives]:
    """Return streets, and the recorded pairs of a folder, as windows of all pixels."""
    streets = Drives(SIMULATED, simulated_pair, varied=True)
    if data is None:
        return [streets]
    recorded = (
        Drives(pair.drives, partial(_counted_draw, data, pair.drives), pair.files)
        for pair in _pairs(data)
        if pair.has_images and pair.settings.pixels == PAPER.pixels
    )
    return [streets, *recorded]


def event_drives(data: Path | None) -> list[Drives]:
    """Return streets, and the pairs of a folder whose events were recorded."""
    streets = Drives(SIMULATED, _event_street, varied=True)
    recorded = (
        Drives(pair.name, lambda seed, pair=pair: pair, pair.files)  # type: ignore[misc]
        for pair in event_pairs(data)
    )
    return [streets, *recorded]


@lru_cache(maxsize=1)
def _pairs(data: Path) -> tuple[Pair, ...]:
    """Open the pairs of a folder once, for as many draws of pixels as there are."""
    return tuple(pairs(data, needed=False))


def _opened(data: Path, name: str, seed: int) -> Pair:
    return next(pair for pair in _pairs(data) if pair.name == name)


def _counted_draw(data: Path, name: str, seed: int) -> CountedPair:
    return _counted(data, name)


def _event_street(seed: int) -> EventPair:
    reference, query = (drive.keep() for drive in simulate_pair(seed))
    truth_of = truth_of_pair(reference, query)
    return EventPair(SIMULATED, reference, query, PAPER, truth_of, None)


# Pairs of drives for the experiment on rivals: of all pixels, or of those that were published.


LENS_FOLDER = "brisbane_lens49"
#: largest distances of a right match on the streets of Brisbane, as in the literature
_BRISBANE_M = (70.0, 25.0)


@dataclass(frozen=True, eq=False)
class Contest:
    """Two counted drives that systems are compared on.

    Attributes
    ----------
    truths : mapping of str to callable
        Truth by tolerance.
    length : int
        Windows of a sequence.
    laid_out : bool
        Whether all pixels were counted, so that images can be made of them.
    weights : tuple of path
        Of LENS, trained with the reference.
    """

    reference: CountedDrive
    query: CountedDrive
    truths: Mapping[str, TruthOf]
    length: int
    laid_out: bool = True
    weights: tuple[Path, ...] = ()

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        _, height, width = self.reference.images.shape
        return int(height * width)


def contests(data: Path | None) -> list[Drives]:
    """Return the drives of the experiment on rivals: streets, and recorded ones of a folder."""
    found = [
        Drives(f"{SIMULATED}, windows of {name}", partial(_street_contest, window), varied=True)
        for window, name in (("time", "1 s"), ("count", "N events"))
    ]
    if data is None:
        return found
    for folder, open_one in (
        (_INDOOR, _indoor_contest), (speck_walks.FOLDER, _walks_contest)
    ):  # fmt: skip
        if (data / folder).is_dir():
            found.append(Drives(_CONTEST_NAMES[folder], partial(open_one, data), [data / folder]))
    sparse = data / brisbane.FOLDER
    if sparse.is_dir():
        for names in (("sunset2", "sunset1"), ("sunset1", "sunset2")):
            open_sparse = partial(_brisbane_contest, sparse, sparse, names)
            found.append(
                Drives(
                    f"Brisbane, 49 pixels, {names[1]} on {names[0]}",
                    open_sparse,
                    [sparse],
                    drawn=False,
                )
            )
        lens = data / LENS_FOLDER
        if lens.is_dir():
            open_lens = partial(_brisbane_contest, lens, sparse, ("sunset2", "sunset1"))
            found.append(
                Drives(
                    "Brisbane, LENS's 49 pixels, sunset1 on sunset2",
                    open_lens,
                    [lens, sparse],
                    drawn=False,
                )
            )
    for pair in published_pairs(data):
        opened = partial(_published_contest, pair)
        files = (pair.reference.path, pair.query.path)
        found.append(Drives(pair.name, opened, files))
    return found


_CONTEST_NAMES = {_INDOOR: "Speck indoor", speck_walks.FOLDER: "Speck walks"}


def _street_contest(window: str, seed: int) -> Contest:
    reference, query = _kept_street(FIRST_SEED + seed)
    settings = PAPER.replaced({"window": window}, "rivals")
    truth_of = truth_of_pair(reference, query)
    pair = count_pair(SIMULATED, reference, query, settings, truth_of)
    return _contest(pair, {f"{TOLERANCE_M:g} m": truth_of})


@lru_cache(maxsize=1)
def _kept_street(seed: int) -> tuple[SimulatedRecording, SimulatedRecording]:
    """Simulate a street, which is counted in several ways."""
    reference, query = simulate_pair(seed, length_m=LENGTH_M)
    return reference.keep(), query.keep()


def _contest(pair: CountedPair, truths: Mapping[str, TruthOf]) -> Contest:
    return Contest(pair.reference, pair.query, truths, pair.settings.sequence_length)


def _indoor_contest(data: Path, seed: int) -> Contest:
    return _contest(_counted(data, "Speck indoor"), {"3 frames of 1 s": _truth_indoor})


def _walks_contest(data: Path, seed: int) -> Contest:
    truth_of = speck_walks.truth_of_walks(data / speck_walks.FOLDER)
    return _contest(_counted(data, "Speck walks"), {"60 frames, about 2 s": truth_of})


@lru_cache(maxsize=1)
def _counted(data: Path, name: str) -> CountedPair:
    """Count a recorded pair, for as many draws of pixels as there are."""
    return next(pair for pair in recorded_pairs(data) if pair.name == name)


def _brisbane_contest(folder: Path, logs: Path, names: tuple[str, str], seed: int) -> Contest:
    tracks = [load_nmea(logs / f"{name}.nmea") for name in names]
    drives = [_published_counts(folder / f"{name}.npz") for name in names]
    truths = {
        f"{metres:g} m": truth_of_tracks(tracks[0], tracks[1], metres) for metres in _BRISBANE_M
    }
    return Contest(
        drives[0], drives[1], truths, brisbane.SETTINGS.sequence_length, laid_out=False,
        weights=tuple(sorted(folder.glob("*.pth"))),
    )  # fmt: skip


def _published_counts(path: Path) -> CountedDrive:
    """Read counts of some pixels in windows of a second, as a square if they are in one."""
    with np.load(path) as arrays:
        counts = arrays["frames"] if "frames" in arrays else arrays["counts"][:, None, :]
    second = 1_000_000
    centre_us = np.arange(len(counts), dtype=np.int64) * second + second // 2
    return CountedDrive(counts.astype(np.uint16), centre_us)


def _published_contest(pair: PublishedPair, seed: int) -> Contest:
    tracks = pair.reference.track, pair.query.track
    tolerances = _BRISBANE_M if pair.tolerance_m in _BRISBANE_M else (pair.tolerance_m,)
    truths = {f"{metres:g} m": truth_of_tracks(*tracks, metres) for metres in tolerances}
    drives = pair.reference.recording, pair.query.recording
    counted = count_pair(pair.name, *drives, PAPER, truths[f"{tolerances[0]:g} m"])
    return _contest(counted, truths)
