"""Brisbane-Event-VPR at 49 published locations: a car, two drives of one route at sunset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.descriptors.windows import PublishedWindows
from edge_vpr.evaluation.metrics import RECALL_AT, Evaluation
from edge_vpr.evaluation.tracks import load_nmea
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.report.figures import precision_recall
from edge_vpr_tools.report.style import save
from edge_vpr_tools.research.experiments.trial import markdown_table

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


def run(data: Path, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Return the figures of each sequence length as a Markdown table."""
    on_start("matching sunset 1 against sunset 2")
    by_length = evaluate_lengths(data)
    if figures:
        save(draw(by_length), *figures)
    rows = [
        [
            str(length),
            f"{found.precision_at_100_recall:.3f}",
            f"{found.recall_at_99_precision:.3f}",
            *(f"{found.recall_at[n]:.3f}" for n in RECALL_AT),
        ]
        for length, found in by_length.items()
    ]
    header = ("L", "P@100R", "R@99P", *(f"Recall@{n}" for n in RECALL_AT))
    return markdown_table(header, rows) + "\n\n" + _faults(data)


def draw(found: Mapping[int, Evaluation]) -> Figure:
    """Draw precision against recall for each length of a sequence."""
    return precision_recall({f"sequences of {length}": each for length, each in found.items()})


def _faults(data: Path) -> str:
    """Describe the faults of the data, with their number if they can be counted."""
    counts = [np.load(data / FOLDER / f"{name}.npz")["counts"] for name in ("sunset2", "sunset1")]
    neighbours = [_jumps(traverse) for traverse in counts]
    return (
        "Faults of this data: each value sums a 3 x 3 patch in 8 bits and has wrapped past 255 in "
        f"busy seconds ({neighbours[0]} and {neighbours[1]} values of the reference and the query "
        "fall or rise by more than 200 from one second to the next, as a wrap does); the route's "
        "start and end lie beside each other, so that the first queries may rightly match the last "
        "places."
    )


def _jumps(counts: npt.NDArray[np.uint8]) -> int:
    return int(np.count_nonzero(np.abs(np.diff(counts.astype(np.int64), axis=0)) > 200))
