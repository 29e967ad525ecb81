"""The embedded default: one route driven twice, the second time at another and varying speed.

No parameter of the default was chosen on these streets.
"""

from __future__ import annotations

from edge_vpr_tools.research.experiments.drives import FIRST_SEED, simulated_pair
from edge_vpr_tools.research.experiments.experiment import Drives
from edge_vpr_tools.research.experiments.pairs import SIMULATED
from edge_vpr_tools.research.experiments.variants import (
    DEFAULT_MATCHING,
    Variant,
    variants_experiment,
)

DEFAULT = "150 varying pixels, place filter (default)"
DEFAULT_25 = "25 varying pixels, place filter"
BEST, BY_TIME = "150 varying pixels, fixed N", "150 varying pixels, fixed tau"
CODED = "150 varying pixels, fixed N, 3-bit log"
FIXED_N_25, RANDOM_25 = "25 varying pixels, fixed N", "25 random pixels, fixed N"
DENSE = "all pixels, fixed N"
VARIANTS = (
    Variant(DEFAULT, DEFAULT_MATCHING),
    Variant(DEFAULT_25, {**DEFAULT_MATCHING, "pixels": 25}),
    Variant(BEST, {"window": "count"}),
    Variant(CODED, {"window": "count", "counter_code": "log"}),
    Variant(BY_TIME),
    Variant("150 random pixels, fixed N", {"window": "count", "strategy": "random"}),
    Variant(FIXED_N_25, {"window": "count", "pixels": 25}),
    Variant(RANDOM_25, {"window": "count", "pixels": 25, "strategy": "random"}),
    Variant(DENSE, {"window": "count"}, all_pixels=True),
    Variant("all pixels, fixed tau", all_pixels=True),
)
EXPERIMENT = variants_experiment(
    lambda data: [Drives(SIMULATED, lambda seed: simulated_pair(FIRST_SEED + seed), varied=True)],
    VARIANTS,
    DEFAULT,
    reads_data=False,
)
