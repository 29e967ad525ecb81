"""Brisbane-Event-VPR at 49 published locations: a car, two drives of one route at sunset.

Each value of this data sums a 3 x 3 patch in 8 bits and has wrapped past 255 in busy seconds. The
route's start and end lie beside each other, so that the first queries may rightly match the last
places.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.descriptors.windows import PublishedWindows
from edge_vpr.evaluation.ground_truth import from_tracks
from edge_vpr.evaluation.metrics import RECALL_AT, Evaluation, evaluate
from edge_vpr.evaluation.tracks import Track, load_nmea
from edge_vpr.pipeline import count_windows, match_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.experiments.experiment import (
    CHOSEN_ON,
    Draw,
    Drives,
    Experiment,
    Row,
    recorded_folder,
)
from edge_vpr_tools.research.experiments.nulls import BY_AUTHORS, BY_US, null_rows
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.trial import inner_windows

FOLDER = "brisbane_sparse49"
TOLERANCE_M = 70.0
LENGTHS = (1, 5, 10, 20)
LIVE, RECORDED = "place filter, live (default)", "place filter, recorded (default)"
SETTINGS = PRESETS["paper"].replaced({"pixels": 49, "strategy": "top"}, "Brisbane")


class Counts(NamedTuple):
    """Counts of the reference, sunset 2, and the query, sunset 1, with their tracks."""

    reference: PublishedWindows
    query: PublishedWindows
    tracks: tuple[Track, Track]


def open_counts(data: Path) -> Counts:
    """Open the counts of a folder."""
    folder, names = data / FOLDER, ("sunset2", "sunset1")
    reference, query = (PublishedWindows(folder / f"{name}.npz") for name in names)
    first, second = (load_nmea(folder / f"{name}.nmea") for name in names)
    return Counts(reference, query, (first, second))


def evaluate_lengths(counts: Counts, longest: int = 1) -> dict[int, Evaluation]:
    """Match sunset 1 against sunset 2 with sequences of each length.

    Parameters
    ----------
    longest : int
        Only the windows that sequences of so many windows match are judged.
    """
    reference = ReferenceMap.build(counts.reference, SETTINGS)
    found = {}
    for length in LENGTHS:
        matched = reference.match(counts.query, sequence_length=length)
        centres = reference.places.centre_us, matched.query_time_us
        truth = from_tracks(*counts.tracks, *centres, TOLERANCE_M)
        found[length] = evaluate(matched.matches, inner_windows(truth, longest))
    return found


def measure(draw: Draw) -> Iterator[Row]:
    """Match with sequences of each length, with the default, and what the filter assumes."""
    counts: Counts = draw.pair
    longest = max(LENGTHS)
    for length, found in evaluate_lengths(counts, longest).items():
        name = f"sequences of {length}"
        yield {"matching": name, CHOSEN_ON: BY_AUTHORS, **figures_of(found)}
    given = {"pixels": SETTINGS.pixels, "strategy": "top"}
    default = PRESETS["default"].replaced(given, "Brisbane")
    recorded = ReferenceMap.build(counts.reference, default)
    counted = count_windows(counts.query, recorded.pixel_map, recorded.settings)
    centres = recorded.places.centre_us, counted.centre_us
    truth = inner_windows(from_tracks(*counts.tracks, *centres, TOLERANCE_M), longest)
    for name, reference in ((LIVE, recorded.causal()), (RECORDED, recorded)):
        found = evaluate(match_query(reference, reference.coded(counted)), truth)
        yield {"matching": name, CHOSEN_ON: BY_US, **figures_of(found)}
    rng = np.random.default_rng(draw.seed)
    yield from null_rows(recorded.causal(), counted, truth, rng, "matching")


def figures_of(found: Evaluation) -> dict[str, float]:
    """Return the measured columns."""
    return {
        "P@100R": found.precision_at_100_recall,
        "R@99P": found.recall_at_99_precision,
        **{f"Recall@{n}": found.recall_at[n] for n in RECALL_AT},
    }


def drives(data: Path | None) -> list[Drives]:
    """Return the drives in a folder, of which all published pixels are used."""
    folder = recorded_folder(data, FOLDER)
    return [
        Drives("Brisbane, 49 px", lambda seed: open_counts(folder.parent), [folder], drawn=False)
    ]


EXPERIMENT = Experiment(
    drives=drives,
    names=("matching", CHOSEN_ON),
    measure=measure,
    figure=partial(dots, measures=("P@100R", "R@99P"), row="matching"),
)
