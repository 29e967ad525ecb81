"""The embedded default: one route driven twice, the second time at another and varying speed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.settings import PRESETS
from edge_vpr.simulate import SimulatedRecording, simulate_pair
from edge_vpr_tools.experiments.latency import Latency, measure_latency
from edge_vpr_tools.experiments.trial import (
    DEFAULT_MATCHING,
    Trial,
    TruthOf,
    Variant,
    run_trial,
    truth_of_tracks,
)
from edge_vpr_tools.experiments.variants import draw_variants, variants_table
from edge_vpr_tools.report.style import save

#: name of the pairs in tables of several experiments
SIMULATED = "simulated streets"
#: largest distance of a right match along the route, in metres
TOLERANCE_M = 10.0
SETTINGS = PRESETS["paper"]
DEFAULT = "150 varying pixels, place filter (default)"
DEFAULT_FEW = "25 varying pixels, place filter"
BEST, BY_TIME = "150 varying pixels, fixed N", "150 varying pixels, fixed tau"
CODED = "150 varying pixels, fixed N, 3-bit log"
FEW, FEW_RANDOM = "25 varying pixels, fixed N", "25 random pixels, fixed N"
DENSE = "all pixels, fixed N"
VARIANTS = (
    Variant(DEFAULT, DEFAULT_MATCHING),
    Variant(DEFAULT_FEW, {**DEFAULT_MATCHING, "pixels": 25}),
    Variant(BEST, {"window": "count"}),
    Variant(CODED, {"window": "count", "counter_code": "log"}),
    Variant(BY_TIME),
    Variant("150 random pixels, fixed N", {"window": "count", "strategy": "random"}),
    Variant(FEW, {"window": "count", "pixels": 25}),
    Variant(FEW_RANDOM, {"window": "count", "pixels": 25, "strategy": "random"}),
    Variant(DENSE, {"window": "count"}, all_pixels=True),
    Variant("all pixels, fixed tau", all_pixels=True),
)


def truth_of_pair(reference: SimulatedRecording, query: SimulatedRecording) -> TruthOf:
    """Return the ground truth of a simulated pair, by the positions along the route."""
    return truth_of_tracks(reference.track, query.track, TOLERANCE_M)


def run_variants(
    reference: SimulatedRecording,
    query: SimulatedRecording,
    seed: int,
    on_start: Callable[[str], None] = lambda name: None,
) -> dict[str, Trial]:
    """Run every variant on one pair.

    Parameters
    ----------
    reference, query : SimulatedRecording
    seed : int
        Seed of the draw of pixels.
    on_start : callable, optional
        Called with the name of each variant before it begins.
    """
    settings = SETTINGS.replaced({"seed": seed}, "seed")
    truth_of = truth_of_pair(reference, query)
    trials = {}
    for variant in VARIANTS:
        on_start(variant.name)
        trials[variant.name] = run_trial(reference, query, truth_of, settings, variant)
    return trials


def run_pair(seed: int) -> dict[str, Trial]:
    """Simulate the pair of this seed, and run every variant on it."""
    reference, query = (drive.keep() for drive in simulate_pair(seed))
    return run_variants(reference, query, seed)


def compare_latencies(
    reference: SimulatedRecording, query: SimulatedRecording, trial: Trial
) -> dict[str, Latency]:
    """Time the recognition of places with a match after every event, and after every window."""
    policies = {
        "event by event": MatchSchedule(events=1),
        "window by window": MatchSchedule.window(trial.reference.settings),
    }
    return {
        name: measure_latency(
            trial.reference, query, reference.track, query.track, every, TOLERANCE_M
        )
        for name, every in policies.items()
    }


def run(data: object, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Simulate several pairs, and return the figures of every variant as a Markdown table."""
    pairs = []
    for seed in range(seeds):
        on_start(f"pair {seed + 1} of {seeds}")
        pairs.append(run_pair(seed))
    found = {variant.name: [pair[variant.name] for pair in pairs] for variant in VARIANTS}
    if figures:
        save(draw(found), *figures)
    return variants_table(found)


draw = draw_variants
