"""Pairs of drives: as they were recorded, mapped at some pixels, and counted at every pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.cleaning import can_be_searched, find_hot_pixels
from edge_vpr.descriptors.counting import DescriptorStream, count_windows, event_windows
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.published import WindowSource
from edge_vpr.descriptors.windows import Descriptors, FixedCount, FixedTime, Window, narrow
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.ground_truth import GroundTruth, from_tracks
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.evaluation.tracks import Track
from edge_vpr.events import Events
from edge_vpr.map_making import coded_map
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.matching.matches import Matches
from edge_vpr.matching.sequences import middle_window
from edge_vpr.odometry import Odometry
from edge_vpr.recordings.reading import EventSource
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Score, Settings
from edge_vpr.simulation import SimulatedRecording
from fixedpoint.formats import packed_bytes
from lab.baselines import Baseline, filter_distances, match_distances
from lab.codes import Code

# Ground truth of two drives, for windows at any times.


Times = npt.NDArray[np.int64]
#: maps the centre times of places and query windows to their ground truth
TruthOf = Callable[[Times, Times], GroundTruth]
#: truth by tolerance, the one that pairs are evaluated by first
Truths = Mapping[str, TruthOf]
#: name of simulated streets in tables of several experiments, and largest distance of a correct
#: match along them, in metres
SIMULATED, TOLERANCE_M = "simulated streets", 10.0
#: Trust compares the best place with those outside the exclusion zone of 3 windows, so that it
#: can only indicate larger errors: a little over 3 windows of a second at 6 m/s, in metres.
TRUSTED_M = 20.0


def truth_of_tracks(reference: Track, query: Track, tolerance_m: float) -> TruthOf:
    """Return the ground truth by the distances between two tracks."""
    return partial(from_tracks, reference, query, tolerance_m=tolerance_m)


def truths_of_tracks(reference: Track, query: Track, *metres: float) -> Truths:
    """Return the truth of two tracks for each tolerance."""
    return {f"{each:g} m": truth_of_tracks(reference, query, each) for each in metres}


#: column of the share of windows matched correctly, of those that every row of a table matches;
#: ``P@100R`` is the share of all windows that a row matches, as `edge-vpr evaluate` prints it
INNER = "P@100R (inner windows)"


def inner_windows(truth: GroundTruth, longest: int) -> GroundTruth:
    """Leave out the windows at both ends, which the longest sequences do not match.

    Parameters
    ----------
    longest : int
        Windows of the longest sequence.
    """
    inner = truth.has_truth.copy()
    before = middle_window(longest)
    inner[:before] = False
    inner[len(inner) - (longest - 1 - before) :] = False
    return replace(truth, correct=truth.correct & inner, has_truth=inner)


def inner_share(matches: Matches, truth: GroundTruth, longest: int) -> float:
    """Return the share of correct matches, of the windows that the longest sequences match."""
    return evaluate(matches, inner_windows(truth, longest)).precision_at_100_recall


# Two drives as they were recorded or simulated.


class Kept(EventSource):
    """Recording whose events are held in memory from the first of many passes on."""

    def __init__(self, recording: EventSource) -> None:
        super().__init__(recording.sensor)
        self._recording = recording
        self._chunks: list[Events] | None = None

    def __iter__(self) -> Iterator[Events]:
        if self._chunks is None:
            self._chunks = list(self._recording)
            self.end_us, self.faults = self._recording.end_us, self._recording.faults
        return iter(self._chunks)


class Tracks(NamedTuple):
    """Tracks of a pair of drives."""

    reference: Track
    query: Track


@dataclass(frozen=True, eq=False)
class Pair:
    """Two drives, and how they are matched."""

    drives: str  #: Name of the drives.
    reference: EventSource | WindowSource
    query: EventSource | WindowSource
    settings: Settings
    truths: Truths  #: Each makes the ground truth from the times of places and queries.
    drawn: bool = True  #: Whether pixels are drawn, so that several draws differ.
    tracks: Tracks | None = None  #: Tracks of the drives, where the truth comes from them.
    #: Of the wheels in the reference and in the query, if they had odometers.
    odometry: tuple[Odometry, Odometry] | None = None

    @classmethod
    def simulated(cls, reference: SimulatedRecording, query: SimulatedRecording) -> Pair:
        """Return two simulated drives of one street, matched by the settings of the paper."""
        tracks = Tracks(reference.track, query.track)
        truths = truths_of_tracks(*tracks, TOLERANCE_M)
        return cls(SIMULATED, reference, query, PRESETS["paper"], truths, tracks=tracks)

    @property
    def truth_of(self) -> TruthOf:
        """Truth by the first tolerance."""
        return next(iter(self.truths.values()))

    @property
    def name(self) -> str:
        """Name of the drives, with the number of pixels."""
        some = self.query.counted.sum() if isinstance(self.query, WindowSource) else 0
        of_all = f" of {some}" if not self.has_images and some > self.settings.pixels else ""
        return f"{self.drives}, {self.settings.pixels}{of_all} px"

    @property
    def has_events(self) -> bool:
        """Whether the events were recorded, and not only their counts."""
        return not isinstance(self.query, WindowSource)

    @property
    def events(self) -> tuple[EventSource, EventSource]:
        """Reference and query, if their events were recorded."""
        assert not isinstance(self.reference, WindowSource)
        assert not isinstance(self.query, WindowSource)
        return self.reference, self.query

    @property
    def has_images(self) -> bool:
        """Whether every pixel of the query was counted, or can be."""
        return not isinstance(self.query, WindowSource) or bool(self.query.counted.all())

    def drawn_with(self, seed: int) -> Settings:
        """Return the settings with another draw of pixels."""
        return self.settings.replaced({"seed": seed}, "seed")

    def default(self, seed: int, **changes: Any) -> Settings:
        """Return the default settings for as many pixels, chosen alike, in one draw of them."""
        pixels = {"pixels": self.settings.pixels, "strategy": self.settings.strategy, "seed": seed}
        return PRESETS["default"].replaced(pixels | changes, self.drives)

    def mapped(self, settings: Settings) -> MappedPair:
        """Map the reference with some settings, and count the query at the map's pixels."""
        odometry = None if self.odometry is None else self.odometry[0]
        reference = ReferenceMap.build(self.reference, settings, odometry=odometry)
        return MappedPair.of(reference, self.query, self.truth_of)

    def counted(self, **changes: Any) -> CountedPair:
        """Count both drives at every pixel, by number of events if the settings ask for it.

        Hot pixels are left out, whatever the settings, if they can be searched for.

        Parameters
        ----------
        **changes
            Settings that replace those of the pair.
        """
        settings = self.settings.replaced(changes, self.drives)
        window: Window = FixedTime(settings.tau_us)
        first = count_drive(self.reference, window)
        if settings.window == "count":
            window = FixedCount(max(1, int(first.images.sum(dtype=np.int64)) // len(first.images)))
            first = count_drive(self.reference, window)
        second = count_drive(self.query, window)
        totals = first.images.sum(axis=0, dtype=np.int64)
        if self.has_images and can_be_searched(totals):
            hot = find_hot_pixels(totals)
            for drive in (first, second):
                drive.images[:, hot] = 0
        return CountedPair(self.drives, first, second, settings, self.truths, self.has_images)


# A map, and counts of the query at its pixels: what all ways to match start from.


@dataclass(frozen=True, eq=False)
class MappedPair:
    """Map of the reference, counts of the query at its pixels, and their truth.

    A code of the laboratory takes the place of that of the settings; the map then has counts.
    """

    reference: ReferenceMap  #: Its places have counts, or the codes of its settings.
    counted: Descriptors  #: Counts, which `match` replaces by the codes of the map.
    truth: GroundTruth
    code: Code | None = field(default=None, kw_only=True)

    @classmethod
    def of(
        cls, reference: ReferenceMap, query: EventSource | WindowSource, truth_of: TruthOf
    ) -> MappedPair:
        """Count a query at the pixels of a map."""
        counted = count_windows(query, reference.pixel_map, reference.settings)
        return cls(reference, counted, truth_of(reference.places.centre_us, counted.centre_us))

    def coded(self, changes: Mapping[str, Any], code: Code | None = None) -> MappedPair:
        """Return the pair with other settings, and a map of counts in their codes."""
        settings = self.reference.settings.replaced(changes, "variant")
        return replace(self, reference=coded_map(self.reference, settings), code=code)

    def with_settings(self, changes: Mapping[str, Any]) -> MappedPair:
        """Return the pair with other settings for matching; the codes stay as they are."""
        settings = self.reference.settings.replaced(changes, "variant")
        return replace(self, reference=self.reference.matched_with(settings))

    def match(self, odometry: Odometry | None = None) -> Matches:
        """Match the query with the map's settings, and odometry of the query if there is any."""
        return self.match_coded(*self.described(), odometry)

    def match_coded(
        self, places: Descriptors, queries: Descriptors, odometry: Odometry | None = None
    ) -> Matches:
        """Match what `described` returns."""
        reference = self.reference
        return match_descriptors(
            places, queries, reference.settings, reference.confidence,
            along_mm=reference.along_mm, odometry=odometry,
        )  # fmt: skip

    def described(self) -> tuple[Descriptors, Descriptors]:
        """Return the places and the windows of the query in the codes that are compared."""
        if self.code is not None:
            return self.code.coded(self.reference, self.counted)
        return self.reference.places, self.reference.coded(self.counted)

    @property
    def score(self) -> Score | None:
        """Score by which matches are accepted, if it is not that of the settings."""
        sequences = self.reference.settings.matching == "sequence"
        return "ratio" if self.code is not None and sequences else None

    @property
    def packed_bytes_per_window(self) -> int:
        """Packed size of all places that begin in a window, in bytes."""
        if self.code is None:
            return self.reference.packed_bytes_per_window
        return packed_bytes(len(self.reference.pixel_map), self.code.bits)

    def correct(self) -> float:
        """Match, and return the share of correct matches."""
        return evaluate(self.match(), self.truth).precision_at_100_recall


# Windows that are counted at every pixel, as every system to compare gets them.
#
# On simulated streets, whose drives differ in speed, a window is a number of events of the whole
# sensor; on recorded drives it is a period of time.


@dataclass(frozen=True, eq=False)
class CountedDrive:
    """Windows of a drive, counted at every pixel."""

    #: Shape (n, height, width): counts of events at each pixel, for n windows.
    images: npt.NDArray[np.integer] = field(repr=False)
    #: Shape (n,): centre of each window.
    centre_us: Times = field(repr=False)
    #: Where the pixels of `images` lie on the sensor, if only some were published.
    published: PixelMap | None = None

    @property
    def on_sensor(self) -> npt.NDArray[np.integer]:
        """Images of the sensor, in which pixels that were not published have no events."""
        if self.published is None:
            return self.images
        sensor = self.published.sensor
        whole = np.zeros((len(self.images), sensor.height, sensor.width), self.images.dtype)
        whole[:, self.published.y, self.published.x] = self.images.reshape(len(self.images), -1)
        return whole

    @cached_property
    def activity(self) -> npt.NDArray[np.int64]:
        """Events of each window, shape (n,)."""
        return self.images.sum(axis=(1, 2), dtype=np.int64)

    def at(self, pixel_map: PixelMap) -> Descriptors:
        """Return the counts at some pixels."""
        counts, centre = self.images[:, pixel_map.y, pixel_map.x], self.centre_us
        return Descriptors(narrow(counts), centre, centre + 1, self.activity)


@dataclass(frozen=True, eq=False)
class CountedPair:
    """Two drives as windows, and how they are matched."""

    name: str
    reference: CountedDrive
    query: CountedDrive
    settings: Settings
    truths: Truths  #: See `Pair`.
    laid_out: bool = True  #: Whether all pixels were counted, so that images can be made of them.
    weights: tuple[Path, ...] = ()  #: Of LENS, trained with the reference.

    def truth(self) -> GroundTruth:
        """Return the truth of all windows by the first tolerance."""
        truth_of = next(iter(self.truths.values()))
        return truth_of(self.reference.centre_us, self.query.centre_us)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        _, height, width = self.reference.images.shape
        return int(height * width)

    def mapped(self, pixel_map: PixelMap, settings: Settings) -> MappedPair:
        """Map the reference at some pixels, in the codes of some settings."""
        size = self.reference.images.shape[1:]
        nothing = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.bool_)
        places = self.reference.at(pixel_map)
        counts = ReferenceMap(settings.uncoded, pixel_map, places, *nothing)
        return MappedPair(coded_map(counts, settings), self.query.at(pixel_map), self.truth())

    def distances(self, system: Baseline) -> npt.NDArray[np.float64]:
        """Return the distances of a baseline, shape (K, Q)."""
        system.prepare(self.reference.images)
        places, queries = (system.describe(each.images) for each in (self.reference, self.query))
        return system.distances(places, queries)

    def match(
        self, distances: npt.NDArray[np.floating], settings: Settings, part: slice = slice(None)
    ) -> Matches:
        """Match a part of the query by distances, shape (K, Q).

        Parameters
        ----------
        settings : Settings
            Of sequences or of the filter.
        part : slice
            Windows of the query; those of the matches count from 0.
        """
        shape = len(self.reference.images), len(self.query.images)
        if distances.shape != shape:
            raise UsageError(
                f"distances have shape {distances.shape}: give those of {shape[0]} places, a row "
                f"each, to {shape[1]} windows"
            )
        some, centre_us = distances[:, part], self.query.centre_us[part]
        if settings.matching == "filter":
            activity = self.reference.activity, self.query.activity[part]
            return filter_distances(some, activity, centre_us, settings)
        return match_distances(some, centre_us, settings)


def count_drive(
    drive: EventSource | WindowSource, window: Window, *, bursts: bool = False
) -> CountedDrive:
    """Count a drive's windows at every pixel, by default without bursts."""
    if isinstance(drive, WindowSource):
        windows = drive.windows()
    else:
        stream = DescriptorStream(PixelMap.all_of(drive.sensor), window)
        cleaning = PRESETS["paper"].replaced({"remove_bursts": not bursts}, "counting")
        windows = event_windows(drive, stream, cleaning, None)
    size = (drive.sensor.height, drive.sensor.width)
    images, centres = [], []
    for one in windows:
        images.append(np.minimum(one.counts, 65_535).astype(np.uint16).reshape(size))
        centres.append(one.start_us + (one.end_us - one.start_us) // 2)
    return CountedDrive(np.array(images), np.array(centres, dtype=np.int64))


def rates(matches: Matches, truth: GroundTruth, score: Score | None = None) -> dict[str, Any]:
    """Return how often matches are correct, and how many of them are accepted."""
    evaluation = evaluate(matches, truth, score=score)
    rejection = evaluation.rejection
    row: dict[str, Any] = {
        "P@100R": evaluation.precision_at_100_recall,
        "R@99P": evaluation.recall_at_99_precision,
    }
    if rejection.accepted is not None:
        row["accepted at 0.99"] = rejection.accepted / evaluation.queries
        row["correct of accepted"] = rejection.precision
    return row
