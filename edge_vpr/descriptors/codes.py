"""Codes of descriptors: saturating counts and contrast codes, which windows are compared by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import Descriptors, find_pauses, mean_of_query, narrow
from fixedpoint.activity import SUMS
from fixedpoint.own_mean import FULL_SCALE, ContrastCode, RunningMean


def saturated(counted: Descriptors, most: int | None) -> Descriptors:
    """Return windows whose counters saturate at a count, `Settings.most_counted`.

    Parameters
    ----------
    most : int, optional
        Without it, counts stay as they are.
    """
    if most is None:
        return counted
    # as uint16, since NumPy would convert a plain integer to the dtype of the counts
    counts = narrow(np.minimum(counted.counts, np.uint16(most)))
    return replace(counted, counts=counts, selected=counted.selected_events)


# Contrast codes of descriptors, with the mean of a drive or a running mean.


def drive_mean(
    windows: Descriptors, code: ContrastCode, mean_activity: int
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
    events = windows.counted_events
    paused = find_pauses(events, mean_of_query(events, mean_activity))
    moving = windows.counts if paused.all() else windows.counts[~paused]
    return code.mean(moving)


#: of the windows of a reference, one in so many may have more events at a pixel than count
LIMIT_SHARE = 50


def limits_of(counts: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
    """Return the largest number of events of each pixel that count in a window.

    The number of events says how fast a robot drives, and a pixel that is hot, or in a flickering
    light, must not say it alone.

    Parameters
    ----------
    counts : ndarray of int, shape (n, J)
        Windows of the reference.

    Returns
    -------
    ndarray of int32, shape (J,)
        The largest count that at most one window in 50 exceeds, at most that of a full counter.
    """
    n = len(counts)
    rank = n - 1 - n // LIMIT_SHARE
    of_rank = np.partition(counts, rank, axis=0)[rank].astype(np.int64)
    return np.minimum(of_rank, FULL_SCALE).astype(np.int32)


def counted_events(
    counts: npt.NDArray[np.integer], limits: npt.NDArray[np.int32]
) -> npt.NDArray[np.int64]:
    """Return the events of each window that count: of each pixel no more than its limit.

    Parameters
    ----------
    counts : ndarray of int, shape (n, J)
        Of each window.
    limits : ndarray of int32, shape (J,)
        See `limits_of`.

    Returns
    -------
    ndarray of int64, shape (n,)
    """
    return np.minimum(counts, limits).sum(axis=1, dtype=np.int64)


def encode(
    counted: Descriptors,
    code: ContrastCode,
    limits: npt.NDArray[np.int32],
    start: npt.NDArray[np.int32] | None,
    mean_activity: int,
    gains: int,
) -> Descriptors:
    """Code the counts of a query.

    Parameters
    ----------
    counted : Descriptors
        Counts.
    limits : ndarray of int32, shape (J,)
        Of the reference, see `limits_of`.
    start : ndarray of int32, shape (J,), or None
        Where a running mean starts, see `encode_running`; None: see `encode_own`.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    gains : int
        See `encode_own`.
    """
    counted = replace(counted, counted=counted_events(counted.counts, limits))
    if start is None:
        return encode_own(counted, code, mean_activity, gains)
    return encode_running(counted, code, start, mean_activity, gains)


def encode_own(
    counted: Descriptors, code: ContrastCode, mean_activity: int, gains: int
) -> Descriptors:
    """Code a recorded query with its mean over the whole drive.

    Parameters
    ----------
    counted : Descriptors
        Counts, and the events that count.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    gains : int
        Whether sums of windows are coded too, each with a mean of its own: not for one gain.
    """
    counted, coded = replace(counted, counted=counted.counted_events), []
    for windows in SUMS[: len(SUMS) if gains > 1 else 1]:
        some = replace(counted, counts=narrow(newest(counted.counts, windows)))
        coded.append(code.encode(some.counts, drive_mean(some, code, mean_activity)))
    return _replaced(counted, coded)


def encode_running(
    counted: Descriptors,
    code: ContrastCode,
    mean: npt.NDArray[np.int32],
    mean_activity: int,
    gains: int,
) -> Descriptors:
    """Code each window of a query with the running mean of the windows before it, as on a robot.

    Parameters
    ----------
    counted : Descriptors
        Counts, and the events that count.
    mean : ndarray of int32, shape (J,)
        Of the reference: where the running mean starts.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    gains : int
        See `encode_own`.
    """
    paused, coded = find_pauses(counted.counted_events, mean_activity), []
    for windows in SUMS[: len(SUMS) if gains > 1 else 1]:
        running, of_sum = RunningMean(mean), np.empty(counted.counts.shape, dtype=np.uint8)
        for i, counts in enumerate(newest(counted.counts, windows)):
            of_sum[i] = code.encode(counts, running.mean)
            if not paused[i]:
                running.update(code.level(counts))
        coded.append(of_sum)
    return _replaced(counted, coded)


def newest(counts: npt.NDArray[np.integer], windows: int) -> npt.NDArray[np.integer]:
    """Return the sums of so many newest windows at each window, of fewer at the start.

    Parameters
    ----------
    counts : ndarray of int, shape (n, J)
        Of each window.

    Examples
    --------
    >>> newest(np.array([[1], [2], [3]]), 2).tolist()
    [[1], [3], [5]]
    """
    if windows == 1:
        return counts
    total = np.cumsum(counts, axis=0, dtype=np.int64)
    total[windows:] -= total[:-windows].copy()
    return total


def _replaced(counted: Descriptors, coded: list[npt.NDArray[np.uint8]]) -> Descriptors:
    return replace(
        counted,
        counts=coded[0],
        selected=counted.selected_events,
        summed=np.stack(coded[1:], axis=1) if len(coded) > 1 else None,
    )
