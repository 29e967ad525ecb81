"""GPS logs in GPX, the exchange format of hand-held receivers and telephones."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

import numpy as np

from edge_vpr.errors import GroundTruthError
from edge_vpr.evaluation.text_files import read_text
from edge_vpr.evaluation.tracks import Track

_MICROSECOND = dt.timedelta(microseconds=1)


def load_gpx(path: str | Path, *, max_gap_us: int | None) -> Track:
    """Read the track points of a GPX file (version 1.0 or 1.1, all segments in a row).

    Time 0 is the first point with a time. Points without a time or with a faulty one, or without a
    position, are left out and counted in `Track.dropped`; of points of one time the first is taken.

    Parameters
    ----------
    path : path
    max_gap_us : int, optional
        Positions between points further apart than this are unknown.

    Returns
    -------
    Track
        Geographic, with `start_utc`.

    Raises
    ------
    GroundTruthError
        If the file cannot be read, holds no track point with a time, or its time runs backwards.
    """
    path = Path(path)
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
