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
from edge_vpr.events import TIME_LIMIT_US, Columns
from edge_vpr.recordings.reading import FaultLog

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


class Named(NamedTuple):
    """Columns of a table, found by their names.

    Attributes
    ----------
    fields : dict of str to str
        Names of the columns t, x, y and perhaps p in the table.
    unit : {"s", "ms", "us", "ns"} or None
        Unit of the times, if their name states it.
    """

    fields: dict[str, str]
    unit: str | None


class ArrayColumns(NamedTuple):
    """Columns of an array of events: fields of a structured array, or column numbers.

    Attributes
    ----------
    fields : dict of str to (str or int)
        Of t, x, y and perhaps p.
    unit : {"s", "ms", "us", "ns"} or None
        Unit of the times, if the name of their field states it.
    """

    fields: Mapping[str, str | int]
    unit: str | None

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
        matched = match_columns(dtype.names, order)
        if matched is None:
            raise RecordingError(
                f"{name} has the fields {', '.join(dtype.names)}, and not "
                "t, x, y, p: name all of them in their order with columns="
            )
        return ArrayColumns({**matched.fields}, matched.unit)
    if len(shape) == 2 and dtype.kind in "iuf":
        wanted = order or ("txy" if shape[1] == 3 else "txyp")
        if shape[1] == len(wanted):
            fields = {each: i for i, each in enumerate(wanted) if each != "-"}
            return ArrayColumns(fields, None)
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
        Order of the columns, as ``"txyp"``, which overrides their names.

    Raises
    ------
    RecordingError
        If there are times in several units, which may be the parts of one time.
    UsageError
        If `order` has another number of columns.
    """
    names = list(names)
    if order is not None:
        if len(order) != len(names):
            raise UsageError(
                f"columns {order!r} name {len(order)} columns, and there are {len(names)} "
                f"({', '.join(names)}): name all of them, with - for those to leave out"
            )
        ordered = dict(zip(order, names, strict=True))
        unit = _parse_name(ordered["t"])[1]
        return Named({column: ordered[column] for column in "txyp" if column in ordered}, unit)
    names_of: dict[str, tuple[int, str]] = {}
    times: dict[str, str] = {}
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        base, unit = _parse_name(name)
        whose, part = ("", UNITS.get(base)) if unit is None else (base, unit)
        if part is not None:
            parts.setdefault(whose, {})[part] = name
        for column, aliases in ALIASES.items():
            if base in aliases:
                names_of[column] = min(names_of.get(column, (99, "")), (aliases.index(base), name))
                if column == "t" and unit is not None:
                    times[name] = unit
    fields = {column: name for column, (_, name) in names_of.items()}
    if {"x", "y"} <= fields.keys() and fields.get("t") in (None, *times):
        _refuse_parts(parts.values())
    if len(set(times.values())) > 1:
        raise RecordingError(
            f"the columns {', '.join(times)} are all times: leave out all but one, or in text name "
            "the order of all columns with columns="
        )
    if not {"t", "x", "y"} <= fields.keys():
        return None
    return Named(fields, times.get(fields["t"]))


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


def microseconds(
    times: npt.NDArray[Any], unit: str | None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Express times of any dtype as whole microseconds.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Integers, floating-point numbers, datetime64 or timedelta64.
    unit : {"s", "ms", "us", "ns"} or None
        With None, whole numbers are microseconds. datetime64 and timedelta64 have their own unit.

    Returns
    -------
    us : ndarray of int64, shape (n,)
        0 if there is no time.
    valid : ndarray of bool, shape (n,)
        False for NaN, NaT, and times beyond 2**60 us.

    Notes
    -----
    Seconds are rounded to the nearest microsecond. Times since 1970 in float64 seconds have a
    resolution of 0.24 us, so that this gives the microsecond that was written. Nanoseconds are
    rounded down.
    """
    ns = Fraction(_NS_PER_UNIT[unit or "us"])
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
            valid = np.abs(scaled) <= TIME_LIMIT_US
        return np.where(valid, scaled, 0).astype(np.int64), valid
    # no product may overflow: 2**60 us leaves 3 bits
    longest = math.floor(min(TIME_LIMIT_US / scale, Fraction(2**62, scale.numerator)))
    valid = times <= longest
    if times.dtype.kind != "u":
        valid &= times >= -longest
    if missing is not None:
        valid &= ~missing
    whole = np.where(valid, times, times.dtype.type(0)).astype(np.int64)
    return whole * scale.numerator // scale.denominator, valid


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
    if columns["t"].dtype.kind == "f":
        _check_float_times(log.path, columns["t"].dtype, unit)
    try:
        t, timed = microseconds(columns["t"], unit)
    except ValueError as error:
        raise RecordingError(f"{log.path}: {error}: save microseconds") from error
    good = timed.copy()
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
        what = (
            f"entry {entry + first:,} is no event ({values}): x, y are whole, and t lies "
            "within 2**60 us; check time_unit= and columns="
        )
        log.unreadable(int(np.count_nonzero(~good)), what)
        columns = {name: column[good] for name, column in columns.items()}
        t = t[good]
    x, y = (
        columns[name].astype(np.int64) if columns[name].dtype.kind in "fb" else columns[name]
        for name in "xy"
    )
    return Columns(t, x, y, on_events(columns["p"], log.path))


def _check_float_times(path: Path, dtype: np.dtype[Any], unit: str | None) -> None:
    """Refuse floating-point times of no stated unit, or with too few digits."""
    if unit is None:
        raise no_unit(path, f"are {dtype}")
    if dtype.itemsize < 8:
        raise RecordingError(
            f"{path}: the times are {dtype}, which has too few digits for microseconds: save them "
            "as float64, or as whole numbers"
        )


def no_unit(path: Path, what: str) -> RecordingError:
    """Return the error of times that are no whole numbers, and whose unit is not stated."""
    return RecordingError(
        f"{path}: the times {what}, and no unit is stated: pass time_unit=, one of s, ms, us and ns"
    )


def on_events(polarity: npt.NDArray[Any], path: Path) -> npt.NDArray[np.bool_]:
    """Return which events are ON: those of polarity 1; 0 and -1 are OFF."""
    # a byte of a file may be neither 0 nor 1, which NumPy does not handle in booleans
    if polarity.dtype.kind == "b":
        return np.asarray(np.ascontiguousarray(polarity).view(np.uint8) > 0)
    on = np.asarray(polarity == 1)
    other = ~(on | (polarity == 0) | (polarity == -1))
    if other.any():
        raise RecordingError(
            f"{path}: an event has the polarity {polarity[other][0]}, which is 1 for ON, and 0 or "
            "-1 for OFF: write it so, or leave the column out with columns= (txy- for example)"
        )
    return on
