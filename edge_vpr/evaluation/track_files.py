"""Files of tracks: GPS logs (NMEA, GPX), tables with named columns, and poses."""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError, as_path
from edge_vpr.evaluation.fixes import Fixes, in_order, within_reach
from edge_vpr.evaluation.nmea import is_nmea, read_nmea
from edge_vpr.evaluation.tables import (
    UNKNOWN,
    Floats,
    TableData,
    cells_of,
    numbers,
    read_cells,
    read_text,
)
from edge_vpr.evaluation.tracks import MAX_GAP_US, Track
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.files import replacing
from edge_vpr.recordings.memory import column_names
from edge_vpr.route import Kind

#: of files that can be a table or poses
_TEXTS = (".csv", ".tsv", ".txt", ".tum", ".log", ".dat")


#: a track as callers hold it
AnyTrack: TypeAlias = Track | TableData | str | Path
_PLACE = Path("the track data")


def load_track(path: str | Path | TableData, *, max_gap_s: float = MAX_GAP_US / 1e6) -> Track:
    """Read a track from a GPS log, a table with names, or poses as TUM and KITTI write them.

    Parameters
    ----------
    path : str or Path or TableData
        A file, or a table in memory by the same rules (a DataFrame, an Arrow table, a mapping). GPS
        logs are known by their content: NMEA and GPX. A table has a header, which can be a
        comment, as in EuRoC. Its columns are the time (``time_s``, ``timestamp``, ``timestamp
        [ns]``; seconds if the name has no unit; or dates with times), and ``latitude,longitude``,
        ``x_m[,y_m[,z_m]]``, ``tx,ty,tz``, EuRoC's ``p_RS_R_x [m],...``, ``position_m``, or without
        any of these ``distance_m`` of an odometer; others are ignored. Poses have eight numbers a
        line (TUM: seconds, position, rotation), or twelve (KITTI: the first three rows of a pose;
        the seconds are in ``times.txt`` beside it, or in KITTI's own folder).
    max_gap_s : float
        Positions between points further apart are unknown.

    Returns
    -------
    Track
        Times are those of the file, also where they count from 1970: see `Track.shifted`. Of a log
        with dates, time 0 is its first entry with a time, and `start_utc` is set. What no drive can
        have is left out and counted in `Track.dropped`, see `fixes.within_reach`.

    Raises
    ------
    GroundTruthError
        If the file cannot be read or is not of this form, or a log holds no position, or its time
        runs backwards.

    Examples
    --------
    >>> load_track({"time_s": [0.0, 1.0, 2.0], "x_m": [0.0, 4.0, 9.0]}).at([500_000]).tolist()
    [[2.0]]
    """
    if not max_gap_s > 0:
        raise GroundTruthError(
            f"a longest gap of {max_gap_s:g} s (max_gap_s=): expected seconds such as 20"
        )
    names = column_names(path)
    place = as_path(path, "a track") if names is None else _PLACE
    try:
        read = (
            _fixes(place) if names is None else _named_columns(place, *cells_of(path, names, place))
        )
        fixes = within_reach(in_order(read))
        return Track(
            fixes.time_us,
            fixes.position,
            fixes.kind,
            round(min(max_gap_s * 1e6, TIME_LIMIT_US)),
            fixes.start_utc,
            MappingProxyType(dict(fixes.dropped)),
            fixes.entries,
        )
    except GroundTruthError as error:
        message = str(error)
        raise GroundTruthError(
            message if str(place) in message else f"{place}: {message}"
        ) from None


def _fixes(path: Path) -> Fixes:
    """Read the entries of a file, whose form its content or else its suffix says."""
    suffix, text = path.suffix.lower(), read_text(path)
    start = text[:1_000].lstrip()
    if suffix == ".nmea" or (not start.startswith("<") and is_nmea(text)):
        return read_nmea(text)
    if suffix == ".gpx" or start.startswith(("<?xml", "<gpx")):
        return _gpx(text)
    if suffix in _TEXTS:
        if _has_header(text):
            return _named_columns(path, *read_cells(path, text))
        return _poses(path, text)
    raise GroundTruthError(
        "this is not a track: give a log of NMEA or GPX, a .csv table, or poses of TUM or KITTI "
        "(.tum, .txt)"
    )


# GPX, the exchange format of hand-held receivers and telephones.

_MICROSECOND = dt.timedelta(microseconds=1)


def _utc(text: str) -> dt.datetime | None:
    """Read a date with its time (ISO 8601); UTC if it states no zone. None if it is no such."""
    if ":" not in text:  # a number, which can look like a date without separators
        return None
    try:
        time = dt.datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return time.replace(tzinfo=dt.UTC) if time.tzinfo is None else time.astimezone(dt.UTC)


def _of_dates(
    start: dt.datetime,
    times: list[dt.datetime],
    position: Floats,
    dropped: Counter[str],
    entries: int,
) -> Fixes:
    time_us = np.array([(time - start) // _MICROSECOND for time in times], dtype=np.int64)
    return Fixes(time_us, position, "geographic", start, dropped, entries)


def _gpx(text: str) -> Fixes:
    """Read the track points of a GPX file (1.0 or 1.1, all segments in a row), else waypoints."""
    dropped: Counter[str] = Counter()
    times, positions = [], []
    entries, unread, start = 0, "", None
    for point in _points(text):
        entries += 1
        parts = {_name(child): (child.text or "").strip() for child in point}
        written = parts.get("time", "")
        time, position = _utc(written), _position(point)
        start = start or time
        if parts.get("fix") == "none":
            dropped["no fix"] += 1
        elif time is None:
            dropped["unreadable time" if written else "no time"] += 1
            unread = unread or written
        elif position is None:
            dropped["unreadable position"] += 1
        else:
            times.append(time)
            positions.append(position)
    if not times or start is None:
        counts = ", ".join(f"{count} with {why}" for why, count in dropped.items())
        remedy = "export the recorded track, not a planned route"
        if unread:
            remedy = f"write times such as 2024-03-04T10:00:00Z, and not {unread[:40]!r}"
        elif dropped["unreadable position"]:
            remedy = "export latitudes and longitudes in degrees"
        raise GroundTruthError(
            f"no track point with a time and a position ({counts or 'no point at all'}): {remedy}"
        )
    return _of_dates(start, times, np.array(positions), dropped, entries)


def _points(text: str) -> list[ElementTree.Element]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        # nested entities can expand to gigabytes; GPX needs none
        raise GroundTruthError("the file declares XML entities: export it as plain GPX")
    try:
        # the text is decoded already, so that the declared encoding would be wrong
        root = ElementTree.fromstring(text[text.find("?>") + 2 :] if "<?xml" in text else text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise GroundTruthError(f"this is not a GPX file ({error}): export it again") from error
    if _name(root) == "kml":
        raise GroundTruthError("this is KML: convert it to GPX, for example with GPSBabel")
    points = [element for element in root.iter() if _name(element) in ("trkpt", "wpt")]
    return [point for point in points if _name(point) == "trkpt"] or points


def _name(element: ElementTree.Element) -> str:
    """Return the name of an element without its namespace, which depends on the version."""
    return element.tag.rpartition("}")[2]


def _position(point: ElementTree.Element) -> tuple[float, float] | None:
    try:
        latitude, longitude = (
            float(point.get(name, "").replace(",", ".")) for name in ("lat", "lon")
        )
    except ValueError:
        return None
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        return None
    return latitude, longitude


# Tables with names, and poses.


_TIME_COLUMN = re.compile(r"(?:time|timestamp)(?:[ _]?[\[(]?(s|ms|us|µs|ns)[\])]?)?")
_NAMED_TIME = re.compile(rf"#\s*{_TIME_COLUMN.pattern}(?=[\s,;])")
_IN_A_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "µs": 1_000_000, "ns": 1_000_000_000}
#: Units of positions, which are not part of the name of a column.
_POSITION_UNIT = re.compile(r"(?:[ _]?[\[(](?:m|°|deg|degrees)[\])]|_m|_deg)$")
#: Names of the columns of a position, without their unit.
_POSITION_COLUMNS: tuple[tuple[Kind, tuple[str, ...]], ...] = (
    ("geographic", ("latitude", "longitude")),
    ("geographic", ("lat", "lon")),
    ("metric", ("position",)),
    ("metric", ("x", "y", "z")),
    ("metric", ("tx", "ty", "tz")),
    ("metric", ("px", "py", "pz")),
    ("metric", ("p_rs_r_x", "p_rs_r_y", "p_rs_r_z")),
)
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[-+]?\d+)?|nan", re.IGNORECASE)


def _has_header(text: str) -> bool:
    """Return whether the first line that is no comment, or the comment before it, names columns."""
    before = ""
    for line in text.splitlines():
        if line.startswith("#"):
            before = line
        elif line.strip():
            first, *others = re.split(r"[,;\t]", line)
            named_above = bool(others) and len(re.split(r"[,;\t]", before)) == len(others) + 1
            return named_above or not _NUMBER.fullmatch(re.split(r"[\s]", first.strip())[0])
    return False


def _named_columns(path: Path, header: tuple[str, ...], rows: list[list[str]]) -> Fixes:
    """Return times and positions of a table, found by the names of its columns."""
    times = [i for i, name in enumerate(header) if _TIME_COLUMN.fullmatch(name)]
    names = [_POSITION_UNIT.sub("", name) for name in header]
    positions: list[tuple[Kind, list[int]]] = []
    for kind, wanted in _POSITION_COLUMNS:
        columns = [names.index(name) for name in takewhile(names.__contains__, wanted)]
        if len(columns) == len(wanted) or (columns and kind == "metric"):
            positions.append((kind, columns))
    if not positions and "distance" in names:  # of an odometer
        positions.append(("metric", [names.index("distance")]))
    if len(times) > 1:
        raise GroundTruthError(
            f"{path} has {len(times)} columns of time ({', '.join(header[i] for i in times)}): "
            "leave all but one out"
        )
    if len(positions) > 1:
        kinds = " and ".join(",".join(header[i] for i in columns) for _, columns in positions)
        raise GroundTruthError(
            f"{path} has {len(positions)} kinds of position ({kinds}): leave all but one out"
        )
    if not times or not positions:
        raise GroundTruthError(
            f"{path} has the header {','.join(header)!r}: expected time_s,x_m[,y_m[,z_m]], "
            "time_s,position_m, time_s,distance_m or time_s,latitude,longitude; times can be "
            "timestamp_ns too"
        )
    ((kind, columns),) = positions
    position = numbers(path, header, rows, columns, unknown=True)
    if kind == "geographic":
        longitude = position[:, 1]
        longitude -= 360.0 * ((longitude > 180.0) & (longitude <= 360.0))
    written = [row[times[0]] for row in rows]
    timed = np.array([time.lower() not in UNKNOWN for time in written])
    dropped = Counter({"no time": int((~timed).sum())})
    if not timed.any():
        raise GroundTruthError(f"{path} has no row with a time: fill its cells")
    position, written = position[timed], [time for time in written if time.lower() not in UNKNOWN]
    if _utc(written[0]) is not None:
        dates = [_utc(time) for time in written]
        if None in dates:
            wrong = written[dates.index(None)]
            raise GroundTruthError(f"{path} has the time {wrong!r}: write all of them alike")
        stated = [date for date in dates if date is not None]
        return _of_dates(stated[0], stated, position, dropped, len(rows))._replace(kind=kind)
    kept = [row for row, is_timed in zip(rows, timed.tolist(), strict=True) if is_timed]
    match = _TIME_COLUMN.fullmatch(header[times[0]])
    assert match is not None
    time_us = _times_us(path, numbers(path, header, kept, [times[0]])[:, 0], match[1] or "s")
    return Fixes(time_us, position, kind, None, dropped, len(rows))


def _poses(path: Path, text: str) -> Fixes:
    """Return times and positions of poses: eight numbers a line (TUM), or twelve (KITTI)."""
    rows = _lines(path, text)
    if len(rows[0]) not in (8, 12):
        raise GroundTruthError(
            f"{path} has {len(rows[0])} cells in its first line: poses have 8 (TUM: seconds, "
            "position, rotation) or 12 (KITTI), and tables a header such as time_s,x_m,y_m"
        )
    poses = _all_numbers(path, rows)
    if poses.shape[1] == 8:
        named = filter(None, map(_NAMED_TIME.match, text.lower().splitlines()))
        unit = next((match[1] for match in named if match[1]), "s")
        time_us = _times_us(path, poses[:, 0], unit)
        position = poses[:, 1:4]
    else:
        time_us, position = _kitti_times(path, len(poses)), poses[:, [3, 7, 11]]
    return Fixes(time_us, position, "metric", None, Counter(), len(poses))


def _kitti_times(path: Path, poses: int) -> npt.NDArray[np.int64]:
    of_sequence = path.parent.parent / "sequences" / path.stem / "times.txt"
    places = (path.with_name("times.txt"), path.with_name(f"{path.stem}_times.txt"), of_sequence)
    times = next((place for place in places if place.is_file()), None)
    if times is None:
        raise GroundTruthError(
            f"{path} holds poses of KITTI, which have no times: put the sequence's times.txt "
            f"beside it ({', '.join(str(place) for place in places)} are looked for)"
        )
    seconds = _all_numbers(times, _lines(times, read_text(times)))
    if seconds.shape != (poses, 1):
        raise GroundTruthError(
            f"{times} has {seconds.size} times, and {path} {poses} poses: give one a pose"
        )
    return _times_us(times, seconds[:, 0], "s")


def _lines(path: Path, text: str) -> list[list[str]]:
    """Return the cells of lines, between blanks, commas or semicolons."""
    lines = [re.split(r"[\s,;]+", line.strip()) for line in text.splitlines()]
    rows = [line for line in lines if line[0] and not line[0].startswith("#")]
    if not rows:
        raise GroundTruthError(f"{path} has no rows: give one pose a line")
    return rows


def _all_numbers(path: Path, rows: list[list[str]]) -> Floats:
    header = tuple(f"number {i + 1}" for i in range(len(rows[0])))
    return numbers(path, header, rows, range(len(header)))


def _times_us(path: Path, times: Floats, unit: str) -> npt.NDArray[np.int64]:
    times = times * (1_000_000 / _IN_A_SECOND[unit])
    if np.abs(times).max() > TIME_LIMIT_US:
        raise GroundTruthError(
            f"{path} has times up to {np.abs(times).max() / 1e6:g} s: name their unit in the "
            "header, as in time_ns, or give seconds from the recording's start"
        )
    return np.round(times).astype(np.int64)


def save_track(path: Path, track: Track) -> None:
    """Write the distance along a route over time as a table for `load_track`, atomically."""
    rows = zip(track.time_us.tolist(), track.position[:, 0].tolist(), strict=True)
    with replacing(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write("time_s,position_m\n")
        file.writelines(f"{t / 1e6:.6f},{metres:.4f}\n" for t, metres in rows)
