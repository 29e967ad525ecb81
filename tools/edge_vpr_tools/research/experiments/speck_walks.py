"""Two walks with a Speck through one building: real events, cut into short count frames."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path

from edge_vpr.evaluation.ground_truth import GroundTruth, from_alignment, load_alignment
from edge_vpr.recordings import open_recording
from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.experiments.experiment import (
    CHOSEN_ON,
    Draw,
    Drives,
    Experiment,
    Row,
    recorded_folder,
)
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.trial import (
    DEFAULT_MATCHING,
    Kept,
    Times,
    TruthOf,
    Variant,
    rows_of_variants,
)

FOLDER = "speck_walks"
#: not published with the data; windows have 30 frames whatever the period is
FRAME_PERIOD = Fraction(1, 30)
TOLERANCE_FRAMES = 60.0
SETTINGS = PRESETS["paper"].replaced({"sequence_length": 10}, "speck walks")
DEFAULT = "150 pixels, place filter (default)"
VARIANTS = (
    Variant(DEFAULT, DEFAULT_MATCHING),
    Variant("25 pixels, place filter", {**DEFAULT_MATCHING, "pixels": 25}),
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


def open_pair(folder: Path, seed: int) -> tuple[Kept, Kept, TruthOf]:
    """Read the walks and their truth."""
    return *_kept_walks(folder), truth_of_walks(folder)


@lru_cache(maxsize=1)
def _kept_walks(folder: Path) -> tuple[Kept, Kept]:
    return open_walks(folder)


def measure(draw: Draw) -> Iterator[Row]:
    """Run every variant with one draw of pixels; those that draw nothing once."""
    variants = [
        variant
        for variant in VARIANTS
        if draw.is_new or not (variant.all_pixels or variant.changes.get("strategy") == "top")
    ]
    settings = SETTINGS.replaced({"seed": draw.seed}, "seed")
    reference, query, truth_of = draw.pair
    yield from rows_of_variants(reference, query, truth_of, settings, variants, DEFAULT)


def walks(data: Path | None) -> list[Drives]:
    """Return the walks in a folder."""
    folder = recorded_folder(data, FOLDER)
    return [Drives("Speck walks", partial(open_pair, folder), [folder])]


EXPERIMENT = Experiment(
    drives=walks,
    names=("variant", CHOSEN_ON),
    measure=measure,
    figure=partial(dots, measures=("P@100R", "R@99P", "Recall@5"), row="variant"),
)
