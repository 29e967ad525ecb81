"""How many pixels are enough: right matches against their number, for each way to choose them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Descriptors, narrow
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import coded_map, match_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.style import legend_below, log_ticks, look, mean_line, panels, save
from edge_vpr_tools.research.baselines import open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.experiments.drives import CountedDrive, CountedPair, absent_data, draws
from edge_vpr_tools.research.experiments.rivals import compare_systems
from edge_vpr_tools.research.experiments.trial import Summary, markdown_table

NUMBERS = (5, 10, 25, 50, 83, 150, 300)
#: strategies with the suppression of the default number of pixels; numbers of pixels that do not
#: fit are left out of the table
STRATEGIES: Mapping[str, Mapping[str, Any]] = {
    "variance": {"strategy": "variance"},
    "mean (released code)": {"strategy": "seed-code"},
    "information": {"strategy": "information"},
    "random": {"strategy": "random"},
    "random, upper two thirds": {"strategy": "random-upper"},
}
ALL = "all pixels"


#: ways to match the pixels: sequences of counts, as in the paper, or the default for a robot
PAPER, ROBOT = "sequences of counts (the paper)", "place filter, running mean (robot)"
_ROBOT = {"smooth": False, "query_mean": "running"}


@dataclass(frozen=True, eq=False)
class Found:
    """P@100R of each trial, by method, strategy and number of pixels; and of all pixels."""

    few: dict[tuple[str, str, int], list[float]]
    every: list[float]

    def add(self, method: str, strategy: str, number: int, right: float) -> None:
        """Store the figure of a trial."""
        self.few.setdefault((method, strategy, number), []).append(right)


def score(pair: CountedPair, seed: int, found: Found, dense: bool = True) -> None:
    """Match a pair with every number of pixels, and add the figures to `found`.

    Parameters
    ----------
    pair : CountedPair
    seed : int
        Seed of the draw of pixels.
    found : Found
        Changed in place.
    dense : bool
        Match all pixels too.
    """
    truth = pair.truth_of(pair.reference.centre_us, pair.query.centre_us)
    for name, changes in STRATEGIES.items():
        for number in NUMBERS:
            settings = pair.settings.replaced({"pixels": number, "seed": seed, **changes}, name)
            pixels = SelectedPixels(name, settings)
            results = compare_systems(replace(pair, settings=settings), [(name, pixels)])
            if not results:  # on this sensor, the surrounds of fewer pixels cover all others
                continue
            found.add(PAPER, name, number, results[name][1].precision_at_100_recall)
            matches = match_as_robot(pair, pixels.pixel_map)
            found.add(ROBOT, name, number, evaluate(matches, truth).precision_at_100_recall)
    if dense:
        _, evaluation = compare_systems(pair, [(ALL, open_baseline("all-pixels"))])[ALL]
        found.every.append(evaluation.precision_at_100_recall)


def match_as_robot(pair: CountedPair, pixel_map: PixelMap) -> Matches:
    """Match a pair at these pixels by the default method, window by window."""
    settings = PRESETS["default"].replaced(
        {"pixels": len(pixel_map), "window": pair.settings.window, **_ROBOT}, ROBOT
    )
    places, queries = (_windows_at(drive, pixel_map) for drive in (pair.reference, pair.query))
    size = pair.reference.images.shape[1:]
    nothing = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.bool_)
    counted = ReferenceMap(settings.uncoded, pixel_map, places, *nothing)
    coded = coded_map(counted, settings)
    return match_query(coded, coded.coded(queries))


def _windows_at(drive: CountedDrive, pixel_map: PixelMap) -> Descriptors:
    counts, centre = drive.images[:, pixel_map.y, pixel_map.x], drive.centre_us
    events = drive.images.sum(axis=(1, 2), dtype=np.int64)
    return Descriptors(narrow(counts), centre, centre + 1, events)


def run(
    data: Path | None,
    seeds: int,
    on_start: Callable[[str], None],
    *figures: Path,
) -> str:
    """Vary the number of pixels on simulated pairs, and on recorded ones if a folder is given."""
    results: dict[str, Found] = {}
    for each in draws(data, seeds, on_start):
        found = results.setdefault(each.name, Found({}, []))
        score(each.pair, each.seed, found, dense=each.is_new)
    if figures:
        save(draw(results), *figures)
    tables = "\n\n".join(
        f"{name}, {method}, P@100R:\n\n{_table(found, method)}"
        for name, found in results.items()
        for method in (PAPER, ROBOT)
    )
    return tables + absent_data(data, results)


def _table(found: Found, method: str) -> str:
    rows = []
    for name in STRATEGIES:
        values = [found.few.get((method, name, number)) for number in NUMBERS]
        rows.append([name, *("-" if v is None else str(Summary(v)) for v in values)])
    if method == PAPER:
        rows.append([ALL, *[""] * (len(NUMBERS) - 1), str(Summary(found.every))])
    return markdown_table(("choice of pixels", *map(str, NUMBERS)), rows)


def draw(results: Mapping[str, Found]) -> Figure:
    """Draw right matches against the number of pixels: a column each pair, a row each method."""
    with panels(2, len(results), 4.2 * len(results) + 1.5, 8.0, sharex=True) as (drawing, grid):
        every = (
            (pair, found, method) for method in (PAPER, ROBOT) for pair, found in results.items()
        )
        for axes, (pair, found, method) in zip(grid.flat, every, strict=True):
            for i, name in enumerate(STRATEGIES):
                numbers = [n for n in NUMBERS if (method, name, n) in found.few]
                values = [found.few[method, name, n] for n in numbers]
                mean_line(axes, numbers, values, label=name, **look(i))
            if method == PAPER:
                axes.axhline(float(np.mean(found.every)), color="gray", lw=0.9, label=ALL)
            log_ticks(axes, NUMBERS)
            axes.set(title=f"{pair}\n{method}", ylim=(0, 1.03))
        for row in grid:
            row[0].set_ylabel("P@100R")
        for axes in grid[-1]:
            axes.set_xlabel("pixels")
        legend_below(drawing, grid[0], 3)
    return drawing
