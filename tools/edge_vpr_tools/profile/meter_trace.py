"""The trace of an external meter: its table, and its place among the windows of a profile.

The clock of the meter is aligned with that of the profile by the steps of the load.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr_tools.profile.measurement import Floats, Window
from edge_vpr_tools.profile.sensors.sensor import MAX_WATTS

#: Thresholds for a trace that follows the load: its correlation with the load in standard errors of
#: the readings, and the mean difference of the pairs in standard errors of the differences. Of 450
#: traces of noise, of random walks and of other steps, none passed; with 3 in place of 6, one in
#: five did.
_FOLLOWING, _PAIRS_HIGHER = 5.0, 6.0
#: median power of a trace above which its unit must be wrong: no board of this kind takes more
MAX_TRACE_WATTS = 500.0
#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 100_000, 1e6


#: words in a column's name that say what it holds, and units with their factors
_QUANTITIES = {
    "time": ("timestamp", "datetime", "time", "elapsed", "t"),
    "date": ("date",),
    "power": ("power", "watts", "watt", "p"),
    "voltage": ("voltage", "volts", "volt", "u", "v"),
    "current": ("current", "amperes", "amps", "ampere", "amp", "i"),
}
_UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
             "min": 60.0, "h": 3600.0},
    "date": {},
    "power": {"w": 1.0, "mw": 1e-3, "uw": 1e-6, "nw": 1e-9},
    "voltage": {"v": 1.0, "mv": 1e-3, "uv": 1e-6},
    "current": {"a": 1.0, "ma": 1e-3, "ua": 1e-6, "na": 1e-9},
}  # fmt: skip
#: words of columns that hold something else
_OTHER_WORDS = frozenset({"shunt", "temp", "temperature", "c", "energy", "charge", "wh", "ah"})
#: rows before the header, in which programs write what they are
_MOST_PREFACE = 50
#: Unix times without a unit: as many milliseconds, or microseconds, have passed since 1970
_UNIX_MS, _UNIX_US = 1e11, 1e14
_DAY_S = 86_400.0
#: characters that are read at a time, and samples of a trace that are kept
_BLOCK_CHARS, MOST_SAMPLES = 1 << 22, 1 << 20
_DAY = re.compile(r"\d[-/]\d|\d\.\d+\.\d")
_GERMAN_DAY = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})")


class _Column(NamedTuple):
    """Column of a meter's file: its number, the factor to SI units, and whether it names a unit."""

    at: int
    factor: float
    unit: str


def read_csv(path: Path, voltage: float | None = None) -> tuple[Floats, Floats]:
    """Read the times and watts that an external meter wrote.

    Parameters
    ----------
    path : path
        Table with commas, semicolons (then also decimal commas) or tabs between its cells, and a
        header that names columns of time and of power, or of voltage and current, with or without
        units: ``time_s,power_w``, ``Timestamp(ms),Current(uA)``, ``Date;Voltage (V);Current (A)``.
        Rows before the header are skipped. Times are numbers, ISO 8601 or a time of day. Rows of
        the same time, as of clocks with whole seconds, are averaged, and neighbours in a file of
        more than `MOST_SAMPLES` rows.
    voltage : float, optional
        Supply in volts, for a meter that writes current alone.

    Returns
    -------
    time_s, watts : ndarray of float64, shape (n,)
        Time begins with the meter's own clock if it is in numbers, else at 0.

    Raises
    ------
    UsageError
        If columns are missing, a cell is not a number, time decreases, or the power is more than
        any board takes.
    """
    samples = _Samples(path)
    with _opened(path) as file:
        blocks = _blocks(path, file)
        lines = next(blocks, [])
        if not lines:
            raise UsageError(f"cannot read a power trace from {path}: it is empty")
        header, delimiter, columns = _find_header(path, lines, voltage)
        table = _Table(path, lines[header], delimiter, columns, voltage)
        samples.add(*table.read(lines[header + 1 :]))
        for lines in blocks:
            samples.add(*table.read(lines))
    if samples.read < 2:
        raise UsageError(f"{path}: a power trace needs two samples or more")
    when, watts = _averaged(*samples.kept())
    if len(when) < 2:
        raise UsageError(f"{path}: time does not increase from row to row")
    typical = float(np.median(watts))
    if not -1.0 <= typical <= MAX_TRACE_WATTS or watts.max() > MAX_WATTS:
        raise UsageError(
            f"{path}: its power is {typical:,.4g} W (median) and up to {watts.max():,.4g} W, which "
            "no board of this kind takes: name the unit in the header, such as power_mw"
        )
    return when, watts


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    """Open a text, and report what cannot be read of it."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            yield file
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(
            f"cannot read a power trace from {path}: {error}: name a CSV with a header of time "
            "and power"
        ) from error


def _blocks(path: Path, file: TextIO) -> Iterator[list[str]]:
    """Yield the lines of a text that are not empty, some at a time."""
    rest = ""
    while text := file.read(_BLOCK_CHARS):
        *lines, rest = f"{rest}{text}".split("\n")
        if len(rest) > _BLOCK_CHARS:
            raise UsageError(f"cannot read a power trace from {path}: a line has no end")
        if lines := _filled(lines):
            yield lines
    if lines := _filled([rest]):
        yield lines


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
            If time decreases, or a value is not finite.
        """
        rows = np.stack([when, watts])
        if not np.isfinite(rows).all() or (np.diff(when, prepend=self._last_s) < 0).any():
            raise UsageError(
                f"{self._path}: time does not increase from row to row, or a cell is no number"
            )
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


class _Table:
    """Reads the rows of a meter's file, some at a time."""

    def __init__(
        self,
        path: Path,
        header: str,
        delimiter: str,
        columns: dict[str, _Column],
        voltage: float | None,
    ) -> None:
        self._path, self._delimiter, self._voltage = path, delimiter, voltage
        self._columns = columns
        self._width = len(next(csv.reader([header], delimiter=delimiter)))
        self._before = 0  # rows of earlier blocks
        self._factor: float | None = None  # of times in numbers; None of clocks
        self._first_s = 0.0  # of clocks
        self._clock_s, self._days = -math.inf, 0

    def read(self, lines: Sequence[str]) -> tuple[Floats, Floats]:
        """Return the times and watts of the next lines, which may be none."""
        if not lines:
            return np.empty(0), np.empty(0)
        try:
            rows = list(csv.reader(lines, delimiter=self._delimiter))
        except csv.Error as error:
            raise UsageError(f"cannot read a power trace from {self._path}: {error}") from error
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
        decimal_comma = self._delimiter != ","
        found = {
            name: self._numbers(rows, texts, decimal_comma) * self._columns[name].factor
            for name, texts in cells.items()
        }
        self._before += len(rows)
        watts = found.get("power")
        if watts is None:
            volts = found["voltage"] if self._voltage is None else self._voltage
            watts = found["current"] * volts
        return when, watts

    def _bad_row(self, number: int, row: Sequence[str]) -> UsageError:
        shown = ",".join(row)[:80]
        return UsageError(
            f"cannot read a power trace from {self._path}, sample {self._before + number + 1}, "
            f"{shown!r}: expected numbers, and a time in numbers, as ISO 8601 or as a time of day"
        )

    def _numbers(
        self, rows: Sequence[Sequence[str]], cells: Sequence[str], decimal_comma: bool
    ) -> Floats:
        try:
            return _as_numbers(cells, decimal_comma)
        except ValueError:
            for number, cell in enumerate(cells):
                try:
                    _number(cell, decimal_comma)
                except ValueError:
                    raise self._bad_row(number, rows[number]) from None
            raise

    def _times(self, rows: Sequence[Sequence[str]], cells: Sequence[str]) -> Floats:
        """Return times in seconds: numbers in the column's unit, ISO 8601, or times of day."""
        column = self._columns["time"]
        if self._before == 0:
            with suppress(ValueError):
                first = float(_as_numbers(cells[:1], decimal_comma=True)[0])
                self._factor = column.factor
                if not column.unit and first > _UNIX_MS:
                    self._factor = 1e-6 if first > _UNIX_US else 1e-3
        if self._factor is not None:
            return self._numbers(rows, cells, decimal_comma=True) * self._factor
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


def _find_header(
    path: Path, lines: Sequence[str], voltage: float | None
) -> tuple[int, str, dict[str, _Column]]:
    """Return the number of the header's line, the delimiter, and the columns by quantity."""
    best: tuple[str, ...] = ()
    for number, line in enumerate(lines[:_MOST_PREFACE]):
        delimiter = max(";\t,", key=line.count)
        names = next(csv.reader([line.lstrip("# ")], delimiter=delimiter))
        columns = _columns(names)
        by_power = "power" in columns
        by_current = "current" in columns and (voltage is not None or "voltage" in columns)
        if "time" in columns and (by_power or by_current):
            needed = ("power",) if by_power else ("current", "voltage")
            needed = ("time", "date", *needed)
            return number, delimiter, {name: columns[name] for name in needed if name in columns}
        if len(columns) > len(best):
            best = tuple(columns)
            if {"time", "current"} <= set(columns):
                raise UsageError(
                    f"{path} has time and current: give the supply by --voltage, such as "
                    "--voltage 5"
                )
    shown = lines[0][:80]
    raise UsageError(
        f"{path} begins with {shown!r}: expected time_s, and power_w or both voltage_v and "
        "current_a, or such names, in a header"
    )


def _columns(names: Sequence[str]) -> dict[str, _Column]:
    """Return the first column of each quantity that the names say."""
    found: dict[str, _Column] = {}
    for at, name in enumerate(names):
        text = name.strip().lower().replace("\u00b5", "u").replace("\u03bc", "u")
        words = re.findall(r"[a-z]+", text)
        # a shunt's voltage is not the supply's, for example
        if not words or _OTHER_WORDS & set(words):
            continue
        for quantity, known in _QUANTITIES.items():
            unit = words[-1] if len(words) > 1 and words[-1] in _UNITS[quantity] else ""
            if not set(words[:-1] if unit else words) & set(known):
                # a unit alone names a quantity too, such as mW
                alone = len(words) == 1 and words[0] in _UNITS[quantity] and quantity != "time"
                if not alone:
                    continue
                unit = words[0]
            if quantity not in found:
                found[quantity] = _Column(at, _UNITS[quantity].get(unit, 1.0), unit)
            break
    # a date alone is a time too
    if "time" not in found and "date" in found:
        found["time"] = found.pop("date")
    return found


def _as_numbers(cells: Sequence[str], decimal_comma: bool) -> Floats:
    if decimal_comma and any("," in cell for cell in cells):
        return np.array([_number(cell, decimal_comma) for cell in cells])
    return np.array(cells, dtype=np.float64)


def _number(cell: str, decimal_comma: bool) -> float:
    """Read a number; with a decimal comma, points are between thousands."""
    if decimal_comma and "," in cell:
        cell = cell.replace(".", "").replace(",", ".")
    return float(cell)


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


def _averaged(when: Floats, watts: Floats) -> tuple[Floats, Floats]:
    """Return one sample for each time: the mean of those that share it."""
    times, first, number = np.unique(when, return_index=True, return_counts=True)
    return times, np.add.reduceat(watts, first) / number


def check_turns(windows: Sequence[Window]) -> None:
    """Raise ValueError unless the windows are consecutive pairs of idle and load."""
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

    At the same times, `pattern` is the load minus its mean, and `window` the number of the window.
    `watts` was interpolated from as many readings of the meter as `samples`.
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
