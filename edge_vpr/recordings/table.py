"""Tables of events (npz, npy, csv, parquet, HDF5): names of columns, units of time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.recordings.reading import Columns, FaultLog, unit_remedy

#: Other names of the columns in published files.
ALIASES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps", "t_us", "time_us"),
    "x": ("x", "xs", "col", "column", "x_coordinate", "x_coordinates"),
    "y": ("y", "ys", "row", "y_coordinate", "y_coordinates"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}

_NS_PER_UNIT = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
_NS_PER_DATETIME = {
    "W": Fraction(604_800_000_000_000),
    "D": Fraction(86_400_000_000_000),
    "h": Fraction(3_600_000_000_000),
    "m": Fraction(60_000_000_000),
    **{name: Fraction(ns) for name, ns in _NS_PER_UNIT.items()},
    "ps": Fraction(1, 10**3),
    "fs": Fraction(1, 10**6),
    "as": Fraction(1, 10**9),
}
#: Coordinates must be whole numbers below this.
_FARTHEST = float(1 << 31)


def match_columns(names: Iterable[str]) -> dict[str, str] | None:
    """Map t, x, y (and p, if present) to the names in a table; None if one of t, x, y is absent."""
    by_lower = {name.strip().lower(): name for name in names}
    found = {}
    for column, aliases in ALIASES.items():
        for alias in aliases:
            if alias in by_lower:
                found[column] = by_lower[alias]
                break
    return found if {"t", "x", "y"} <= found.keys() else None


def microseconds(
    times: npt.NDArray[Any], unit: str | None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Express times of any dtype as whole microseconds.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Integers, floating-point numbers, datetime64 or timedelta64.
    unit : {"s", "ms", "us", "ns"} or None
        With None, floating-point times are in seconds and whole numbers in microseconds, as in the
        published data sets. datetime64 and timedelta64 have their own unit.

    Returns
    -------
    us : ndarray of int64, shape (n,)
        0 if there is no time.
    known : ndarray of bool, shape (n,)
        False for NaN, NaT, and times beyond 2**60 us.

    Raises
    ------
    ValueError
        If the dtype holds no times, or is in months or years.

    Notes
    -----
    Seconds are rounded to the nearest microsecond. Times since 1970 in float64 seconds have a
    resolution of 0.24 us, so that this gives the microsecond that was written. Nanoseconds are
    rounded down.
    """
    ns = Fraction(_NS_PER_UNIT[unit or ("s" if times.dtype.kind == "f" else "us")])
    missing = None
    if times.dtype.kind in "mM":
        name, count = np.datetime_data(times.dtype)
        if name not in _NS_PER_DATETIME:
            raise ValueError(f"times of dtype {times.dtype} have no unit of fixed length")
        ns, missing = _NS_PER_DATETIME[name] * count, np.isnat(times)
        times = np.ascontiguousarray(times).view(f"{times.dtype.byteorder}i8")
    scale = ns / 1_000
    if times.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            scaled = np.rint(times.astype(np.float64) * float(scale))
            known = np.abs(scaled) <= TIME_LIMIT_US
        return np.where(known, scaled, 0).astype(np.int64), known
    # no product may overflow: 2**60 us leaves 3 bits
    longest = math.floor(min(TIME_LIMIT_US / scale, Fraction(2**62, scale.numerator)))
    known = times <= longest
    if times.dtype.kind != "u":
        known &= times >= -longest
    if missing is not None:
        known &= ~missing
    whole = np.where(known, times, times.dtype.type(0)).astype(np.int64)
    return whole * scale.numerator // scale.denominator, known


def tidy(
    columns: dict[str, npt.NDArray[Any]], unit: str | None, log: FaultLog, entry: int
) -> Columns:
    """Convert columns of any dtype to integers, without the rows that hold no number.

    Parameters
    ----------
    columns : dict of ndarray, each of shape (n,)
        ``t``, ``x``, ``y`` and perhaps ``p`` (all ON if absent).
    unit : str or None
        See :func:`microseconds`.
    entry : int
        Index in the file of the first row, for messages.

    Raises
    ------
    RecordingError
        If a column holds anything other than real numbers or times, or `log` does not allow a
        fault.
    """
    if "p" not in columns:
        columns = columns | {"p": np.ones(columns["t"].shape, dtype=bool)}
    for name, column in columns.items():
        if column.dtype.kind not in ("iufmM" if name == "t" else "iufb") or column.ndim != 1:
            raise RecordingError(
                f"{log.path}: column {name} has dtype {column.dtype} and {column.ndim} "
                "dimensions: events need one whole number or fraction each"
            )
    try:
        t, known = microseconds(columns["t"], unit)
    except ValueError as error:
        raise RecordingError(f"{log.path}: {error}: save microseconds") from error
    good = known.copy()
    for name in "xyp":
        column = columns[name]
        if column.dtype.kind == "f":
            good &= np.isfinite(column)
            if name != "p":
                with np.errstate(invalid="ignore"):
                    good &= (column == np.floor(column)) & (np.abs(column) < _FARTHEST)
    if not good.all():
        first = int(np.flatnonzero(~good)[0])
        values = ", ".join(f"{name} = {column[first]}" for name, column in columns.items())
        what = f"entry {entry + first:,} is no event ({values})"
        if not known[first] and columns["t"].dtype.kind in "iuf":
            what += unit_remedy(columns["t"][first].item())
        log.unreadable(int(np.count_nonzero(~good)), what)
        columns = {name: column[good] for name, column in columns.items()}
        t = t[good]
    x, y = (
        columns[name].astype(np.int64) if columns[name].dtype.kind in "fb" else columns[name]
        for name in "xy"
    )
    return Columns(t, x, y, _on(columns["p"]))


def _on(polarity: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    # a byte of a file may be neither 0 nor 1, which NumPy does not handle in booleans
    if polarity.dtype.kind == "b":
        polarity = np.ascontiguousarray(polarity).view(np.uint8)
    return polarity > 0
