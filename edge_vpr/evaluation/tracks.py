"""Tracks: positions of the camera over time, and the files that hold them (GPS logs, poses)."""

from __future__ import annotations

import contextlib
import csv
import datetime as dt
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue
from edge_vpr.errors import GroundTruthError, UsageError, as_path, kind_of
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.files import open_input, replacing
from edge_vpr.map_record import AnyMap
from edge_vpr.route import MOST_MM, Kind, Odometry, Route

# Tracks: positions of the camera over time, interpolated but never extrapolated.


Floats = npt.NDArray[np.float64]

#: Mean radius of the Earth in metres (IUGG, R1).
EARTH_RADIUS_M = 6_371_008.8


@dataclass(frozen=True, eq=False)
class Track(EqualByValue):
    """Positions over time.

    >>> track = Track(np.array([0, 2_000_000]), np.array([[0.0], [10.0]]))
    >>> track.at(np.array([500_000])).tolist()
    [[2.5]]

    Attributes
    ----------
    time_us : ndarray of int64, shape (n,)
        Times in microseconds from the recording's start, strictly increasing.
    position : ndarray of float64, shape (n, d)
        Latitude and longitude in degrees (`kind` "geographic", d = 2), or metres (d = 1, 2 or 3).
    kind : {"metric", "geographic"}
        What the positions are.
    max_gap_us : int, optional
        Between two points further apart than this the position is unknown; no limit if None.
    start_utc : datetime, optional
        The instant of time 0, where the log states a date.
    dropped : mapping of str to int
        How many entries of the log were left out, by reason.
    entries : int
        Entries of the log, those left out included; 0 where there was no log.

    Raises
    ------
    GroundTruthError
        If the arrays are not of these shapes, a value is not finite, or time does not increase.
    """

    time_us: npt.NDArray[np.int64]
    position: Floats
    kind: Kind = "metric"
    max_gap_us: int | None = None
    start_utc: dt.datetime | None = None
    dropped: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    entries: int = 0

    def __repr__(self) -> str:
        return f"Track({len(self.time_us)} points, {self.kind})"

    def __post_init__(self) -> None:
        try:
            time_us = np.array(self.time_us, dtype=np.int64)
            position = np.array(self.position, dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise GroundTruthError(
                f"time_us and position of a track are {kind_of(self.time_us)} and "
                f"{kind_of(self.position)}: give numbers of shape (n,) and (n, d)"
            ) from error
        if self.kind not in ("geographic", "metric"):
            raise GroundTruthError(f"track kind {self.kind!r} is unknown: use geographic or metric")
        widths = (2,) if self.kind == "geographic" else (1, 2, 3)
        if time_us.ndim != 1 or time_us.size == 0 or position.ndim != 2:
            raise GroundTruthError(
                f"a track has times of shape {time_us.shape} and positions of shape "
                f"{position.shape}: give (n,) and (n, d) with n of at least 1"
            )
        if position.shape[0] != time_us.size or position.shape[1] not in widths:
            raise GroundTruthError(
                f"a {self.kind} track of {time_us.size} times has positions of shape "
                f"{position.shape}: expected ({time_us.size}, d) with d in {widths}"
            )
        if max(abs(int(time_us.min())), abs(int(time_us.max()))) > TIME_LIMIT_US:
            raise GroundTruthError(
                f"track time runs from {time_us.min()} to {time_us.max()} us, beyond "
                f"{TIME_LIMIT_US}: give seconds from the recording's start"
            )
        back = np.flatnonzero(np.diff(time_us) <= 0)
        if back.size:
            i = int(back[0])
            raise GroundTruthError(
                f"track time does not increase at point {i + 1}, from {time_us[i]} to "
                f"{time_us[i + 1]} us: sort the points and keep one a time"
            )
        if not np.isfinite(position).all():
            i = int(np.flatnonzero(~np.isfinite(position).all(axis=1))[0])
            raise GroundTruthError(f"track point {i} is not finite: leave unknown points out")
        if self.kind == "geographic" and (np.abs(position) > (90.0, 180.0)).any():
            i = int(np.flatnonzero((np.abs(position) > (90.0, 180.0)).any(axis=1))[0])
            raise GroundTruthError(
                f"track point {i} is {tuple(position[i].tolist())}, outside 90 and 180 degrees: "
                "give latitude first, then longitude"
            )
        for array in (time_us, position):
            array.setflags(write=False)
        object.__setattr__(self, "time_us", time_us)
        object.__setattr__(self, "position", position)

    def shifted(self, seconds: float) -> Track:
        """Return the same track with its times shifted.

        Parameters
        ----------
        seconds : float
            Where time 0 of the track is in the recording; negative if the log began earlier.

        Raises
        ------
        GroundTruthError
            If it is not a finite number, or moves the track out of the range of times.
        """
        if not abs(seconds) * 1e6 <= TIME_LIMIT_US:
            raise GroundTruthError(f"offset of {seconds} s: expected seconds such as 5 or -2.5")
        offset = round(seconds * 1e6)
        start = self.start_utc
        if start is not None:
            try:
                start -= dt.timedelta(microseconds=offset)
            except OverflowError:
                start = None
        return replace(self, time_us=self.time_us + offset, start_utc=start)

    def describe_dropped(self) -> str:
        """Return a text on how much of the log was left out, and why."""
        total = sum(self.dropped.values())
        if total == 0:
            return "nothing was left out"
        reasons = ", ".join(f"{count:,} with {why}" for why, count in self.dropped.items())
        share = 100 * total / max(self.entries, total)
        return f"{total:,} of {self.entries:,} entries were left out ({share:.1f} %: {reasons})"

    def at(self, times_us: npt.ArrayLike) -> Floats:
        """Return positions at other times, linear between the points of the track.

        Parameters
        ----------
        times_us : array_like, shape (m,)
            Microseconds from the recording's start.

        Returns
        -------
        ndarray of float64, shape (m, d)
            NaN before the first point, after the last, and inside gaps longer than `max_gap_us`.

        Examples
        --------
        >>> Track([0, 1_000_000], [[0.0], [3.0]]).at([500_000, 1_000_001]).tolist()
        [[1.5], [nan]]
        """
        position = self.position
        if self.kind == "geographic":  # the short way round across the 180th meridian
            position = np.column_stack([position[:, 0], np.unwrap(position[:, 1], period=360.0)])
        found = interpolate(times_us, self.time_us, position, max_gap=self.max_gap_us)
        if self.kind == "geographic":
            wrapped = np.abs(found[:, 1]) > 180.0
            found[wrapped, 1] = (found[wrapped, 1] + 180.0) % 360.0 - 180.0
        return found


def interpolate(
    x: npt.ArrayLike, points: npt.ArrayLike, values: Floats, *, max_gap: float | None = None
) -> Floats:
    """Interpolate linearly; the result is NaN outside the points and in gaps.

    `numpy.interp` continues the end values, and can use fused operations on some machines. Here
    each operation rounds once, so that every machine gets the same places.

    Parameters
    ----------
    x : array_like, shape (m,)
        Where the values are wanted.
    points : array_like, shape (n,)
        Strictly increasing.
    values : ndarray of float64, shape (n, d)
        Values at `points`.
    max_gap : float, optional
        Between points further apart than this the result is NaN (but not at the points).

    Returns
    -------
    ndarray of float64, shape (m, d)
    """
    at, known = np.asarray(x, dtype=np.float64), np.asarray(points, dtype=np.float64)
    inside = (at >= known[0]) & (at <= known[-1])
    right = np.clip(np.searchsorted(known, at), 1, max(known.size - 1, 1))
    right = np.minimum(right, known.size - 1)
    left = np.maximum(right - 1, 0)
    gap = known[right] - known[left]
    weight = np.where(gap > 0, (at - known[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    if max_gap is not None:
        inside &= (gap <= max_gap) | (at == known[left]) | (at == known[right])
    found = values[left] + weight[:, None] * (values[right] - values[left])
    # a + 1 * (b - a) may differ from b: at a point, use its own value
    found = np.where((weight == 1.0)[:, None], values[right], found)
    return np.where(inside[:, None], found, np.nan)


def great_circle(a: Floats, b: Floats) -> Floats:
    """Return distances on a sphere of the Earth's mean radius (haversine).

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., 2)
        Latitude and longitude in degrees; broadcast against each other.

    Returns
    -------
    ndarray of float64, shape (...)
        Metres. The Earth's flattening makes it wrong by up to 0.6 %.
    """
    a, b = np.radians(a), np.radians(b)
    half = np.sin((a - b) / 2.0) ** 2
    h = half[..., 0] + np.cos(a[..., 0]) * np.cos(b[..., 0]) * half[..., 1]
    return 2.0 * EARTH_RADIUS_M * np.arcsin(np.sqrt(np.minimum(h, 1.0)))


def local_metres(kind: Kind, position: Floats, origin: Floats) -> Floats:
    """Return positions on a flat map, in metres east and north of an origin.

    Parameters
    ----------
    kind : {"metric", "geographic"}
        Metric positions are returned as they are.
    position : ndarray of float64, shape (n, d)
        Positions of the kind.
    origin : ndarray of float64, shape (d,)
        Latitude and longitude in degrees, near the positions: lengths are exact along its parallel
        and its meridian, and wrong by less than 1 % within 50 km up to 50 degrees of latitude.

    Examples
    --------
    >>> local_metres("geographic", np.array([[0.0, 0.001]]), np.zeros(2)).round(1).tolist()
    [[111.2, 0.0]]
    """
    if kind == "metric":
        return position
    north, east = np.radians(position - origin).T
    east = (east + np.pi) % (2 * np.pi) - np.pi  # the short way round across the 180th meridian
    return EARTH_RADIUS_M * np.column_stack([east * np.cos(np.radians(origin[0])), north])


def distances(kind: Kind, a: Floats, b: Floats) -> Floats:
    """Return the distances between positions of a kind, in metres, shape (...).

    Parameters
    ----------
    kind : {"metric", "geographic"}
        What the positions are.
    a, b : ndarray of float64, shape (..., d)
        Broadcast against each other.
    """
    if kind == "geographic":
        return great_circle(a, b)
    return np.asarray(np.sqrt(((a - b) ** 2).sum(axis=-1)))


# Reading of text files of ground truth, in any usual encoding.


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


# Track files: GPS logs, tables with names, and poses.


#: Between two fixes further apart than this the position counts as unknown. A car at 50 km/h drives
#: 70 m, the tolerance of Brisbane-Event-VPR, in 5 s; the logs of that data set have gaps of 4 s.
MAX_GAP_S = 5.0


def load_track(path: str | Path, *, max_gap_s: float | None = MAX_GAP_S) -> Track:
    """Read a track from a GPS log, a table with names, or poses as TUM and KITTI write them.

    Parameters
    ----------
    path : str or Path
        ``.nmea``, ``.gpx``: a GPS log. ``.csv``: a table with a header, which can be a comment, as
        in EuRoC. Its columns are the time (``time_s``, ``timestamp``, ``timestamp [ns]``; seconds
        if the name has no unit), and ``latitude,longitude``, ``x_m[,y_m[,z_m]]``, ``tx,ty,tz``,
        EuRoC's ``p_RS_R_x [m],...`` or ``position_m``; others are ignored. ``.txt``, ``.tum``:
        eight numbers a line (TUM: seconds, position, rotation), or twelve (KITTI: the first three
        rows of a pose; the seconds are in ``times.txt`` beside it, or in KITTI's own folder).
    max_gap_s : float, optional
        Positions between points further apart are unknown; None for points set by hand.

    Returns
    -------
    Track
        Times are those of the file, also where they count from 1970: see `Track.shifted`. Of a GPS
        log, time 0 is its first entry with a time, and `start_utc` is set where it states a date.

    Raises
    ------
    GroundTruthError
        If the file cannot be read or is not of this form, or a log holds no position, or its time
        runs backwards.
    """
    path = as_path(path, "a track")
    suffix = path.suffix.lower()
    max_gap_us = None if max_gap_s is None else round(max_gap_s * 1e6)
    if suffix == ".nmea":
        return _nmea_track(path, max_gap_us)
    if suffix == ".gpx":
        return _gpx_track(path, max_gap_us)
    if suffix == ".csv":
        time_us, position, kind = _named_columns(path)
    elif suffix in (".txt", ".tum"):
        time_us, position, kind = *_poses(path), "metric"
    else:
        raise GroundTruthError(
            f"{path} is not a track: give a .nmea or .gpx log, a .csv table, or poses of TUM or "
            "KITTI (.tum, .txt)"
        )
    try:
        return Track(time_us, position, kind, max_gap_us)
    except GroundTruthError as error:
        raise GroundTruthError(f"{path}: {error}") from None


_TIME_COLUMN = re.compile(r"(?:time|timestamp)(?:[ _]?\[?(s|ms|us|ns)\]?)?")
_IN_A_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
#: Names of the columns of a position, without their unit of metres.
_POSITION_COLUMNS: tuple[tuple[Kind, tuple[str, ...]], ...] = (
    ("geographic", ("latitude", "longitude")),
    ("geographic", ("lat", "lon")),
    ("metric", ("position",)),
    ("metric", ("x", "y", "z")),
    ("metric", ("tx", "ty", "tz")),
    ("metric", ("p_rs_r_x", "p_rs_r_y", "p_rs_r_z")),
)


def _named_columns(path: Path) -> tuple[npt.NDArray[np.int64], Floats, Kind]:
    """Return times and positions of a table, found by the names of its columns."""
    header, rows = _records(path)
    times = [i for i, name in enumerate(header) if _TIME_COLUMN.fullmatch(name)]
    names = [re.sub(r" ?\[m\]$|_m$", "", name) for name in header]
    found = []
    for kind, wanted in _POSITION_COLUMNS:
        columns = [names.index(name) for name in takewhile(names.__contains__, wanted)]
        if len(columns) == len(wanted) or (columns and kind == "metric"):
            found.append((kind, columns))
    if len(times) != 1 or len(found) != 1:
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected time_s,x_m[,y_m[,z_m]], "
            "time_s,position_m or time_s,latitude,longitude; times can be timestamp_ns too"
        )
    ((kind, columns),) = found
    table = _numbers(path, header, rows, [times[0], *columns])
    match = _TIME_COLUMN.fullmatch(header[times[0]])
    assert match is not None
    return _times_us(path, table[:, 0], match[1] or "s"), table[:, 1:], kind


def _poses(path: Path) -> tuple[npt.NDArray[np.int64], Floats]:
    """Return times and positions of poses: eight numbers a line (TUM), or twelve (KITTI)."""
    poses = _number_lines(path)
    if poses.shape[1] == 8:
        return _times_us(path, poses[:, 0], "s"), poses[:, 1:4]
    if poses.shape[1] != 12:
        raise GroundTruthError(
            f"{path} has {poses.shape[1]} numbers in its first line: poses have 8 (TUM: seconds, "
            "position, rotation) or 12 (KITTI)"
        )
    of_sequence = path.parent.parent / "sequences" / path.stem / "times.txt"
    places = (path.with_name("times.txt"), path.with_name(f"{path.stem}_times.txt"), of_sequence)
    times = next((place for place in places if place.is_file()), None)
    if times is None:
        raise GroundTruthError(
            f"{path} holds poses of KITTI, which have no times: put the sequence's times.txt "
            f"beside it ({', '.join(str(place) for place in places)} are looked for)"
        )
    seconds = _number_lines(times)
    if seconds.shape != (len(poses), 1):
        raise GroundTruthError(
            f"{times} has {seconds.size} times, and {path} {len(poses)} poses: give one a pose"
        )
    return _times_us(times, seconds[:, 0], "s"), poses[:, [3, 7, 11]]


def _number_lines(path: Path) -> Floats:
    """Read lines of numbers between blanks or commas, all as long as the first."""
    lines = [line.replace(",", " ").split() for line in read_text(path).splitlines()]
    rows = [line for line in lines if line and not line[0].startswith("#")]
    if not rows:
        raise GroundTruthError(f"{path} has no rows: give one pose a line")
    header = tuple(f"number {i + 1}" for i in range(len(rows[0])))
    return _numbers(path, header, rows, list(range(len(header))))


def _times_us(path: Path, times: Floats, unit: str) -> npt.NDArray[np.int64]:
    times = times * (1_000_000 / _IN_A_SECOND[unit])
    if np.abs(times).max() > TIME_LIMIT_US:
        raise GroundTruthError(
            f"{path} has times up to {np.abs(times).max() / 1e6:g} s: name their unit in the "
            "header, as in time_ns, or give seconds from the recording's start"
        )
    return np.round(times).astype(np.int64)


#: Times after this one, in 1973, count from 1970 and not from a recording's start.
_UNIX_US = 10**14
_HOUR_US = 3_600_000_000


def unix_remedy(flag: str, *tracks: Track, start_us: int | None = None) -> str:
    """Return the offsets of tracks whose times count from 1970, for messages; "" if none does.

    Parameters
    ----------
    flag : str
        Takes the offsets.
    start_us : int, optional
        The recording's start on its own clock, which is taken if it is near the track.

    Examples
    --------
    >>> unix_remedy("--track-offset", Track([1_587_452_582_350_000], [[0.0]]))
    'Unix times: pass --track-offset -1587452582.35, if the track begins with its recording'
    """
    first = [int(track.time_us[0]) for track in tracks]
    if max(first) < _UNIX_US:
        return ""
    offsets = [-time if time >= _UNIX_US else 0 for time in first]
    near = start_us is not None and abs(start_us - first[0]) < _HOUR_US
    if near and start_us is not None:
        offsets = [-start_us]
    shown = " ".join(f"{time / 1e6:.6f}".rstrip("0").rstrip(".") for time in offsets)
    one = "the track begins" if len(tracks) == 1 else "each track begins"
    return f"Unix times: pass {flag} {shown}" + ("" if near else f", if {one} with its recording")


# GPS logs as receivers send them: NMEA 0183.


def _nmea_track(path: Path, max_gap_us: int | None) -> Track:
    """Read the RMC and GGA sentences of a GPS log (NMEA 0183, any talker).

    Time 0 is the first sentence of the log with a time, with or without a fix. If logger and camera
    start together, this is the start of the recording. Sentences with a wrong or missing checksum,
    or without a fix, are left out and counted in `Track.dropped`. RMC and GGA of one instant make
    one point, the first. A log may pass midnight.
    """
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
        max_gap_us,
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


# GPS logs in GPX, the exchange format of hand-held receivers and telephones.


_MICROSECOND = dt.timedelta(microseconds=1)


def _gpx_track(path: Path, max_gap_us: int | None) -> Track:
    """Read the track points of a GPX file (version 1.0 or 1.1, all segments in a row).

    Time 0 is the first point with a time. Points without a time or with a faulty one, or without a
    position, are left out and counted in `Track.dropped`. Of several points at one time, the first
    is taken.
    """
    dropped: Counter[str] = Counter()
    fixes: dict[dt.datetime, tuple[float, float]] = {}
    entries, last = 0, None
    for point in _points(path):
        entries += 1
        time = _time(point)
        if time is None:
            dropped["no time"] += 1
            continue
        position = _position(point)
        if position is None:
            dropped["unreadable position"] += 1
            continue
        if last is not None and time < last:
            raise GroundTruthError(
                f"{path}: time runs backwards by {(last - time).total_seconds():g} s at track "
                f"point {entries}: split the log there and use the part of this traverse"
            )
        last = time
        fixes.setdefault(time, position)
    if not fixes:
        raise GroundTruthError(
            f"{path} holds no track point with a time and a position ({entries} points): export "
            "the recorded track, not a planned route"
        )
    start = next(iter(fixes))
    return Track(
        np.array([(time - start) // _MICROSECOND for time in fixes], dtype=np.int64),
        np.array(list(fixes.values())),
        "geographic",
        max_gap_us,
        start,
        MappingProxyType(dict(dropped)),
        entries,
    )


def _points(path: Path) -> list[ElementTree.Element]:
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        # nested entities can expand to gigabytes; GPX needs none
        raise GroundTruthError(f"{path} declares XML entities: export it as plain GPX")
    try:
        # the text is decoded already, so that the declared encoding would be wrong
        root = ElementTree.fromstring(text[text.find("?>") + 2 :] if "<?xml" in text else text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise GroundTruthError(f"{path} is not a GPX file ({error}): export it again") from error
    return [element for element in root.iter() if _name(element) == "trkpt"]


def _name(element: ElementTree.Element) -> str:
    """Return the name of an element without its namespace, which depends on the version."""
    return element.tag.rpartition("}")[2]


def _time(point: ElementTree.Element) -> dt.datetime | None:
    for child in point:
        if _name(child) == "time":
            try:
                time = dt.datetime.fromisoformat((child.text or "").strip())
                zone = time.tzinfo or dt.UTC  # times in GPX are UTC, even without a Z
                return time.replace(tzinfo=zone).astimezone(dt.UTC)
            except (ValueError, OverflowError):
                return None
    return None


def _position(point: ElementTree.Element) -> tuple[float, float] | None:
    try:
        latitude, longitude = float(point.get("lat", "")), float(point.get("lon", ""))
    except ValueError:
        return None
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        return None
    return latitude, longitude


# Tables: CSV files of numbers.


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
    header, rows = _records(Path(path))
    return header, _numbers(path, header, rows, list(range(len(header))))


def _records(path: Path) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the header of a CSV file, in lower case, and its rows.

    A comment that is as long as the row of numbers below it is the header, as in EuRoC.
    """
    try:
        lines = [row for row in csv.reader(read_text(path).splitlines(keepends=True)) if row]
    except csv.Error:
        raise GroundTruthError(f"{path} is not a text table: give a .csv file") from None
    first = next((i for i, row in enumerate(lines) if not row[0].startswith("#")), len(lines))
    if 0 < first < len(lines) and len(lines[first - 1]) == len(lines[first]) > 1:
        with contextlib.suppress(ValueError):
            float(lines[first][0])
            first -= 1
    rows = [row for row in lines[first + 1 :] if not row[0].startswith("#")]
    if not rows:
        raise GroundTruthError(f"{path} has no rows: give a header line and at least one row")
    return tuple(name.strip(" #").lower() for name in lines[first]), rows


def _numbers(
    path: str | Path, header: tuple[str, ...], rows: list[list[str]], columns: list[int]
) -> Floats:
    """Return some columns of a table, shape (n, columns), whose rows are as long as its header."""
    table = np.empty((len(rows), len(columns)))
    for number, row in enumerate(rows):
        try:
            cells = dict(zip(range(len(header)), row, strict=True))
            table[number] = [float(cells[column]) for column in columns]
        except ValueError:
            raise GroundTruthError(
                f"{path}: row {number + 1} is {','.join(row)!r}, not {len(header)} numbers for "
                f"{','.join(header)}: correct it"
            ) from None
    if not np.isfinite(table).all():
        row_number = int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0]) + 1
        raise GroundTruthError(f"{path}: row {row_number} is not finite: leave the row out")
    return table


# The positions of a map's places, from the track of the reference drive.


def with_positions(reference: AnyMap, track: Track, start_us: int | None = None) -> AnyMap:
    """Give each place the position that the reference drive had in the middle of its window.

    Metres along the route are counted from the beginning of the first window whose place is known.

    Parameters
    ----------
    track : Track
        Of the reference drive; time 0 is the recording's start.
    start_us : int, optional
        That start on the recording's own clock, for the message about a track of Unix times.

    Raises
    ------
    GroundTruthError
        If the track covers no place.
    """
    position = track.at(reference.places.centre_us)
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    if known.size == 0:
        first, last = (float(t) / 1e6 for t in (track.time_us[0], track.time_us[-1]))
        raise GroundTruthError(
            f"the track runs from {first:.1f} to {last:.1f} s and covers no place of the map: "
            + (
                unix_remedy("--track-offset", track, start_us=start_us)
                or "give the reference drive's own track, and set its clock right"
            )
        )
    position[~np.isfinite(position).all(axis=1)] = np.nan
    along = np.full(len(position), np.nan)
    # distances are added between places, not between fixes: those would add the noise of the GPS
    stops = np.concatenate([track.at(reference.places.start_us[known[:1]]), position[known]])
    legs = distances(track.kind, stops[:-1], stops[1:])
    along[known] = np.cumsum(np.nan_to_num(legs))  # a track may begin within that window
    return replace(reference, route=Route(position, along, track.kind))


# Odometry files: tables of time and distance, or of time and speed.


def load_odometry(path: str | Path) -> Odometry:
    """Read odometry from a ``.csv`` table.

    Parameters
    ----------
    path : str or Path
        With the header ``time_s,distance_m`` (the reading of an odometer, from any zero),
        ``time_s,position_m`` (a track along the route), or ``time_s,speed_mps`` (below 0 backwards;
        between two rows the mean of both holds). Times in seconds from the recording's start.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, is not of this form, or holds values out of range.
    """
    path = as_path(path, "odometry")
    if path.suffix.lower() != ".csv":
        raise GroundTruthError(f"{path} is not odometry: give a .csv table")
    header, table = read_table(path)
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
    if not (np.abs(time_s) * 1e6 <= TIME_LIMIT_US).all():
        raise GroundTruthError(
            f"{path} has times up to {np.abs(time_s).max():g} s: give seconds from the recording's "
            "start"
        )
    if not (np.abs(values) * 1e3 <= MOST_MM).all():
        raise GroundTruthError(
            f"{path} has distances up to {np.abs(values).max():g} m: expected at most "
            f"{MOST_MM // 1000}"
        )
    try:
        return Odometry(
            np.rint(time_s * 1e6).astype(np.int64), np.rint(values * 1e3).astype(np.int64)
        )
    except UsageError as error:
        raise GroundTruthError(f"{path}: {error}") from None


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


# Jump files: tables of pairs of places between which one step can lead.


def load_jumps(path: str | Path, places: int) -> npt.NDArray[np.int32]:
    """Read jumps from a ``.csv`` table.

    Parameters
    ----------
    path : str or Path
        With the header ``from,to``: from the first place of a row, one step leads to the second.
        For both directions, give two rows.
    places : int
        Number of places of the map, which are counted from 0.

    Returns
    -------
    ndarray of int32, shape (n, 2)

    Raises
    ------
    GroundTruthError
        If the file cannot be read, is not of this form, or names a place that the map lacks.
    """
    path = as_path(path, "a list of jumps")
    if path.suffix.lower() != ".csv":
        raise GroundTruthError(f"{path} is no list of jumps: give a .csv table")
    header, table = read_table(path)
    if header != ("from", "to"):
        raise GroundTruthError(f"{path} has the header {','.join(header)!r}: expected from,to")
    wrong = (table != np.floor(table)) | (table < 0) | (table >= places)
    rows = np.flatnonzero(wrong.any(axis=1) | (table[:, 0] == table[:, 1]))
    if rows.size:
        one, other = table[rows[0]].tolist()
        raise GroundTruthError(
            f"{path}: row {rows[0] + 1} is {one:g},{other:g}: expected two places of the map, from "
            f"0 to {places - 1}"
        )
    return table.astype(np.int32)
