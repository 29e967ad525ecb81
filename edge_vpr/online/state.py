"""State of a localiser: one tuple of arrays, which its kernel takes and updates in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.windows import window_of
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.match import MATCH_DTYPE
from edge_vpr.matching.place_filter import FilterState, PlaceFilter, WindowRows
from edge_vpr.matching.prediction import FilterTable
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.sliding_windows import UNLIMITED, SlidingWindows, start
from edge_vpr.reference_map import ReferenceMap
from fixedpoint.activity import SUMS
from fixedpoint.own_mean import ContrastCode

#: Initial capacity for the events of a chunk.
CHUNK_EVENTS = 4_096
#: Number of matches after which the kernel returns.
MATCHES_AT_ONCE = 4_096
#: A time later than the end of any window.
NEVER = np.iinfo(np.int64).max

#: Control of the kernel; times in microseconds.
CONTROL = np.dtype(
    [
        # when to match, see `MatchSchedule`
        ("every", "<i8"),
        ("interval", "<i8"),
        ("change", "<i8"),
        ("next_tick", "<i8"),  # time of the next match by the interval
        ("last_reported", "<i8"),  # place of the last match
        # search
        ("exclusion", "<i8"),  # of sequences: width of the zone around the best place
        ("least_trust", "<i8"),  # of a match that is accepted
        # place filter
        ("windows", "<i8"),  # windows that a match compares
        ("window_end", "<i8"),  # end of the current window; `NEVER` with sequences
        ("paused", "<i8"),  # whether the window that ended last was a pause
        # events
        ("floor", "<i8"),  # earliest time that the next event may have
        ("now", "<i8"),  # T: all earlier events have been processed, except for these:
        ("read", "<i8"),  # first selected event of the chunk that is not processed yet
        ("selected", "<i8"),  # number of selected events of the chunk
        ("until", "<i8"),  # time of the last event of the chunk, to which the time advances
    ]
)


class OnlineState(NamedTuple):
    """State of the kernel `process_events`.

    Attributes
    ----------
    windows : SlidingWindows
        Counters of the newest windows, and their distances to all places.
    filter : FilterState or None
        Arrays shared with the `PlaceFilter`; None with sequences, as are the next two.
    filter_table : FilterTable or None
        See `Transitions`.
    rows : WindowRows or None
        Scratch of the place filter, for one window.
    length : int or None
        L of sequences; None with the place filter.
    limits : ndarray of int64, shape (J,)
        Largest number of events of each pixel that counts in a window, of the place filter.
    control : ndarray of CONTROL, shape (1,)
        Numbers of the kernel.
    trust_steps, probability_steps : ndarray of int64 and float64, shape (m,)
        `trust` and `probability` of `edge_vpr.confidence.Confidence`; m is 0 if it is unknown.
    table : ndarray of int16 or int32, shape (height, width)
        See `PixelMap.table`.
    slots, times : ndarray of int32 and int64, shape (CHUNK_EVENTS or more,)
        Selected events of the current chunk.
    out : ndarray of MATCH_DTYPE, shape (MATCHES_AT_ONCE,)
        Output of matches.
    """

    windows: SlidingWindows
    filter: FilterState | None
    filter_table: FilterTable | None
    rows: WindowRows | None
    length: int | None
    limits: npt.NDArray[np.int64]
    control: npt.NDArray[np.void]
    trust_steps: npt.NDArray[np.int64]
    probability_steps: npt.NDArray[np.float64]
    table: npt.NDArray[np.signedinteger]
    slots: npt.NDArray[np.int32]
    times: npt.NDArray[np.int64]
    out: npt.NDArray[np.void]


def state_before(
    reference: ReferenceMap, schedule: MatchSchedule, place_filter: PlaceFilter | None = None
) -> OnlineState:
    """Return the state before the first event.

    Parameters
    ----------
    place_filter : PlaceFilter, optional
        Its arrays are shared, not copied; without it, sequences are matched.
    """
    settings, acceptance = reference.settings, reference.acceptance
    code: ContrastCode | int | None = settings.contrast_code
    if code is None:
        most = settings.most_counted
        code = UNLIMITED if most is None else most
    sums = SUMS[: 1 if place_filter is None else place_filter.sums]
    windows = start(
        reference.places.counts, window_of(settings), max(settings.windows_per_match, sums[-1]),
        code, reference.mean, len(sums),
    )  # fmt: skip
    control = np.zeros(1, dtype=CONTROL).view(np.recarray)
    first = control[0]
    first.every, first.interval = schedule.events, schedule.interval_us
    first.change, first.exclusion = schedule.change, settings.exclusion_places
    first.next_tick, first.last_reported = schedule.interval_us, -1
    first.window_end = NEVER
    first.least_trust = -2 * TIME_LIMIT_US
    trust, probability = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.float64)
    if acceptance.confidence is not None:
        # copies, because Numba gives read-only arrays another type
        trust, probability = (
            acceptance.confidence.trust.copy(),
            acceptance.confidence.probability.copy(),
        )
        if acceptance.precision is not None:
            first.least_trust = acceptance.confidence.least_trust(acceptance.precision)
    filter_state = filter_table = rows = None
    length = settings.windows_per_match if place_filter is None else None
    first.windows, limits = settings.windows_per_match, np.empty(0, dtype=np.int64)
    if place_filter is not None:
        assert reference.limits is not None
        filter_state, filter_table = place_filter.state, place_filter.transitions.table
        rows = WindowRows.empty(1, place_filter.sums, len(place_filter))
        limits = reference.limits.astype(np.int64)
    return OnlineState(
        windows,
        filter_state,
        filter_table,
        rows,
        length,
        limits,
        control,
        trust,
        probability,
        reference.pixel_map.table(),
        np.empty(CHUNK_EVENTS, dtype=np.int32),
        np.empty(CHUNK_EVENTS, dtype=np.int64),
        np.zeros(MATCHES_AT_ONCE, dtype=MATCH_DTYPE),
    )
