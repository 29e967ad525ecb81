"""The state of a localiser's kernel, in one tuple."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.matching.filter_recursion import Predictions
from edge_vpr.matching.step_prices import Metrics
from edge_vpr.online.match_records import MATCH_DTYPE
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.online.state import Sliding
from edge_vpr.reference_map import ReferenceMap

#: Number of matches after which the kernel returns.
MATCHES_AT_ONCE = 4_096
#: Largest number of events that one call processes; more are processed by columns.
FEW = 4_096
#: Time that is later than the end of any window.
NEVER = np.iinfo(np.int64).max

#: Control of the kernel; times in microseconds.
CONTROL = np.dtype(
    [
        # when to give a match, see `edge_vpr.online.schedule.MatchSchedule`
        ("every", "<i8"),
        ("interval", "<i8"),
        ("change", "<i8"),
        ("next_tick", "<i8"),  # time of the next match by the interval
        ("place_told", "<i8"),  # place of the last match
        # search
        ("exclusion", "<i8"),  # width of the zone around the best place
        ("places", "<i8"),  # number of sums that are searched
        ("least_trust", "<i8"),  # of a match that is not lost
        # place filter
        ("window_end", "<i8"),  # of the present window: a time, or the number of an event
        ("usual", "<i8"),  # number of events in a window
        ("reciprocal", "<i8"),  # of the spread of the distances
        ("place", "<i8"),  # of the window before
        ("trust", "<i8"),
        # events
        ("off_slots", "<i8"),  # first slot of OFF events
        ("floor", "<i8"),  # earliest time that the next event may have
        ("now", "<i8"),  # T: all earlier events have been processed
    ]
)


class Followed(NamedTuple):
    """State of the kernel.

    Attributes
    ----------
    s : Sliding
    predicted : Predictions
        Of the place filter; of size 0 where sequences are matched.
    metric : ndarray of int32, shape (K,)
        Scratch of the place filter.
    control : ndarray of CONTROL, shape (1,)
    trust : ndarray of int64, shape (m,)
    probability : ndarray of float64, shape (m,)
        Steps of `edge_vpr.confidence.Confidence`; of size 0 where nothing is known.
    table : ndarray of int16 or int32, shape (height, width)
        Of `PixelMap.table`.
    slots : ndarray of int32, shape (FEW,)
    times : ndarray of int64, shape (FEW,)
        Scratch for the events of one call.
    out : ndarray of MATCH_DTYPE, shape (MATCHES_AT_ONCE,)
        Matches are written here.
    """

    s: Sliding
    predicted: Predictions
    metric: Metrics
    control: npt.NDArray[np.void]
    trust: npt.NDArray[np.int64]
    probability: npt.NDArray[np.float64]
    table: npt.NDArray[np.signedinteger]
    slots: npt.NDArray[np.int32]
    times: npt.NDArray[np.int64]
    out: npt.NDArray[np.void]

    @classmethod
    def begin(cls, reference: ReferenceMap, s: Sliding, schedule: MatchSchedule) -> Followed:
        """Build the state before the first event.

        Parameters
        ----------
        reference : ReferenceMap
        s : Sliding
            Of this map.
        schedule : MatchSchedule
            When to give a match.
        """
        settings, judge = reference.settings, reference.judge
        control = np.zeros(1, dtype=CONTROL).view(np.recarray)
        first = control[0]
        first.every, first.interval = schedule.events, schedule.interval_us
        first.change, first.exclusion = schedule.change, settings.exclusion
        first.next_tick, first.place_told = schedule.interval_us, -1
        first.window_end, first.place = NEVER, -1
        first.least_trust = -2 * TIME_LIMIT_US
        first.off_slots = len(reference.pixel_map) if settings.polarity else 0
        trust, probability = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.float64)
        if judge.confidence is not None:
            # copies, because for Numba a read-only array is of another type
            trust, probability = judge.confidence.trust.copy(), judge.confidence.probability.copy()
            if judge.precision is not None:
                first.least_trust = judge.confidence.least_trust(judge.precision)
        places = len(reference) if settings.matching == "filter" else 0
        moving, quiet, metric = np.zeros((3, places), dtype=np.int32)
        return cls(
            s,
            Predictions(moving, quiet, np.zeros(metric.size, dtype=np.bool_)),
            metric,
            control,
            trust,
            probability,
            reference.pixel_map.table(),
            np.empty(FEW, dtype=np.int32),
            np.empty(FEW, dtype=np.int64),
            np.zeros(MATCHES_AT_ONCE, dtype=MATCH_DTYPE),
        )
