"""The trace of an external meter: columns and units as its header or the user states them."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from io import TextIOWrapper
from itertools import islice
from operator import mul
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.files import open_input
from edge_vpr_tools.profile.measurement import LEAST_PAIRS, Floats, Window

#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 10_000, 1e6
#: lines before the header, in which programs describe themselves
_MOST_PREFACE = 50
#: seconds or watts that no meter writes, far below what sums of them may reach
_TOO_LARGE = 1e100
#: SCPI-99 writes 9.9E37 for a reading beyond the range, and 9.91E37 for no reading
_NO_READING = 9.9e37
_MOST_VOLTS = 60.0

#: Factors to SI units. ``iso`` is a date and time by ISO 8601.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "iso": 1.0},
    "power": {"w": 1.0, "mw": 1e-3, "uw": 1e-6},
    "current": {"a": 1.0, "ma": 1e-3, "ua": 1e-6, "na": 1e-9},
    "voltage": {"v": 1.0, "mv": 1e-3, "uv": 1e-6},
}
_QUANTITY = {unit: quantity for quantity, units in _UNITS.items() for unit in units}
#: A unit ends the name of a column: in brackets, or behind an underline.
_UNIT = re.compile(r"[(\[{]\s*(\w+)\s*[)\]}]$|_([^\W_]+)$")


class Column(NamedTuple):
    """A column of a meter's file."""

    name: str
    unit: str  #: In lower case; "" if not stated.

    @property
    def quantity(self) -> str:
        """What the unit measures; "" without a unit that is read."""
        return _QUANTITY.get(self.unit, "")

    @classmethod
    def parse(cls, text: str) -> Column:
        """Read a column as a flag states it: NAME, or NAME:UNIT."""
        name, colon, unit = text.rpartition(":")
        if colon and _plain(unit) in _QUANTITY:
            return cls(name.strip(), _plain(unit))
        return cls(text.strip(), "")

    @classmethod
    def of_header(cls, cell: str) -> Column:
        """Read a column as a header names it."""
        name = cell.strip(" #\r\n")
        unit = _UNIT.search(_plain(name))
        return cls(name, "" if unit is None else unit[1] or unit[2])


class Stated(NamedTuple):
    """What the user states about a meter's file, each as on the command line."""

    time: str | None = None  #: Column of times.
    power: str | None = None
    current: str | None = None
    voltage: str | None = None  #: Column, or volts as a number.
    #: The meter's time at which the first loaded period begins, as the file writes its times.
    first_load: str | None = None


class MeterTrace(NamedTuple):
    """What a meter recorded."""

    time_s: Floats  #: Shape (n,), increasing; on the meter's clock.
    watts: Floats  #: Shape (n,).
    read_from: str  #: Names and units of the columns.
    no_reading: int  #: Samples that the meter marked as none, left out.
    #: Whether times count from 1970, by a time zone in the file.
    unix: bool
    #: The meter's time of the first load, as stated; None if it was not.
    first_load_s: float | None


def read_meter(path: Path, stated: Stated = Stated()) -> MeterTrace:  # noqa: B008, immutable
    """Read the times and watts that a meter's program exported.

    Parameters
    ----------
    path : path
        Text in UTF-8, UTF-16 with its mark, or Windows-1252, with commas, semicolons or tabs
        between its cells. Its header is the first line with a column of time. The name of a column
        ends with its unit: ``time_s``, ``Current (uA)``. Lines before the header are skipped.
    stated : Stated
        Columns and units that the header does not state, or of which it has several.

    Raises
    ------
    UsageError
        If a column or its unit is not stated, or several may be meant; if a cell is no number, or
        time does not increase.
    """
    try:
        with open_input(path) as file:
            encoding = _encoding_of(file.read(1 << 16))
            file.seek(0)
            lines = TextIOWrapper(file, encoding=encoding, errors="replace", newline="")
            delimiter, columns = _header(path, lines, stated.time)
            chosen, volts = _chosen(path, columns, stated)
            table = csv.reader(lines, delimiter=delimiter)
            rows = ([_decimal(cell, delimiter) for cell in row] for row in table)
            filled = (row for row in rows if any(row))
            samples = _samples(path, filled, columns, chosen, volts)
            read = np.fromiter(samples, np.dtype((np.float64, 3)))
    except (OSError, csv.Error) as error:
        raise UsageError(
            f"cannot read a power trace from {path}: {error}: name a CSV with a header of time and "
            "power"
        ) from error
    time_s, watts, zoned = read.T
    kept = np.abs(watts) < _NO_READING
    if np.count_nonzero(kept) < 2:
        raise UsageError(f"{path}: a power trace needs two samples or more")
    names = [f"{one.name!r} ({one.unit})" for one in chosen.values()]
    names += [] if volts is None else [f"{volts:g} V as stated"]
    unit, first = chosen["time"].unit, stated.first_load
    try:
        first_s = None if first is None else _time_s(first, unit)[0]
    except ValueError:
        raise UsageError(
            f"--first-load {first}: expected a time as {path} writes it in {chosen['time'].name!r}"
        ) from None
    unix = bool(zoned.all())
    return MeterTrace(
        time_s[kept], watts[kept], f"{', '.join(names[:-1])} and {names[-1]}",
        int(np.count_nonzero(~kept)), unix, first_s,
    )  # fmt: skip


def _plain(text: str) -> str:
    return text.replace("\u00b5", "u").replace("\u03bc", "u").strip().lower()


def _encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes; of Windows if it is none of Unicode."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _decimal(cell: str, delimiter: str) -> str:
    """Return a cell with a decimal point; where commas are between the cells, it has one."""
    return cell.strip() if delimiter == "," else cell.strip().replace(",", ".")


def _header(path: Path, lines: Iterable[str], time: str | None) -> tuple[str, list[Column]]:
    """Read lines up to the header; return the delimiter, and all columns."""
    name = None if time is None else Column.parse(time).name
    first = ""
    for line in islice(lines, _MOST_PREFACE):
        first = first or line.strip()
        delimiter = max(";\t,", key=line.count)
        columns = [
            Column.of_header(cell) for cell in next(csv.reader([line], delimiter=delimiter), [])
        ]
        if any(one.quantity == "time" if name is None else one.name == name for one in columns):
            return delimiter, columns
    missing = "no column of time with its unit, such as time_s" if name is None else f"no {name!r}"
    raise UsageError(
        f"{path} begins with {first[:80]!a}, and has {missing}: name the column and its unit, such "
        "as --time 'Timestamp:ms' (s, ms, us, ns, or iso)"
    )


def _chosen(
    path: Path, columns: Sequence[Column], stated: Stated
) -> tuple[dict[str, Column], float | None]:
    """Choose a column of time, and of power or of current and voltage; or volts as a number."""
    volts = _volts(stated.voltage)
    flags = {
        "time": stated.time, "power": stated.power, "current": stated.current,
        "voltage": None if volts is not None else stated.voltage,
    }  # fmt: skip

    def column(quantity: str) -> Column:
        """Return the only column of a quantity: as stated, or by the units of the header."""
        flag, units = f"--{quantity}", ", ".join(_UNITS[quantity])
        text = flags[quantity]
        if text is None:
            same = [one for one in columns if one.quantity == quantity]
        else:
            named = Column.parse(text)
            same = [
                one._replace(unit=named.unit or one.unit)
                for one in columns
                if one.name == named.name
            ]
        if len(same) != 1:
            names = ", ".join(repr(one.name) for one in same or columns)
            which = f"{len(same)} columns of {quantity}" if same else f"no column of {quantity}"
            which = which if text is None else f"{len(same)} columns {Column.parse(text).name!r}"
            raise UsageError(
                f"{path} has {which}: name one and its unit by {flag} NAME:UNIT ({units}), of "
                f"{names}"
            )
        if same[0].quantity != quantity:
            raise UsageError(
                f"{path}: the unit of its column {same[0].name!r} is none of {units}: state it, "
                f"such as {flag} '{same[0].name}:{units.split(', ')[0]}'"
            )
        return same[0]

    chosen = {"time": column("time")}
    powers = [one for one in columns if one.quantity == "power"]
    electric = stated.current is not None or stated.voltage is not None
    if stated.power is not None or (powers and not electric):
        return {**chosen, "power": column("power")}, None
    chosen["current"] = column("current")
    if volts is None:
        if stated.voltage is None and not any(one.quantity == "voltage" for one in columns):
            raise UsageError(
                f"{path} has time and current: state the supply in volts, such as --voltage 5"
            )
        chosen["voltage"] = column("voltage")
    return chosen, volts


def _volts(text: str | None) -> float | None:
    """Return volts if a flag states a number; None if it names a column."""
    try:
        volts = None if text is None else float(text)
    except ValueError:
        return None
    if volts is not None and not 0 < volts <= _MOST_VOLTS:
        raise UsageError(f"--voltage {text}: expected volts, such as 5, or the name of a column")
    return volts


def _samples(
    path: Path, rows: Iterable[Sequence[str]], columns: Sequence[Column],
    chosen: Mapping[str, Column], volts: float | None,
) -> Iterator[tuple[float, float, float]]:  # fmt: skip
    """Yield times, watts, and whether a time has a zone."""
    names = [one.name for one in columns]
    at = {quantity: names.index(one.name) for quantity, one in chosen.items()}
    factors = {
        at[quantity]: _UNITS[quantity][one.unit] for quantity, one in chosen.items()
        if quantity != "time"
    }  # fmt: skip
    unit, last = chosen["time"].unit, -math.inf
    for number, row in enumerate(rows, 1):
        try:
            when, zoned = _time_s(row[at["time"]], unit)
            values = [float(row[column]) for column in factors]
        except (ValueError, IndexError):
            raise UsageError(
                f"cannot read a power trace from {path}, sample {number}, {','.join(row)[:80]!r}: "
                f"expected a number in each column, and a time in {unit}; delete a row that is no "
                "sample"
            ) from None
        if not all(abs(value) < _TOO_LARGE for value in (when, *values)):
            raise UsageError(
                f"{path}, sample {number}: a cell is no number, or too large: delete such rows"
            )
        if when <= last:
            raise UsageError(
                f"{path}, sample {number}: its time is not later than that of the row above: "
                "export a time for each sample, in fractions of a second"
            )
        last = when
        watts = math.prod(map(mul, values, factors.values()), start=volts or 1.0)
        # a mark in one of two columns is no reading of power either
        marked = any(abs(value) >= _NO_READING for value in values)
        yield when, _NO_READING if marked else watts, float(zoned)


def _time_s(cell: str, unit: str) -> tuple[float, bool]:
    """Return a time in seconds, and whether it is one since 1970, by its zone."""
    if unit != "iso":
        return float(cell) * _UNITS["time"][unit], False
    when = datetime.fromisoformat(cell.replace("/", "-"))
    zoned = when.tzinfo is not None
    return (when if zoned else when.replace(tzinfo=UTC)).timestamp(), zoned


def check_turns(windows: Sequence[Window]) -> None:
    """Raise ValueError unless the windows are consecutive pairs of idle and load."""
    if len(windows) % 2 or not 2 * LEAST_PAIRS <= len(windows) <= _MOST_WINDOWS:
        raise ValueError(f"{len(windows)} windows are no {LEAST_PAIRS} pairs or more")
    end = -math.inf
    for window in windows:
        times = type(window.load) is bool and type(window.matches) is int and window.matches >= 0
        if not times or not end <= window.start_s < window.end_s <= _MOST_S:
            raise ValueError(f"{window} is no span after {end:g} s")
        end = window.end_s
    if any(a.load == b.load for a, b in zip(windows[::2], windows[1::2], strict=True)):
        raise ValueError("a pair has two idle or two load windows")


def ahead_s(trace: MeterTrace, windows: Sequence[Window], began_unix_s: float | None) -> float:
    """Return by how much the meter's clock is ahead of that of a profile.

    Parameters
    ----------
    began_unix_s : float, optional
        Time at which the first window began, since 1970.

    Raises
    ------
    UsageError
        If neither the user states it nor a time zone in the file.
    """
    first = next(window for window in windows if window.load)
    if trace.first_load_s is not None:
        return trace.first_load_s - first.start_s
    if trace.unix and began_unix_s is not None:
        return began_unix_s - windows[0].start_s
    raise UsageError(
        "the meter's times have no time zone: state the one at which its power first rises to that "
        "of the load, as the file writes it, by --first-load TIME"
    )
