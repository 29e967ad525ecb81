"""Pairs of drives whose windows are counted at every pixel, as every system to compare gets them.

On simulated streets, whose drives differ in speed, a window is a number of events of the whole
sensor; on recorded drives it is a period of time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.hot_pixels import find_hot_pixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime, Window
from edge_vpr.pipeline import EventSource, WindowSource, cleaned
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulate import SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments.drive_pairs import PAPER, pairs
from edge_vpr_tools.experiments.simulated import SIMULATED, truth_of_pair
from edge_vpr_tools.experiments.trial import Times, TruthOf

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
