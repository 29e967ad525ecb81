"""One route driven twice, the second time at another and varying speed.

No parameter of the default was chosen on these streets.
"""

from __future__ import annotations

from lab.codes import TableCode
from lab.drives import FIRST_SEED, simulated_pair
from lab.loop import Drives
from lab.pairs import SIMULATED
from lab.variants import DEFAULT_MATCHING, Variant, variants_experiment

DEFAULT = "150 varying pixels, place filter (default)"
VARIANTS = (
    Variant(DEFAULT, DEFAULT_MATCHING),
    Variant("25 varying pixels, place filter", {**DEFAULT_MATCHING, "pixels": 25}),
    Variant("150 varying pixels, fixed N", {"window": "count"}),
    Variant("150 varying pixels, fixed N, 3-bit log", {"window": "count"}, code=TableCode("log")),
    Variant("150 varying pixels, fixed tau"),
    Variant("150 random pixels, fixed N", {"window": "count", "strategy": "random"}),
    Variant("25 varying pixels, fixed N", {"window": "count", "pixels": 25}),
    Variant("25 random pixels, fixed N", {"window": "count", "pixels": 25, "strategy": "random"}),
    Variant("all pixels, fixed N", {"window": "count"}, all_pixels=True),
    Variant("all pixels, fixed tau", all_pixels=True),
)
EXPERIMENT = variants_experiment(
    lambda data: [Drives(SIMULATED, lambda seed: simulated_pair(FIRST_SEED + seed), varied=True)],
    VARIANTS,
    DEFAULT,
    reads_data=False,
)
