"""Two walks with a Speck through one building: real events, cut into short count frames."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

from edge_vpr.evaluation.ground_truth import GroundTruth, from_alignment, load_alignment
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.style import save
from edge_vpr_tools.research.experiments.simulated import draw_variants, variants_table
from edge_vpr_tools.research.experiments.trial import (
    Kept,
    Times,
    Trial,
    TruthOf,
    Variant,
    run_trial,
)

FOLDER = "speck_walks"
#: not published with the data; windows have 30 frames whatever the period is
FRAME_PERIOD = Fraction(1, 30)
TOLERANCE_FRAMES = 60.0
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 10}, "speck walks")
VARIANTS = (
    *(
        Variant(f"150 pixels, {strategy}, L = 10", {"strategy": strategy})
        for strategy in ("variance", "seed-code", "random", "random-upper", "top")
    ),
    Variant("all pixels, L = 10", all_pixels=True),
    *(
        Variant(
            f"25 pixels, {strategy}, L = {length}",
            {"pixels": 25, "strategy": strategy, "sequence_length": length},
        )
        for length in (10, 1)
        for strategy in ("variance", "random")
    ),
    Variant("all pixels, L = 1", {"sequence_length": 1}, all_pixels=True),
)


def open_walks(folder: Path) -> tuple[Kept, Kept]:
    """Read the events of the reference and the query."""
    reference, query = (
        Kept(open_recording(folder / f"{name}.npz", frame_period=FRAME_PERIOD))
        for name in ("reference", "query")
    )
    return reference, query


def truth_of_walks(folder: Path) -> TruthOf:
    """Return the published alignment of the two walks as ground truth."""
    alignment = load_alignment(folder / "ground_truth.csv")
    period_us = float(FRAME_PERIOD * 1_000_000)

    def truth_of(places_us: Times, queries_us: Times) -> GroundTruth:
        return from_alignment(
            alignment.pairs,
            alignment.coordinate(queries_us, period_us),
            alignment.coordinate(places_us, period_us),
            TOLERANCE_FRAMES,
            "frames",
        )

    return truth_of


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Run every variant with several draws of pixels, and return a Markdown table."""
    folder = data / FOLDER
    on_start("reading the walks")
    reference, query = open_walks(folder)
    truth_of = truth_of_walks(folder)
    found: dict[str, list[Trial]] = {}
    for variant in VARIANTS:
        on_start(variant.name)
        # without a draw, all trials would be the same
        drawn = not variant.all_pixels and variant.changes.get("strategy") != "top"
        found[variant.name] = [
            run_trial(
                reference, query, truth_of, SETTINGS.replaced({"seed": seed}, "seed"), variant
            )
            for seed in range(seeds if drawn else 1)
        ]
    if figures:
        save(draw(found), *figures)
    return variants_table(found)


draw = draw_variants
