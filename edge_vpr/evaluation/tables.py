"""Tables of numbers as text, in common encodings and dialects; odometry."""

from __future__ import annotations

import contextlib
import csv
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import EdgeVprWarning, GroundTruthError, UsageError, as_path, number_in
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.files import open_input, replacing
from edge_vpr.odometry import LEAP_MM_PER_S, LEAST_GAP_US, MOST_MM, Odometry
from edge_vpr.recordings.memory import NamedTable, column_names

Floats = npt.NDArray[np.float64]

# Texts in common encodings, and rows of cells in common dialects.

#: longest log: a day at ten fixes a second has 140 MB, all of which is read into memory
MAX_BYTES = 256 << 20


def read_text(path: Path) -> str:
    """Read a text of UTF-8 or, as some loggers on Windows write, UTF-16.

    Returns
    -------
    str
        Bytes that are no text are U+FFFD, so that checksums and number parsers refuse them.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, or is too long to be a log.
    """
    try:
        with open_input(path) as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise GroundTruthError(
            f"{path} cannot be read ({error.strerror}): check the path"
        ) from error
    if len(raw) > MAX_BYTES:
        raise GroundTruthError(f"{path} has more than {MAX_BYTES} bytes: split it")
    return raw.decode(_encoding(raw), errors="replace").removeprefix("\ufeff")


def _encoding(raw: bytes) -> str:
    # Every other byte of Latin text in UTF-16 is zero. The byte order mark is not used: it can be
    # missing, and noise on a serial line can look like it.
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        half = raw[first:1_000:2]
        if half and half.count(0) > 0.9 * len(half):
            return encoding
    return "utf-8"


def read_cells(path: Path, text: str) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the header of a table and its rows, as texts.

    Columns are separated by semicolons, tabs or commas, whichever the header has first in this
    order; between semicolons and tabs, decimal commas become points. A comment that is as long as
    the row of numbers below it is the header, as in EuRoC.

    Returns
    -------
    header : tuple of str
        Lower case, without surrounding blanks; empty if the first row is numbers.
    rows : list of list of str
    """
    lines = [line for line in text.splitlines() if line.strip(" ,;\t")]
    first = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = lines[first] if first < len(lines) else ""
    delimiter = next((mark for mark in ";\t" if mark in head), ",")
    try:
        table = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]
    except csv.Error:
        raise GroundTruthError(f"{path} is not a text table: give a .csv file") from None
    if 0 < first < len(table) and len(table[first - 1]) == len(table[first]) > 1:
        with contextlib.suppress(ValueError):
            float(table[first][0])
            first -= 1
    header, *rows = table[first:] or [[]]
    rows = [row for row in rows if not row[0].startswith("#")]
    if not rows:
        raise GroundTruthError(f"{path} has no rows: give a header line and at least one row")
    if delimiter != ",":
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    names = tuple(name.strip(" #").lower() for name in header)
    for number, row in enumerate(rows):
        if len(row) != len(names):
            commas = delimiter == "," and len(row) == 2 * len(names)
            raise _bad_length(path, names, number, row, commas)
    return names, rows


def _bad_length(
    path: str | Path, header: Sequence[str], number: int, row: Sequence[str], commas: bool = False
) -> GroundTruthError:
    remedy = "correct it, or leave it out"
    if commas:
        remedy = "write decimals with points, or semicolons between columns"
    return GroundTruthError(
        f"{path}: row {number + 1} is {','.join(row)[:80]!r}, not {len(header)} cells for "
        f"{','.join(header)[:80]}: {remedy}"
    )


#: a table with named columns that a program holds, such as a DataFrame or a dictionary
TableData: TypeAlias = Mapping[str, npt.ArrayLike] | NamedTable
#: odometry as a caller holds it
AnyOdometry: TypeAlias = Odometry | TableData | str | Path


def cells_of(table: Any, names: list[str], place: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the header and the rows of a table in memory, as `read_cells` does of a file.

    Parameters
    ----------
    names : list of str
        Of the columns.
    place : Path
        Named in messages.
    """
    columns = [np.asarray(table[name]) for name in names]
    shapes = {column.shape for column in columns}
    if len(shapes) != 1 or columns[0].ndim != 1 or not columns[0].size:
        raise GroundTruthError(
            f"{place} has columns of shapes {', '.join(str(each.shape) for each in columns)}: "
            "give one value a row in each, at least one row"
        )
    # text of NumPy's dates keeps all digits, and that of its floats all bits
    cells = [(each.astype(str) if each.dtype.kind == "M" else each).tolist() for each in columns]
    header = tuple(name.strip().lower() for name in names)
    return header, [[str(cell) for cell in row] for row in zip(*cells, strict=True)]


def read_table(path: str | Path) -> tuple[tuple[str, ...], Floats]:
    """Read a table of numbers under one header line.

    Returns
    -------
    header : tuple of str
        Lower case, without surrounding blanks.
    table : ndarray of float64, shape (n, columns)

    Raises
    ------
    GroundTruthError
        If the file cannot be read, a row has another length or a value is not a finite number.
    """
    header, rows = read_cells(Path(path), read_text(Path(path)))
    return header, numbers(path, header, rows, range(len(header)))


#: cells of a value that is not known
UNKNOWN = ("", "nan", "na", "n/a", "null", "none", "nat", "-")


def numbers(
    path: str | Path,
    header: tuple[str, ...],
    rows: list[list[str]],
    columns: Sequence[int],
    *,
    unknown: bool = False,
) -> Floats:
    """Return some columns of a table as numbers, shape (n, columns).

    Parameters
    ----------
    unknown : bool
        Whether cells may be `UNKNOWN`; they are NaN.
    """
    table = np.empty((len(rows), len(columns)))
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise _bad_length(path, header, number, row)
        for at, column in enumerate(columns):
            cell = row[column]
            stated = not (unknown and cell.lower() in UNKNOWN)
            try:
                table[number, at] = number_in(cell) if stated else np.nan
            except ValueError:
                raise GroundTruthError(
                    f"{path}: row {number + 1} has {cell[:40]!r} in {header[column]}: expected a "
                    "number"
                ) from None
    wrong = np.isinf(table) if unknown else ~np.isfinite(table)
    if wrong.any():
        row_number = int(np.flatnonzero(wrong.any(axis=1))[0]) + 1
        raise GroundTruthError(f"{path}: row {row_number} is not finite: leave the row out")
    return table


# Odometry files: tables of time and distance, or of time and speed; logs of `edge-vpr stream`.


def load_odometry(path: str | Path | TableData) -> Odometry:
    """Read odometry from a ``.csv`` table, a ``.jsonl`` log of a stream, or a table in memory.

    Parameters
    ----------
    path : str or Path or TableData
        With the header ``time_s,distance_m`` (the reading of an odometer, from any zero),
        ``time_s,position_m`` (a track along the route), or ``time_s,speed_mps`` (below 0 backwards;
        between two rows the mean of both holds). Times in seconds from the recording's start. A
        log that ``edge-vpr stream --odometry --log`` wrote has the readings of its drive.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, is not of this form, or holds values out of range or that no
        robot drives.

    Warns
    -----
    EdgeVprWarning
        If the distance leaps here and there, as where an odometer starts again. Leaps add nothing.
    """
    names = column_names(path)
    if names is not None:
        columns, path = path, Path("the odometry data")
        header, rows = cells_of(columns, names, path)
        table = numbers(path, header, rows, range(len(header)))
    else:
        path = as_path(path, "odometry")
        if path.suffix.lower() == ".jsonl":
            header, table = ("time_s", "distance_m"), _logged_readings(path)
        elif path.suffix.lower() == ".csv":
            header, table = read_table(path)
        else:
            raise GroundTruthError(f"{path} is not odometry: give a .csv table or a .jsonl log")
    speeds = header == ("time_s", "speed_mps")
    if not speeds and header not in (("time_s", "distance_m"), ("time_s", "position_m")):
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected time_s,distance_m, "
            "time_s,position_m or time_s,speed_mps"
        )
    time_s, values = table.T
    if speeds:
        with np.errstate(all="ignore"):  # too large values are refused below
            legs = (values[1:] + values[:-1]) / 2 * np.diff(time_s)
            values = np.concatenate([[0.0], np.cumsum(legs)])
    if not (np.abs(time_s) <= TIME_LIMIT_US / 1e6).all():
        raise GroundTruthError(
            f"{path} has times up to {np.abs(time_s).max():g} s: give seconds from the recording's "
            "start"
        )
    if not (np.abs(values) <= MOST_MM / 1e3).all():
        raise GroundTruthError(
            f"{path} has distances up to {np.abs(values).max():g} m: expected at most "
            f"{MOST_MM // 1000}"
        )
    try:
        odometry = Odometry(
            np.rint(time_s * 1e6).astype(np.int64), np.rint(values * 1e3).astype(np.int64)
        )
    except UsageError as error:
        raise GroundTruthError(f"{path}: {error}") from None
    return _without_leaps(path, odometry)


def _logged_readings(path: Path) -> Floats:
    """Return times and distances in a log of a stream; of readings at one time, the newest."""
    readings: dict[float, float] = {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if '"odometry"' not in line:
            continue
        try:
            row = json.loads(line)
            if row["kind"] == "odometry":
                readings[float(row["time_s"])] = float(row["distance_m"])
        except Exception as error:  # parsers also raise others, for deep nesting and long numbers
            raise GroundTruthError(
                f"{path}: line {number} is not a line of edge-vpr stream --log: leave it out"
            ) from error
    if not readings:
        raise GroundTruthError(
            f"{path} has no readings of an odometer: give the log of edge-vpr stream --odometry"
        )
    return np.array(list(readings.items()))


def _without_leaps(path: Path, odometry: Odometry) -> Odometry:
    """Return readings of which leaps add nothing, as live, with a warning; refuse mostly leaps."""
    step_mm, passed_us = np.diff(odometry.distance_mm), np.diff(odometry.time_us)
    most_mm = LEAP_MM_PER_S * np.maximum(passed_us, LEAST_GAP_US) // 1_000_000
    leaps = np.flatnonzero(np.abs(step_mm) > most_mm)
    if not leaps.size:
        return odometry
    if 2 * leaps.size > step_mm.size:
        speed = float(np.median(np.abs(step_mm) / passed_us)) * 1e3
        raise GroundTruthError(
            f"{path} says {speed:,.0f} m/s in the median: give metres, not millimetres or ticks, "
            "and seconds"
        )
    first, more = leaps[0], leaps.size - 1
    warnings.warn(
        f"{path} leaps by {step_mm[first] / 1e3:,.1f} m at {odometry.time_us[first + 1] / 1e6:g} s"
        + (f" and {more} times more" if more else "")
        + ", as an odometer that starts again: leaps count as 0 m; check the distances",
        EdgeVprWarning,
        stacklevel=3,
    )
    step_mm[leaps] = 0
    distance_mm = np.cumsum(np.concatenate([odometry.distance_mm[:1], step_mm]))
    return replace(odometry, distance_mm=distance_mm)


def save_odometry(path: str | Path, odometry: Odometry) -> None:
    """Write readings as a table for `load_odometry`, atomically.

    Parameters
    ----------
    path : str or Path
        A ``.csv`` file.
    """
    rows = zip(odometry.time_us.tolist(), odometry.distance_mm.tolist(), strict=True)
    with replacing(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write("time_s,distance_m\n")
        file.writelines(f"{t / 1e6:.6f},{mm / 1e3:.3f}\n" for t, mm in rows)
