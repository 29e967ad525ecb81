"""The trace of an external meter: its table, and its place among the windows of a profile.

Columns are found by their names and units. The clock of the meter is aligned with that of the
profile by the steps of the load.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.files import open_input
from edge_vpr_tools.profile.measurement import LEAST_PAIRS, Floats, Trace, Window, varying_load
from edge_vpr_tools.profile.sensors.sensor import MAX_WATTS

#: Random orders of idle and load that a trace has to fit worse than the true one, and places at
#: which they are tried in the length of a window. Of 1,500 traces of noise, of random walks and of
#: other steps beside 5 pairs, 5 passed, as many as 252 orders allow; of 300 that are switched on
#: and off at a constant period, 28 did, of nearly the period of the load.
_ORDERS, _PLACES_OF_WINDOW = 500, 20
#: median power of a trace above which its unit must be wrong: no board of this kind takes more
MAX_TRACE_WATTS = 500.0
#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 10_000, 1e6
_DAY_S = 86_400.0
#: a trace that seems longer has another unit of time
_MOST_TRACE_S = 7 * _DAY_S
#: rows before the header, in which programs describe themselves
_MOST_PREFACE = 50
#: Unix times without a unit: as many milliseconds, microseconds or nanoseconds since 1970
_UNIX = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
#: characters that are read at a time, and samples of a trace that are kept
_BLOCK_CHARS, MOST_SAMPLES = 1 << 22, 1 << 20
#: seconds or watts that no meter writes, far below what sums of them may reach
_TOO_LARGE = 1e100
_DAY = re.compile(r"\d[-/]\d|\d\.\d+\.\d")
_GERMAN_DAY = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})")


# What the name of a column says: its quantity, its unit, and which of several values it is.


def _set_of(words: str) -> frozenset[str]:
    return frozenset(words.split())


#: words of a quantity, in some languages of meters' programs
_QUANTITIES = {
    "time": _set_of(
        """timestamp datetime time elapsed t seconds milliseconds zeit zeitstempel uhrzeit temps
        heure horodatage tiempo hora tempo ora 时间 時間"""
    ),
    "date": _set_of("date datum fecha data 日期 日付"),
    "power": _set_of("power pwr watts watt p leistung puissance potencia potenza 功率 電力"),
    "voltage": _set_of(
        "voltage volts volt u v spannung tension tensión voltaje tensione 电压 電圧"
    ),
    "current": _set_of(
        "current curr amperes amps ampere amp i strom courant corriente corrente 电流 電流"
    ),
}
_WORDS = {word: quantity for quantity, words in _QUANTITIES.items() for word in words}
_UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "sekunden": 1.0, "ms": 1e-3, "msec": 1e-3,
             "milliseconds": 1e-3, "us": 1e-6, "usec": 1e-6, "microseconds": 1e-6, "ns": 1e-9,
             "nanoseconds": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0, "hours": 3600.0},
    "date": {},
    "power": {"w": 1.0, "watts": 1.0, "watt": 1.0, "kw": 1e3, "mw": 1e-3, "uw": 1e-6, "nw": 1e-9},
    "voltage": {"v": 1.0, "volts": 1.0, "volt": 1.0, "mv": 1e-3, "uv": 1e-6},
    "current": {"a": 1.0, "amps": 1.0, "amp": 1.0, "amperes": 1.0, "ampere": 1.0, "ma": 1e-3,
                "ua": 1e-6, "na": 1e-9},
}  # fmt: skip
_BASE_UNIT = {"power": "W", "voltage": "V", "current": "A"}
_AVERAGE = _set_of(
    """avg average averaged mean mittel mittelwert mittlere mittlerer durchschnitt moyenne moyen
    moy media medio promedio 平均 平均值"""
)
#: other values of a quantity than the mean
_NO_MEAN = _set_of(
    """min minimum minimal mini max maximum maximal maxi peak pk pp rms eff effektiv std stddev
    stdev dev sd sigma var variance deviation median low lowest high highest spitze mínimo minimo
    máximo maximo limit setpoint set range 最小 最大 最小值 最大值"""
)
#: words of columns that hold something else
_NO_QUANTITY = _set_of(
    """shunt d cc temp temperature c energy charge wh mwh kwh ah mah capacity factor apparent
    reactive va ohm ohms resistance frequency hz ripple"""
)
#: words of columns of cumulated energy
_ENERGY = _set_of("energy energie énergie energía energia wh mwh kwh j joule joules 能量 電力量")
#: words beside a time that say how it is written, and not in which unit
_CLOCK_WORDS = _set_of("iso utc gmt local unix epoch posix hh h mm m ss s fff yyyy dd")
_LAST_TIMES = _set_of("end stop finish ende fin")


class _Column(NamedTuple):
    """A column of a meter's file: its number, and what its name says."""

    at: int
    name: str
    quantity: str  #: "" if it is none that is needed.
    unit: str  #: "" without one.
    factor: float | None  #: To SI units; None if the unit is not known.
    is_average: bool
    is_no_mean: bool  #: Whether it is a minimum, a maximum, or the like.
    rest: frozenset[str]  #: Other words, such as those of a channel.

    def __str__(self) -> str:
        taken = "" if self.unit else _BASE_UNIT.get(self.quantity, "")
        return repr(self.name) + f" (taken as {taken})" * bool(taken)


def _words(text: str) -> list[str]:
    """Split a name into words of letters, and numbers."""
    text = re.sub(r"(?<=[a-z]{2})(?=[A-Z])", " ", text)
    text = re.sub(r"(?<![^\W_])([iuvp])(?=(avg|mean|min|max|rms)\b)", r"\1 ", text, flags=re.I)
    return [word.lower() for word in re.findall(r"[^\W\d_]+|\d+", text)]


def _column(at: int, name: str) -> _Column:
    """Read what the name of a column says."""
    name = name.strip().lstrip("#").strip()
    text = name.replace("\u00b5", "u").replace("\u03bc", "u")
    bracketed = [_words(part) for part in re.findall(r"[(\[{](.*?)[)\]}]", text)]
    words = _words(re.sub(r"[(\[{].*?[)\]}]", " ", text))
    named = list(dict.fromkeys(_WORDS[word] for word in words if word in _WORDS))
    if {"time", "date"} <= set(named):
        named.remove("date")
    found = [*words, *(word for part in bracketed for word in part)]
    quantity, unit, factor = named[0] if named else "", "", 1.0
    # those in brackets first, then the last word; a letter alone is one beside a quantity only
    for word in [word for part in bracketed for word in part] + words[::-1]:
        alone = len(found) == 1 or word not in words or len(word) > 1
        of = [
            one for one, units in _UNITS.items()
            if word in units and (one in named or (not named and alone and one != "time"))
        ]  # fmt: skip
        if of and not (word in _NO_MEAN and not named):
            quantity, unit, factor = of[0], word, _UNITS[of[0]][word]
            break
    known = {*_WORDS, *_AVERAGE, *_NO_MEAN, unit}
    is_factor_known = True
    if quantity and not unit:
        for part in bracketed:
            others = [word for word in part if word not in known and not word.isdigit()]
            channel = any(word.isdigit() for word in part)
            clock = quantity in ("time", "date") and set(part) <= _CLOCK_WORDS
            if others and not channel and not clock:
                unit, is_factor_known = " ".join(part), False
    if _NO_QUANTITY & set(found):
        quantity = ""
    left = set(found) - ({unit} if found.count(unit) == 1 else set())
    return _Column(
        at, name, quantity, unit, factor if is_factor_known else None, bool(left & _AVERAGE),
        bool(left & _NO_MEAN), frozenset(left - known),
    )  # fmt: skip


class MeterFile:
    """A table that a meter's program exported, and the columns of it that are read.

    Parameters
    ----------
    path : path
        Text in UTF-8, UTF-16 or Latin-1 with commas, semicolons or tabs between its cells, decimal
        points or commas, and a header that names columns of time and of power, or of voltage and
        current, with or without units: ``time_s,power_w``, ``Timestamp(ms),Current(uA)``,
        ``Datum;Spannung (V);Strom (A)``. Rows before the header are skipped. Times are numbers,
        ISO 8601 or a time of day.
    voltage : float, optional
        Supply in volts, instead of a column of voltage.
    named : sequence of str
        Names of columns to take where several hold the same quantity.

    Raises
    ------
    UsageError
        If a column is missing, its unit is not known, or several may be meant.
    """

    def __init__(self, path: Path, voltage: float | None = None, named: Sequence[str] = ()) -> None:
        self._path, self._voltage, self._named = path, voltage, named
        try:
            with open_input(path) as file:
                self._encoding = _encoding_of(file.read(1 << 16))
        except OSError as error:
            raise self._error(error.strerror or str(error)) from error
        lines = next(self._blocks(), [])
        if not lines:
            raise self._error("it is empty")
        self._header, self._delimiter, columns = self._find_header(lines)
        self._width = len(columns)
        after = lines[self._header + 1 :]
        self._columns = self._chosen(columns, self._cells(after[0]) if after else [])
        self._before = 0  # rows of earlier blocks
        self.left_out = 0  #: Rows behind the last reading, without a number.
        self._first_left_out: list[str] = []
        self._factor: float | None = None  # of times in numbers; None of clocks
        self._first_s = 0.0  # of clocks
        self._clock_s, self._days = -math.inf, 0

    def __str__(self) -> str:
        """Name the columns that are read."""
        names = list(map(str, self._columns.values()))
        if self._voltage is not None and "power" not in self._columns:
            names.append(f"{self._voltage:g} V as given")
        return ", ".join(names[:-1]) + f" and {names[-1]}"

    def read(self) -> tuple[Floats, Floats]:
        """Read the times and watts.

        Rows of the same time, as of clocks with whole seconds, are spread evenly until the next
        one; neighbours in a file of more than `MOST_SAMPLES` rows are averaged. Rows behind the
        last reading whose cells hold no number, such as a total, are counted in `left_out`.

        Returns
        -------
        time_s, watts : ndarray of float64, shape (n,)
            Time begins with the meter's own clock if it is in numbers, else at 0.

        Raises
        ------
        UsageError
            If a cell is not a number, time decreases, or no board takes such a power.
        """
        samples, skipped = _Samples(self._path), self._header + 1
        for lines in self._blocks():
            samples.add(*self._rows(lines[skipped:]))
            skipped = 0
        if samples.read < 2:
            raise UsageError(f"{self._path}: a power trace needs two samples or more")
        when, watts = samples.kept()
        if when[0] == when[-1]:
            raise UsageError(f"{self._path}: time does not increase from row to row")
        when = _spread(when)
        if when[-1] - when[0] > _MOST_TRACE_S:
            raise UsageError(
                f"{self._path}: by its column {self._columns['time']} it covers "
                f"{(when[-1] - when[0]) / _DAY_S:,.4g} days: name the unit of time in the header, "
                "such as time_ms, or cut it to the measurement"
            )
        typical = float(np.median(watts))
        if abs(typical) > MAX_TRACE_WATTS or np.abs(watts).max() > MAX_WATTS:
            raise UsageError(
                f"{self._path}: by its columns {self} its power is {typical:,.4g} W (median) and "
                f"up to {np.abs(watts).max():,.4g} W, which no board of this kind takes: name the "
                "unit in the header, such as power_mw"
            )
        if watts.mean() < 0:
            raise UsageError(
                f"{self._path}: by its columns {self} its power is {watts.mean():,.4g} W on "
                "average: are the leads of the meter reversed? Swap them and record again, or "
                "change the sign in the file"
            )
        return when, watts

    def _error(self, what: str) -> UsageError:
        return UsageError(
            f"cannot read a power trace from {self._path}: {what}: name a CSV with a header of "
            "time and power"
        )

    def _blocks(self) -> Iterator[list[str]]:
        """Yield the lines that are not empty, some at a time."""
        rest = ""
        with self._path.open(encoding=self._encoding, errors="replace") as file:
            while text := file.read(_BLOCK_CHARS):
                *lines, rest = f"{rest}{text}".split("\n")
                if len(rest) > _BLOCK_CHARS:
                    raise self._error("a line has no end")
                if lines := _filled(lines):
                    yield lines
        if lines := _filled([rest]):
            yield lines

    def _cells(self, line: str) -> list[str]:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=self._delimiter))]
        except csv.Error as error:
            raise self._error(str(error)) from error

    def _find_header(self, lines: Sequence[str]) -> tuple[int, str, list[_Column]]:
        """Return the number of the header's last line, the delimiter, and all columns."""
        for number, line in enumerate(lines[:_MOST_PREFACE]):
            self._delimiter = max(";\t,", key=line.count)
            names = self._cells(line)
            units = self._cells(lines[number + 1]) if number + 1 < len(lines) else []
            if len(units) == len(names) and not any(re.search(r"\d", cell) for cell in units):
                # some programs write the units below the names
                bare = [cell.strip("()[] ") for cell in units]
                names = [f"{a} ({b})" if b else a for a, b in zip(names, bare, strict=True)]
                number += 1
            columns = [_column(at, name) for at, name in enumerate(names)]
            found = {column.quantity for column in columns}
            if {"time", "date"} & found and {"power", "current"} & found:
                return number, self._delimiter, columns
            energy = [one.name for one in columns if _ENERGY & set(_words(one.name))]
            if {"time", "date"} & found and energy:
                raise UsageError(
                    f"{self._path}: its column {energy[0]!r} is of energy, which is not read: "
                    "export power, or current and voltage"
                )
        raise UsageError(
            f"{self._path} begins with {lines[0][:80]!a}: expected time_s, and power_w or "
            "both voltage_v and current_a, or such names, in a header"
        )

    def _chosen(self, columns: Sequence[_Column], first: Sequence[str]) -> dict[str, _Column]:
        """Choose a column of time, and of power or current and voltage; and a date to a time."""
        named: dict[str, _Column] = {}
        for name in self._named:
            same = [one for one in columns if one.name.lower() == name.strip().lower()]
            if len(same) != 1 or same[0].quantity in ("", *named):
                known = ", ".join(repr(one.name) for one in columns if one.quantity)
                raise UsageError(
                    f"{self._path}: --column {name!r} is no column of a quantity, or a second one: "
                    f"choose from {known}"
                )
            named[same[0].quantity] = same[0]

        def of(quantity: str) -> list[_Column]:
            return [one for one in columns if one.quantity == quantity]

        chosen = {"time": named.get("time") or self._time_of(of("time"), of("date"), first)}
        dates = [one for one in of("date") if one is not chosen["time"]]
        cell = first[chosen["time"].at : chosen["time"].at + 1]
        if dates and cell and _is_clock(cell[0]) and not _DAY.search(cell[0]):
            chosen["date"] = dates[0]
        if "power" in named or (of("power") and not {"current", "voltage"} & set(named)):
            chosen["power"] = named.get("power") or self._only(of("power"))
        else:
            current = named.get("current") or self._only(of("current"))
            chosen["current"] = current
            if self._voltage is None:
                volts = of("voltage")
                if not volts:
                    raise UsageError(
                        f"{self._path} has time and current: give the supply by --voltage, such "
                        "as --voltage 5"
                    )
                same = [one for one in volts if one.rest == current.rest]
                chosen["voltage"] = named.get("voltage") or self._only(same or volts)
        for column in chosen.values():
            if column.factor is None:
                expected = ", ".join(_UNITS[column.quantity])
                raise UsageError(
                    f"{self._path}: the unit {column.unit!r} of its column {column.name!r} is not "
                    f"known: write one of {expected} into the header"
                )
        return chosen

    def _only(self, columns: Sequence[_Column]) -> _Column:
        """Return the only column of a mean; which one is meant is never guessed."""
        means = [one for one in columns if not one.is_no_mean]
        if len(means) == 1:
            return means[0]
        raise self._ask(means or columns)

    def _ask(self, columns: Sequence[_Column]) -> UsageError:
        names = ", ".join(repr(one.name) for one in columns)
        return UsageError(
            f"{self._path}: its {columns[0].quantity} is in {names}: which one is meant? Name it, "
            f"such as --column {columns[0].name!r}"
        )

    def _time_of(
        self, times: Sequence[_Column], dates: Sequence[_Column], first: Sequence[str]
    ) -> _Column:
        """Return the column of time: in numbers with a unit, else a clock, else bare numbers."""
        times = [one for one in times if not one.rest & _LAST_TIMES] or times
        clocks = [one for one in times if one.at < len(first) and _is_clock(first[one.at])]
        units = [one for one in times if one.unit and one.factor and one not in clocks]
        bare = [one for one in times if not one.unit and one not in clocks]
        for group in (units, clocks, bare, times, dates):
            if len(group) == 1:
                return group[0]
            if group:
                raise self._ask(group)
        raise AssertionError

    def _rows(self, lines: Sequence[str]) -> tuple[Floats, Floats]:
        """Return the times and watts of the next lines, which may be none."""
        if not lines:
            return np.empty(0), np.empty(0)
        try:
            rows = list(csv.reader(lines, delimiter=self._delimiter))
        except csv.Error as error:
            raise self._error(str(error)) from error
        behind = next((i for i, row in enumerate(rows[::-1]) if self._has_number(row)), len(rows))
        if behind < len(rows) and self.left_out:
            raise self._bad_row(0, self._first_left_out)
        if behind:
            self._first_left_out = self._first_left_out or rows[-behind]
            self.left_out += behind
            rows = rows[:-behind]
        if not rows:
            return np.empty(0), np.empty(0)
        for number, row in enumerate(rows):
            if len(row) < self._width or any(cell.strip() for cell in row[self._width :]):
                raise self._bad_row(number, row)
        cells = {
            name: [row[column.at].strip() for row in rows] for name, column in self._columns.items()
        }
        clock = cells.pop("time")
        if "date" in cells:
            clock = [f"{day} {time}" for day, time in zip(cells.pop("date"), clock, strict=True)]
        when = self._times(rows, clock)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite ones are refused
            found = {
                name: self._numbers(rows, texts) * (self._columns[name].factor or 1.0)
                for name, texts in cells.items()
            }
            watts = found.get("power")
            if watts is None:
                volts = found["voltage"] if self._voltage is None else self._voltage
                watts = found["current"] * volts
        self._before += len(rows)
        return when, watts

    def _has_number(self, row: Sequence[str]) -> bool:
        """Return whether any cell that is read holds one."""
        return any(
            re.search(r"\d", row[column.at])
            for column in self._columns.values()
            if column.at < len(row)
        )

    def _bad_row(self, number: int, row: Sequence[str]) -> UsageError:
        shown = ",".join(row)[:80]
        return UsageError(
            f"cannot read a power trace from {self._path}, sample {self._before + number + 1}, "
            f"{shown!r}: expected numbers, and a time in numbers, as ISO 8601 or as a time of day"
        )

    def _numbers(self, rows: Sequence[Sequence[str]], cells: Sequence[str]) -> Floats:
        with suppress(ValueError):
            return np.array(cells, dtype=np.float64)
        values = np.empty(len(cells))
        for number, cell in enumerate(cells):
            try:
                values[number] = _number(cell)
            except ValueError:
                raise self._bad_row(number, rows[number]) from None
        return values

    def _times(self, rows: Sequence[Sequence[str]], cells: Sequence[str]) -> Floats:
        """Return times in seconds: numbers in the column's unit, ISO 8601, or times of day."""
        column = self._columns["time"]
        if self._before == 0:
            with suppress(ValueError):
                first = _number(cells[0])
                self._factor = column.factor
                if not column.unit:
                    self._factor = next((by for least, by in _UNIX if first > least), 1.0)
        if self._factor is not None:
            with np.errstate(over="ignore"):
                return self._numbers(rows, cells) * self._factor
        values = np.empty(len(cells))
        for number, cell in enumerate(cells):
            try:
                now_s = _clock(cell)
            except ValueError:
                raise self._bad_row(number, rows[number]) from None
            # a time of day begins again at midnight
            if ":" in cell and not _DAY.search(cell):
                self._days += now_s - self._clock_s < -_DAY_S / 2
                self._clock_s = now_s
            values[number] = now_s + self._days * _DAY_S
        if self._before == 0:
            self._first_s = values[0]
        return values - self._first_s


def read_csv(path: Path, voltage: float | None = None) -> tuple[Floats, Floats]:
    """Read the times and watts that an external meter wrote; see `MeterFile`."""
    return MeterFile(path, voltage).read()


def _encoding_of(head: bytes) -> str:
    """Return the encoding of a text by its first bytes; of Windows if it is none of Unicode."""
    for mark in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        if head.startswith(mark):
            return "utf-16"
    if b"\0" in head[:2]:
        return "utf-16-be" if head[:1] == b"\0" else "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _filled(lines: list[str]) -> list[str]:
    return [line for line in lines if line.strip(" ,;\t")]


class _Samples:
    """Times and watts; of a long trace, the means of so many neighbours that few are kept.

    A meter with 100,000 samples a second writes 10**8 of them in 17 minutes. The load changes each
    few seconds.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.read = 0  #: Samples so far.
        self._last_s = -math.inf
        # rows: time and watts
        self._parts: list[Floats] = []
        self._rest = np.empty((2, 0))
        self._each = 1  # samples in a mean

    def add(self, when: Floats, watts: Floats) -> None:
        """Take the next samples.

        Raises
        ------
        UsageError
            If time decreases, or a value is not finite or too large.
        """
        rows = np.stack([when, watts])
        for is_bad, what in (
            (~(np.abs(rows) < _TOO_LARGE).all(axis=0), "a cell is no number, or too large"),
            (np.diff(when, prepend=self._last_s) < 0, "its time is before that of the row above"),
        ):
            if is_bad.any():
                number = self.read + int(is_bad.argmax()) + 1
                raise UsageError(f"{self._path}, sample {number}: {what}: leave out such rows")
        self.read += when.size
        self._last_s = when[-1] if when.size else self._last_s
        self._mean_of(np.concatenate([self._rest, rows], axis=1))
        while sum(part.shape[1] for part in self._parts) > MOST_SAMPLES:
            means, rest = np.concatenate(self._parts, axis=1), self._rest
            self._parts, each, self._each = [], self._each, 2 * self._each
            # in a mean of twice as many, each of the old means counts as often as before
            odd = np.repeat(means[:, means.shape[1] // 2 * 2 :], each, axis=1)
            self._parts.append(_means(means, 2))
            self._mean_of(np.concatenate([odd, rest], axis=1))

    def _mean_of(self, rows: Floats) -> None:
        self._parts.append(_means(rows, self._each))
        self._rest = rows[:, rows.shape[1] // self._each * self._each :]

    def kept(self) -> tuple[Floats, Floats]:
        """Return the times and watts."""
        last = [self._rest.mean(axis=1, keepdims=True)] if self._rest.size else []
        when, watts = np.concatenate([*self._parts, *last], axis=1)
        return when, watts


def _means(rows: Floats, each: int) -> Floats:
    """Return the means of `each` columns, of as many as are whole."""
    whole = rows.shape[1] // each
    return rows[:, : whole * each].reshape(2, whole, each).mean(axis=2)


def _number(cell: str) -> float:
    """Read a number; of a point and a comma in it, the last one is before its decimals."""
    if "," in cell:
        thousands = "." if cell.rfind(",") > cell.rfind(".") else ","
        cell = cell.replace(thousands, "").replace(",", ".")
    return float(cell)


def _is_clock(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return True
    return False


def _clock(cell: str) -> float:
    """Return the seconds of an ISO 8601 time since 1970, or of a time of day since midnight."""
    text = cell.replace(",", ".")
    day = re.fullmatch(r"(?:(\d+):)?(\d+):(\d+(?:\.\d+)?)", text)
    if day:
        hours, minutes, seconds = day.groups(default="0")
        return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    text = _GERMAN_DAY.sub(lambda day: f"{day[3]}-{int(day[2]):02}-{int(day[1]):02}", text)
    when = datetime.fromisoformat(text.replace("/", "-"))
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
        busy = varying_load(windows)
        raise UsageError(
            "the meter's trace does not rise and fall with the load of the profile, at any time: "
            "is it of the same run, and of the board that ran it, and is its unit of time right? "
            f"If so, {f'{busy}: stop other programs' if busy else 'take longer windows'}"
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
    for part in np.array_split(ahead, 1 + ahead.size * load.size // _BLOCK_CHARS):
        before, after = (np.interp(part[:, None] + at, time_s, energy) for at in (start, end))
        fits = (after - before) / (end - start) @ orders.T
        best = np.maximum(best, fits.max(axis=0, initial=-np.inf))
    return bool(best[0] > best[1:].max())
