"""Track files: GPS logs (the RMC and GGA sentences of NMEA 0183, or GPX) and tables."""

from __future__ import annotations

import csv
import datetime as dt
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.gpx_files import load_gpx
from edge_vpr.evaluation.text_files import read_text
from edge_vpr.evaluation.tracks import Floats, Track
from edge_vpr.events import TIME_LIMIT_US

#: Between two fixes further apart than this the position counts as unknown. A car at 50 km/h drives
#: 70 m, the tolerance of Brisbane-Event-VPR, in 5 s; the logs of that data set have gaps of 4 s.
MAX_GAP_S = 5.0


def load_track(path: str | Path, *, max_gap_s: float | None = MAX_GAP_S) -> Track:
    """Read a track from a GPS log (``.nmea``, ``.gpx``) or a table (``.csv``).

    Parameters
    ----------
    path : str or Path
        A table has the header ``time_s,x_m[,y_m[,z_m]]``, ``time_s,position_m`` or
        ``time_s,latitude,longitude``; times in seconds from the recording's start.
    max_gap_s : float, optional
        Positions between points further apart are unknown; None for points set by hand.

    Raises
    ------
    GroundTruthError
        If the file cannot be read or is not of this form.
    """
    path = Path(path)
    if path.suffix.lower() == ".nmea":
        return load_nmea(path, max_gap_s=max_gap_s)
    if path.suffix.lower() == ".gpx":
        return load_gpx(path, max_gap_us=_microseconds(max_gap_s))
    if path.suffix.lower() != ".csv":
        raise GroundTruthError(f"{path} is not a track: give a .nmea or .gpx log or a .csv table")
    header, table = read_table(path)
    position = header[1:]
    if header[0] != "time_s" or position not in (
        ("position_m",),
        ("latitude", "longitude"),
        *(("x_m", "y_m", "z_m")[:d] for d in (1, 2, 3)),
    ):
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected time_s,x_m[,y_m[,z_m]], "
            "time_s,position_m or time_s,latitude,longitude"
        )
    if np.abs(table[:, 0]).max() * 1e6 > TIME_LIMIT_US:
        raise GroundTruthError(
            f"{path} has times up to {np.abs(table[:, 0]).max():g} s: give seconds from the "
            "recording's start"
        )
    try:
        return Track(
            np.round(table[:, 0] * 1e6).astype(np.int64),
            table[:, 1:],
            "geographic" if position == ("latitude", "longitude") else "metric",
            _microseconds(max_gap_s),
        )
    except GroundTruthError as error:
        raise GroundTruthError(f"{path}: {error}") from None


def load_nmea(path: str | Path, *, max_gap_s: float | None = MAX_GAP_S) -> Track:
    """Read the RMC and GGA sentences of a GPS log (NMEA 0183, any talker).

    Time 0 is the first sentence of the log with a time, with or without a fix. If logger and camera
    start together, this is the start of the recording. Sentences with a wrong or missing checksum,
    or without a fix, are left out and counted in `Track.dropped`. RMC and GGA of one instant make
    one point, the first. A log may pass midnight.

    Parameters
    ----------
    path : str or Path
    max_gap_s : float, optional
        Positions between fixes further apart than this are unknown.

    Returns
    -------
    Track
        Geographic; `start_utc` is set where an RMC sentence states the date.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, holds no fix, or its time runs backwards.
    """
    path = Path(path)
    dropped: Counter[str] = Counter()
    zero = ordinal_of_day_0 = None
    fixes: dict[int, tuple[float, float]] = {}
    with_fix = last = 0
    for number, fix in enumerate(_sentences(path, dropped), 1):
        # take the day on which this time of day is nearest to the sentence before ...
        since_last = (fix.time_of_day_us - last + _DAY_US // 2) % _DAY_US - _DAY_US // 2
        time = last + since_last if zero is not None else fix.time_of_day_us
        if fix.ordinal is not None:  # ... unless the sentence states its date
            if ordinal_of_day_0 is None:
                ordinal_of_day_0 = fix.ordinal - time // _DAY_US
            time = (fix.ordinal - ordinal_of_day_0) * _DAY_US + fix.time_of_day_us
        if zero is None:
            zero = last = time
        if fix.position is None:
            dropped["no fix"] += 1
            continue
        if time < last:
            raise GroundTruthError(
                f"{path}: time runs backwards by {(last - time) / 1e6:g} s at RMC/GGA sentence "
                f"{number}: split the log there and use the part of this traverse"
            )
        last = time
        with_fix += 1
        fixes.setdefault(time, fix.position)
    if zero is None or not fixes:
        raise _no_fix(path, dropped)
    start = None
    if ordinal_of_day_0 is not None:
        day = dt.datetime.fromordinal(ordinal_of_day_0).replace(tzinfo=dt.UTC)
        start = day + dt.timedelta(microseconds=zero)
    return Track(
        np.array(list(fixes), dtype=np.int64) - zero,
        np.array(list(fixes.values())),
        "geographic",
        _microseconds(max_gap_s),
        start,
        MappingProxyType(dict(dropped)),
        with_fix + sum(dropped.values()),
    )


def _no_fix(path: Path, dropped: Counter[str]) -> GroundTruthError:
    """Return the error that says what the sentences lacked, and the remedy."""
    tally = ", ".join(f"{count} with {why}" for why, count in dropped.items()) or "none at all"
    remedy = "record again with the receiver under open sky, or give a .csv track"
    most = max(dropped, key=lambda why: dropped[why], default="")
    if most == "no checksum":
        remedy = "let the logger write checksums, or give a .gpx or .csv track"
    elif most in ("bad checksum", "unreadable field"):
        remedy = "copy the log again, as it was edited or damaged, or give a .csv track"
    return GroundTruthError(f"{path} holds no RMC or GGA sentence with a fix ({tally}): {remedy}")


_DAY_US = 86_400_000_000
_SENTENCE = re.compile(
    r"\$(?P<body>[A-Z]{2}(?P<type>RMC|GGA),[^*$]*)(?:\*(?P<sum>[0-9A-Fa-f]{2}))?"
)
_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{1,6})\d*)?")
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)")


@dataclass(frozen=True)
class _Fix:
    time_of_day_us: int
    ordinal: int | None  # proleptic day number of the date, if stated
    position: tuple[float, float] | None  # None if the receiver had no fix


def _sentences(path: Path, dropped: Counter[str]) -> Iterator[_Fix]:
    """Yield the timed RMC and GGA sentences; count the faulty ones.

    Written here because it needs only two types of sentence and an XOR. pynmea2 has had no release
    since 2022 and would be a dependency of every installation.
    """
    text = read_text(path)
    for match in _SENTENCE.finditer(text):
        body, checksum = match["body"], 0
        for byte in body.encode("ascii", errors="replace"):
            checksum ^= byte
        if match["sum"] is None or int(match["sum"], 16) != checksum:
            dropped["no checksum" if match["sum"] is None else "bad checksum"] += 1
            continue
        try:
            fix = _parse(match["type"], body.split(","))
        except (ValueError, IndexError):
            dropped["unreadable field"] += 1
            continue
        if fix is None:
            dropped["no fix"] += 1
        else:
            yield fix


def _parse(sentence: str, fields: list[str]) -> _Fix | None:
    """Return the fields of a sentence; None if it has no time, as before the first fix."""
    if not fields[1]:
        return None
    clock = _TIME.fullmatch(fields[1])
    if clock is None:
        raise ValueError
    hour, minute, second = (int(part) for part in clock.groups()[:3])
    if hour > 23 or minute > 59 or second > 60:  # 60: a leap second
        raise ValueError
    time = (hour * 3600 + minute * 60 + second) * 1_000_000 + int((clock[4] or "0").ljust(6, "0"))
    first = 3 if sentence == "RMC" else 2  # the field of the latitude
    ordinal = None
    if sentence == "RMC":
        valid = fields[2] == "A"
        if fields[9]:
            ordinal = dt.datetime.strptime(fields[9], "%d%m%y").toordinal()
    else:
        valid = fields[6] not in ("", "0")
    if not valid:
        return _Fix(time, ordinal, None)
    latitude = _degrees(fields[first], fields[first + 1], "NS", 90.0)
    longitude = _degrees(fields[first + 2], fields[first + 3], "EW", 180.0)
    return _Fix(time, ordinal, (latitude, longitude))


def _degrees(value: str, side: str, sides: str, limit: float) -> float:
    """Convert ``2730.39720,S`` (degrees and minutes) to signed degrees."""
    angle = _ANGLE.fullmatch(value)
    if angle is None or side not in tuple(sides):
        raise ValueError
    degrees = int(angle[1]) + float(angle[2]) / 60.0
    if float(angle[2]) >= 60.0 or degrees > limit:
        raise ValueError
    return degrees if side == sides[0] else -degrees


def read_table(path: str | Path) -> tuple[tuple[str, ...], Floats]:
    """Read a CSV file of numbers under one header line.

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
    path = Path(path)
    try:
        rows = csv.reader(read_text(path).splitlines(keepends=True))
        lines = [row for row in rows if row and not row[0].startswith("#")]
    except csv.Error:
        raise GroundTruthError(f"{path} is not a text table: give a .csv file") from None
    if len(lines) < 2:
        raise GroundTruthError(f"{path} has no rows: give a header line and at least one row")
    header = tuple(name.strip().lower() for name in lines[0])
    table = np.empty((len(lines) - 1, len(header)))
    for number, row in enumerate(lines[1:]):
        try:
            table[number] = [float(row[column]) for column in range(max(len(row), len(header)))]
        except (ValueError, IndexError):
            raise GroundTruthError(
                f"{path}: row {number + 1} is {','.join(row)!r}, not {len(header)} numbers for "
                f"{','.join(header)}: correct it"
            ) from None
    if not np.isfinite(table).all():
        row_number = int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0]) + 1
        raise GroundTruthError(f"{path}: row {row_number} is not finite: leave the row out")
    return header, table


def _microseconds(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e6)
