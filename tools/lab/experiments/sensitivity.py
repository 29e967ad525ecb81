"""Sensitivity to each constant of the place filter, and accuracy on drives that did not choose it.

Each constant is varied alone, as a multiple of the default, with places at whole windows. Beside
each setting stands its accuracy on a query with shuffled pixels, which comes from
assumptions alone. The last rows leave one pair out: of all settings of the table, the one that is
best on the other pairs of drives, the streets as one pair, is evaluated on the pair that is left
out, which chose nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from edge_vpr.matching.distances import ReferenceIndex
from edge_vpr.matching.drive import filter_drive
from edge_vpr.matching.place_filter import PlaceFilter
from lab.drives import recorded_drives
from lab.experiments.place_filter import DEFAULTS, ROBOT, driven, driven_street
from lab.loop import CHOSEN_ON, DRIVES, Draw, Drives, Experiment, Row, Rows
from lab.nulls import BY_US, null_queries
from lab.pairs import MappedPair
from lab.plots import lines
from lab.tables import TableView

# A filter with other constants.


@dataclass(frozen=True)
class Constants:
    """Constants of the filter as multiples of the default."""

    restart: float = 1.0  #: Of the cost of a restart.
    steps: float = 1.0  #: Of the costs of steps.
    typical: float = 1.0  #: Of the part of the typical distance of a place that is subtracted.


def match_with(pair: MappedPair, constants: Constants) -> npt.NDArray[np.int64]:
    """Match window by window as on a robot; return the place of each window."""
    coded = pair.coded(DEFAULTS[ROBOT]).reference
    queries, index = coded.coded(pair.counted), ReferenceIndex(coded.places.counts)
    place_filter = PlaceFilter.of(coded.places, coded.settings)
    table = place_filter.transitions.table
    place_filter.transitions.table = table._replace(
        costs=np.rint(constants.steps * table.costs.view(np.uint8)).astype(np.uint8).view(np.int64),
        restart_cost=round(constants.restart * table.restart_cost),
        bias=np.rint(constants.typical * table.bias).astype(np.int64),
    )
    return filter_drive(place_filter, index, queries).rows["place"]


# The constants that are varied, and what is chosen by the other drives.


#: multiples of the default by constant
VARIED: Mapping[str, tuple[float, ...]] = {
    "restart": (0.25, 0.5, 1.0, 1.5, 1.75),
    "steps": (0.25, 0.5, 1.0, 1.5, 2.0),
    "typical": (0.25, 0.5, 1.0, 1.5, 2.0),
}
#: how the constants are shown
SHOWN = {
    "restart": "cost of a restart",
    "steps": "costs of steps",
    "typical": "typical distance that is subtracted",
}
CONSTANT, TIMES = "constant", "times the default"
#: streets of these kinds, of those of `place_filter`
KINDS = ("street", "street, 3 stops", "street, low sun")
#: first seed of the streets
FIRST_SEED = 70
#: what chose the parameters of a row in which a constant is varied, or in which a pair is left out
VARIED_ALONE = f"{BY_US}, but for this constant"
BY_OTHERS = "the other drives of this table"
THE_DEFAULT, OF_DEFAULT = "none: the default", "P@100R of the default"
#: null query, and the column of its share of correct matches
NULL = "null: pixels shuffled once"
#: a constant and a multiple of it
Setting = tuple[str, float]


def measure(draw: Draw) -> Iterator[Row]:
    """Vary each constant alone, on a recorded pair or on each drive of a street."""
    for drive in driven(draw):
        pair = drive.mapped(drive.settings)
        shown = dict(null_queries(pair.counted, np.random.default_rng(draw.seed)))
        null = replace(pair, counted=shown[NULL])
        default = _correct(pair, Constants()), _correct(null, Constants())
        for constant, multiples in VARIED.items():
            for times in multiples:
                varied = Constants(**{constant: times})
                correct, chance = (
                    default if times == 1 else (_correct(pair, varied), _correct(null, varied))
                )
                yield {
                    DRIVES: drive.name,
                    CONSTANT: SHOWN[constant],
                    TIMES: times,
                    "matching": "live",
                    CHOSEN_ON: BY_US if times == 1 else VARIED_ALONE,
                    "P@100R": correct,
                    NULL: chance,
                }


def _correct(pair: MappedPair, constants: Constants) -> float:
    """Return the share of correct matches."""
    places, truth = match_with(pair, constants), pair.truth
    return float(truth.correct[places, np.arange(len(places))][truth.has_truth].mean())


def left_out(rows: Rows) -> list[Row]:
    """Evaluate on each pair the setting that is best on the others, live, beside the default."""
    live = [row for row in rows if row["matching"] == "live"]
    correct: dict[Setting, dict[str, list[float]]] = {}
    for row in live:
        of = correct.setdefault((row[CONSTANT], row[TIMES]), {})
        of.setdefault(_group(row[DRIVES]), []).append(row["P@100R"])
    # the default first, so that it is chosen where it is as good as any
    settings = sorted(correct, key=lambda each: each[1] != 1)
    groups = dict.fromkeys(_group(row[DRIVES]) for row in live)
    chosen_rows: list[Row] = []
    for group in groups if len(groups) > 1 else ():
        others = [each for each in groups if each != group]
        on_others = {
            setting: np.mean([np.mean(correct[setting][each]) for each in others])
            for setting in settings
        }
        best = max(settings, key=on_others.__getitem__)
        mine = [row for row in live if _group(row[DRIVES]) == group]
        of_setting = [
            [row for row in mine if (row[CONSTANT], row[TIMES]) == setting]
            for setting in (best, settings[0])
        ]
        for chosen, default in zip(*of_setting, strict=True):
            name = THE_DEFAULT if best[1] == 1 else chosen[CONSTANT]
            more = {CONSTANT: name, CHOSEN_ON: BY_OTHERS, OF_DEFAULT: default["P@100R"]}
            chosen_rows.append({**chosen, **more})
    return chosen_rows


def _group(drives: str) -> str:
    """Return the drives that a pair is left out with: the same with another number of pixels."""
    return drives.split(",")[0]


def drives(data: Path | None) -> list[Drives]:
    """Return streets, and the recorded pairs of a folder."""
    streets = Drives("streets", lambda seed: driven_street(FIRST_SEED + seed, KINDS), varied=True)
    return [streets, *(recorded_drives(data) if data is not None else ())]


def figure(rows: Rows) -> Figure:
    """Draw correct matches over each constant."""
    # of drives with several numbers of pixels the last one, which is the largest
    last = {row[DRIVES].rpartition(",")[0]: row[DRIVES] for row in rows}
    shown = set(last.values())
    varied = [row for row in rows if row[DRIVES] in shown and row[CHOSEN_ON] != BY_OTHERS]
    return lines(varied, x=TIMES, y="P@100R", line=CONSTANT, mark=1.0)


EXPERIMENT = Experiment(
    drives=drives,
    names=(CONSTANT, TIMES, "matching", CHOSEN_ON),
    measure=measure,
    figure=figure,
    conclude=left_out,
    view=TableView({"matching": "live"}, (CONSTANT, TIMES, "P@100R", NULL)),
)
