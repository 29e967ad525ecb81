"""Pixels of conventional frames: chosen by the variance of their intensity, compared by SAD.

Frames are taken at the centres of the windows of events, so that both show the same places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from edge_vpr_tools.sweep.trial import fastest

from edge_vpr.errors import UsageError
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from lab.baselines import Baseline, compare, open_baseline
from lab.baselines.baseline import Images
from lab.baselines.selected_pixels import SelectedPixels
from lab.datasets import PublishedDrive, PublishedPair, published_pairs
from lab.drives import LENGTH_M
from lab.intensity import BagImages, frames_at, simulated_images
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import SIMULATED, CountedDrive, CountedPair, Pair, Times, rates, truths_of_tracks

SETTINGS = PRESETS["paper"]


class FramedPair(NamedTuple):
    """Pair of drives as windows of events, and as a frame at the centre of each window."""

    events: CountedPair
    frames: CountedPair


def framed(
    events: CountedPair, drives: Iterable[Any], images_at: Callable[[Any, Times], Images]
) -> FramedPair:
    """Return a pair with the images of both drives at the centres of its windows."""
    reference, query = (
        CountedDrive(images_at(drive, counted.centre_us), counted.centre_us)
        for drive, counted in zip(drives, (events.reference, events.query), strict=True)
    )
    return FramedPair(events, replace(events, reference=reference, query=query))


def published_frames(pair: PublishedPair) -> FramedPair:
    """Count the drives of two published bags, and take the frames that the same camera recorded."""

    def images_at(drive: PublishedDrive, centre_us: Times) -> Images:
        start_us = drive.recording.start_us
        return frames_at(BagImages(drive.path), centre_us, SETTINGS.tau_us // 2, start_us)

    reference, query = pair.reference, pair.query
    truths = truths_of_tracks(reference.track, query.track, pair.tolerance_m)
    events = Pair(pair.name, reference.recording, query.recording, SETTINGS, truths).counted()
    return framed(events, (reference, query), images_at)


#: strategies for choosing pixels, by the name in the table
STRATEGIES = {"by variance": "variance", "by mean": "seed-code", "at random": "random"}
NUMBERS = (25, 150)
#: systems that use every pixel
DENSE = {"all pixels": "all-pixels", "patch-normalised": "patch-normalised"}


def simulated_frames(seed: int) -> FramedPair:
    """Simulate the pair of this seed, and take a frame at the centre of each window."""
    drives = tuple(drive.keep() for drive in simulate_pair(seed, length_m=LENGTH_M))
    events = Pair.simulated(*drives).counted(window="count")
    return framed(events, drives, partial(simulated_images, rng=np.random.default_rng(seed)))


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
        yield {
            "system": name,
            **rates(matches, pair.truth()),
            "bytes per place": compared.bytes_per_place,
            "operations per query": compared.operations,
            "time per query (us)": compared.query_us + 1e6 * matching_s / len(matches),
        }


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every choice of pixels, as events and as frames."""
    pair: FramedPair = draw.pair
    for seen, counted in zip(("events", "frames"), pair, strict=True):
        for row in compare_systems(counted, systems(draw)):
            yield {"seen": seen, **row}


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the pairs of published bags in a folder, which have frames."""
    declared = [Drives(SIMULATED, simulated_frames, varied=True)]
    for pair in published_pairs(data, ("bag",)) if data is not None else ():
        declared.append(Drives(pair.name, lambda seed, pair=pair: published_frames(pair)))  # type: ignore[misc]
    return declared


EXPERIMENT = Experiment(
    drives=drives, names=("seen", "system"), measure=measure, takes_systems=True
)
