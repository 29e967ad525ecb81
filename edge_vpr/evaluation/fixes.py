"""Entries of a log of positions, and detection of impossible ones: frozen, too fast, late."""

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


class Fixes(NamedTuple):
    """Positions as a file has them, in its order."""

    time_us: npt.NDArray[np.int64]  #: Shape (n,).
    position: Floats  #: Shape (n, d); rows that are not finite are unknown.
    kind: Kind
    start_utc: dt.datetime | None  #: The instant of time 0, where the log states a date.
    dropped: Counter[str]  #: How many entries were left out before, by reason.
    entries: int  #: Those included.
    notes: tuple[str, ...] = ()  #: Reasons to doubt the log.


#: entries that are earlier than the one before by up to this are sorted
LATE_US = 2_000_000


def in_order(fixes: Fixes) -> Fixes:
    """Return fixes in time order, one for each time, without unknown positions; count the rest.

    Raises
    ------
    GroundTruthError
        If time runs backwards by more than two seconds, or nothing is left.
    """
    time, position, dropped = fixes.time_us, fixes.position, fixes.dropped.copy()
    back = np.maximum.accumulate(time) - time if time.size else time
    if (back > LATE_US).any():
        row = int(np.argmax(back > LATE_US))
        raise GroundTruthError(
            f"time runs backwards by {back[row] / 1e6:g} s at point {row + 1}: split the log there "
            "and use the part of this traverse"
        )
    known = np.isfinite(position).all(axis=1)
    dropped["no position"] += int((~known).sum())
    rows = np.flatnonzero(known)
    rows = rows[np.argsort(time[rows], kind="stable")]
    again = np.diff(time[rows], prepend=np.iinfo(np.int64).min) == 0
    dropped["a time that another has"] += int(again.sum())
    rows = rows[~again]
    if not rows.size:
        raise GroundTruthError("no entry has a time and a position")
    return fixes._replace(time_us=time[rows], position=position[rows], dropped=+dropped)


# Fixes that a drive cannot have.

#: Bounds of the speed limit of a drive, which is three times the lower quartile of its speeds:
#: 180 km/h, and the fastest trains and small aircraft.
_SPEEDS_MPS = (50.0, 300.0)
#: Errors of satellite navigation between buildings, which are no reason to leave a fix out.
_ERROR_M = 20.0
#: A position that repeats was frozen if the step after it is longer than this, and so many times as
#: fast as the median of all steps.
_FROZEN_M, _FROZEN_FASTER = 10.0, 3.0
#: with fewer fixes, it cannot be decided which are correct
_FEWEST = 5
#: number of earlier runs among which a predecessor of a run is searched
_LOOK_BACK = 256


def possible(fixes: Fixes) -> Fixes:
    """Return the fixes that one drive can have, and count the others by reason.

    Left out are 0 N 0 E, repeats of a position before a step that is too fast (a frozen receiver),
    and fixes that cannot be reached from the others. Where fixes contradict each other, the larger
    group is kept.

    Raises
    ------
    GroundTruthError
        If fewer than half of the fixes can belong to one drive.
    """
    fixes = _without(fixes, "0 N 0 E", _of_null_island(fixes))
    fixes = _without(fixes, "a frozen position", _frozen(fixes))
    if fixes.time_us.size < _FEWEST:
        return fixes
    reached = _reached(fixes)
    if 2 * int(reached.sum()) < reached.size:
        raise GroundTruthError(
            f"{int((~reached).sum())} of {reached.size} positions cannot be reached from the "
            f"others at {_SPEEDS_MPS[1]:g} m/s: give positions in metres, or in degrees as "
            "latitude,longitude, and times in seconds or with their unit"
        )
    return _without(fixes, "a position that cannot be reached", ~reached)


def _without(fixes: Fixes, why: str, wrong: Bools) -> Fixes:
    if not wrong.any() or wrong.all():
        return fixes
    dropped = fixes.dropped + Counter({why: int(wrong.sum())})
    kept = ~wrong
    return fixes._replace(
        time_us=fixes.time_us[kept], position=fixes.position[kept], dropped=dropped
    )


def _of_null_island(fixes: Fixes) -> Bools:
    if fixes.kind != "geographic":
        return np.zeros(fixes.time_us.size, dtype=np.bool_)
    return np.asarray((fixes.position == 0.0).all(axis=1))


def _speeds(fixes: Fixes) -> tuple[Floats, Floats]:
    """Return the length of each step in metres and its speed in m/s, shape (n - 1,)."""
    step = distances(fixes.kind, fixes.position[1:], fixes.position[:-1])
    return step, step / (np.diff(fixes.time_us) / 1e6)


def _frozen(fixes: Fixes) -> Bools:
    step, speed = _speeds(fixes)
    wrong = np.zeros(fixes.time_us.size, dtype=np.bool_)
    if not (step > 0).any():
        return wrong
    fast = (speed > _FROZEN_FASTER * np.median(speed[step > 0])) & (step > _FROZEN_M)
    for last in np.flatnonzero(fast).tolist():
        row = last
        while row > 0 and step[row - 1] == 0:
            row -= 1
        if last - row >= 2:  # three times the same
            wrong[row + 1 : last + 1] = True
    return wrong


def _reached(fixes: Fixes) -> Bools:
    """Return which fixes make the longest drive, a chain of runs each reachable from the last."""
    time_s, position = fixes.time_us / 1e6, fixes.position
    step, speed = _speeds(fixes)
    limit = float(np.clip(3 * np.quantile(speed, 0.25), *_SPEEDS_MPS))
    breaks = np.flatnonzero(step > _ERROR_M + limit * np.diff(time_s))
    if not breaks.size:
        return np.ones(time_s.size, dtype=np.bool_)
    first = np.concatenate([[0], breaks + 1])
    last = np.concatenate([breaks, [time_s.size - 1]])
    best = (last - first + 1).astype(np.int64)
    before = np.full(first.size, -1)
    for run in range(1, first.size):
        others = np.arange(max(0, run - _LOOK_BACK), run)
        away = distances(fixes.kind, position[last[others]], position[first[run]])
        open_ = away <= _ERROR_M + limit * (time_s[first[run]] - time_s[last[others]])
        if open_.any():
            from_ = others[open_][int(np.argmax(best[others[open_]]))]
            best[run] += best[from_]
            before[run] = from_
    kept = np.zeros(time_s.size, dtype=np.bool_)
    run = int(np.argmax(best))
    while run >= 0:
        kept[first[run] : last[run] + 1] = True
        run = int(before[run])
    return kept
