"""Systems side by side on the same windows: how often each is right, and what a match costs.

Every system gets the same counted and cleaned windows, sequence length and ground truth. On
simulated streets, whose drives differ in speed, a window is a number of events of the whole sensor;
on recorded ones it is a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.baselines import Compared, baseline_names, compare, open_baseline
from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.hot_pixels import find_hot_pixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import FixedCount, FixedTime, Window
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import Evaluation, evaluate
from edge_vpr.pipeline import EventSource, WindowSource, cleaned
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulate import simulate_pair
from edge_vpr_tools.experiments import codes_frontier
from edge_vpr_tools.experiments.simulated import truth_of_pair
from edge_vpr_tools.experiments.trial import Summary, Times, TruthOf, markdown_table
from edge_vpr_tools.report.style import CYCLE, figure, save

#: of the simulated streets, in metres
LENGTH_M = 450.0
SIMULATED = "simulated streets"


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


Result = tuple[Compared, Evaluation]


def count_drive(drive: EventSource | WindowSource, window: Window) -> CountedDrive:
    """Count a drive's windows at every pixel, without bursts."""
    if isinstance(drive, WindowSource):
        windows = list(drive.windows())
    else:
        stream = DescriptorStream(PixelMap.all_of(drive.sensor), window)
        windows = [
            one for events in cleaned(drive, PRESETS["paper"]) for one in stream.windows(events)
        ]
    size = (drive.sensor.height, drive.sensor.width)
    images = [np.minimum(one.counts, 65_535).astype(np.uint16).reshape(size) for one in windows]
    centres = [one.start_us + (one.end_us - one.start_us) // 2 for one in windows]
    return CountedDrive(np.array(images), np.array(centres, dtype=np.int64))


def count_pair(
    name: str,
    reference: EventSource | WindowSource,
    query: EventSource | WindowSource,
    settings: Settings,
    truth_of: TruthOf,
) -> CountedPair:
    """Count both drives; by events if the settings ask for it, and without hot pixels."""
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
    reference, query = (drive.keep() for drive in simulate_pair(seed, sensor, length_m=length_m))
    settings = PRESETS["paper"].replaced({"window": "count"}, "rivals")
    return count_pair(SIMULATED, reference, query, settings, truth_of_pair(reference, query))


def recorded_pairs(data: Path) -> Iterator[CountedPair]:
    """Open the recorded pairs that were counted at every pixel, each once."""
    for pair in codes_frontier.pairs(data):
        if isinstance(pair.query, WindowSource) and not pair.query.counted.all():
            continue
        if pair.settings.pixels != PRESETS["paper"].pixels:  # the same drives again
            continue
        name = pair.name.split(",")[0]
        yield count_pair(name, pair.reference, pair.query, pair.settings, pair.truth_of)


class Draw(NamedTuple):
    """A pair of drives, and the seed of a draw of pixels.

    Attributes
    ----------
    name : str
        Of the pair, or `SIMULATED`.
    pair : CountedPair
    seed : int
    is_new : bool
        Whether the pair comes for the first time: what draws nothing need not be matched again.
    """

    name: str
    pair: CountedPair
    seed: int
    is_new: bool


def draws(data: Path | None, seeds: int, on_start: Callable[[str], None]) -> Iterator[Draw]:
    """Yield a simulated pair for each seed, and each recorded pair with all of them.

    Parameters
    ----------
    data : path, optional
        Folder of the recordings; without it, there is none.
    seeds : int
    on_start : callable
        Told what begins.
    """
    for seed in range(seeds):
        on_start(f"street {seed + 1} of {seeds}")
        yield Draw(SIMULATED, simulated_pair(seed), seed, is_new=True)
    for pair in recorded_pairs(data) if data is not None else ():
        for seed in range(seeds):
            on_start(f"{pair.name}, draw {seed + 1} of {seeds}")
            yield Draw(pair.name, pair, seed, is_new=seed == 0)


def compare_all(pair: CountedPair, seed: int, names: Sequence[str]) -> dict[str, Result]:
    """Match a pair with every baseline of these names that can be used on its sensor."""
    truth = pair.truth_of(pair.reference.centre_us, pair.query.centre_us)
    found = {}
    for name in names:
        try:
            compared = compare(
                open_baseline(name, seed), pair.reference.images, pair.query.images,
                pair.query.centre_us, pair.settings,
            )  # fmt: skip
        except UsageError:  # the released code's 100 pixels do not fit every sensor
            continue
        found[name] = compared, evaluate(compared.matches, truth)
    return found


def run(
    data: Path | None,
    seeds: int,
    on_start: Callable[[str], None],
    figure_path: Path | None = None,
) -> str:
    """Compare on simulated pairs, and on the recorded ones where a folder is given.

    Parameters
    ----------
    data : path, optional
        Folder that holds ``speck_indoor``, ``speck_walks`` and ``brisbane_sparse49``.
    seeds : int
        Simulated pairs, and draws of pixels.
    on_start : callable
        Told what begins.
    figure_path : path, optional
        Where to write the figure.
    """
    names = baseline_names()
    found: dict[str, dict[str, list[Result]]] = {}
    for each in draws(data, seeds, on_start):
        drawn = [n for n in names if each.is_new or n in ("paper", "seed-code")]
        results = found.setdefault(each.name, {})
        for name, result in compare_all(each.pair, each.seed, drawn).items():
            results.setdefault(name, []).append(result)
    if figure_path is not None:
        save(draw(found), figure_path)
    return "\n\n".join(f"{pair}:\n\n{_table(results)}" for pair, results in found.items())


def _table(results: dict[str, list[Result]]) -> str:
    rows = []
    for name in baseline_names():
        if name not in results:
            rows.append([open_baseline(name).title, "does not fit", *["-"] * 5])
            continue
        trials = results[name]
        first = trials[0][0]
        rows.append(
            [
                open_baseline(name).title,
                str(Summary([e.precision_at_100_recall for _, e in trials])),
                str(Summary([e.recall_at_99_precision for _, e in trials])),
                f"{max(c.bytes_per_place for c, _ in trials):,}",
                f"{first.operations:,}",
                f"{np.median([c.describe_us for c, _ in trials]):,.0f} us",
                f"{np.median([c.match_us for c, _ in trials]):,.0f} us",
            ]
        )
    header = ("system", "P@100R", "R@99P", "bytes a place", "operations a match", "describing",
              "matching a query")  # fmt: skip
    return markdown_table(header, rows)


def draw(found: dict[str, dict[str, list[Result]]]) -> Figure:
    """Draw right matches against bytes a place, a panel for each pair of drives."""
    names = baseline_names()
    with figure(4.2 * len(found) + 1.5, 4.8) as (drawing, only):
        only.remove()
        panels = drawing.subplots(1, len(found), squeeze=False)
        for axes, (pair, results) in zip(panels.flat, found.items(), strict=True):
            for name, trials in results.items():
                i = names.index(name)
                values = [e.precision_at_100_recall for _, e in trials]
                axes.errorbar(
                    trials[0][0].bytes_per_place,
                    float(np.mean(values)),
                    float(np.std(values, ddof=1)) if len(values) > 1 else 0,
                    color=CYCLE[i % len(CYCLE)],
                    marker="osD^vP"[i % 6],
                    ms=7,
                    linestyle="none",
                    label=open_baseline(name).title,
                )
            axes.set_xscale("log")
            axes.set(title=pair, xlabel="bytes a place", ylim=(0, 1.03))
        panels[0, 0].set_ylabel("P@100R")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=2)
    return drawing
