"""Sensitivity to each constant of the place filter, and accuracy on drives that did not choose it.

Each constant is varied alone, as a multiple of the default, with places at whole windows. A rule
that the filter does not have is varied too: a limit on the evidence while the running misfit is
high. Beside each setting stands its accuracy on a query with shuffled pixels, which comes from
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

from edge_vpr.descriptors.windows import (
    activity_of,
    activity_of_drive,
    is_pause,
    mean_activity_after,
    place_activity,
)
from edge_vpr.matching.distances import ReferenceIndex, typical_distances
from edge_vpr.matching.evidence import EVIDENCE_TOP, evidence_of, reciprocal_of_spread, weight_of
from edge_vpr.matching.prediction import METRIC_TOP, TransitionCosts, Transitions, predict
from edge_vpr.matching.trust import FIRST_MISFIT, reported_misfit, update_misfit, window_misfit
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.report.tables import TableView
from edge_vpr_tools.research.experiments.drives import recorded_drives
from edge_vpr_tools.research.experiments.experiment import (
    CHOSEN_ON,
    DRIVES,
    Draw,
    Drives,
    Experiment,
    Row,
    Rows,
)
from edge_vpr_tools.research.experiments.nulls import BY_US, null_queries
from edge_vpr_tools.research.experiments.pairs import MappedPair
from edge_vpr_tools.research.experiments.place_filter import DEFAULTS, ROBOT, driven, driven_street
from edge_vpr_tools.research.experiments.plots import lines
from fixedpoint.activity import PARTS, WEIGHT_BITS

# A filter with other constants than those that are compiled.


#: the running misfit from which on evidence is limited, and the least activity of the windows that
#: it is the mean of, and in which evidence is limited: a robot that stands repeats its misfit
DOUBT_FROM, DOUBT_ACTIVITY = 16, -PARTS


@dataclass(frozen=True)
class Constants:
    """Constants of the filter as multiples of the default."""

    restart: float = 1.0  #: Of the cost of a restart.
    weight: float = 1.0  #: Of the weight of the evidence.
    cap: float = 1.0  #: Of the largest evidence; at most 1, since evidence has 8 bits.
    steps: float = 1.0  #: Of the costs of steps.
    #: Of the largest evidence while the running misfit is `DOUBT_FROM` or more; at most 1.
    doubted: float = 1.0


def transitions_of(reference: ReferenceMap, constants: Constants) -> Transitions:
    """Return the moves along a map, with costs of these constants."""
    default = TransitionCosts.of(reference.settings)
    activity = place_activity(reference.places.selected_events)
    exclusion = reference.settings.exclusion_places
    found = Transitions(len(reference), default, activity, exclusion=exclusion)
    table = found.table
    found.table = table._replace(
        costs=np.rint(constants.steps * table.costs).astype(np.int16),
        restart_cost=round(constants.restart * table.restart_cost),
    )
    return found


def match_with(pair: MappedPair, constants: Constants) -> npt.NDArray[np.int64]:
    """Match window by window as on a robot; return the place of each window."""
    coded = pair.coded(DEFAULTS[ROBOT]).reference
    queries = coded.coded(pair.counted)
    distances = ReferenceIndex(coded.places.counts).rows(queries.counts)
    transitions = transitions_of(coded, constants)
    cap, doubted = (round(of * EVIDENCE_TOP) for of in (constants.cap, constants.doubted))
    typical, misfit = typical_distances(coded.places.counts), FIRST_MISFIT
    mean, scale = activity_of_drive(coded.places.selected_events), 0
    places = np.empty(len(distances), dtype=np.int64)
    metric = np.zeros(distances.shape[1], dtype=np.int32)
    unweighted = np.zeros(metric.size, dtype=np.uint8)
    prediction = np.zeros(metric.size, dtype=np.int16)
    for i, events in enumerate(queries.selected_events.tolist()):
        activity = activity_of(events, mean)
        if i:
            predict(metric, transitions.table, activity, prediction)
        pause = is_pause(events, mean)
        weight = 0.0 if pause else constants.weight * weight_of(activity)
        if not pause and scale == 0:
            scale = reciprocal_of_spread(distances[i])
        evidence_of(distances[i], scale, 1 << WEIGHT_BITS, unweighted)
        moves = activity >= DOUBT_ACTIVITY
        doubts = moves and reported_misfit(misfit) >= DOUBT_FROM
        limited = np.minimum(unweighted, min(cap, doubted) if doubts else cap)
        weighted = (limited * weight).astype(np.int64) >> WEIGHT_BITS
        evidence = np.minimum(weighted, EVIDENCE_TOP).astype(np.uint8)
        metric = np.minimum(prediction + evidence, METRIC_TOP).astype(np.int32)
        places[i] = place = int(metric.argmin())
        if moves and not pause:
            whole = weight_of(activity)
            against = ((unweighted.astype(np.int64) * whole) >> WEIGHT_BITS).astype(np.uint8)
            of_window = window_misfit(against, place, typical, scale * whole, 1 << WEIGHT_BITS)
            misfit = update_misfit(misfit, of_window, scale * whole)
        if not pause:
            scale = reciprocal_of_spread(distances[i])
        mean = mean_activity_after(mean, events)
    return places


# The constants that are varied, and what is chosen by the other drives.


#: multiples of the default by constant
VARIED: Mapping[str, tuple[float, ...]] = {
    "restart": (0.25, 0.5, 1.0, 2.0, 4.0),
    "weight": (0.25, 0.5, 1.0, 2.0, 4.0),
    "cap": (0.0625, 0.125, 0.25, 0.5, 1.0),
    "steps": (0.25, 0.5, 1.0, 2.0, 4.0),
    "doubted": (1 / 64, 1 / 32, 1 / 16, 1.0),
}
#: how the constants are shown
SHOWN = {
    "restart": "cost of a restart",
    "weight": "weight of evidence",
    "cap": "largest evidence",
    "steps": "costs of steps",
    "doubted": "largest evidence at high misfit",
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
    for drives_name, pair, *_ in driven(draw):
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
                    DRIVES: drives_name,
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
    return float(truth.correct[places, np.arange(len(places))][truth.known].mean())


def left_out(rows: Rows) -> list[Row]:
    """Evaluate on each pair the setting that is best on the others, live, beside the default."""
    live = [row for row in rows if row["matching"] == "live"]
    found: dict[Setting, dict[str, list[float]]] = {}
    for row in live:
        of = found.setdefault((row[CONSTANT], row[TIMES]), {})
        of.setdefault(_group(row[DRIVES]), []).append(row["P@100R"])
    # the default first, so that it is chosen where it is as good as any
    settings = sorted(found, key=lambda each: each[1] != 1)
    groups = dict.fromkeys(_group(row[DRIVES]) for row in live)
    chosen_rows: list[Row] = []
    for group in groups if len(groups) > 1 else ():
        others = [each for each in groups if each != group]
        on_others = {
            setting: np.mean([np.mean(found[setting][each]) for each in others])
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
    return lines(
        varied, x=TIMES, y="P@100R", line=CONSTANT, mark=1.0,
    )  # fmt: skip


EXPERIMENT = Experiment(
    drives=drives,
    names=(CONSTANT, TIMES, "matching", CHOSEN_ON),
    measure=measure,
    figure=figure,
    conclude=left_out,
    view=TableView({"matching": "live"}, (CONSTANT, TIMES, "P@100R", NULL)),
)
