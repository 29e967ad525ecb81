"""What the shipped probabilities are worth on real drives that they were not learnt on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge_vpr.confidence import SMOOTHED
from edge_vpr.descriptors.counting import count_windows
from edge_vpr.evaluation.tracks import distances, with_positions
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr_tools.research.experiments import calibration
from edge_vpr_tools.research.experiments.calibration import (
    CARRIED,
    CUT,
    MATCHINGS,
    NAMES,
    WHOLE,
    Case,
    carried_off,
    described,
    evaluate_tables,
    scrambled,
    with_settings,
    without_places,
)
from edge_vpr_tools.research.experiments.drives import Pair, Tracks, recorded_drives
from edge_vpr_tools.research.experiments.experiment import Draw, Drives, Experiment, Row

#: of `MATCHINGS`, those that are evaluated, and those that a robot can use
LIVE = ("4", "0")
EVALUATED = (SMOOTHED, *LIVE)
#: places that are cut out of the map of Brisbane's counts; of other maps, it is the third quarter
_CUT = (220, 330)
_NULLS = 11  # random stream that shuffles windows and pixels


def case_of(pair: Pair, seed: int) -> Case:
    """Map and describe a pair with the default settings and one draw of pixels."""
    settings = PRESETS["default"].replaced(
        {"pixels": pair.settings.pixels, "strategy": pair.settings.strategy, "seed": seed}, "trust"
    )
    mapped = ReferenceMap.build(pair.reference, settings)
    counted = count_windows(pair.query, mapped.pixel_map, settings)
    truth = pair.truth_of(mapped.places.centre_us, counted.centre_us)
    return Case(mapped, counted, truth)


def measure(draw: Draw) -> Iterator[Row]:
    """Evaluate the tables on a pair: whole, a piece cut out, carried off twice, and nulls."""
    pair: Pair = draw.pair
    case = case_of(pair, draw.seed)
    places, windows = len(case.reference), len(case.counted)
    piece = (places // 2, 3 * places // 4) if pair.has_images else _CUT
    versions = {
        WHOLE: [case],
        CUT: [without_places(case, *piece)],
        CARRIED: [carried_off(case, windows // 3, 2 * windows // 3)],
    }
    nulls = scrambled(case, np.random.default_rng((_NULLS, draw.seed)))
    versions |= {name: [shown] for name, shown in nulls.items()}
    intervals: dict[str, dict[str, float]] = {}
    if pair.tracks is not None:
        intervals = {
            described(name): interval(pair.tracks, with_settings(case, **MATCHINGS[name]))
            for name in EVALUATED
        }
    for row in evaluate_tables(versions, EVALUATED, LIVE):
        yield {**row, **(intervals.get(row["matching"], {}) if row["map"] == WHOLE else {})}


def interval(tracks: Tracks, case: Case) -> dict[str, float]:
    """Return how often the interval along the route holds the true position, and its length."""
    route = with_positions(case.reference, tracks.reference).route
    assert route is not None
    matches = case.match()
    known = case.truth.known[matches.query]
    gaps = distances(
        tracks.query.kind, tracks.query.at(matches.time_us)[known, None], route.position[None]
    )
    true_m = route.along_m[np.nanargmin(gaps, axis=1)]  # the nearest place of the map
    located = route.locate(matches.place[known], matches.settings.exclusion_places)
    inside = (located.from_m <= true_m) & (true_m <= located.to_m)
    return {
        "positions in their interval": float(inside.mean()),
        "median interval (m)": float(np.nanmedian(located.to_m - located.from_m)),
    }


def drives(data: Path | None) -> list[Drives]:
    """Return the recorded pairs; 49 of 49 pixels represent the counts of Brisbane."""
    with_images = {each.name for each in recorded_drives(data, images=True)}
    every = recorded_drives(data)
    return [each for each in every if each.name in with_images or not each.drawn]


EXPERIMENT = Experiment(
    drives=drives,
    names=NAMES,
    measure=measure,
    figure=calibration.figure,
    view=calibration.EXPERIMENT.view,
)
