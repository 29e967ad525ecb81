"""Brisbane-Event-VPR at 49 published locations: a car, two drives of one route at sunset.

Each value of this data sums a 3 x 3 patch in 8 bits and has wrapped past 255 in busy seconds. The
route's start and end lie beside each other, so that the first queries may rightly match the last
places.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from edge_vpr.descriptors.windows import PublishedWindows
from edge_vpr.evaluation.metrics import RECALL_AT, Evaluation
from edge_vpr.evaluation.tracks import load_nmea
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.experiments.experiment import (
    Draw,
    Drives,
    Experiment,
    Row,
    recorded_folder,
)
from edge_vpr_tools.research.experiments.plots import dots

FOLDER = "brisbane_sparse49"
TOLERANCE_M = 70.0
LENGTHS = (1, 5, 10, 20)
SETTINGS = PRESETS["paper"].replaced({"pixels": 49, "strategy": "top"}, "Brisbane")


def evaluate_lengths(data: Path) -> dict[int, Evaluation]:
    """Match sunset 1 against sunset 2 with sequences of each length."""
    folder = data / FOLDER
    reference = ReferenceMap.build(PublishedWindows(folder / "sunset2.npz"), SETTINGS)
    reference_track, query_track = (
        load_nmea(folder / f"{name}.nmea") for name in ("sunset2", "sunset1")
    )
    found = {}
    for length in LENGTHS:
        query = PublishedWindows(folder / "sunset1.npz")
        matched = reference.match(query, sequence_length=length)
        found[length] = matched.evaluate((reference_track, query_track), TOLERANCE_M)
    return found


def measure(draw: Draw) -> Iterator[Row]:
    """Match with sequences of each length."""
    for length, found in evaluate_lengths(draw.pair).items():
        yield {
            "windows of a sequence": length,
            "P@100R": found.precision_at_100_recall,
            "R@99P": found.recall_at_99_precision,
            **{f"Recall@{n}": found.recall_at[n] for n in RECALL_AT},
        }


def drives(data: Path | None) -> list[Drives]:
    """Return the drives in a folder, of which all published pixels are used."""
    folder = recorded_folder(data, FOLDER)
    return [Drives("Brisbane, 49 px", lambda seed: folder.parent, [folder], drawn=False)]


EXPERIMENT = Experiment(
    drives=drives,
    names=("windows of a sequence",),
    measure=measure,
    figure=partial(dots, measures=("P@100R", "R@99P"), row="windows of a sequence"),
)
