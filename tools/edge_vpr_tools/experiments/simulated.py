"""The embedded default: one route driven twice, the second time at another and varying speed."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

from edge_vpr.ground_truth import GroundTruth, from_tracks
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments.trial import (
    Summary,
    Times,
    Trial,
    Variant,
    markdown_table,
    run_trial,
)

#: a match is right within this distance along the route, in metres
TOLERANCE_M = 10.0
SETTINGS = PRESETS["paper"]
VARIANTS = (
    Variant("150 varying pixels, fixed N", {"window": "count"}),
    Variant("150 varying pixels, fixed tau"),
    Variant("150 random pixels, fixed N", {"window": "count", "strategy": "random"}),
    Variant("25 varying pixels, fixed N", {"window": "count", "pixels": 25}),
    Variant("25 random pixels, fixed N", {"window": "count", "pixels": 25, "strategy": "random"}),
    Variant("all pixels, fixed N", {"window": "count"}, all_pixels=True),
    Variant("all pixels, fixed tau", all_pixels=True),
)


def truth_of_pair(
    reference: SimulatedRecording, query: SimulatedRecording
) -> Callable[[Times, Times], GroundTruth]:
    """Give the ground truth of a simulated pair, by the positions along the route."""
    return functools.partial(_truth, reference, query)


def _truth(
    reference: SimulatedRecording, query: SimulatedRecording, places: Times, queries: Times
) -> GroundTruth:
    return from_tracks(reference.track, query.track, places, queries, TOLERANCE_M)


def run_pair(seed: int, sensor: str = "default") -> dict[str, Trial]:
    """Simulate one pair and try every variant on it.

    Parameters
    ----------
    seed : int
        Of the world, the drives, and the draw of pixels.
    sensor : str
        A camera of the simulator.
    """
    reference, query = (drive.keep() for drive in simulate_pair(seed, sensor))
    settings = SETTINGS.replaced({"seed": seed}, "seed")
    truth_of = truth_of_pair(reference, query)
    return {
        variant.name: run_trial(reference, query, truth_of, settings, variant)
        for variant in VARIANTS
    }


def summary(pairs: Sequence[dict[str, Trial]]) -> str:
    """Set the figures of several pairs as a Markdown table, with their spread."""
    rows = []
    for variant in VARIANTS:
        trials = [pair[variant.name] for pair in pairs]
        rows.append(
            [
                variant.name,
                str(Summary([t.evaluation.precision_at_100_recall for t in trials])),
                str(Summary([t.evaluation.recall_at_99_precision for t in trials])),
                f"{max(t.reference.bytes_per_place for t in trials):,}",
            ]
        )
    return markdown_table(("variant", "P@100R", "R@99P", "bytes per place"), rows)
