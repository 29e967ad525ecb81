"""Making and calibrating the map of a recording."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.confidence import Confidence
from edge_vpr.descriptors.counting import EventSource, Removed, WindowSource
from edge_vpr.evaluation.calibration import learn_confidence, reliability
from edge_vpr.evaluation.ground_truth import GroundTruth
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.evaluation.tracks import Track
from edge_vpr.matching.matches import Matches
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
    pixel_map: str | None = None,
    hot: npt.NDArray[np.bool_] | None = None,
    track: Track | None = None,
    odometry: Odometry | None = None,
    jumps: str | None = None,
) -> MapRun:
    """Make a map of a drive, and take the time.

    Parameters
    ----------
    pixel_map : str, optional
        File of the pixels, or a map that has them; by default they are selected.
    hot : ndarray of bool, shape (height, width), optional
        Hot pixels; by default they are found, if the settings ask for it.
    track : Track, optional
        Gives each place its position.
    odometry : Odometry, optional
        Gives each place its distance along the drive.
    jumps : str, optional
        File of pairs of places that one step can lead between.

    Raises
    ------
    EdgeVprError
        If the recording cannot be mapped, or has fewer places than a sequence has windows.
    """
    start, removed = time.perf_counter(), Removed()
    reference = ReferenceMap.build(
        recording, settings, pixel_map=pixel_map, hot=hot, track=track, odometry=odometry,
        jumps=jumps, removed=removed,
    )  # fmt: skip
    return MapRun(reference, removed, time.perf_counter() - start)


# Learning the table of probabilities of a map from a drive with ground truth.


class Calibrated(NamedTuple):
    """A map with a table of probabilities, and their error."""

    reference: ReferenceMap
    confidence: Confidence  #: The table, as the map has it.
    #: Whether the map took over the settings that the drive was matched with.
    settings_changed: bool
    #: matches, right, off_map: that were learnt from, those of them that are correct, and queries
    #: off the map.
    matches: int
    right: int
    off_map: int
    error_before: float | None  #: Expected calibration error of the table used before.
    error: float  #: Expected calibration error on the drive that it was learnt from.


def calibrate(reference: ReferenceMap, matches: Matches, truth: GroundTruth) -> Calibrated:
    """Learn the probability that a match is correct.

    Parameters
    ----------
    matches : Matches
        Of a drive against this map.

    Raises
    ------
    EdgeVprError
        If there is nothing to learn from.
    """
    found = evaluate(matches, truth)
    trust, correct = matches.net_trust[found.evaluated], found.correct[found.evaluated]
    confidence = learn_confidence(trust, correct)
    changed = reference.settings.of_trust != matches.settings.of_trust
    if changed:
        taken = matches.settings.to_dict()
        of_map = reference.settings.to_dict()
        kept = {name: of_map[name] for name in ("precision", "query_mean", "stays_on_map")}
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
