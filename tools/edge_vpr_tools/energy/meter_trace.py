"""Trace of an external meter, aligned with the windows of a profile by the steps of the load."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr_tools.energy.sampling import Floats, Window

#: Thresholds for a trace that follows the load: its correlation with the load in standard errors of
#: the readings, and the mean difference of the pairs in standard errors of the differences. Of 450
#: traces of noise, of random walks and of other steps, none passed; with 3 in place of 6, one in
#: five did.
_FOLLOWING, _PAIRS_HIGHER = 5.0, 6.0
#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 100_000, 1e6


def read_csv(path: Path) -> tuple[Floats, Floats]:
    """Read the times and watts that an external meter wrote.

    Parameters
    ----------
    path : path
        CSV with a header: a column of time in seconds (``time``, ``time_s``, ``timestamp``), and
        either one of power in watts (``power``, ``power_w``) or those of volts and amperes
        (``voltage``, ``current``, with or without ``_v`` and ``_a``).

    Returns
    -------
    time_s, watts : ndarray of float64, shape (n,)

    Raises
    ------
    UsageError
        If columns are missing, a cell is not a number, or time does not increase.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = [row for row in csv.reader(file) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise UsageError(
            f"cannot read a power trace from {path}: {error}: name a CSV with a header of time "
            "and power"
        ) from error
    names = [name.strip().lower() for name in header]
    values = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        try:
            values[i] = [float(cell) for cell, _ in zip(row, names, strict=True)]
        except ValueError:
            raise UsageError(
                f"cannot read a power trace from {path}, sample {i + 1}, {','.join(row)!r}: "
                f"expected {len(names)} numbers with commas between them, time in seconds"
            ) from None

    def column(*choices: str) -> Floats | None:
        found = next((names.index(name) for name in choices if name in names), None)
        return None if found is None else values[:, found]

    if len(values) < 2:
        raise UsageError(f"{path}: a power trace needs two samples or more")
    when, watts = column("time", "time_s", "timestamp"), column("power", "power_w")
    if watts is None:
        volts, amperes = column("voltage", "voltage_v"), column("current", "current_a")
        watts = None if volts is None or amperes is None else volts * amperes
    if when is None or watts is None:
        raise UsageError(
            f"{path} has the columns {', '.join(names)}: expected time_s, and power_w or both "
            "voltage_v and current_a"
        )
    if not (np.diff(when) > 0).all() or not np.isfinite(values).all():
        raise UsageError(f"{path}: time does not increase from row to row, or a cell is no number")
    return when, watts


def check_turns(windows: Sequence[Window]) -> None:
    """Raise ValueError unless the windows are consecutive pairs of idle and load.

    Parameters
    ----------
    windows : sequence of Window
        For example from a file.
    """
    if len(windows) % 2 or len(windows) > _MOST_WINDOWS:
        raise ValueError(f"{len(windows)} windows are no pairs")
    end = -math.inf
    for window in windows:
        times = type(window.load) is bool and type(window.matches) is int and window.matches >= 0
        if not times or not end <= window.start_s < window.end_s <= _MOST_S:
            raise ValueError(f"{window} is no span after {end:g} s")
        end = window.end_s
    if any(a.load == b.load for a, b in zip(windows[::2], windows[1::2], strict=True)):
        raise ValueError("a pair has two idle or two load windows")


def align(windows: Sequence[Window], time_s: Floats, watts: Floats) -> float:
    """Return by how much a meter's clock is ahead, from the steps of the load in its trace.

    Parameters
    ----------
    windows : sequence of Window
    time_s, watts : ndarray of float64, shape (n,)

    Returns
    -------
    float
        Seconds to be subtracted from `time_s`.

    Raises
    ------
    UsageError
        If the trace is shorter than the windows, or does not follow the load at any time.
    """
    start, end = windows[0].start_s, windows[-1].end_s
    span = end - start
    room = time_s[-1] - time_s[0] - span
    if room < 0:
        raise UsageError(
            f"the meter's trace of {time_s[-1] - time_s[0]:g} s is shorter than the measurement of "
            f"{span:g} s: let it run before and after"
        )
    step = min(0.05, span / 2_000)
    grid = np.arange(0.0, span, step)
    edges = np.array([window.start_s - start for window in windows])
    which = np.searchsorted(edges, grid, side="right") - 1
    loaded = np.array([window.load for window in windows], dtype=np.float64)[which]
    pattern = loaded - loaded.mean()
    fine = np.interp(np.arange(0.0, room + span, step), time_s - time_s[0], watts)
    scores = np.correlate(fine - fine.mean(), pattern, mode="valid")
    best = int(np.argmax(scores))
    part = fine[best : best + grid.size]
    if not _follows(part, pattern, which, span / float(np.median(np.diff(time_s)))):
        raise UsageError(
            "the meter's trace does not rise and fall with the load of the profile, at any time: "
            "is it of the same run, and of the board that ran it? If it is, take longer windows"
        )
    return float(time_s[0] + best * step - start)


def _follows(watts: Floats, pattern: Floats, window: npt.NDArray[np.intp], samples: float) -> bool:
    """Return whether power is higher in load windows by more than chance.

    Parameters
    ----------
    watts, pattern : ndarray of float64, shape (n,)
        Power, and the load minus its mean, at the same times.
    window : ndarray of int, shape (n,)
        Number of the window at each time.
    samples : float
        Number of the meter's readings in that time, from which `watts` was interpolated.
    """
    spread = float(watts.std() * pattern.std())
    if spread == 0 or float(np.mean(watts * pattern)) / spread * np.sqrt(samples) < _FOLLOWING:
        return False
    means = np.bincount(window, watts) / np.bincount(window)
    loaded = np.bincount(window, pattern) > 0
    # each two consecutive windows are a pair, in either order
    differences = np.where(loaded, means, -means).reshape(-1, 2).sum(axis=1)
    error = differences.std(ddof=1) / np.sqrt(differences.size) if differences.size > 1 else 0.0
    return bool(differences.mean() > _PAIRS_HIGHER * error)
