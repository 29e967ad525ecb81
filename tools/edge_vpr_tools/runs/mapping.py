"""Making and calibrating the map of a recording."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Confidence
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.calibration import learn_confidence, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.evaluation.tracks import Track, with_positions
from edge_vpr.matching.matches import Matches
from edge_vpr.pipeline import EventSource, Removed, WindowSource, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Odometry
from edge_vpr.settings import Settings

# Making a reference map of a recording.


class MapRun(NamedTuple):
    """A map, the events that cleaning removed, and the time it took in seconds."""

    reference: ReferenceMap
    removed: Removed
    seconds: float


def map_recording(
    recording: EventSource | WindowSource,
    settings: Settings,
    *,
    hot: npt.NDArray[np.bool_] | None = None,
    track: Track | None = None,
    odometry: Odometry | None = None,
) -> MapRun:
    """Make a map of a drive, and check that a drive can be matched with it.

    Parameters
    ----------
    recording : EventSource or WindowSource
    settings : Settings
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it.
    track : Track, optional
        Gives each place its position.
    odometry : Odometry, optional
        Gives each place its distance along the drive.

    Raises
    ------
    EdgeVprError
        If the recording cannot be mapped, or has fewer places than a sequence has windows.
    """
    start, removed = time.perf_counter(), Removed()
    reference = map_traverse(recording, settings, hot=hot, removed=removed)
    seconds = time.perf_counter() - start
    _check_matchable(reference)
    if track is not None:
        reference = with_positions(reference, track)
    if odometry is not None:
        along = odometry.along(reference.places.centre_us)
        reference = replace(reference, odometer_mm=along)
    return MapRun(reference, removed, seconds)


def _check_matchable(reference: ReferenceMap) -> None:
    """Check that a map has enough places for its own sequence length."""
    length, places = reference.settings.windows_per_match, len(reference)
    if length > places:
        raise UsageError(
            f"a sequence of {length} windows does not fit the {places} places of this drive: take "
            "a shorter sequence (-L), shorter windows (--tau), or a longer drive"
        )


# Learning the table of probabilities of a map from a drive with ground truth.


class Calibrated(NamedTuple):
    """A map with a table of probabilities, and their error.

    Attributes
    ----------
    reference : ReferenceMap
    confidence : Confidence
        The table, as the map has it.
    settings_changed : bool
        Whether the map took over the settings that the drive was matched with.
    matches, right, off_map : int
        That were learnt from, those of them that are right, and queries off the map.
    error_before : float or None
        Expected calibration error of the table used before.
    error : float
        Expected calibration error on the drive that it was learnt from.
    """

    reference: ReferenceMap
    confidence: Confidence
    settings_changed: bool
    matches: int
    right: int
    off_map: int
    error_before: float | None
    error: float


def calibrate(reference: ReferenceMap, matches: Matches, truth: GroundTruth) -> Calibrated:
    """Learn the probability that a match is right.

    Parameters
    ----------
    reference : ReferenceMap
    matches : Matches
        Of a drive against this map.
    truth : GroundTruth

    Raises
    ------
    EdgeVprError
        If there is nothing to learn from.
    """
    found = evaluate(matches, truth)
    trust, correct = matches.trust[found.evaluated], found.correct[found.evaluated]
    confidence = learn_confidence(trust, correct)
    changed = reference.settings.of_trust != matches.settings.of_trust
    if changed:
        taken = matches.settings.to_dict()
        kept = {name: reference.settings.to_dict()[name] for name in ("precision", "query_mean")}
        settings = reference.settings.replaced(taken | kept, "the matches")
        reference = replace(reference, settings=settings)
    before = found.reliability
    within = reliability(confidence.probability_of(trust), correct)
    return Calibrated(
        reference=replace(reference, confidence=confidence),
        confidence=confidence,
        settings_changed=changed,
        matches=int(trust.size),
        right=int(correct.sum()),
        off_map=found.rejection.off_map,
        error_before=None if before is None else before.expected_calibration_error,
        error=within.expected_calibration_error,
    )
