"""Codes of descriptors: conversion of a window's counts before they are compared.

The codes of single counters are in `fixedpoint`, which the hardware model uses too; here they are
those that the settings choose, for all counters of a map. A code of another package is any function
of the counts of a window.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Descriptors, find_pauses, possible_starts
from edge_vpr.errors import MapError
from edge_vpr.settings import Settings
from fixedpoint.codes import PixelCodes
from fixedpoint.own_mean import OwnMeanCode, RunningMean

FullScale = npt.NDArray[np.uint16]


def codes_of(
    settings: Settings, counters: int, full_scale: FullScale | None = None
) -> PixelCodes | None:
    """Return the code of each counter; None if descriptors hold counts.

    Parameters
    ----------
    counters : int
        J, or with polarity 2 J.
    full_scale : ndarray of uint16, shape (counters,), optional
        What the reference map learned, needed where the settings scale the code to each pixel.
    """
    code = settings.shared_code
    if code is None:
        return None
    if settings.own_mean_code is not None:
        raise MapError(
            f"{settings.counter_scaling} codes need the mean of a drive: take ReferenceMap.match, "
            "or counts with settings.uncoded"
        )
    if not settings.learns_full_scale:
        return PixelCodes.shared(code, counters)
    if full_scale is None or full_scale.shape != (counters,):
        raise MapError(
            f"the code of {counters} counters is scaled to each pixel and "
            f"{0 if full_scale is None else full_scale.size} scales are given: take "
            "ReferenceMap.match, or counts with settings.uncoded"
        )
    return PixelCodes.scaled(code.kind, code.bits, full_scale)


# Own-mean codes of descriptors, with the mean of a drive or a running mean.


def drive_mean(
    windows: Descriptors, code: OwnMeanCode, mean_activity: int
) -> npt.NDArray[np.int32]:
    """Return the mean logarithm of each counter over the windows of a drive, without pauses.

    Parameters
    ----------
    windows : Descriptors
        Counts. If all windows are pauses, the mean is over all of them.
    mean_activity : int
        Of the reference, see `activity_of_drive`.

    Returns
    -------
    ndarray of int32, shape (J,)
        In units of 1/256 octave.
    """
    events = windows.selected_events
    paused = find_pauses(events, possible_starts(events, mean_activity)[-1])
    moving = windows.counts if paused.all() else windows.counts[~paused]
    return code.mean(moving)


def encode_own(counted: Descriptors, code: OwnMeanCode, mean_activity: int) -> Descriptors:
    """Code a recorded query with its mean over the whole drive.

    Parameters
    ----------
    counted : Descriptors
        Counts.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    """
    own = drive_mean(counted, code, mean_activity)
    return _replaced(counted, code.encode(counted.counts, own))


def encode_running(
    counted: Descriptors, code: OwnMeanCode, mean: npt.NDArray[np.int32], mean_activity: int
) -> Descriptors:
    """Code each window of a query with the running mean of the windows before it, as on a robot.

    Parameters
    ----------
    counted : Descriptors
        Counts.
    mean : ndarray of int32, shape (J,)
        Of the reference: where the running mean starts.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    """
    running, coded = RunningMean(mean), np.empty(counted.counts.shape, dtype=np.uint8)
    paused = find_pauses(counted.selected_events, mean_activity)
    for i, counts in enumerate(counted.counts):
        coded[i] = code.encode(counts, running.mean)
        if not paused[i]:
            running.update(code.level(counts))
    return _replaced(counted, coded)


def _replaced(counted: Descriptors, coded: npt.NDArray[np.uint8]) -> Descriptors:
    return replace(counted, counts=coded, selected=counted.selected_events)
