"""How many pixels are enough: right matches against their number, for each way to choose them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.baselines import open_baseline
from edge_vpr_tools.research.baselines.selected_pixels import SelectedPixels
from edge_vpr_tools.research.experiments.drives import counted_drives
from edge_vpr_tools.research.experiments.experiment import Draw, Experiment, Row
from edge_vpr_tools.research.experiments.pairs import CountedPair
from edge_vpr_tools.research.experiments.plots import lines
from edge_vpr_tools.research.experiments.rivals import compare_systems

NUMBERS = (5, 10, 25, 50, 83, 150, 300)
#: strategies with the suppression of the default number of pixels; numbers of pixels that do not
#: fit are left out of the table
STRATEGIES: Mapping[str, Mapping[str, Any]] = {
    "variance": {"strategy": "variance"},
    "mean (released code)": {"strategy": "seed-code"},
    "information": {"strategy": "information"},
    "random": {"strategy": "random"},
    "random, upper two thirds": {"strategy": "random-upper"},
}
ALL = "all pixels"


#: ways to match the pixels: sequences of counts, as in the paper, or the default for a robot
PAPER, ROBOT = "sequences of counts (the paper)", "place filter, running mean (robot)"
_ROBOT = {"smooth": False, "query_mean": "running"}


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every choice and number of pixels, and with all of them."""
    pair: CountedPair = draw.pair
    for name, changes in STRATEGIES.items():
        for number in NUMBERS:
            settings = pair.settings.replaced(
                {"pixels": number, "seed": draw.seed, **changes}, name
            )
            pixels = SelectedPixels(name, settings)
            found = list(compare_systems(replace(pair, settings=settings), [(name, pixels)]))
            if not found:  # on this sensor, the surrounds of fewer pixels cover all others
                continue
            row = {"pixels chosen by": name, "pixels": number}
            yield {"matching": PAPER, **row, "P@100R": found[0]["P@100R"]}
            robot = PRESETS["default"].replaced(
                {"pixels": len(pixels.pixel_map), "window": pair.settings.window, **_ROBOT}, ROBOT
            )
            mapped = pair.mapped(pixels.pixel_map, robot)
            yield {"matching": ROBOT, **row, "P@100R": mapped.correct()}
    if draw.is_new:
        for found_all in compare_systems(pair, [(ALL, open_baseline("all-pixels"))]):
            every = pair.reference.images[0].size
            row = {"matching": PAPER, "pixels chosen by": ALL, "pixels": every}
            yield {**row, "P@100R": found_all["P@100R"]}


EXPERIMENT = Experiment(
    drives=counted_drives,
    names=("matching", "pixels chosen by", "pixels"),
    measure=measure,
    figure=partial(
        lines,
        x="pixels",
        y="P@100R",
        line="pixels chosen by",
        panel=("drives", "matching"),
        log=True,
    ),
)
