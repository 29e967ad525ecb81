"""Pixels of conventional frames: chosen by the variance of their intensity, compared by SAD.

Frames are taken at the centres of the windows of events, so that both show the same places.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from edge_vpr_tools.sweep.trial import fastest

from edge_vpr.descriptors.counting import EventSource
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.evaluation.track_files import load_track
from edge_vpr.evaluation.tracks import Track
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from lab.baselines import Baseline, compare, open_baseline
from lab.baselines.selected_pixels import SelectedPixels
from lab.datasets import PublishedDrive, PublishedPair, published_pairs
from lab.drives import LENGTH_M
from lab.intensity import (
    IntensityFrames,
    frames_at,
    open_intensity,
    simulated_images,
)
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import (
    SIMULATED,
    CountedDrive,
    CountedPair,
    Pair,
    Times,
    truths_of_tracks,
)

# Drives of the user that have intensity frames.
#
# The folder given with ``--data`` can hold the bags of Brisbane-Event-VPR under their published
# names, and a folder ``frames``. The latter has ``reference`` and ``query``, each a ROS bag or a
# folder of PNG (see `lab.intensity`), and ``reference_track`` and ``query_track`` (``.csv``,
# ``.nmea`` or ``.gpx``), whose times count from the start of their recordings.


FRAMES = "frames"
#: largest distance of a correct match, by the kind of track
TOLERANCE_M = {"geographic": 70.0, "metric": 10.0}
SETTINGS = PRESETS["paper"]
_TRACKS = (".csv", ".nmea", ".gpx")


class FramedPair(NamedTuple):
    """Pair of drives as windows of events (None if none were recorded), and as frames."""

    name: str
    events: CountedPair | None
    frames: CountedPair


@dataclass(frozen=True, eq=False)
class FramedDrive:
    """Drive with frames, on whose clock `start_us` is its time 0; events, if any were recorded."""

    frames: IntensityFrames
    start_us: int
    recording: EventSource | None
    track: Track


def framed_pairs(data: Path) -> list[Drives]:
    """Return the pairs of drives in a folder that have frames.

    Raises
    ------
    GroundTruthError
        If the GPS log of a published traverse is missing.
    """
    folder, pairs = data / FRAMES, []
    if folder.is_dir():
        pairs.append(Drives("own frames", lambda seed: _read_own(folder)))
    for pair in published_pairs(data, ("bag",)):
        pairs.append(Drives(pair.name, lambda seed, pair=pair: _read_published(pair)))  # type: ignore[misc]
    return pairs


def _read_own(folder: Path) -> FramedPair:
    return _read("own frames", _own_drive(folder, "reference"), _own_drive(folder, "query"))


def _read_published(pair: PublishedPair) -> FramedPair:
    reference, query = (_published_drive(drive) for drive in (pair.reference, pair.query))
    return _read(pair.name, reference, query, pair.tolerance_m)


def _read(
    name: str, reference: FramedDrive, query: FramedDrive, tolerance_m: float | None = None
) -> FramedPair:
    metres = tolerance_m or TOLERANCE_M[reference.track.kind]
    truths = truths_of_tracks(reference.track, query.track, metres)
    if reference.recording is None or query.recording is None:
        events = None
        times = [_grid(drive) for drive in (reference, query)]
    else:
        events = Pair(name, reference.recording, query.recording, SETTINGS, truths).counted()
        times = [events.reference.centre_us, events.query.centre_us]
    first, second = (
        CountedDrive(
            frames_at(drive.frames, wanted, SETTINGS.tau_us // 2, drive.start_us)[0], wanted
        )
        for drive, wanted in zip((reference, query), times, strict=True)
    )
    return FramedPair(name, events, CountedPair(name, first, second, SETTINGS, truths))


def _grid(drive: FramedDrive) -> Times:
    """Return the centres of windows of tau, from the drive's start to its last frame."""
    last_us = max(frame.time_us for frame in drive.frames) - drive.start_us
    return np.arange(SETTINGS.tau_us // 2, last_us + 1, SETTINGS.tau_us, dtype=np.int64)


def _own_drive(folder: Path, side: str) -> FramedDrive:
    tracks = [path for path in sorted(folder.glob(f"{side}_track.*")) if path.suffix in _TRACKS]
    drives = [path for path in sorted(folder.iterdir()) if path.name.split(".")[0] == side]
    for what, files, example in (
        ("drive", drives, f"{side}.bag, or a folder {side} of images"),
        ("track", tracks, f"{side}_track.csv"),
    ):
        if len(files) != 1:
            raise UsageError(
                f"{folder} has {len(files)} files of the {side} {what}, and one is needed: put "
                f"there {example}"
            )
    frames = open_intensity(drives[0])
    recording = open_recording(drives[0]) if frames.has_events else None
    return FramedDrive(frames, frames.start_us, recording, load_track(tracks[0]))


def _published_drive(drive: PublishedDrive) -> FramedDrive:
    frames = open_intensity(drive.path)
    return FramedDrive(frames, drive.recording.start_us, drive.recording, drive.track)


#: strategies for choosing pixels, by the name in the table
STRATEGIES = {"by variance": "variance", "by mean": "seed-code", "at random": "random"}
NUMBERS = (25, 150)
#: systems that use every pixel
DENSE = {"all pixels": "all-pixels", "patch-normalised": "patch-normalised"}


def simulated_frames(seed: int) -> FramedPair:
    """Simulate the pair of this seed, and take a frame at the centre of each window."""
    drives = tuple(drive.keep() for drive in simulate_pair(seed, length_m=LENGTH_M))
    events = Pair.simulated(*drives).counted(window="count")
    rng = np.random.default_rng(seed)
    first, second = (
        CountedDrive(simulated_images(drive, counted.centre_us, rng), counted.centre_us)
        for drive, counted in zip(drives, (events.reference, events.query), strict=True)
    )
    frames = CountedPair(SIMULATED, first, second, events.settings, events.truths)
    return FramedPair(SIMULATED, events, frames)


def systems(draw: Draw) -> Iterator[tuple[str, Baseline]]:
    """Yield each choice of pixels with its name; what draws none, once."""
    if draw.is_new:
        for name, baseline in [*DENSE.items(), *((each, each) for each in draw.systems)]:
            yield name, open_baseline(baseline, draw.seed)
    for number in NUMBERS:
        for name, strategy in STRATEGIES.items():
            changes = {"pixels": number, "strategy": strategy, "seed": draw.seed}
            settings = PRESETS["paper"].replaced(changes, name)
            yield f"{number} {name}", SelectedPixels(name, settings)


def compare_systems(pair: CountedPair, systems: Iterable[tuple[str, Baseline]]) -> Iterator[Row]:
    """Match a pair by sequences with every system that fits its sensor."""
    for name, system in systems:
        try:
            compared = compare(system, pair.reference.images, pair.query.images)
            matches, matching_s = fastest(partial(pair.match, compared.distances, pair.settings))
        except UsageError:  # as of pixels whose surrounds do not fit the sensor
            continue
        evaluated = evaluate(matches, pair.truth())
        yield {
            "system": name,
            "P@100R": evaluated.precision_at_100_recall,
            "R@99P": evaluated.recall_at_99_precision,
            "bytes per place": compared.bytes_per_place,
            "operations per query": compared.operations,
            "time per query (us)": compared.query_us + 1e6 * matching_s / len(matches),
        }


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every choice of pixels, as events and as frames."""
    pair: FramedPair = draw.pair
    for seen, counted in (("events", pair.events), ("frames", pair.frames)):
        if counted is not None:
            for row in compare_systems(counted, systems(draw)):
                yield {"seen": seen, **row}


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the drives of a folder that have frames."""
    streets = Drives(SIMULATED, lambda seed: simulated_frames(seed), varied=True)
    return [streets, *(framed_pairs(data) if data is not None else ())]


EXPERIMENT = Experiment(
    drives=drives,
    names=("seen", "system"),
    measure=measure,
    takes_systems=True,
)
