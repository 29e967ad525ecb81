"""How far a few pixels agree with all: in events a second, in distances, and in matched places.

The same windows are compared at a few pixels and at all of them. Distances are those of single
windows; places are matched by sequences. Events a second are counted in windows of fixed time, also
on simulated streets, whose other windows have one number of events of the whole sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import FixedTime
from edge_vpr.errors import UsageError
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import simulate_pair
from edge_vpr_tools.report.style import (
    CYCLE,
    DASHES,
    legend_below,
    log_ticks,
    look,
    mean_line,
    panels,
    save,
)
from edge_vpr_tools.research.baselines import Baseline, match_distances, open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.experiments.drives import (
    LENGTH_M,
    CountedDrive,
    CountedPair,
    absent_data,
    count_drive,
    count_simulated,
    recorded_pairs,
)
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table

NUMBERS = (5, 10, 25, 50, 150)
#: number of pixels whose events are drawn
SHOWN = 25
#: with what each is called
STRATEGIES = {"variance": "by variance", "random": "at random"}
PROFILE, DISTANCES, PLACES = "events a second", "distances", "same place"
MEASURES = (PROFILE, DISTANCES, PLACES)
Floats = npt.NDArray[np.float64]


class Trial(NamedTuple):
    """Pair of drives, windows of fixed time of its query, and the seed of a draw of pixels."""

    pair: CountedPair
    timed: CountedDrive
    seed: int


@dataclass(frozen=True, eq=False)
class Found:
    """Figures of each trial by strategy, number of pixels and measure; and events a second.

    Attributes
    ----------
    figures : dict of (strategy, number, measure) to list of float
    profiles : dict of str to ndarray of float64, shape (n,)
        Of the first trial: mean events of a pixel in each window, by what pixels these are.
    """

    figures: dict[tuple[str, int, str], list[float]] = field(default_factory=dict)
    profiles: dict[str, Floats] = field(default_factory=dict)


def trials(data: Path | None, seeds: int, on_start: Callable[[str], None]) -> Iterator[Trial]:
    """Yield a simulated pair for each seed, and each recorded pair with all seeds."""
    for seed in range(seeds):
        on_start(f"street {seed + 1} of {seeds}")
        yield street(seed)
    for pair in recorded_pairs(data) if data is not None else ():
        for seed in range(seeds):
            on_start(f"{pair.name}, draw {seed + 1} of {seeds}")
            yield Trial(pair, pair.query, seed)


def street(seed: int, length_m: float = LENGTH_M, sensor: str = "default") -> Trial:
    """Simulate and count the pair of this seed, the query also in windows of fixed time."""
    reference, query = (drive.keep() for drive in simulate_pair(seed, sensor, length_m=length_m))
    pair = count_simulated(reference, query)
    timed = count_drive(query, FixedTime(PRESETS["paper"].tau_us))
    # the hot pixels of the pair, which hold no counts there
    timed.images[:, ~(pair.reference.images.any(axis=0) | pair.query.images.any(axis=0))] = 0
    return Trial(pair, timed, seed)


def score(trial: Trial, found: Found) -> None:
    """Compare every number of pixels with all pixels, and add the figures to `found`."""
    pair, timed = trial.pair, trial.timed
    dense, places = _matched(pair, open_baseline("all-pixels"))
    every = timed.images.mean(axis=(1, 2), dtype=np.float64)
    found.profiles.setdefault("all pixels", every)
    for strategy, called in STRATEGIES.items():
        for number in NUMBERS:
            changes = {"pixels": number, "strategy": strategy, "seed": trial.seed}
            settings = pair.settings.replaced(changes, strategy)
            chosen = SelectedPixels(strategy, settings)
            try:
                few, matched = _matched(pair, chosen)
            except UsageError:  # on this sensor, the surrounds of fewer pixels cover all others
                continue
            at = chosen.pixel_map
            profile = timed.images[:, at.y, at.x].mean(axis=1, dtype=np.float64)
            if number == SHOWN:
                found.profiles.setdefault(f"{number} {called}", profile)
            near = np.abs(matched - places) <= settings.exclusion
            for measure, value in (
                (PROFILE, correlation(profile, every)),
                (DISTANCES, correlation(few, dense)),
                (PLACES, float(near.mean())),
            ):
                found.figures.setdefault((strategy, number, measure), []).append(value)


def correlation(a: Floats, b: Floats) -> float:
    """Return Pearson's correlation of two arrays of one shape; 0 if one of them is constant."""
    a, b = a.ravel() - a.mean(), b.ravel() - b.mean()
    scale = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / scale if scale > 0 else 0.0


def _matched(pair: CountedPair, system: Baseline) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return the distances of single windows, shape (K, Q), and the place of each query."""
    system.prepare(pair.reference.images)
    places, queries = (system.describe(d.images) for d in (pair.reference, pair.query))
    distances = system.distances(places, queries)
    matches = match_distances(distances, pair.query.centre_us, pair.settings)
    return distances, matches.place.astype(np.int64)


def run(data: Path | None, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Compare on simulated pairs, and on recorded ones if a folder is given."""
    results: dict[str, Found] = {}
    for trial in trials(data, seeds, on_start):
        score(trial, results.setdefault(trial.pair.name, Found()))
    if figures:
        save(draw(results), *figures)
    tables = "\n\n".join(f"{name}:\n\n{_table(found)}" for name, found in results.items())
    return (
        "Correlation (Pearson) of events a second and of distances with those of all pixels, and "
        f"share of matches with the place that all pixels match:\n\n{tables}"
        + absent_data(data, results)
    )


def _table(found: Found) -> str:
    rows = []
    for measure in MEASURES:
        for strategy, called in STRATEGIES.items():
            values = [found.figures.get((strategy, number, measure)) for number in NUMBERS]
            shown = ("-" if v is None else str(Summary(v)) for v in values)
            rows.append([f"{measure}, {called}", *shown])
    return markdown_table(("pixels", *map(str, NUMBERS)), rows)


def draw(results: Mapping[str, Found]) -> Figure:
    """Draw events a second of some pixels and all, and the measures; a column each pair."""
    with panels(2, len(results), 4.4 * len(results) + 1.5, 7.4) as (drawing, grid):
        for (above, below), (pair, found) in zip(grid.T, results.items(), strict=True):
            for i, (name, profile) in enumerate(found.profiles.items()):
                relative = profile / max(float(profile.mean()), 1e-9)
                above.plot(relative, label=name, lw=1.3, **look(i))
            above.set(title=pair, xlabel="window", ylim=(0, None))
            for i, measure in enumerate(MEASURES):
                for dashes, (strategy, called) in zip(DASHES, STRATEGIES.items(), strict=False):
                    numbers = [n for n in NUMBERS if (strategy, n, measure) in found.figures]
                    values = [found.figures[strategy, n, measure] for n in numbers]
                    label = f"{measure}, {called}"
                    mean_line(below, numbers, values, color=CYCLE[i], linestyle=dashes, label=label)
            below.set(xlabel="pixels", ylim=(0, 1.03))
            log_ticks(below, NUMBERS)
        grid[0, 0].set_ylabel("events of a pixel, share of the mean")
        grid[1, 0].set_ylabel("agreement with all pixels")
        grid[0, 0].legend()
        legend_below(drawing, grid[1], 3)
    return drawing
