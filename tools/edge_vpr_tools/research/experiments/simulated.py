"""The embedded default: one route driven twice, the second time at another and varying speed.

No parameter of the default was chosen on these streets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import EventSource, cleaned
from edge_vpr.evaluation.tracks import Track
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import SimulatedRecording, simulate_pair
from edge_vpr_tools.research.experiments.experiment import (
    CHOSEN_ON,
    Draw,
    Drives,
    Experiment,
    Row,
)
from edge_vpr_tools.research.experiments.plots import dots
from edge_vpr_tools.research.experiments.trial import (
    DEFAULT_MATCHING,
    Trial,
    TruthOf,
    Variant,
    rows_of_variants,
    run_trial,
    truth_of_tracks,
)

# How soon a place is recognised after it was entered: event by event against window by window.


@dataclass(frozen=True, eq=False)
class Latency:
    """Times from entering a place to its first correct match.

    Attributes
    ----------
    seconds : ndarray of float64, shape (m,)
        For the places that were recognised before the drive was `reach_m` past their end.
    places : int
        Number of places entered while matches were given.
    """

    seconds: npt.NDArray[np.float64]
    places: int
    matches: int

    @property
    def median_s(self) -> float:
        """Median over the recognised places in seconds; NaN if there are none."""
        return float(np.median(self.seconds)) if self.seconds.size else float("nan")


def measure_latency(
    reference: ReferenceMap,
    query: EventSource,
    reference_track: Track,
    query_track: Track,
    every: MatchSchedule,
    reach_m: float,
) -> Latency:
    """Run the query online, and measure the time to each place's first correct match.

    A place is entered when the query reaches the position at which the reference's window began. It
    is recognised by the first later match with this place, or with a later place whose window began
    within `reach_m` of the query's position, while the query is not yet `reach_m` past the window's
    end.

    Parameters
    ----------
    reference_track, query_track : Track
        Metric, one coordinate: the distance along the route, which does not decrease.
    every : MatchSchedule
        Schedule of matches.
    reach_m : float
        Reach in metres.
    """
    localiser = Localiser(reference, every=every)
    given = [localiser.update(events) for events in cleaned(query, reference.settings)]
    matches = np.concatenate(given)
    start_m = reference_track.at(reference.places.start_us)[:, 0]
    end_m = reference_track.at(reference.places.end_us)[:, 0]
    at_m = query_track.at(matches["time_us"])[:, 0]
    along_m = query_track.position[:, 0]
    entered_us = np.interp(start_m, along_m, query_track.time_us, left=np.nan, right=np.nan)

    named = matches["place"]
    near = np.abs(start_m[named] - at_m) <= reach_m
    seconds, places = [], 0
    for k in range(reference.settings.windows_per_match - 1, len(reference)):
        if not (np.isfinite(entered_us[k]) and matches["time_us"][0] <= entered_us[k]):
            continue
        places += 1
        first, last = np.searchsorted(matches["time_us"], [entered_us[k], np.inf])
        last = first + np.searchsorted(at_m[first:last], end_m[k] + reach_m)
        correct = (named[first:last] == k) | ((named[first:last] > k) & near[first:last])
        if correct.any():
            seconds.append((matches["time_us"][first + np.argmax(correct)] - entered_us[k]) / 1e6)
    return Latency(np.array(seconds), places, len(matches))


#: name of the pairs in tables of several experiments
SIMULATED = "simulated streets"
#: largest distance of a correct match along the route, in metres
TOLERANCE_M = 10.0
#: of the streets from here on, which no parameter was chosen on
FIRST_SEED = 70
SETTINGS = PRESETS["paper"]
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


def truth_of_pair(reference: SimulatedRecording, query: SimulatedRecording) -> TruthOf:
    """Return the ground truth of a simulated pair, by the positions along the route."""
    return truth_of_tracks(reference.track, query.track, TOLERANCE_M)


def run_variants(
    reference: SimulatedRecording,
    query: SimulatedRecording,
    seed: int,
    on_start: Callable[[str], None],
) -> dict[str, Trial]:
    """Run every variant on one pair, as the demo does."""
    settings = SETTINGS.replaced({"seed": seed}, "seed")
    truth_of = truth_of_pair(reference, query)
    trials = {}
    for variant in VARIANTS:
        on_start(variant.name)
        trials[variant.name] = run_trial(reference, query, truth_of, settings, variant)
    return trials


def compare_latencies(
    reference: SimulatedRecording, query: SimulatedRecording, trial: Trial
) -> dict[str, Latency]:
    """Time the recognition of places with a match after every event, and after every window."""
    policies = {
        "event by event": MatchSchedule(events=1),
        "window by window": MatchSchedule.window(trial.reference.settings),
    }
    return {
        name: measure_latency(
            trial.reference, query, reference.track, query.track, every, TOLERANCE_M
        )
        for name, every in policies.items()
    }


def measure(draw: Draw) -> Iterator[Row]:
    """Run every variant on one pair."""
    reference, query = draw.pair
    settings = SETTINGS.replaced({"seed": draw.seed}, "seed")
    truth_of = truth_of_pair(reference, query)
    yield from rows_of_variants(reference, query, truth_of, settings, VARIANTS, DEFAULT)


def kept_pair(seed: int) -> tuple[SimulatedRecording, SimulatedRecording]:
    """Simulate a pair for this seed."""
    reference, query = simulate_pair(FIRST_SEED + seed)
    return reference.keep(), query.keep()


EXPERIMENT = Experiment(
    drives=lambda data: [Drives(SIMULATED, kept_pair, varied=True)],
    names=("variant", CHOSEN_ON),
    measure=measure,
    figure=partial(dots, measures=("P@100R", "R@99P", "Recall@5"), row="variant"),
    reads_data=False,
)
