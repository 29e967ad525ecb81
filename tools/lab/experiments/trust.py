"""Calibration of the shipped probabilities on real drives that they were not learnt on.

A match counts as correct here if the true place lies in the exclusion zone around it, which is what
its probability states. The tolerances of other experiments are narrower on some drives, and wider
on others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import LIVE, SMOOTHED, Confidence, default_confidence
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.calibration import learn_confidence
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate_rejection
from edge_vpr.evaluation.tracks import distances, with_positions
from edge_vpr.route import along_columns
from lab.drives import fullest_drives
from lab.loop import Draw, Experiment, Row
from lab.nulls import scrambled
from lab.pairs import MappedPair, Pair, Tracks
from lab.shipped_tables import (
    LEARNT_ON,
    MATCHINGS,
    NAMES,
    PRECISION,
    STAYS_ON_MAP,
    VIEW,
    Sample,
    evaluate_tables,
    learnt_seeds,
    sample,
)
from lab.spliced import CARRIED, CUT, WHOLE, carried_off, without_places

#: of `MATCHINGS`, in the order of the table
EVALUATED = (SMOOTHED, LIVE)
#: places that are cut out of the map of Brisbane's counts; of other maps, it is the third quarter
_CUT = (220, 330)
_NULLS = 11  # random stream that shuffles windows and pixels
#: Places of a track at most so far apart are the same: two GPS logs of one street differ by it.
_SAME_M = 5.0
BY_TOLERANCE = "precision by tolerance"
FIRST_HALF, SECOND_HALF = "the first half of the drive", "the second half of the drive"


def in_zone(truth: GroundTruth, places: int) -> GroundTruth:
    """Return the truth that a probability refers to.

    Parameters
    ----------
    truth : GroundTruth
        With positions.
    places : int
        Of the exclusion zone, on each side of a match.

    Returns
    -------
    GroundTruth
        Correct are the place that is nearest to the true position, those that are as near or within
        5 m of it, and so many places before and after each of these.
    """
    positions = truth.positions
    assert positions is not None, "pairs of drives have tracks or an alignment"
    apart = distances(positions.kind, positions.place[:, None], positions.query[None])
    apart = np.where(np.isnan(apart), np.inf, apart)
    same = _SAME_M if positions.unit == "m" else 0.0
    true = np.isfinite(apart) & (apart <= np.maximum(apart.min(axis=0), same))
    correct = true.copy()
    for step in range(1, places + 1):
        correct[step:] |= true[:-step]
        correct[:-step] |= true[step:]
    return GroundTruth(correct & truth.has_truth, truth.has_truth, f"within {places} places")


def driven_versions(mapped: MappedPair, piece: tuple[int, int]) -> dict[str, list[MappedPair]]:
    """Return the drive whole, with a piece cut out of the map, and carried off twice."""
    windows = len(mapped.counted)
    return {
        WHOLE: [mapped],
        CUT: [without_places(mapped, *piece)],
        CARRIED: [carried_off(mapped, windows // 3, 2 * windows // 3)],
    }


def measure(draw: Draw) -> Iterator[Row]:
    """Evaluate the tables on a pair: whole, a piece cut out, carried off twice, and nulls."""
    pair: Pair = draw.pair
    near = pair.mapped(pair.default(draw.seed))
    mapped = replace(near, truth=in_zone(near.truth, near.reference.settings.exclusion_places))
    places = len(mapped.reference)
    piece = (places // 2, 3 * places // 4) if pair.has_images else _CUT
    nulls = scrambled(mapped, np.random.default_rng((_NULLS, draw.seed)))
    versions = driven_versions(mapped, piece) | {name: [shown] for name, shown in nulls.items()}
    others: dict[tuple[str, str], dict[str, float]] = {}
    for row in evaluate_tables(driven_versions(near, piece), EVALUATED, ()):
        others[row["map"], row["matching"]] = {
            BY_TOLERANCE + which: row["precision" + which]
            for which in ("", STAYS_ON_MAP)
            if "precision" + which in row
        }
    if pair.tracks is not None:
        for name in EVALUATED:
            intervals = interval(pair.tracks, mapped.with_settings(MATCHINGS[name]))
            others[WHOLE, name] |= intervals
    yield from with_a_drive_of_ones_own(mapped)
    for row in evaluate_tables(versions, EVALUATED, (LIVE,)):
        yield {**row, **others.get((row["map"], row["matching"]), {})}


def with_a_drive_of_ones_own(whole: MappedPair) -> Iterator[Row]:
    """Accept matches of the second half of a drive, by what was learnt from its first half.

    Rows are for the shipped table, for one learnt as `edge-vpr calibrate` does, and for a threshold
    by Quantile Transfer [1]_: the share of the first half's matches below the threshold that finds
    most at the required precision is also left out of the second half, whose truth is not used.

    References
    ----------
    .. [1] D. M. Rajani, M. Milford, T. Fischer, "Quantile Transfer for Reliable Operating Point
       Selection in Visual Place Recognition", arXiv:2602.04401.
    """
    for name in EVALUATED:
        pair = whole.with_settings(MATCHINGS[name])
        settings, middle = pair.reference.settings, len(pair.counted) // 2
        first, second = sample(pair, 0, middle), sample(pair, middle)
        learnt = learn_confidence(first.trust, first.correct)
        shipped = default_confidence(settings.smooth)
        for learnt_on, accepted in (
            (f"streets of seeds {learnt_seeds()[0]} to {learnt_seeds()[1]}",
             second.trust >= shipped.least_trust(PRECISION)),
            (FIRST_HALF, _accepted_by(learnt, second.trust)),
            (f"{FIRST_HALF}, quantile transfer", quantile_transfer(first, second.trust, PRECISION)),
        ):  # fmt: skip
            counts = evaluate_rejection(second.trust, second.correct, second.has_place, accepted)
            yield {
                "map": SECOND_HALF,
                "matching": name,
                LEARNT_ON: learnt_on,
                "windows": second.trust.size,
                "accepted at 0.99": float(accepted.mean()),
                "precision": counts.precision,
                "recall": counts.recall,
            }


def _accepted_by(table: Confidence, trust: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Return which matches a table accepts: none, if it was learnt from too few matches."""
    try:
        return trust >= table.least_trust(PRECISION)
    except UsageError:
        return np.zeros(trust.size, dtype=np.bool_)


def quantile_transfer(
    calibration: Sample, trust: npt.NDArray[np.int64], precision: float
) -> npt.NDArray[np.bool_]:
    """Return which matches to accept, as many as by the best threshold of a calibration drive.

    Parameters
    ----------
    calibration : Sample
        Matches of the calibration drive, whose truth is known.
    trust : ndarray of int64, shape (n,)
        Net trust of each match of the later drive.
    precision : float
        Share of the accepted matches that must be correct, as measured on the calibration drive.
    """
    order = np.argsort(-calibration.trust, kind="stable")
    descending, correct = calibration.trust[order], np.cumsum(calibration.correct[order])
    accepted = np.arange(1, order.size + 1)
    last_of_level = np.append(descending[1:] != descending[:-1], True)
    reached = np.flatnonzero(last_of_level & (correct >= precision * accepted))
    if not reached.size:
        return np.zeros(trust.size, dtype=np.bool_)
    below = 1 - accepted[reached[-1]] / order.size
    return trust >= np.quantile(trust, below, method="higher")


def interval(tracks: Tracks, mapped: MappedPair) -> dict[str, float]:
    """Return how often the interval along the route holds the true position, and its length."""
    route = with_positions(mapped.reference, tracks.reference).route
    assert route is not None
    matches = mapped.match()
    judged = mapped.truth.has_truth[matches.query]
    gaps = distances(
        tracks.query.kind, tracks.query.at(matches.time_us)[judged, None], route.position[None]
    )
    true_m = route.along_m[np.nanargmin(gaps, axis=1)]  # the nearest place of the map
    place, within = matches.place[judged], matches.settings.exclusion_places
    _, from_m, to_m = along_columns(route.along_m, place, within).values()
    inside = (from_m <= true_m) & (true_m <= to_m)
    return {
        "positions in their interval": float(inside.mean()),
        "median interval (m)": float(np.nanmedian(to_m - from_m)),
    }


EXPERIMENT = Experiment(
    drives=fullest_drives,
    names=NAMES,
    measure=measure,
    view=VIEW,
)
