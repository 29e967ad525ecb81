"""Entries of a log of positions: in order of time, one a time, and each within reach."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.tracks import Floats, distances
from edge_vpr.route import Kind

Bools = npt.NDArray[np.bool_]

#: a fix that needs a higher speed than this is left out: 360 km/h
MOST_MPS = 100.0


class Fixes(NamedTuple):
    """Positions as a file has them, in its order."""

    time_us: npt.NDArray[np.int64]  #: Shape (n,).
    position: Floats  #: Shape (n, d); rows that are not finite are unknown.
    kind: Kind
    start_utc: dt.datetime | None  #: The instant of time 0, where the log states a date.
    dropped: Counter[str]  #: How many entries were left out before, by reason.
    entries: int  #: Those included.


def in_order(fixes: Fixes) -> Fixes:
    """Return the first fix of each time, without unknown positions; count the rest.

    Raises
    ------
    GroundTruthError
        If time runs backwards, or nothing is left.
    """
    positioned = np.isfinite(fixes.position).all(axis=1)
    rows = np.flatnonzero(positioned)
    if not rows.size:
        raise GroundTruthError("no entry has a time and a position")
    first = np.sort(np.unique(fixes.time_us[rows], return_index=True)[1])
    dropped = fixes.dropped + Counter(
        {
            "no position": int((~positioned).sum()),
            "a time that another has": rows.size - first.size,
        }
    )
    rows = rows[first]
    time = fixes.time_us[rows]
    back = np.flatnonzero(np.diff(time) < 0)
    if back.size:
        at = int(back[0])
        raise GroundTruthError(
            f"time runs backwards by {(time[at] - time[at + 1]) / 1e6:,.12g} s at entry "
            f"{rows[at + 1] + 1}: keep the part that belongs to this drive, in order of time"
        )
    return fixes._replace(time_us=time, position=fixes.position[rows], dropped=+dropped)


def within_reach(fixes: Fixes) -> Fixes:
    """Return the fixes between which no step needs more than 100 m/s; count the others.

    The longest unbroken run of fixes is kept, and before and behind it each fix that is within
    reach of the one kept last. 0 N 0 E is what receivers write without a fix.

    Raises
    ------
    GroundTruthError
        If more than half of the fixes are out of reach.
    """
    at_zero = (fixes.kind == "geographic") & (fixes.position == 0.0).all(axis=1)
    if not at_zero.all():
        fixes = _without(fixes, "0 N 0 E", at_zero)
    time_s, position = fixes.time_us / 1e6, fixes.position
    step_m = distances(fixes.kind, position[1:], position[:-1])
    breaks = np.flatnonzero(step_m > MOST_MPS * np.diff(time_s))
    first, last = np.append(0, breaks + 1), np.append(breaks, time_s.size - 1)
    longest = int(np.argmax(last - first))
    kept = np.zeros(time_s.size, dtype=np.bool_)
    kept[first[longest] : last[longest] + 1] = True
    for runs, near, far in (
        (range(longest + 1, first.size), first, last),
        (range(longest - 1, -1, -1), last, first),
    ):
        at = far[longest]
        for run in runs:
            reach_m = MOST_MPS * abs(time_s[near[run]] - time_s[at])
            if distances(fixes.kind, position[near[run]], position[at]) <= reach_m:
                kept[first[run] : last[run] + 1] = True
                at = far[run]
    if 2 * int(kept.sum()) < kept.size:
        raise GroundTruthError(
            f"{int((~kept).sum())} of {kept.size} positions need more than {MOST_MPS:g} m/s from "
            "the others: give metres, or degrees as latitude,longitude, and times in seconds or "
            "with their unit in the header"
        )
    return _without(fixes, f"more than {MOST_MPS:g} m/s", ~kept)


def _without(fixes: Fixes, why: str, wrong: Bools) -> Fixes:
    kept = ~wrong
    return fixes._replace(
        time_us=fixes.time_us[kept],
        position=fixes.position[kept],
        dropped=fixes.dropped + Counter({why: int(wrong.sum())}),
    )
