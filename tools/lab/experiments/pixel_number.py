"""Accuracy by the number of pixels, for each strategy of selection."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.settings import PRESETS
from lab.baselines import Baseline, open_baseline
from lab.baselines.selected_pixels import SelectedPixels
from lab.drives import counted_drives
from lab.loop import Draw, Experiment, Row
from lab.pairs import CountedPair
from lab.plots import lines

NUMBERS = (5, 10, 25, 50, 83, 150, 300)
#: strategies with the suppression of the default number of pixels, and one of the laboratory alone
INFORMATION = "information"
STRATEGIES = ("variance", "seed-code", INFORMATION, "random", "random-upper")
ALL = "all pixels"
#: ways to match the pixels: sequences of counts, as in the paper, or the default for a robot
PAPER, ROBOT = "sequences of counts (the paper)", "place filter, running mean (robot)"
_ROBOT = {"smooth": False}


def measure(draw: Draw) -> Iterator[Row]:
    """Match a pair with every choice and number of pixels, and with all of them."""
    pair: CountedPair = draw.pair

    def by_sequences(system: Baseline) -> float:
        matches = pair.match(pair.distances(system), pair.settings)
        return evaluate(matches, pair.truth()).precision_at_100_recall

    for name in STRATEGIES:
        for number in NUMBERS:
            changes: dict[str, object] = {"pixels": number, "seed": draw.seed}
            if name != INFORMATION:
                changes["strategy"] = name
            pixels = SelectedPixels(
                name, pair.settings.replaced(changes, name), by_information=name == INFORMATION
            )
            try:
                correct = by_sequences(pixels)
            except UsageError:  # these pixels do not fit the sensor
                continue
            row = {"pixels chosen by": name, "pixels": number}
            yield {"matching": PAPER, **row, "P@100R": correct}
            robot = PRESETS["default"].replaced(
                {"pixels": len(pixels.pixel_map), "window": pair.settings.window, **_ROBOT}, ROBOT
            )
            mapped = pair.mapped(pixels.pixel_map, robot)
            yield {"matching": ROBOT, **row, "P@100R": mapped.correct()}
    if draw.is_new:
        row = {"pixels chosen by": ALL, "pixels": pair.pixels}
        every = by_sequences(open_baseline("all-pixels"))
        yield {"matching": PAPER, **row, "P@100R": every}


EXPERIMENT = Experiment(
    drives=counted_drives,
    names=("matching", "pixels chosen by", "pixels"),
    measure=measure,
    figure=partial(
        lines, x="pixels", y="P@100R", line="pixels chosen by", panel=("drives", "matching")
    ),
)
