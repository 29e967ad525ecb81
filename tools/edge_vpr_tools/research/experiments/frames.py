"""Pixels of conventional frames: chosen by the variance of their intensity, compared by SAD.

Frames are taken at the centres of the windows of events, so that both show the same places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tracks import Track, load_track
from edge_vpr.pipeline import EventSource
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from edge_vpr_tools.report.style import CYCLE, save
from edge_vpr_tools.research.baselines import Baseline, open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.datasets import BRISBANE_BAGS_PAGE, PublishedDrive, published_pairs
from edge_vpr_tools.research.experiments.drives import (
    LENGTH_M,
    CountedDrive,
    CountedPair,
    count_pair,
    count_simulated,
)
from edge_vpr_tools.research.experiments.rivals import (
    Result,
    Results,
    compare_systems,
    draw_curves,
    systems_table,
)
from edge_vpr_tools.research.experiments.simulated import SIMULATED
from edge_vpr_tools.research.experiments.trial import Times, truth_of_tracks
from edge_vpr_tools.research.intensity import IntensityFrames, frames_at, open_intensity
from edge_vpr_tools.research.intensity.frames import simulated_images

# Drives of the user that have intensity frames.
#
# The folder given with ``--data`` can hold the bags of Brisbane-Event-VPR under their published
# names, and a folder ``frames``. The latter has ``reference`` and ``query``, each an AEDAT file, a
# ROS bag, HDF5 or a folder of images (see `research.intensity`), and ``reference_track`` and
# ``query_track`` (``.csv``, ``.nmea`` or ``.gpx``), whose times count from the start of their
# recordings.


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
    """Drive with frames.

    Attributes
    ----------
    frames : IntensityFrames
    start_us : int
        Time 0 of the drive on the clock of the frames.
    recording : EventSource or None
        Events of the drive.
    track : Track
    """

    frames: IntensityFrames
    start_us: int
    recording: EventSource | None
    track: Track


def framed_pairs(data: Path, on_start: Callable[[str], None]) -> Iterator[FramedPair]:
    """Yield the pairs of drives that have frames.

    Parameters
    ----------
    data : Path
    on_start : callable
        Called with a description before each part begins.

    Raises
    ------
    UsageError
        If the folder of own drives holds only half of a pair.
    """
    folder = data / FRAMES
    if folder.is_dir():
        on_start("reading frames")
        yield _read("own frames", _own_drive(folder, "reference"), _own_drive(folder, "query"))
    for pair in published_pairs(data, ("bag",)):
        on_start(f"reading {pair.name}")
        reference, query = (_published_drive(drive) for drive in (pair.reference, pair.query))
        yield _read(pair.name, reference, query, pair.tolerance_m)


def _read(
    name: str, reference: FramedDrive, query: FramedDrive, tolerance_m: float | None = None
) -> FramedPair:
    truth_of = truth_of_tracks(
        reference.track, query.track, tolerance_m or TOLERANCE_M[reference.track.kind]
    )
    if reference.recording is None or query.recording is None:
        events = None
        times = [_grid(drive) for drive in (reference, query)]
    else:
        events = count_pair(name, reference.recording, query.recording, SETTINGS, truth_of)
        times = [events.reference.centre_us, events.query.centre_us]
    first, second = (
        CountedDrive(
            frames_at(drive.frames, wanted, SETTINGS.tau_us // 2, drive.start_us)[0], wanted
        )
        for drive, wanted in zip((reference, query), times, strict=True)
    )
    return FramedPair(name, events, CountedPair(name, first, second, SETTINGS, truth_of))


def _grid(drive: FramedDrive) -> Times:
    """Return the centres of windows of tau, from the drive's start to its last frame."""
    last_us = max(frame.time_us for frame in drive.frames) - drive.start_us
    return np.arange(SETTINGS.tau_us // 2, last_us + 1, SETTINGS.tau_us, dtype=np.int64)


def _own_drive(folder: Path, side: str) -> FramedDrive:
    tracks = [path for path in sorted(folder.glob(f"{side}_track.*")) if path.suffix in _TRACKS]
    drives = [path for path in sorted(folder.iterdir()) if path.name.split(".")[0] == side]
    for what, found, example in (
        ("drive", drives, f"{side}.aedat4, {side}.bag, or a folder {side} of images"),
        ("track", tracks, f"{side}_track.csv"),
    ):
        if len(found) != 1:
            raise UsageError(
                f"{folder} has {len(found)} files of the {side} {what}, and one is needed: put "
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
#: rows of the figure, in which all rows would be too many
SHOWN = ("all pixels", "patch-normalised", "150 by variance", "150 at random", "25 by variance")


def simulated_frames(seed: int, length_m: float = LENGTH_M, sensor: str = "default") -> FramedPair:
    """Simulate the pair of this seed, and take a frame at the centre of each window."""
    drives = tuple(drive.keep() for drive in simulate_pair(seed, sensor, length_m=length_m))
    events = count_simulated(*drives)
    rng = np.random.default_rng(seed)
    first, second = (
        CountedDrive(simulated_images(drive, counted.centre_us, rng), counted.centre_us)
        for drive, counted in zip(drives, (events.reference, events.query), strict=True)
    )
    frames = CountedPair(SIMULATED, first, second, events.settings, events.truth_of)
    return FramedPair(SIMULATED, events, frames)


def systems(
    seed: int, drawn_only: bool, baselines: Sequence[str] = ()
) -> Iterator[tuple[str, Baseline]]:
    """Yield each choice of pixels with its name.

    Parameters
    ----------
    seed : int
        Seed of the draw of pixels.
    drawn_only : bool
        Skip the systems that draw nothing.
    baselines : sequence of str
        Additional baselines; see `edge_vpr_tools.research.baselines.open_baseline`.
    """
    if not drawn_only:
        for name, baseline in DENSE.items():
            yield name, open_baseline(baseline)
        for name in baselines:
            yield name, open_baseline(name, seed)
    for number in NUMBERS:
        for name, strategy in STRATEGIES.items():
            changes = {"pixels": number, "strategy": strategy, "seed": seed}
            settings = PRESETS["paper"].replaced(changes, name)
            yield f"{number} {name}", SelectedPixels(name, settings)


def titles(baselines: Sequence[str] = ()) -> Mapping[str, str]:
    """Return the titles of all rows by their keys, those of events first."""
    names = {name: name for name in DENSE}
    names |= {name: open_baseline(name).title for name in baselines}
    names |= {f"{j} {name}": f"{j} {name}" for j in NUMBERS for name in STRATEGIES}
    return {
        f"{what}, {name}": f"{what}, {title}"
        for what in ("events", "frames")
        for name, title in names.items()
    }


def score(
    pair: FramedPair, seed: int, drawn_only: bool, baselines: Sequence[str] = ()
) -> dict[str, Result]:
    """Match a pair with every choice of pixels, as events and as frames."""
    found: dict[str, Result] = {}
    for what, counted in (("events", pair.events), ("frames", pair.frames)):
        if counted is not None:
            results = compare_systems(counted, systems(seed, drawn_only, baselines))
            found |= {f"{what}, {name}": result for name, result in results.items()}
    return found


def run(
    data: Path | None,
    seeds: int,
    on_start: Callable[[str], None],
    *figures: Path,
    baselines: Sequence[str] = (),
) -> str:
    """Compare frames with events on simulated pairs, and on the user's if a folder is given."""
    rows = titles(baselines)
    results: dict[str, dict[str, list[Result]]] = {}

    def add(pair: FramedPair, seed: int, drawn_only: bool) -> None:
        kept = results.setdefault(pair.name, {})
        for name, result in score(pair, seed, drawn_only, baselines).items():
            kept.setdefault(name, []).append(result)

    for seed in range(seeds):
        on_start(f"street {seed + 1} of {seeds}")
        add(simulated_frames(seed), seed, drawn_only=False)
    for pair in framed_pairs(data, on_start) if data is not None else ():
        for seed in range(seeds):
            on_start(f"{pair.name}, draw {seed + 1} of {seeds}")
            add(pair, seed, drawn_only=seed > 0)
    if figures:
        save(draw(results, rows), *figures)
    tables = "\n\n".join(
        f"{pair}:\n\n"
        + systems_table(found, {key: title for key, title in rows.items() if key in found})
        for pair, found in results.items()
    )
    if set(results) - {SIMULATED}:
        return tables
    where = "no folder was given with --data" if data is None else f"{data} holds none"
    return (
        f"{tables}\n\nNo recorded frames were compared: {where}. Name a folder with two bags or "
        f"more of Brisbane-Event-VPR ({BRISBANE_BAGS_PAGE}) under their published names and their "
        f"GPS logs, or with own drives in its folder {FRAMES} (docs/results_methods.md says how)."
    )


def draw(results: Mapping[str, Results], rows: Mapping[str, str]) -> Figure:
    """Draw precision against recall of selected rows, with a panel for each pair."""
    hidden = {f"{j} {name}" for j in NUMBERS for name in STRATEGIES} - set(SHOWN)
    shown = {key: title for key, title in rows.items() if _choice(key) not in hidden}
    choices = list(dict.fromkeys(map(_choice, shown)))
    looks = {
        key: {
            "color": CYCLE[choices.index(_choice(key)) % len(CYCLE)],
            "linestyle": "-" if key.startswith("events") else "--",
        }
        for key in shown
    }
    return draw_curves(results, shown, looks)


def _choice(key: str) -> str:
    return key.split(", ", 1)[1]
