"""Tables of events (npz, npy, csv, parquet, HDF5): names of columns, units of time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.recordings.reading import Columns, FaultLog, unit_remedy

#: Other names of the columns in published files.
ALIASES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps", "time_stamp", "time_stamps"),
    "x": ("x", "xs", "col", "column", "x_coordinate", "x_coordinates"),
    "y": ("y", "ys", "row", "y_coordinate", "y_coordinates"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}
#: Names of the units of time.
UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(
        ("ms", "msec", "msecs", "milli", "millis", "millisecond", "milliseconds"), "ms"
    ),
    **dict.fromkeys(
        ("us", "usec", "usecs", "micro", "micros", "microsecond", "microseconds"), "us"
    ),
    **dict.fromkeys(
        ("ns", "nsec", "nsecs", "nano", "nanos", "nanosec", "nanosecond", "nanoseconds"), "ns"
    ),
}
_PIXELS = ("px", "pixel", "pixels")

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
#: Fewest rows from which the order of columns is told.
_FEWEST_ROWS = 20


class Named(NamedTuple):
    """Columns of a table, found by their names.

    Attributes
    ----------
    fields : dict of str to str
        Names of the columns t, x, y and perhaps p in the table.
    unit : {"s", "ms", "us", "ns"} or None
        Unit of the times, if their name states it.
    unused : list of str
        Names of further columns.
    """

    fields: dict[str, str]
    unit: str | None
    unused: list[str]


class ArrayColumns(NamedTuple):
    """Columns of an array of events: fields of a structured array, or column numbers.

    Attributes
    ----------
    fields : dict of str to (str or int)
        Of t, x, y and perhaps p.
    unit : {"s", "ms", "us", "ns"} or None
        Unit of the times, if the name of their field states it.
    unused : list of str
        Names of further fields.
    """

    fields: Mapping[str, str | int]
    unit: str | None
    unused: list[str]

    def of(self, rows: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """Return the columns of rows of the array, as views."""
        return {
            name: rows[field] if isinstance(field, str) else rows[:, field]
            for name, field in self.fields.items()
        }


def array_columns(
    name: str, dtype: np.dtype[Any], shape: tuple[int, ...], order: str | None
) -> ArrayColumns:
    """Find the columns of an array of events by its dtype and shape.

    Parameters
    ----------
    name : str
        Of the array, for messages.
    order : str, optional
        Order of the columns, as ``"xytp"``; "-" leaves one out.

    Raises
    ------
    RecordingError
        If the array holds no events.
    """
    if dtype.names is not None and len(shape) == 1:
        found = match_columns(dtype.names, order)
        if found is None:
            raise RecordingError(
                f"{name} has the fields {', '.join(dtype.names)}, and not "
                "t, x, y, p: name all of them in their order with columns="
            )
        return ArrayColumns({**found.fields}, found.unit, found.unused)
    if len(shape) == 2 and dtype.kind in "iuf":
        wanted = order or ("txy" if shape[1] == 3 else "txyp")
        if shape[1] == len(wanted):
            fields = {each: i for i, each in enumerate(wanted) if each != "-"}
            return ArrayColumns(fields, None, [])
        if shape[0] == len(wanted):
            raise RecordingError(f"{name} has shape {shape}, a row a column: transpose it (.T)")
    raise RecordingError(
        f"{name} has shape {shape} and dtype {dtype}, which are no events: "
        "save a structured array with fields t, x, y, p, or columns in that order (or columns=)"
    )


def match_columns(names: Iterable[str], order: str | None = None) -> Named | None:
    """Find t, x, y (and p, if present) among the names in a table; None if t, x or y is absent.

    Names may state a unit, as in ``timestamp [us]``, ``t_ns`` or ``timeMs``.

    Parameters
    ----------
    order : str, optional
        Order of the columns if their names are not known, as ``"txyp"``.

    Raises
    ------
    RecordingError
        If there are times in several units, which may be the parts of one time.
    """
    names = list(names)
    found: dict[str, tuple[int, str]] = {}
    times: dict[str, str] = {}
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        base, unit = _parse_name(name)
        whose, part = ("", UNITS.get(base)) if unit is None else (base, unit)
        if part is not None:
            parts.setdefault(whose, {})[part] = name
        for column, aliases in ALIASES.items():
            if base in aliases:
                found[column] = min(found.get(column, (99, "")), (aliases.index(base), name))
                if column == "t" and unit is not None:
                    times[name] = unit
    fields = {column: name for column, (_, name) in found.items()}
    if {"x", "y"} <= fields.keys() and fields.get("t") in (None, *times):
        _refuse_parts(parts.values())
    if len(set(times.values())) > 1:
        raise RecordingError(
            f"the columns {', '.join(times)} are all times: leave out all but one, or in text name "
            "the order of all columns with columns="
        )
    known = {"t", "x", "y"} <= fields.keys()
    if order is not None and len(order) == len(names) and not (known and "p" in fields):
        given = zip(order, names, strict=True)
        return Named({column: name for column, name in given if column != "-"}, None, [])
    if not known:
        return None
    unused = [name for name in names if name and name not in fields.values()]
    return Named(fields, times.get(fields["t"]), unused)


def _refuse_parts(times: Iterable[dict[str, str]]) -> None:
    """Raise RecordingError if a time is in two columns, of seconds and of their fractions.

    Parameters
    ----------
    times : iterable of dict of str to str
        Of each, the columns by their units.
    """
    for columns in times:
        unit = next((unit for unit in ("ns", "us", "ms") if unit in columns), None)
        if unit is not None and "s" in columns:
            whole, rest = columns["s"], columns[unit]
            raise RecordingError(
                f"the columns {whole}, {rest} are the parts of one time: write one column t_{unit} "
                f"= {10**9 // _NS_PER_UNIT[unit]} * {whole} + {rest} in their place (if each is a "
                "whole time, leave one out)"
            )


def _parse_name(name: str) -> tuple[str, str | None]:
    """Return the name of a column in lower case without its unit, and the unit of time."""
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip("\ufeff#%\"' "))
    name, *brackets = re.split(
        r"[\[({<]", name.lower().replace("\u00b5", "u").replace("\u03bc", "u")
    )
    words = [word for word in re.split(r"[\s_./:\-]+", name) if word]
    last = re.sub(r"[^a-z]", "", brackets[0]) if brackets else ""
    if len(words) > 1 and (words[-1] in UNITS or words[-1] in _PIXELS):
        last = words.pop()
    return "_".join(words), UNITS.get(last)


def likely_order(rows: npt.NDArray[np.float64]) -> str:
    """Return the likely order of the columns of a table without names.

    Parameters
    ----------
    rows : ndarray, shape (n, k)
        First rows of the table.

    Returns
    -------
    str
        As ``"xytp"``, with "-" for a column that counts the rows; "" if the rows fit
        ``t, x, y, p``, or do not show the order.
    """
    n, k = rows.shape
    if n < _FEWEST_ROWS or not 3 <= k <= 5:
        return ""
    steps = np.diff(rows, axis=0)
    rises = (steps >= 0).all(axis=0) & (rows[-1] > rows[0])
    order = ["-" if k > 3 and (each == 1).all() and rises.sum() > 1 else "" for each in steps.T]
    times = [i for i in range(k) if rises[i] and not order[i]]
    if not times:
        return ""
    order[max(times, key=lambda i: float(rows[-1, i]))] = "t"
    left = [i for i in range(k) if not order[i]]
    if len(left) > 3:
        return ""
    if len(left) == 3:
        two = [i for i in left if np.unique(rows[:, i]).size <= 2]
        if len(two) != 1:
            return ""
        order[two[0]] = "p"
    for i, name in zip((i for i in range(k) if not order[i]), "xy", strict=True):
        order[i] = name
    found = "".join(order)
    return "" if found == "txyp"[:k] else found


def check_order(path: Path, rows: npt.NDArray[Any]) -> None:
    """Refuse rows of a table without names whose columns seem to be in another order than txyp.

    Raises
    ------
    UsageError
        With the likely order.
    """
    if order := likely_order(rows.astype(np.float64)):
        raise UsageError(
            f"{path} names no columns, and they do not look like {', '.join('txyp'[: len(order)])} "
            f"but like {', '.join(order)}: pass columns='{order}', or the order that they have"
        )


def usual_unit(times: npt.NDArray[Any]) -> str:
    """Return the unit of the first times of a table that does not state it: "s" or "us".

    Whole numbers are microseconds. As floats they are too if they span 100 or more: events are not
    seconds apart. (Of float32, they may be seconds since 1970 without their fraction.)
    """
    if times.dtype.kind != "f":
        return "us"
    times = times[np.isfinite(times)]
    whole = times.dtype.itemsize > 4 and bool((times == np.floor(times)).all())
    return "us" if whole and times.size and np.ptp(times) >= 100 else "s"


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
        log.without_polarity = True
        columns = columns | {"p": np.ones(columns["t"].shape, dtype=bool)}
    for name, column in columns.items():
        if column.dtype.kind not in ("iufmM" if name == "t" else "iufb") or column.ndim != 1:
            raise RecordingError(
                f"{log.path}: column {name} has dtype {column.dtype} and shape {column.shape}: "
                f"give one number an event, of text or objects {name}.astype(float)"
            )
    if unit is None and columns["t"].dtype.kind in "iuf":
        unit = log.assumed_unit = log.assumed_unit or usual_unit(columns["t"])
        log.times_are_float32 = columns["t"].dtype in (np.dtype("<f4"), np.dtype(">f4"))
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
        what = f"entry {entry + first:,} is no event ({values}; x and y are whole numbers)"
        if not known[first] and columns["t"].dtype.kind in "iuf":
            what += unit_remedy(columns["t"][first].item())
        log.unreadable(int(np.count_nonzero(~good)), what, good.size)
        columns = {name: column[good] for name, column in columns.items()}
        t = t[good]
    x, y = (
        columns[name].astype(np.int64) if columns[name].dtype.kind in "fb" else columns[name]
        for name in "xy"
    )
    return Columns(t, x, y, on_events(columns["p"], log))


def on_events(polarity: npt.NDArray[Any], log: FaultLog) -> npt.NDArray[np.bool_]:
    """Return which events are ON: those whose polarity is above 0.

    If the first events have several values above 0 (1 and 2, or 255 for -1), a remark says so.
    """
    # a byte of a file may be neither 0 nor 1, which NumPy does not handle in booleans
    if polarity.dtype.kind == "b":
        polarity = np.ascontiguousarray(polarity).view(np.uint8)
    on = np.asarray(polarity > 0)
    if log.entries == 0 and on.any():
        values = np.unique(polarity[on])
        if values.size > 1:
            log.remark(
                f"polarity has the values {', '.join(f'{v:g}' for v in values[:5].tolist())}, and "
                "each above 0 is ON: counts of events are right, but for shares of ON and for "
                "polarity= write OFF as 0 or -1"
            )
    return on
