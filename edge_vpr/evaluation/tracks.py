"""Tracks: positions of the camera over time, and the positions that they give places."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue
from edge_vpr.errors import GroundTruthError, kind_of
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.map_record import AnyMap
from edge_vpr.route import EARTH_RADIUS_M, Kind, Route

# Tracks, interpolated but never extrapolated.


Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

#: Longest gap that is always interpolated. A car at 50 km/h drives 70 m, the tolerance of
#: Brisbane-Event-VPR, in 5 s; the logs of that data set have gaps of 4 s.
SHORT_GAP_US = 5_000_000
#: A longer gap is interpolated if the typical gap of the log is at least a fifth of it: a car's
#: positions between points of 20 s are off by less than 60 m in 95 of 100 cases.
USUAL_GAPS = 5
#: Two receivers on one vehicle are at least so far apart, and points of one of them are hardly ever
#: so far off: from a sentence of the same instant, or from the line of their neighbours in time.
#: Chosen by judgement.
APART_M = 10.0
#: Times of a track may be off whole microseconds by less: products of seconds are.
_ROUNDING_US = 1e-2


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
        Between two points further apart than this the position is unknown; found from the points
        if None, see `bridged`.
    start_utc : datetime, optional
        The instant of time 0, where the log states a date.
    dropped : mapping of str to int
        How many entries of the log were left out, by reason.
    entries : int
        Entries of the log, those left out included; 0 where there was no log.
    notes : tuple of str
        What makes the log doubtful.
    """

    time_us: npt.NDArray[np.int64]
    position: Floats
    kind: Kind = "metric"
    max_gap_us: int | None = None
    start_utc: dt.datetime | None = None
    dropped: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    entries: int = 0
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Track({len(self.time_us)} points, {self.kind})"

    def __post_init__(self) -> None:
        try:
            time_us = _whole(self.time_us)
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

    @property
    def longest_gap_us(self) -> int:
        """Longest gap between two points that is bridged, however far apart they lie."""
        if self.max_gap_us is not None:
            return self.max_gap_us
        gaps = np.diff(self.time_us)
        usual = int(np.median(gaps)) if gaps.size else 0
        return max(SHORT_GAP_US, USUAL_GAPS * usual)

    @property
    def bridged(self) -> Bools:
        """Whether positions are known between each point and the next, shape (n - 1,).

        By default gaps of up to 5 s are bridged, in a sparse log of up to five times the typical
        gap. So is any gap in which the camera stood: its two points are no farther apart than is
        typical.
        """
        short = np.diff(self.time_us) <= self.longest_gap_us
        if self.max_gap_us is not None or short.all():
            return np.asarray(short)
        step = distances(self.kind, self.position[1:], self.position[:-1])
        return np.asarray(short | (step <= np.median(step)))

    @property
    def continuous(self) -> Floats:
        """Positions whose longitudes go the short way round across the 180th meridian."""
        if self.kind != "geographic":
            return self.position
        latitude, longitude = self.position.T
        return np.column_stack([latitude, np.unwrap(longitude, period=360.0)])

    def shifted(self, seconds: float) -> Track:
        """Return the same track with its times shifted.

        Parameters
        ----------
        seconds : float
            Where time 0 of the track is in the recording; negative if the log began earlier.
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
        """Return how much of the log was left out and why, as text."""
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
            NaN before the first point, after the last, and in gaps that are not `bridged`.

        Examples
        --------
        >>> Track([0, 1_000_000], [[0.0], [3.0]]).at([500_000, 1_000_001]).tolist()
        [[1.5], [nan]]
        """
        found = interpolate(times_us, self.time_us, self.continuous, self.bridged)
        if self.kind == "geographic":
            wrapped = np.abs(found[:, 1]) > 180.0
            found[wrapped, 1] = (found[wrapped, 1] + 180.0) % 360.0 - 180.0
        return found


def _whole(time_us: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Return times of a track as whole numbers; refuse others, which are seconds."""
    times = np.asarray(time_us)
    if times.dtype.kind == "f":
        whole = np.rint(times)
        off = np.abs(times - whole) - 2 * np.spacing(np.abs(times))
        odd = np.flatnonzero(~(off < _ROUNDING_US))
        if odd.size:
            raise GroundTruthError(
                f"track time_us has {times.flat[odd[0]]:g}, and is in whole microseconds: give "
                "np.rint(1e6 * seconds), or a table with time_s (load_track)"
            )
        times = whole
    return np.array(times, dtype=np.int64)


def interpolate(
    x: npt.ArrayLike, points: npt.ArrayLike, values: Floats, bridged: Bools | None = None
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
    bridged : ndarray of bool, shape (n - 1,), optional
        Between a point and the next where this is False, the result is NaN (not at the points).

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
    if bridged is not None and known.size > 1:
        inside &= bridged[left] | (at == known[left]) | (at == known[right])
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


# Messages about clocks.


#: Times after this one, in 1973, count from 1970 and not from a recording's start.
UNIX_US = 10**14
_HOUR_US = 3_600_000_000


def unix_remedy(*tracks: Track, start_us: int | None = None) -> str:
    """Return the offsets of tracks whose times count from 1970, for messages; "" if none does.

    Parameters
    ----------
    start_us : int, optional
        The recording's start on its own clock; it is the offset if it is near the track.

    Examples
    --------
    >>> unix_remedy(Track([1_587_452_582_350_000], [[0.0]]))
    'Unix times: shift by -1587452582.35 s (Track.shifted), if the track begins with its recording'
    """
    first = [int(track.time_us[0]) for track in tracks]
    if max(first) < UNIX_US:
        return ""
    offsets = [-time if time >= UNIX_US else 0 for time in first]
    near = start_us is not None and abs(start_us - first[0]) < _HOUR_US
    if near and start_us is not None:
        offsets = [-start_us]
    shown = " ".join(f"{time / 1e6:.6f}".rstrip("0").rstrip(".") for time in offsets)
    one = "the track begins" if len(tracks) == 1 else "each track begins"
    return f"Unix times: shift by {shown} s (Track.shifted)" + (
        "" if near else f", if {one} with its recording"
    )


# Messages about units.


#: A metric track that is slower than this on average is in doubt. Chosen by judgement.
_SLOWEST_MPS = 0.02
#: Nearer than so many degrees to 0 N 0 E a track is one made up; in radians there is the sea too.
_AT_SEA = 0.1
#: Times that end at this share of the drive are not in microseconds.
_SHORTEST_SHARE = 100


def unit_doubts(track: Track) -> tuple[str, ...]:
    """Return a note if a metric track hardly moves, or a geographic one seems to be in radians.

    Raises
    ------
    GroundTruthError
        If the coordinates of a metric one look like latitudes and longitudes.
    """
    if track.kind == "geographic":
        latitude, longitude = np.abs(track.position).max(axis=0).tolist()
        if latitude > math.pi / 2 or longitude > math.pi or max(latitude, longitude) < _AT_SEA:
            return ()
        return (
            f"latitudes up to {latitude:.3g} and longitudes up to {longitude:.3g} degrees lie in "
            "the sea off Africa: if they are in radians, multiply them by 180 / pi",
        )
    position, seconds = track.position, float(np.ptp(track.time_us)) / 1e6
    if track.kind != "metric" or seconds == 0.0:
        return ()
    length = float(np.sqrt((np.diff(position, axis=0) ** 2).sum(axis=1)).sum())
    if length == 0.0 or length > _SLOWEST_MPS * seconds:
        return ()
    speed = f"a track of {length:.3g} m in {seconds:.0f} s"
    largest = np.abs(position).max(axis=0)
    degrees = position.shape[1] > 1 and (largest[:2] <= 180.0).all() and largest[:2].min() <= 90.0
    # from one degree, a metre is the fifth digit behind the point
    if degrees and (largest[:2] > 0.5).all() and length < 0.1 * largest[:2].min():
        raise GroundTruthError(
            f"{speed} looks like degrees: name its columns latitude and longitude in a .csv table "
            "(of a Track, kind='geographic')"
        )
    return (
        f"{speed} hardly moves: are its positions in kilometres, or its times in ms, us or ns? "
        "Give metres and seconds",
    )


def seconds_remedy(track: Track, times_us: npt.NDArray[Any]) -> str:
    """Return what to do about times of a track that are not in microseconds; "" if they may be."""
    last, end = int(track.time_us[-1]), int(times_us.max())
    if not 0 < last * _SHORTEST_SHARE < end:
        return ""
    return (
        f"its times end at {last / 1e6:g} s and the drive at {end / 1e6:g} s: give a longer track, "
        "or of seconds a table with time_s (load_track)"
    )


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
    unit_doubts(track)
    position = track.at(reference.place_time_us)
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    if known.size == 0:
        first, last = (float(t) / 1e6 for t in (track.time_us[0], track.time_us[-1]))
        raise GroundTruthError(
            f"the track runs from {first:.1f} to {last:.1f} s and covers no place of the map: "
            + (
                unix_remedy(track, start_us=start_us)
                or seconds_remedy(track, reference.place_time_us)
                or "give the reference drive's own track, and set its clock right"
            )
        )
    position[~np.isfinite(position).all(axis=1)] = np.nan
    along = np.full(len(position), np.nan)
    # distances are added between places, not between fixes: those would add the noise of the GPS
    begin = reference.places.start_us[known[:1]] + reference.start_us
    stops = np.concatenate([track.at(begin), position[known]])
    legs = distances(track.kind, stops[:-1], stops[1:])
    along[known] = np.cumsum(np.nan_to_num(legs))  # a track may begin within that window
    return replace(reference, route=Route(position, along, track.kind))
