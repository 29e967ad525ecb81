"""The trace of an external meter: its table, and its place among the windows of a profile.

Columns are found by their names and units. The clock of the meter is aligned with that of the
profile by the steps of the load.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.files import open_input
from edge_vpr_tools.profile.measurement import (
    LEAST_PAIRS,
    Floats,
    Trace,
    Window,
    too_slow,
    typical_s,
    varying_load,
)
from edge_vpr_tools.profile.sensors.sensor import MAX_WATTS

#: Random orders of idle and load that a trace has to fit worse than the true one, and places at
#: which they are tried in the length of a window. Of 1,500 traces of noise, of random walks and of
#: other steps beside 5 pairs, 5 passed, as many as 252 orders allow; of 300 that are switched on
#: and off at a constant period, 28 did, of nearly the period of the load.
_ORDERS, _PLACES_OF_WINDOW = 500, 20
#: energies that are looked up at a time
_MOST_CELLS = 1 << 22
#: median power of a trace above which its unit must be wrong: no board of this kind takes more
MAX_TRACE_WATTS = 500.0
#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 10_000, 1e6
#: a trace that seems longer has another unit of time
_MOST_TRACE_S = 7 * 86_400.0
_DAY_S = 86_400.0
#: lines before the header, in which programs describe themselves
_MOST_PREFACE = 50
#: seconds or watts that no meter writes, far below what sums of them may reach
_TOO_LARGE = 1e100

#: words in the name of a column, by the quantity that they mean
_QUANTITIES = {
    "time": "time timestamp datetime elapsed t",
    "date": "date",
    "power": "power watts watt p w",
    "voltage": "voltage volts volt u v",
    "current": "current amperes amps amp i a",
}
_WORDS = {word: quantity for quantity, words in _QUANTITIES.items() for word in words.split()}
_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600},
    "date": {},
    "power": {"w": 1.0, "watts": 1.0, "mw": 1e-3, "uw": 1e-6},
    "voltage": {"v": 1.0, "volts": 1.0, "mv": 1e-3, "uv": 1e-6},
    "current": {"a": 1.0, "amps": 1.0, "ma": 1e-3, "ua": 1e-6, "na": 1e-9},
}


_DIGIT = re.compile(r"\d")


class _Column(NamedTuple):
    """A column of a meter's file: its number, and what its name says."""

    at: int
    name: str
    quantity: str  #: "" if it is none that is needed.
    factor: float | None  #: To SI units, which are assumed without a unit; None: not known.

    @classmethod
    def of(cls, at: int, name: str) -> _Column:
        name = name.strip(" #\r\n")
        text = name.replace("\u00b5", "u").replace("\u03bc", "u").lower()
        outside, bracket, inside = re.sub(r"[\[{]", "(", text).partition("(")
        words = re.findall(r"[^\W\d_]+", outside)
        quantity = next((_WORDS[word] for word in words if word in _WORDS), "")
        units = _UNITS.get(quantity, {})
        if bracket:
            return cls(at, name, quantity, units.get(re.split(r"[)\]}]", inside)[0].strip()))
        return cls(at, name, quantity, next((units[word] for word in words if word in units), 1.0))


class MeterTrace(NamedTuple):
    """What a meter recorded."""

    time_s: Floats  #: Shape (n,), increasing; on the meter's clock.
    watts: Floats  #: Shape (n,).
    read_from: str  #: The names of the columns.
    left_out: int  #: Rows behind the last reading, without a number.


def read_meter(path: Path, voltage: float | None = None, named: Sequence[str] = ()) -> MeterTrace:
    """Read the times and watts that a meter's program exported.

    Parameters
    ----------
    path : path
        Text in UTF-8, UTF-16 or Latin-1 with commas, semicolons or tabs between its cells, and a
        header that names columns of time and of power, or of voltage and current, with or without
        units: ``time_s,power_w``, ``Timestamp(ms),Current(uA)``. Lines before the header are
        skipped. Times are numbers, ISO 8601 or a time of day. Samples of the same time, as of
        clocks with whole seconds, are spread evenly until the next one.
    voltage : float, optional
        Supply in volts, instead of a column of voltage.
    named : sequence of str
        Names of columns to take where several hold the same quantity.

    Raises
    ------
    UsageError
        If a column is missing, its unit is not known, or several may be meant; if a cell is not a
        number, time decreases, or no board takes such a power.
    """
    try:
        with open_input(path) as file:
            encoding = _encoding_of(file.read(1 << 16))
            file.seek(0)
            lines = TextIOWrapper(file, encoding=encoding, errors="replace", newline="")
            delimiter, columns = _header(path, lines)
            chosen = _chosen(path, columns, voltage, named)
            table = csv.reader(lines, delimiter=delimiter)
            rows = ([_decimal(cell, delimiter) for cell in row] for row in table)
            filled = (row for row in rows if any(row))
            given = voltage if voltage is not None and "power" not in chosen else 1.0
            left_out: list[UsageError] = []
            samples = _samples(path, filled, len(columns), chosen, given, left_out)
            read = np.fromiter(samples, np.dtype((np.float64, 2)))
    except (OSError, csv.Error) as error:
        raise UsageError(
            f"cannot read a power trace from {path}: {error}: name a CSV with a header of time and "
            "power"
        ) from error
    names = [repr(column.name) for column in chosen.values()]
    if voltage is not None and "power" not in chosen:
        names.append(f"{voltage:g} V as given")
    time_s, watts = read.T
    read_from = f"{', '.join(names[:-1])} and {names[-1]}"
    return _checked(path, MeterTrace(time_s, watts, read_from, len(left_out)))


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


def _header(path: Path, lines: Iterable[str]) -> tuple[str, list[_Column]]:
    """Read lines up to the header; return the delimiter, and all columns."""
    first = ""
    for line in islice(lines, _MOST_PREFACE):
        first = first or line.strip()
        delimiter = max(";\t,", key=line.count)
        names = next(csv.reader([line], delimiter=delimiter), [])
        columns = [_Column.of(at, name) for at, name in enumerate(names)]
        found = {column.quantity for column in columns}
        if {"time", "date"} & found and {"power", "current"} & found:
            return delimiter, columns
        energy = [one.name for one in columns if re.search(r"energy|wh\b|joules", one.name, re.I)]
        if {"time", "date"} & found and energy:
            raise UsageError(
                f"{path}: its column {energy[0]!r} is of energy, which is not read: export power, "
                "or current and voltage"
            )
    raise UsageError(
        f"{path} begins with {first[:80]!a}: expected time_s, and power_w or both voltage_v and "
        "current_a, or such names, in a header"
    )


def _chosen(
    path: Path, columns: Sequence[_Column], voltage: float | None, named: Sequence[str]
) -> dict[str, _Column]:
    """Choose a column of time, and of power or current and voltage; and a date to a time."""
    of = {name: [one for one in columns if one.quantity == name] for name in _QUANTITIES}
    for name in named:
        same = [one for one in columns if one.name.lower() == name.strip().lower()]
        if len(same) != 1 or not same[0].quantity:
            known = ", ".join(repr(one.name) for one in columns if one.quantity)
            raise UsageError(
                f"{path}: --column {name!r} is no column of a quantity: choose from {known}"
            )
        of[same[0].quantity] = same
        if same[0].quantity in ("voltage", "current"):
            of["power"] = []

    def only(quantity: str) -> _Column:
        """Return the only column of a quantity; which one is meant is never guessed."""
        if len(of[quantity]) > 1:
            names = ", ".join(repr(one.name) for one in of[quantity])
            raise UsageError(
                f"{path}: its {quantity} is in {names}: which one is meant? Name it, such as "
                f"--column {of[quantity][0].name!r}"
            )
        return of[quantity][0]

    chosen = {"time": only("time" if of["time"] else "date")}
    if of["time"] and of["date"]:
        chosen["date"] = only("date")
    if of["power"]:
        chosen["power"] = only("power")
    else:
        chosen["current"] = only("current")
        if voltage is None and not of["voltage"]:
            raise UsageError(
                f"{path} has time and current: give the supply by --voltage, such as --voltage 5"
            )
        if voltage is None:
            chosen["voltage"] = only("voltage")
    for quantity, column in chosen.items():
        if quantity not in ("time", "date"):  # which may be clocks
            _factor(path, column)
    return chosen


def _factor(path: Path, column: _Column) -> float:
    if column.factor is None:
        raise UsageError(
            f"{path}: the unit of its column {column.name!r} is not known: write one of "
            f"{', '.join(_UNITS[column.quantity])} into the header"
        )
    return column.factor


def _samples(
    path: Path, rows: Iterable[Sequence[str]], width: int, chosen: Mapping[str, _Column],
    voltage: float, left_out: list[UsageError],
) -> Iterator[tuple[float, float]]:  # fmt: skip
    """Yield times and watts; clocks count from 1970.

    Rows behind the last reading whose cells hold no number, such as a total, go to `left_out`.
    """
    time, date = chosen["time"], chosen.get("date")
    powers = [
        (column.at, _factor(path, column))
        for quantity, column in chosen.items() if quantity not in ("time", "date")
    ]  # fmt: skip
    unit: float | None = None  # of times; 0 of clocks
    last, midnights = -math.inf, 0
    for number, row in enumerate(rows, 1):
        cells = [row[column.at] for column in chosen.values() if column.at < len(row)]
        if not any(map(_DIGIT.search, cells)):
            left_out.append(_bad_row(path, number, row))
            continue
        if left_out:
            raise left_out[0]
        if len(row) < width or any(row[width:]):
            raise _bad_row(path, number, row)
        try:
            if unit is None:
                unit = _factor(path, time) if _is_number(row[time.at]) else 0.0
            when = (
                float(row[time.at]) * unit if unit
                else _clock(row[time.at], row[date.at] if date else "")
            )  # fmt: skip
            watts = voltage
            for at, factor in powers:
                watts *= float(row[at]) * factor
        except ValueError:
            raise _bad_row(path, number, row) from None
        if not (abs(when) < _TOO_LARGE and abs(watts) < _TOO_LARGE):
            raise UsageError(
                f"{path}, sample {number}: a cell is no number, or too large: leave out such rows"
            )
        if unit == 0.0 and when < _DAY_S:  # a time of day, without a date
            midnights += when + midnights * _DAY_S < last - _DAY_S / 2
            when += midnights * _DAY_S
        if when < last:
            raise UsageError(
                f"{path}, sample {number}: its time is before that of the row above: leave out "
                "such rows"
            )
        last = when
        yield when, watts


def _bad_row(path: Path, number: int, row: Sequence[str]) -> UsageError:
    return UsageError(
        f"cannot read a power trace from {path}, sample {number}, {','.join(row)[:80]!r}: "
        "expected numbers, and a time in numbers, as ISO 8601 or as a time of day"
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _clock(cell: str, date: str) -> float:
    """Return the seconds of an ISO 8601 time since 1970, or of a time of day on some date."""
    text = cell.replace(",", ".").replace("/", "-")
    if date or not re.search(r"\d-", text):
        text = f"{date.replace('/', '-') or '1970-01-01'} {text}"
    when = datetime.fromisoformat(text)
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _spread(when: Floats) -> Floats:
    """Return times of which those that are equal are spread evenly until the next one.

    A clock of whole seconds gives all readings of a second one time. In a gap, they are spread over
    the usual step.
    """
    times, first, number = np.unique(when, return_index=True, return_counts=True)
    steps = np.append(np.diff(times), np.inf)
    each = np.minimum(steps, np.median(steps[:-1])) / number
    return when + (np.arange(when.size) - np.repeat(first, number)) * np.repeat(each, number)


def _checked(path: Path, found: MeterTrace) -> MeterTrace:
    """Return a trace whose times increase, if a board can have it."""
    if found.time_s.size < 2:
        raise UsageError(f"{path}: a power trace needs two samples or more")
    if found.time_s[0] == found.time_s[-1]:
        raise UsageError(f"{path}: time does not increase from row to row")
    times, watts = _spread(found.time_s), found.watts
    seconds, typical, most = times[-1] - times[0], float(np.median(watts)), np.abs(watts).max()
    by = f"{path}: by its columns {found.read_from}"
    if seconds > _MOST_TRACE_S:
        raise UsageError(
            f"{by} it covers {seconds / 86_400:,.4g} days: name the unit of time in the header, "
            "such as time_ms, or cut it to the measurement"
        )
    if abs(typical) > MAX_TRACE_WATTS or most > MAX_WATTS:
        raise UsageError(
            f"{by} its power is {typical:,.4g} W (median) and up to {most:,.4g} W, which no board "
            "of this kind takes: name the unit in the header, such as power_mw"
        )
    if watts.mean() < 0:
        raise UsageError(
            f"{by} its power is {watts.mean():,.4g} W on average: are the leads of the meter "
            "reversed? Swap them and record again, or change the sign in the file"
        )
    return found._replace(time_s=times)


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


def align(windows: Sequence[Window], time_s: Floats, watts: Floats) -> float:
    """Return by how much a meter's clock is ahead, from the steps of the load in its trace.

    Parameters
    ----------
    time_s, watts : ndarray of float64, shape (n,)
        Trace of the meter, on its own clock.

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
    if not _follows(windows, time_s, watts):
        period_s, window_s = float(np.median(np.diff(time_s))), typical_s(windows)
        busy = varying_load(windows)
        remedy = f"{busy}: stop other programs" if busy else "take longer windows"
        raise UsageError(
            "the meter's trace does not rise and fall with the load of the profile, at any time: "
            "is it of the same run, and of the board that ran it, and is its unit of time right? "
            f"If so, {too_slow(period_s, window_s) or remedy}"
        )
    return float(time_s[0] + int(np.argmax(scores)) * step - start)


def _follows(windows: Sequence[Window], time_s: Floats, watts: Floats) -> bool:
    """Return whether the trace fits the load better than the same windows in another order.

    This is a permutation test. In a trace that has nothing to do with the load, every order of idle
    and load finds its best place alike, and that of the profile is the best one of all by a chance
    of one in their number. A steady drift counts for none of them.
    """
    load, start, end = (
        np.array([getattr(window, name) for window in windows], dtype=np.float64)
        for name in ("load", "start_s", "end_s")
    )
    rng = np.random.default_rng(0)
    orders = np.array([load, *(rng.permutation(load) for _ in range(_ORDERS))])
    orders = orders[np.r_[True, (orders[1:] != load).any(axis=1)]]
    drift = np.stack([np.ones(load.size), (start + end) / 2], axis=1)
    orders -= orders @ np.linalg.pinv(drift).T @ drift.T
    orders /= np.linalg.norm(orders, axis=1, keepdims=True)
    energy = Trace.of_power(time_s, watts).energy_j
    step = float(np.median(end - start)) / _PLACES_OF_WINDOW
    ahead = np.arange(time_s[0] - start[0], time_s[-1] - end[-1], step)
    best = np.full(len(orders), -np.inf)
    for part in np.array_split(ahead, 1 + ahead.size * load.size // _MOST_CELLS):
        before, after = (np.interp(part[:, None] + at, time_s, energy) for at in (start, end))
        fits = (after - before) / (end - start) @ orders.T
        best = np.maximum(best, fits.max(axis=0, initial=-np.inf))
    return bool(best[0] > best[1:].max())
