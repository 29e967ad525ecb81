"""Checks of a saved state of a localiser, before kernels use it as indices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import Arrays
from edge_vpr.array_checks import check_array, check_range, whole_number
from edge_vpr.descriptors.windows import FixedTime, Window
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.filter_arithmetic import RECIPROCAL_BITS, TRUST_BITS
from edge_vpr.matching.step_prices import METRIC_TOP
from edge_vpr.odometry import MOST_MM
from edge_vpr.online.schedule import MatchSchedule

#: Largest number of counters of all windows of a sequence: 128 MB in the kernels.
MAX_COUNTERS = 1 << 24
#: Largest number of windows x places x counters: some ten seconds of work at the start.
MAX_COMPARISONS = 1 << 36


class Clock(NamedTuple):
    """Progress of a localiser in its stream.

    Attributes
    ----------
    now_us : int
        T: all events before it have been taken.
    floor_us : int
        No event may be earlier.
    """

    now_us: int
    floor_us: int


def check_extent(places: int, counters: int, length: int, recent: int, window: Window) -> None:
    """Refuse sizes that would overflow the kernels' integers, or take too much memory or time.

    Parameters
    ----------
    places, counters, length, recent : int
        K, J (or 2 J), L, and the newest places that are left out.
    window : FixedTime or FixedCount

    Raises
    ------
    UsageError
        If the map is shorter than a sequence, or one of the above is too large.
    """
    if type(recent) is not int or recent < 0 or places < length + recent:
        raise UsageError(
            f"a map of {places} places cannot hold sequences of {length} besides {recent} recent "
            "places: take a shorter sequence or a longer map"
        )
    if length * counters > MAX_COUNTERS or length * places * counters > MAX_COMPARISONS:
        raise UsageError(
            f"sequences of {length} windows of {counters} counters on {places} places are too "
            "much for matching after every event: take a shorter sequence"
        )
    span = window.tau_us if isinstance(window, FixedTime) else window.events
    if length * span > TIME_LIMIT_US:
        raise UsageError(
            f"a sequence of {length} windows of {window} is longer than {TIME_LIMIT_US} us or "
            "events: take shorter windows"
        )


def check_state(
    arrays: Arrays,
    meta: Mapping[str, Any],
    *,
    counters: int,
    length: int,
    ends: int,
    window: Window,
    every: MatchSchedule,
    filtered: bool,
) -> Clock:
    """Check that the arrays are a possible state of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``slot`` and ``time`` of the events in the windows, ``bound``; of sequences ``policy``.
    meta : mapping
        With ``now_us`` and ``floor_us``.
    counters, length, ends : int
        J (or 2 J), L, and the number of places that a sequence can end at.
    window : FixedTime or FixedCount
    every : MatchSchedule
    filtered : bool
        Whether the place filter matches, and not sequences.

    Returns
    -------
    Clock

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    floor_us = whole_number(meta, "floor_us", 0, TIME_LIMIT_US)
    now_us = whole_number(meta, "now_us", floor_us, floor_us + 1)
    check_array(arrays["slot"], "slot", (np.int32,), (None,))
    n = arrays["slot"].size
    check_range(arrays["slot"], "slot", 0, counters - 1)
    check_array(arrays["time"], "time", (np.int64,), (n,))
    check_range(arrays["time"], "time", 0, min(floor_us, now_us - 1))
    if (np.diff(arrays["time"]) < 0).any():
        raise MapError("time of the events in the windows runs backwards: expected sorted times")
    check_array(arrays["bound"], "bound", (np.int64,), (length + 1,))
    check_range(arrays["bound"], "bound", 0, TIME_LIMIT_US)
    bound = arrays["bound"]
    expected = _bounds(arrays, window, length, now_us)
    if not np.array_equal(bound, expected) or bound[0] - bound[-1] != n:
        raise MapError(
            f"bound is {bound.tolist()} and the {n} events in the windows make it "
            f"{expected.tolist()}"
        )
    if not filtered:  # the place filter has a schedule of its own
        _check_schedule(arrays, "policy", ends, every, floor_us)
    return Clock(now_us, floor_us)


def _bounds(arrays: Arrays, window: Window, length: int, now_us: int) -> npt.NDArray[np.int64]:
    """Return the number of the event with which each lag begins, shape (L + 1,)."""
    last, n = int(arrays["bound"][0]), arrays["slot"].size
    lags = np.arange(length + 1, dtype=np.int64)
    if isinstance(window, FixedTime):
        return last - n + np.searchsorted(arrays["time"], now_us - lags * window.tau_us)
    return np.maximum(last - lags * window.events, 0)


def check_filter_state(
    arrays: Arrays, places: int, window: Window, every: MatchSchedule, floor_us: int
) -> None:
    """Check that the arrays are a possible state of the place filter of a localiser.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        Of `FilterRun.to_arrays`, and ``bound``.
    places : int
        K.
    window : FixedTime or FixedCount
    every : MatchSchedule
    floor_us : int
        Until when time has passed.

    Raises
    ------
    MapError
        If an array is of another dtype or shape, or holds what no run leaves.
    """
    check_array(arrays["filter_metric"], "filter_metric", (np.int32,), (places,))
    check_range(arrays["filter_metric"], "filter_metric", 0, METRIC_TOP)
    check_array(arrays["filter_state"], "filter_state", (np.int64,), (5,))
    reciprocal, usual, place, trust, windows = arrays["filter_state"].tolist()
    ended = floor_us // window.tau_us if isinstance(window, FixedTime) else (
        int(arrays["bound"][0]) // window.events
    )  # fmt: skip
    within = (
        0 <= reciprocal <= 1 << RECIPROCAL_BITS
        and 0 <= usual <= TIME_LIMIT_US
        and (0 <= place < places if windows else place == -1)
        and 0 <= trust <= METRIC_TOP << TRUST_BITS
    )
    if not within or windows != ended:
        raise MapError(
            f"filter_state holds {arrays['filter_state'].tolist()} for {places} places after "
            f"{ended} windows: save the state again"
        )
    _check_schedule(arrays, "filter_schedule", places, every, floor_us)
    if "filter_odometer" in arrays:
        check_array(arrays["filter_odometer"], "filter_odometer", (np.int64,), (4,))
        check_range(arrays["filter_odometer"][:2], "filter_odometer", -MOST_MM, MOST_MM)
        check_range(arrays["filter_odometer"][2:], "filter_odometer", 0, 1)
    if "filter_mean" in arrays:
        check_array(arrays["filter_mean_windows"], "filter_mean_windows", (np.int64,), (1,))
        check_range(arrays["filter_mean_windows"], "filter_mean_windows", 0, max(windows, 0))


def _check_schedule(
    arrays: Arrays, name: str, places: int, every: MatchSchedule, floor_us: int
) -> None:
    check_array(arrays[name], name, (np.int64,), (2,))
    tick, place = arrays[name].tolist()
    interval = every.interval_us
    if tick != ((floor_us // interval + 1) * interval if interval else 0):
        raise MapError(f"the state says the next time for a match is {tick} us, at {floor_us} us")
    if not -1 <= place < places:
        raise MapError(f"the state names the place {place}: expected -1 to {places - 1}")
