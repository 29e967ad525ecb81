"""What the place filter, its code and its measure of trust bring, each on its own.

Parameters were chosen on the real drives and on simulated streets of the seeds 0 to 4. The streets
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
from edge_vpr.evaluation.metrics import Evaluation, evaluate
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import coded_map, count_windows, match_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import PRESETS, Score, Settings
from edge_vpr.simulation import QUERY, Drive, Light, SimulatedRecording, simulate_pair
from edge_vpr.simulation.drive import wheel_odometry
from edge_vpr_tools.report.style import CYCLE, legend_below, panels, save
from edge_vpr_tools.report.tables import markdown_table
from edge_vpr_tools.research.experiments.drives import check_data, pairs
from edge_vpr_tools.research.experiments.simulated import truth_of_pair
from edge_vpr_tools.research.experiments.trial import Summary

# Settings that the place filter is compared by, and drives of simulated streets.


_FILTER = {"matching": "filter", "anchor": "end", "score": None}
_SMOOTH = {"smooth": True}
_LOG = {"counter_code": "log", "score": None}
_OWN = {**_LOG, "counter_scaling": "own-mean"}
_CONTRAST = {**_LOG, "counter_scaling": "contrast"}
_ROBOT = {**_FILTER, **_CONTRAST, "query_mean": "running"}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "sequences of 5, counts (the paper)": {"sequence_length": 5},
    "sequences of 5, 3-bit log": {**_LOG, "sequence_length": 5},
    "sequences of 10, 3-bit log": {**_LOG, "sequence_length": 10},
    "sequences of 10, own mean": {**_OWN, "sequence_length": 10},
    "place filter, counts": _FILTER,
    "place filter, 3-bit log": {**_FILTER, **_LOG},
    "place filter, own mean": {**_FILTER, **_OWN},
    "place filter, contrast": {**_FILTER, **_CONTRAST},
    "place filter, contrast, steps 1,0,1": {**_FILTER, **_CONTRAST, "filter_steps": (1, 0, 1)},
    "place filter, running mean (robot)": _ROBOT,
    "place filter, running mean (robot), 4 windows late": {**_ROBOT, "delay": 4},
    "place filter, contrast, smoothed (default)": {**_FILTER, **_CONTRAST, **_SMOOTH},
}
BEST = "place filter, contrast, smoothed (default)"
ROBOT = "place filter, running mean (robot)"
SCORES: tuple[Score, ...] = ("distance", "ratio", "margin", "trust")
#: values of the sensitivity plot, around the default
SWEEPS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "cost of a restart": {str(p): {"filter_restart": p} for p in (8, 12, 16, 24, 40, 64)},
    "cost of standing and of double pace": {
        "by activity": {},
        **{str(p): {"filter_steps": (p, 0, p)} for p in (0, 1, 2, 3, 4)},
    },
    "bits of a code": {str(bits): {"counter_bits": bits} for bits in (2, 3, 4, 5)},
}


class Second(NamedTuple):
    """A second drive along the street.

    Attributes
    ----------
    contrast : float
        Thresholds of the camera, as a multiple of those in the reference drive.
    """

    drive: Drive
    contrast: float = 1.0


#: as in the demo, in two other lights, with stops, and with a camera that fires sooner or later
STREETS: Mapping[str, Second] = {
    "street": Second(QUERY),
    "street, low sun": Second(
        replace(
            QUERY,
            light=Light(sun=0.2, ambient=0.15, azimuth_deg=110.0, elevation_deg=15.0, glare=0.06),
        )
    ),
    "street, noon": Second(
        replace(
            QUERY,
            light=Light(sun=0.9, ambient=0.2, azimuth_deg=-160.0, elevation_deg=70.0, glare=0.0),
        )
    ),
    "street, 3 stops": Second(replace(QUERY, stops=3, stop_s=10.0)),
    "street, thresholds x 1.3": Second(QUERY, 1.3),
    "street, thresholds x 0.75": Second(QUERY, 0.75),
}


__all__ = ["check_data", "run"]

FIRST_SEED = 10
_WHEELS = 9  # random stream of the odometers


class Counted(NamedTuple):
    """One draw of pixels on one pair of drives, before any code is applied.

    Attributes
    ----------
    reference : ReferenceMap
        Map with counts.
    queries : Descriptors
        Counts of the query.
    odometry : Odometry or None
        Odometry of the query.
    """

    settings: Settings
    reference: ReferenceMap
    queries: Descriptors
    truth: GroundTruth
    odometry: Odometry | None = None

    def matched(self, changes: Mapping[str, Any], odometry: Odometry | None = None) -> Matches:
        """Match with these changes of the pair's settings."""
        coded = coded_map(self.reference, self.settings.replaced(changes, "variant"))
        return match_query(coded, coded.coded(self.queries), odometry)

    def evaluated(
        self,
        changes: Mapping[str, Any],
        score: Score | None = None,
        odometry: Odometry | None = None,
    ) -> Evaluation:
        """Match with these changes of the pair's settings, and evaluate."""
        return evaluate(self.matched(changes, odometry), self.truth, score=score)

    def right_from(self, changes: Mapping[str, Any], window: int) -> float:
        """Return the share of right matches from this window on, without the last few.

        These are the windows with a match by sequences of twice the length plus 1.
        """
        found = self.evaluated(changes)
        counted = found.evaluated.copy()
        counted[:window] = False
        counted[len(counted) - window + 1 :] = False
        return float(found.correct[counted].mean())


def counted_pairs(
    data: Path, seeds: int, on_start: Callable[[str], None]
) -> dict[str, list[Counted]]:
    """Count every pair of drives, `seeds` times each.

    Parameters
    ----------
    data : path
        Folder of the real recordings.
    seeds : int
        Number of draws of pixels of a real pair, and of streets of the simulator.
    on_start : callable
        Called with a description before each part begins.
    """
    found: dict[str, list[Counted]] = {}
    for pair in pairs(data):
        on_start(pair.name)
        found[pair.name] = []
        for seed in range(seeds if pair.drawn else 1):
            settings = pair.settings.replaced({"seed": seed}, "seed")
            reference = ReferenceMap.build(pair.reference, settings)
            queries = count_windows(pair.query, reference.pixel_map, settings)
            truth = pair.truth_of(reference.places.centre_us, queries.centre_us)
            found[pair.name].append(Counted(settings, reference, queries, truth))
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        for name, counted in _street(seed, on_start):
            found.setdefault(name, []).append(counted)
    return found


def _street(seed: int, on_start: Callable[[str], None]) -> Iterator[tuple[str, Counted]]:
    """Simulate one street with every drive."""
    on_start(f"street {seed}: the reference")
    reference, query = simulate_pair(seed)
    reference.keep()
    rng = np.random.default_rng((seed, _WHEELS))
    meter = wheel_odometry(reference.track, rng)
    for name, (drive, contrast) in STREETS.items():
        on_start(f"{name} {seed}")
        camera = replace(
            query.camera,
            contrast_on=contrast * query.camera.contrast_on,
            contrast_off=contrast * query.camera.contrast_off,
        )
        other = SimulatedRecording(
            query.world, camera, drive, seed=query.seed, device=query.device
        ).keep()
        wheel = wheel_odometry(other.track, rng)
        for pixels in (25, 150):
            settings = PRESETS["paper"].replaced({"pixels": pixels, "seed": seed}, "street")
            mapped = ReferenceMap.build(reference, settings)
            queries = count_windows(other, mapped.pixel_map, settings)
            truth = truth_of_pair(reference, other)(mapped.places.centre_us, queries.centre_us)
            mapped = replace(mapped, odometer_mm=meter.along(mapped.places.centre_us))
            yield f"{name}, {pixels} px", Counted(settings, mapped, queries, truth, wheel)


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Compare every variant on every pair of drives, and return Markdown tables."""
    drives = counted_pairs(data, seeds, on_start)
    if figures:
        on_start("varying each parameter")
        save(draw(drives), *figures)
    on_start("matching")
    return "\n\n".join(
        [
            "P@100R / R@99P of every variant, each by its own score:",
            ablation(drives),
            "P@100R over the windows that sequences of 10 answer for:",
            started(drives),
            "P@100R / R@99P with wheel odometry:",
            with_odometry(drives),
            *(
                text
                for name in (BEST, ROBOT, "sequences of 10, own mean")
                for text in (f"R@99P of {name} by what is thresholded:", by_score(drives, name))
            ),
        ]
    )


def ablation(drives: Mapping[str, Sequence[Counted]]) -> str:
    """Return P@100R and R@99P of each variant on each pair as a Markdown table."""
    rows = []
    for name, trials in drives.items():
        row = [name]
        for changes in VARIANTS.values():
            row.append(_right_and_recall([trial.evaluated(changes) for trial in trials]))
        rows.append(row)
    return markdown_table(("drives", *VARIANTS), rows)


def _right_and_recall(found: Sequence[Evaluation]) -> str:
    right = Summary([each.precision_at_100_recall for each in found])
    return f"{right} / {np.mean([each.recall_at_99_precision for each in found]):.2f}"


def started(drives: Mapping[str, Sequence[Counted]]) -> str:
    """Return P@100R without the first and last windows as a Markdown table."""
    names = ("sequences of 10, own mean", "place filter, contrast", BEST)
    rows = [
        [
            pair,
            *(
                str(Summary([trial.right_from(VARIANTS[name], 5) for trial in trials]))
                for name in names
            ),
        ]
        for pair, trials in drives.items()
    ]
    return markdown_table(("drives", *names), rows)


def with_odometry(drives: Mapping[str, Sequence[Counted]]) -> str:
    """Return the filter's figures without and with odometry as a Markdown table."""
    header = ["drives"]
    rows = [[name] for name, trials in drives.items() if trials[0].odometry is not None]
    for variant in (ROBOT, BEST):
        for used in (False, True):
            header.append(variant + (", odometry" if used else ""))
            for row in rows:
                found = [
                    trial.evaluated(VARIANTS[variant], None, trial.odometry if used else None)
                    for trial in drives[row[0]]
                ]
                row.append(_right_and_recall(found))
    return markdown_table(header, rows)


def by_score(drives: Mapping[str, Sequence[Counted]], variant: str) -> str:
    """Return R@99P of a variant by each score as a Markdown table."""
    rows = []
    for name, trials in drives.items():
        row = [name]
        for score in SCORES:
            found = [trial.evaluated(VARIANTS[variant], score) for trial in trials]
            row.append(str(Summary([f.recall_at_99_precision for f in found])))
        rows.append(row)
    return markdown_table(("drives", *SCORES), rows)


def draw(drives: Mapping[str, Sequence[Counted]]) -> Figure:
    """Draw P@100R of every pair against each parameter, with the others at their default."""
    with panels(1, len(SWEEPS), 11.0, 4.6, sharey=True) as (drawing, (row,)):
        for axes, (title, values) in zip(row, SWEEPS.items(), strict=True):
            for i, (name, trials) in enumerate(drives.items()):
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
        row[0].set_ylabel("P@100R")
        legend_below(drawing, row, 4, fontsize=7)
        drawing.suptitle("The place filter's parameters, each varied alone")
    return drawing
