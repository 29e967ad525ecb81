"""Codes of descriptors: saturating counts and contrast codes, which windows are compared by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.activity import find_pauses, mean_of_query
from edge_vpr.descriptors.windows import Descriptors, narrow
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
    mean_activity: int,
    gains: int,
    start: npt.NDArray[np.int32] | None = None,
) -> Descriptors:
    """Code the windows of a query.

    Parameters
    ----------
    counted : Descriptors
        Counts, and the events that count.
    mean_activity : int
        Of the reference, see `activity_of_drive`.
    gains : int
        Whether sums of windows are coded too, each with a mean of its own: not for one gain.
    start : ndarray of int32, shape (J,), optional
        Mean of the reference: where the running mean of the windows before each starts, as on a
        robot. By default, the mean is that of the whole drive.
    """
    counted = replace(counted, counted=counted.counted_events)
    sums = (newest(counted.counts, n) for n in SUMS[: len(SUMS) if gains > 1 else 1])
    if start is None:
        drives = (replace(counted, counts=narrow(counts)) for counts in sums)
        coded = [code.encode(each.counts, drive_mean(each, code, mean_activity)) for each in drives]
    else:
        paused = find_pauses(counted.counted_events, mean_activity)
        coded = [_encode_running(counts, code, start, paused) for counts in sums]
    return replace(
        counted,
        counts=coded[0],
        selected=counted.selected_events,
        summed=np.stack(coded[1:], axis=1) if len(coded) > 1 else None,
    )


def _encode_running(
    counts: npt.NDArray[np.integer],
    code: ContrastCode,
    start: npt.NDArray[np.int32],
    paused: npt.NDArray[np.bool_],
) -> npt.NDArray[np.uint8]:
    running, coded = RunningMean(start), np.empty(counts.shape, dtype=np.uint8)
    for i, row in enumerate(counts):
        coded[i] = code.encode(row, running.mean)
        if not paused[i]:
            running.update(code.level(row))
    return coded


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
