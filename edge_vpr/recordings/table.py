"""Tables of events (npz, npy, csv, parquet, HDF5): names of columns, units of time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import Columns

#: Other names that the columns go by in published files.
ALIASES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps", "t_us", "time_us"),
    "x": ("x", "xs", "col", "column", "x_coordinate"),
    "y": ("y", "ys", "row", "y_coordinate"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}

_NS_PER_UNIT = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


def match_columns(names: Iterable[str]) -> dict[str, str] | None:
    """Map t, x, y (and p, if there) to the names that a table uses; None if one is absent."""
    by_lower = {name.strip().lower(): name for name in names}
    found = {}
    for column, aliases in ALIASES.items():
        for alias in aliases:
            if alias in by_lower:
                found[column] = by_lower[alias]
                break
    return found if {"t", "x", "y"} <= found.keys() else None


def microseconds(times: npt.NDArray[Any], unit: str | None) -> npt.NDArray[np.int64]:
    """Express times of any dtype as whole microseconds.

    Parameters
    ----------
    times : ndarray
        Finite numbers.
    unit : {"s", "ms", "us", "ns"} or None
        None takes floating-point times as seconds, whole numbers as microseconds: what the
        published data sets do.

    Notes
    -----
    Seconds are rounded to the nearest microsecond. Times since 1970 in float64 seconds resolve
    0.24 us, so that this recovers the microsecond that was written. Nanoseconds round down.
    """
    if times.dtype.kind in "mM":
        times, unit = times.astype(f"{times.dtype.kind}8[ns]").view(np.int64), "ns"
    if times.dtype.kind == "f":
        scale = _NS_PER_UNIT[unit or "s"] / 1_000
        return np.rint(times.astype(np.float64) * scale).astype(np.int64)
    ns = _NS_PER_UNIT[unit or "us"]
    whole = times.astype(np.int64, copy=False)
    if ns == 1:
        return np.asarray(whole // 1_000)
    return whole if ns == 1_000 else whole * (ns // 1_000)


def tidy(
    columns: dict[str, npt.NDArray[Any]], unit: str | None, log: FaultLog, entry: int
) -> Columns:
    """Turn columns of any dtype to integer ones, leaving out rows that hold no number.

    Parameters
    ----------
    columns : dict of ndarray, each of shape (n,)
        ``t``, ``x``, ``y`` and perhaps ``p`` (all ON if absent).
    unit : str or None
        See :func:`microseconds`.
    log : FaultLog
    entry : int
        Index in the file of the first row, for messages.
    """
    if "p" not in columns:
        columns = columns | {"p": np.ones(columns["t"].shape, dtype=bool)}
    bad = np.zeros(columns["t"].shape, dtype=bool)
    for name, column in columns.items():
        if column.dtype.kind == "f":
            bad |= ~np.isfinite(column)
            if name in "xy":
                bad |= column != np.floor(column)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        values = ", ".join(f"{name} = {column[first]}" for name, column in columns.items())
        log.unreadable(int(bad.sum()), f"entry {entry + first:,} is no event ({values})")
        columns = {name: column[~bad] for name, column in columns.items()}
    pixel = {
        name: columns[name].astype(np.int64) if columns[name].dtype.kind in "fb" else columns[name]
        for name in "xy"
    }
    return Columns(microseconds(columns["t"], unit), pixel["x"], pixel["y"], columns["p"] > 0)
