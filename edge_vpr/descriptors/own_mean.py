"""Own-mean codes of descriptors, with the mean of a drive or a running mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.descriptors import Descriptors
from edge_vpr.descriptors.pauses import find_pauses
from fixedpoint.own_mean import OwnMeanCode, RunningMean, mean_level


def drive_mean(
    counts: npt.NDArray[np.integer], paused: npt.NDArray[np.bool_], code: OwnMeanCode
) -> npt.NDArray[np.int32]:
    """Return the mean logarithm of each counter over the windows of a drive, without pauses.

    Parameters
    ----------
    counts : ndarray of int, shape (n, J)
    paused : ndarray of bool, shape (n,)
        If all are pauses, they count all the same.
    code : OwnMeanCode

    Returns
    -------
    ndarray of int32, shape (J,)
        In units of 1/256 octave.
    """
    moving = counts if paused.all() else counts[~paused]
    return mean_level(code.level(moving))


def encode_own(counted: Descriptors, code: OwnMeanCode, usual: int) -> Descriptors:
    """Code a recorded query with its mean over the whole drive.

    Parameters
    ----------
    counted : Descriptors
        Counts.
    code : OwnMeanCode
    usual : int
        Selected events that a window of the reference has, see `pauses.Activity`.
    """
    own = drive_mean(counted.counts, find_pauses(counted.activity, usual), code)
    return _replaced(counted, code.encode(counted.counts, own))


def encode_running(
    counted: Descriptors, code: OwnMeanCode, mean: npt.NDArray[np.int32], usual: int
) -> Descriptors:
    """Code each window of a query with the running mean of the windows before it, as on a robot.

    Parameters
    ----------
    counted : Descriptors
        Counts.
    code : OwnMeanCode
    mean : ndarray of int32, shape (J,)
        Of the reference: where the running mean starts.
    usual : int
        Selected events that a window of the reference has, see `pauses.Activity`.
    """
    running, coded = RunningMean(mean), np.empty(counted.counts.shape, dtype=np.uint8)
    paused = find_pauses(counted.activity, usual)
    for i, counts in enumerate(counted.counts):
        coded[i] = code.encode(counts, running.mean)
        if not paused[i]:
            running.update(code.level(counts))
    return _replaced(counted, coded)


def _replaced(counted: Descriptors, coded: npt.NDArray[np.uint8]) -> Descriptors:
    return replace(counted, counts=coded, selected=counted.activity)
