"""Two walks with a Speck through one building: real events, cut into short count frames."""

from __future__ import annotations

from lab.drives import walks
from lab.variants import DEFAULT_MATCHING, Variant, variants_experiment

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
EXPERIMENT = variants_experiment(lambda data: [walks(data)], VARIANTS, DEFAULT)
