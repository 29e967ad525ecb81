"""Pairs of drives: recorded ones that lie in a folder, published ones, simulated ones."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
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
from edge_vpr_tools.research.datasets import (
    BRISBANE_BAGS_PAGE,
    BRISBANE_PAGE,
    QCR_PAGE,
    BrisbaneTraverse,
    found_traverses,
    published_pairs,
)
from edge_vpr_tools.research.experiments import SOURCES, brisbane, speck_walks
from edge_vpr_tools.research.experiments.simulated import SIMULATED, truth_of_pair
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
    reference, query : EventSource or WindowSource
    settings : Settings
    truth_of : callable
    drawn : bool
        Whether pixels are drawn, so that several draws differ.
    tracks : Tracks, optional
        Tracks of the drives, where the truth comes from them.
    """

    drives: str
    reference: EventSource | WindowSource
    query: EventSource | WindowSource
    settings: Settings
    truth_of: TruthOf
    drawn: bool = True
    tracks: Tracks | None = None

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
            yield from open_pairs(data / folder)
    for pair in published_pairs(data):
        tracks = Tracks(pair.reference.track, pair.query.track)
        truth_of = truth_of_tracks(*tracks, pair.tolerance_m)
        drives = pair.reference.recording, pair.query.recording
        for pixels in NUMBERS:
            settings = PAPER.replaced({"pixels": pixels}, "published traverses")
            yield Pair(pair.name, *drives, settings, truth_of, tracks=tracks)


class EventPair(NamedTuple):
    """Two drives whose events were recorded, matched by the settings of the paper."""

    name: str
    reference: EventSource
    query: EventSource
    settings: Settings
    truth_of: TruthOf
    tracks: Tracks | None


def event_pairs(data: Path | None) -> Iterator[EventPair]:
    """Open the pairs of `pairs` whose events were recorded, each once; perhaps none."""
    for pair in pairs(data, needed=False):
        if isinstance(pair.reference, WindowSource) or isinstance(pair.query, WindowSource):
            continue
        if pair.settings.pixels == PAPER.pixels:  # else the same drives with other pixels
            yield EventPair(
                pair.drives, pair.reference, pair.query, pair.settings, pair.truth_of, pair.tracks
            )


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
    """Check that the GPS log of every published traverse of a pair in a folder is there.

    Raises
    ------
    GroundTruthError
        If one is missing or cannot be read.
    """
    for traverses in found_traverses(data).values():
        for traverse, path in traverses:
            if len(traverses) > 1 and isinstance(traverse, BrisbaneTraverse):
                traverse.track(path.parent)


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
    listed = "; ".join(f"{folder}: {SOURCES[folder]}" for folder in folders)
    return (
        f"{where}{alone}: name a folder with two traverses or more of Brisbane-Event-VPR "
        f"(*_denoised.parquet and *.nmea of {BRISBANE_PAGE}, or *.bag and *_concat.nmea of "
        f"{BRISBANE_BAGS_PAGE}) or of QCR-Event-VPR (*_denoised.parquet of {QCR_PAGE}) under "
        f"their published names, or with one of the folders {listed}"
    )


def absent_data(data: Path | None, matched: Collection[str]) -> str:
    """Return the sources of recorded drives as a paragraph; empty if a recorded pair was matched.

    Parameters
    ----------
    data : path, optional
        Folder that the user gave.
    matched : collection of str
        Names of the pairs that were matched.
    """
    return _absent("drives", data, matched, tuple(SOURCES))


def absent_events(data: Path | None, matched: Collection[str]) -> str:
    """Return the sources of recorded events as a paragraph; see `absent_data`."""
    return _absent("events", data, matched, (speck_walks.FOLDER,))


def _absent(
    what: str, data: Path | None, matched: Collection[str], folders: tuple[str, ...]
) -> str:
    if set(matched) - {SIMULATED}:
        return ""
    return f"\n\nNo recorded {what} were compared: {without_pairs(data, folders)}."


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
    centre_us : ndarray of int64, shape (n,)
    """

    images: npt.NDArray[np.integer]
    centre_us: Times


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
    for pair in pairs(data, needed=False):
        if pair.has_images and pair.settings.pixels == PAPER.pixels:  # each pair of drives once
            yield count_pair(pair.drives, pair.reference, pair.query, pair.settings, pair.truth_of)


class Draw(NamedTuple):
    """Pair of drives, and the seed of a draw of pixels.

    Attributes
    ----------
    name : str
        Name of the pair, or `SIMULATED`.
    pair : CountedPair
    seed : int
    is_new : bool
        Whether the pair is yielded for the first time. Later, systems that draw nothing need not be
        matched again.
    """

    name: str
    pair: CountedPair
    seed: int
    is_new: bool


def draws(data: Path | None, seeds: int, on_start: Callable[[str], None]) -> Iterator[Draw]:
    """Yield a simulated pair for each seed, and each recorded pair with all seeds.

    Parameters
    ----------
    data : path, optional
        Folder of the recordings; without it, no recorded pairs are yielded.
    seeds : int
    on_start : callable
        Called with a description before each part begins.
    """
    for seed in range(seeds):
        on_start(f"street {seed + 1} of {seeds}")
        yield Draw(SIMULATED, simulated_pair(seed), seed, is_new=True)
    for pair in recorded_pairs(data) if data is not None else ():
        for seed in range(seeds):
            on_start(f"{pair.name}, draw {seed + 1} of {seeds}")
            yield Draw(pair.name, pair, seed, is_new=seed == 0)
