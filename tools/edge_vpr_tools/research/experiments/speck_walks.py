"""Two walks with a Speck through one building: real events, cut into short count frames."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from edge_vpr_tools.research.experiments.drives import Pair, walks
from edge_vpr_tools.research.experiments.experiment import CHOSEN_ON, Draw, Experiment, Row
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.trial import DEFAULT_MATCHING, Variant, rows_of_variants

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


def measure(draw: Draw) -> Iterator[Row]:
    """Run every variant with one draw of pixels; those that draw nothing once."""
    pair: Pair = draw.pair
    variants = [
        variant
        for variant in VARIANTS
        if draw.is_new or not (variant.all_pixels or variant.changes.get("strategy") == "top")
    ]
    settings = pair.settings.replaced({"seed": draw.seed}, "seed")
    yield from rows_of_variants(*pair.events, pair.truth_of, settings, variants, DEFAULT)


EXPERIMENT = Experiment(
    drives=lambda data: [walks(data)],
    names=("variant", CHOSEN_ON),
    measure=measure,
    figure=partial(dots, measures=("P@100R", "R@99P", "Recall@5"), row="variant"),
)
