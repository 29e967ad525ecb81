"""How far a few pixels agree with all: in events a second, in distances, and in matched places.

The same windows are compared at a few pixels and at all of them. Distances are those of single
windows; places are matched by sequences. Events a second are counted in windows of fixed time, also
on simulated streets, whose other windows have one number of events of the whole sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import UsageError
from edge_vpr_tools.research.baselines import open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.experiments.drives import LENGTH_M, counted_drives, simulated_pair
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row, Rows
from edge_vpr_tools.research.experiments.pairs import CountedDrive, CountedPair, count_drive
from edge_vpr_tools.research.experiments.plots import lines

NUMBERS = (5, 10, 25, 50, 150)
#: with what each is called
STRATEGIES = {"variance": "by variance", "random": "at random"}
PROFILE, DISTANCES, PLACES = "events per second", "distances", "same place"
MEASURES = (PROFILE, DISTANCES, PLACES)
Floats = npt.NDArray[np.float64]


class Timed(NamedTuple):
    """Pair of drives, and windows of fixed time of its query."""

    pair: CountedPair
    timed: CountedDrive


def street(seed: int) -> Timed:
    """Simulate and count the pair of this seed, the query also in windows of fixed time."""
    drives = simulated_pair(seed, length_m=LENGTH_M)
    pair = drives.counted(window="count")
    timed = count_drive(drives.query, FixedTime(drives.settings.tau_us))
    # the hot pixels of the pair, which hold no counts there
    timed.images[:, ~(pair.reference.images.any(axis=0) | pair.query.images.any(axis=0))] = 0
    return Timed(pair, timed)


def measure(draw: Draw) -> Iterator[Row]:
    """Compare every choice and number of pixels with all pixels."""
    pair, timed = draw.pair if isinstance(draw.pair, Timed) else (draw.pair, draw.pair.query)
    dense = pair.distances(open_baseline("all-pixels"))
    places = pair.match(dense, pair.settings).place
    every = timed.images.mean(axis=(1, 2), dtype=np.float64)
    for strategy, called in STRATEGIES.items():
        for number in NUMBERS:
            changes = {"pixels": number, "strategy": strategy, "seed": draw.seed}
            settings = pair.settings.replaced(changes, strategy)
            chosen = SelectedPixels(strategy, settings)
            try:
                sparse = pair.distances(chosen)
            except UsageError:  # these pixels do not fit the sensor
                continue
            at = chosen.pixel_map
            profile = timed.images[:, at.y, at.x].mean(axis=1, dtype=np.float64)
            apart = pair.match(sparse, settings).place.astype(np.int64) - places
            yield {
                "pixels chosen": called,
                "pixels": number,
                PROFILE: correlation(profile, every),
                DISTANCES: correlation(sparse, dense),
                PLACES: float((np.abs(apart) <= settings.exclusion_places).mean()),
            }


def correlation(a: Floats, b: Floats) -> float:
    """Return Pearson's correlation of two arrays of one shape; 0 if one of them is constant."""
    constant = np.ptp(a) == 0 or np.ptp(b) == 0
    return 0.0 if constant else float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def drives(data: Path | None) -> list[Drives]:
    """Return streets, counted in two ways, and recorded pairs."""
    streets, *recorded = counted_drives(data)
    return [replace(streets, open=street), *recorded]


def figure(rows: Rows) -> Figure:
    """Draw the agreement with all pixels against the number of pixels."""
    measured = [
        {**row, "measure": f"{measure}, {row['pixels chosen']}", "agreement": row[measure]}
        for measure in MEASURES
        for row in rows
    ]
    return lines(measured, x="pixels", y="agreement", line="measure", log=True)


EXPERIMENT = Experiment(
    drives=drives, names=("pixels chosen", "pixels"), measure=measure, figure=figure
)
