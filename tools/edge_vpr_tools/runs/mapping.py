"""Making a reference map of a recording."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.place_positions import with_positions
from edge_vpr.evaluation.tracks import Track
from edge_vpr.odometry import Odometry
from edge_vpr.pipeline import EventSource, Removed, WindowSource, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings


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
