"""Accuracy by the size of a design: correct live matches by pixels, bits and places per window.

`edge-vpr estimate --fit` recommends a design by this table.
"""

from __future__ import annotations

from collections.abc import Iterator

from edge_vpr.settings import PRESETS
from lab.drives import simulated_pair
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import SIMULATED, Pair
from lab.tables import TableView

PIXELS = (10, 25, 50, 75, 100, 150, 250, 400)
BITS = (1, 2, 3, 4)
#: of the first street: it and those that follow chose no parameter
FIRST_SEED = 10


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair live with designs of every size."""
    pair: Pair = draw.pair
    live = {"smooth": False, "seed": draw.seed}
    for pixels in PIXELS:
        for number in (1, 2):
            changes = {"pixels": pixels, "places_per_window": number}
            mapped = pair.mapped(PRESETS["default"].replaced(live | changes, "a design").uncoded)
            for bits in BITS:
                yield {
                    "pixels": pixels,
                    "bits": bits,
                    "places per window": number,
                    "P@100R": mapped.coded(
                        {"counter_code": "contrast", "counter_bits": bits}
                    ).correct(),
                    "windows": int(mapped.truth.has_truth.sum()),
                    "places": len(mapped.reference),
                }


EXPERIMENT = Experiment(
    drives=lambda data: [
        Drives(SIMULATED, lambda seed: simulated_pair(FIRST_SEED + seed), varied=True)
    ],
    names=("pixels", "bits", "places per window"),
    measure=measure,
    view=TableView({}, ("pixels", "bits", "places per window", "P@100R")),
    reads_data=False,
)
