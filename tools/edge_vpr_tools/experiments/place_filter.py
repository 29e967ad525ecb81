"""What the place filter, its code and its measure of trust bring, each on its own.

Parameters were chosen on the real drives and on simulated streets of the seeds 0 to 4; the streets
here have other seeds, and light that was not tried before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import Descriptors
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import Evaluation, Score, evaluate
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.pipeline import coded_map, count_windows, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulate import QUERY, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments import codes_frontier
from edge_vpr_tools.experiments.simulated import truth_of_pair
from edge_vpr_tools.experiments.trial import Summary, markdown_table
from edge_vpr_tools.report.style import CYCLE, figure, save

FOLDER = codes_frontier.FOLDER
FIRST_SEED = 10

_FILTER = {"matching": "filter", "anchor": "end"}
_LOG = {"counter_code": "log"}
_OWN = {**_LOG, "counter_scaling": "own-mean"}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "sequences of 5, counts (the paper)": {"sequence_length": 5},
    "sequences of 5, 3-bit log": {**_LOG, "sequence_length": 5},
    "sequences of 10, 3-bit log": {**_LOG, "sequence_length": 10},
    "sequences of 10, own mean": {**_OWN, "sequence_length": 10},
    "place filter, counts": _FILTER,
    "place filter, 3-bit log": {**_FILTER, **_LOG},
    "place filter, own mean (default)": {**_FILTER, **_OWN},
    "place filter, running mean (robot)": {**_FILTER, **_OWN, "query_mean": "running"},
}
BEST = "place filter, own mean (default)"
SCORES: tuple[Score, ...] = ("distance", "ratio", "margin", "trust")
#: what the sensitivity plot varies, around the default
SWEEPS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "price of a restart": {str(p): {"filter_restart": p} for p in (8, 12, 16, 24, 32, 64)},
    "price of standing and of double pace": {
        str(p): {"filter_steps": (p, 0, p)} for p in (0, 1, 2, 3, 4)
    },
    "bits of a code": {str(bits): {"counter_bits": bits} for bits in (2, 3, 4, 5)},
}

#: drives of the street: as in the demo, in two other lights, and with stops
STREETS: Mapping[str, Drive] = {
    "street": QUERY,
    "street, low sun": replace(
        QUERY, light=Light(sun=0.2, ambient=0.15, azimuth_deg=110.0, elevation_deg=15.0, glare=0.06)
    ),
    "street, noon": replace(
        QUERY, light=Light(sun=0.9, ambient=0.2, azimuth_deg=-160.0, elevation_deg=70.0, glare=0.0)
    ),
    "street, 3 stops": replace(QUERY, stops=3, stop_s=10.0),
}


class Counted(NamedTuple):
    """One draw of pixels on one pair of drives, before any code.

    Attributes
    ----------
    settings : Settings
    reference : ReferenceMap
        With counts.
    queries : Descriptors
        Counts.
    truth : GroundTruth
    """

    settings: Settings
    reference: ReferenceMap
    queries: Descriptors
    truth: GroundTruth

    def evaluated(self, changes: Mapping[str, Any], score: Score | None = None) -> Evaluation:
        """Match with these settings in place of the pair's, and evaluate."""
        settings = self.settings.replaced(changes, "variant")
        coded = coded_map(self.reference, settings)
        matches = match_descriptors(coded.places, coded.coded(self.queries), settings)
        return evaluate(matches, self.truth, score=score)


def counted_pairs(
    data: Path, seeds: int, on_start: Callable[[str], None]
) -> dict[str, list[Counted]]:
    """Count every pair of drives, `seeds` times each.

    Parameters
    ----------
    data : path
        Folder of the real recordings.
    seeds : int
        Draws of pixels of a real pair; streets of the simulator.
    on_start : callable
        Told what begins.

    Returns
    -------
    dict of str to list of Counted
    """
    found: dict[str, list[Counted]] = {}
    for pair in codes_frontier.pairs(data):
        on_start(pair.name)
        found[pair.name] = []
        for seed in range(seeds if pair.drawn else 1):
            settings = pair.settings.replaced({"seed": seed}, "seed")
            reference = map_traverse(pair.reference, settings)
            queries = count_windows(pair.query, reference.pixel_map, settings)
            truth = pair.truth_of(reference.places.centre_us, queries.centre_us)
            found[pair.name].append(Counted(settings, reference, queries, truth))
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        for name, counted in _street(seed, on_start):
            found.setdefault(name, []).append(counted)
    return found


def _street(seed: int, on_start: Callable[[str], None]) -> Iterator[tuple[str, Counted]]:
    """Drive one simulated street in every way."""
    on_start(f"street {seed}: the reference")
    reference, query = simulate_pair(seed)
    reference.keep()
    for name, drive in STREETS.items():
        on_start(f"{name} {seed}")
        other = SimulatedRecording(
            query.world, query.camera, drive, seed=query.seed, device=query.device
        ).keep()
        for pixels in (25, 150):
            settings = PRESETS["paper"].replaced({"pixels": pixels, "seed": seed}, "street")
            mapped = map_traverse(reference, settings)
            queries = count_windows(other, mapped.pixel_map, settings)
            truth = truth_of_pair(reference, other)(mapped.places.centre_us, queries.centre_us)
            yield f"{name}, {pixels} px", Counted(settings, mapped, queries, truth)


def run(
    data: Path, seeds: int, on_start: Callable[[str], None], figure_path: Path | None = None
) -> str:
    """Compare every variant on every pair of drives, as Markdown tables.

    Parameters
    ----------
    data : path
        Folder that holds ``speck_indoor``, ``speck_walks`` and ``brisbane_sparse49``.
    seeds : int
        Draws of pixels, and streets of the simulator.
    on_start : callable
        Told what begins.
    figure_path : path, optional
        Where to write the sensitivity plot, as PNG.
    """
    pairs = counted_pairs(data, seeds, on_start)
    if figure_path is not None:
        on_start("varying each parameter")
        save(draw(pairs), figure_path)
    on_start("matching")
    return "\n\n".join(
        [
            "P@100R / R@99P of every variant, each by its own score:",
            ablation(pairs),
            f"R@99P of {BEST} by what is thresholded:",
            by_score(pairs),
        ]
    )


def ablation(pairs: Mapping[str, Sequence[Counted]]) -> str:
    """Set P@100R and R@99P of each variant on each pair as a Markdown table."""
    rows = []
    for name, trials in pairs.items():
        row = [name]
        for changes in VARIANTS.values():
            found = [trial.evaluated(changes) for trial in trials]
            row.append(
                f"{Summary([f.precision_at_100_recall for f in found])} / "
                f"{np.mean([f.recall_at_99_precision for f in found]):.2f}"
            )
        rows.append(row)
    return markdown_table(("drives", *VARIANTS), rows)


def by_score(pairs: Mapping[str, Sequence[Counted]]) -> str:
    """Set R@99P of the default by each score as a Markdown table."""
    rows = []
    for name, trials in pairs.items():
        row = [name]
        for score in SCORES:
            found = [trial.evaluated(VARIANTS[BEST], score) for trial in trials]
            row.append(str(Summary([f.recall_at_99_precision for f in found])))
        rows.append(row)
    return markdown_table(("drives", *SCORES), rows)


def draw(pairs: Mapping[str, Sequence[Counted]]) -> Figure:
    """Draw P@100R of every pair against each parameter, the others at their default."""
    with figure(11.0, 4.6) as (drawing, only):
        only.remove()
        panels = drawing.subplots(1, len(SWEEPS), sharey=True)
        for axes, (title, values) in zip(panels, SWEEPS.items(), strict=True):
            for i, (name, trials) in enumerate(pairs.items()):
                right = [
                    np.mean(
                        [
                            trial.evaluated({**VARIANTS[BEST], **changes}).precision_at_100_recall
                            for trial in trials
                        ]
                    )
                    for changes in values.values()
                ]
                axes.plot(
                    list(values), right, marker="o", ms=3, lw=1.2, label=name,
                    color=CYCLE[i % len(CYCLE)], ls=("-", "--", ":")[i // len(CYCLE) % 3],
                )  # fmt: skip
            axes.set(xlabel=title)
        panels[0].set_ylabel("P@100R")
        handles, labels = panels[0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)
        drawing.suptitle("The place filter's parameters, each varied alone")
    return drawing
