"""Pairs of recorded drives that lie in a folder: the stand-ins, and the published traverses."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.datasets.catalogue import (
    BRISBANE_BAGS_PAGE,
    BRISBANE_PAGE,
    QCR_PAGE,
    BrisbaneTraverse,
)
from edge_vpr.datasets.published_drives import found_traverses, published_pairs
from edge_vpr.descriptors.precounted import PublishedWindows
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.track_files import load_nmea
from edge_vpr.evaluation.tracks import Track
from edge_vpr.evaluation.truth_from_alignment import from_alignment
from edge_vpr.pipeline import EventSource, WindowSource
from edge_vpr.settings import PRESETS, Settings
from edge_vpr_tools.experiments import SOURCES, brisbane, speck_walks
from edge_vpr_tools.experiments.simulated import SIMULATED
from edge_vpr_tools.experiments.trial import Times, TruthOf, truth_of_tracks

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
        traverses (`edge_vpr.datasets.published_drives`), or some of them.
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
