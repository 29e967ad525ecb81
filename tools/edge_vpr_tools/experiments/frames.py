"""Pixels of conventional frames: chosen by the variance of their intensity, compared by SAD.

Frames are taken at the centres of the windows of events, so that both show the same places.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.baselines import Baseline, open_baseline
from edge_vpr.baselines.selected_pixels import SelectedPixels
from edge_vpr.datasets.catalogue import BRISBANE_BAGS_PAGE
from edge_vpr.intensity.exposure import simulated_images
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import simulate_pair
from edge_vpr_tools.experiments.counted_pairs import (
    LENGTH_M,
    CountedDrive,
    CountedPair,
    count_simulated,
)
from edge_vpr_tools.experiments.frame_drives import FRAMES, FramedPair, framed_pairs
from edge_vpr_tools.experiments.simulated import SIMULATED
from edge_vpr_tools.experiments.systems import (
    Result,
    Results,
    compare_systems,
    draw_curves,
    systems_table,
)
from edge_vpr_tools.report.style import CYCLE, save

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
        Additional baselines; see `edge_vpr.baselines.open_baseline`.
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
        f"GPS logs, or with own drives in its folder {FRAMES} (docs/results.md says how)."
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
