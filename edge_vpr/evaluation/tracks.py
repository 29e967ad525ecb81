"""Tracks: positions of the camera over time, and the positions that they give places."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue
from edge_vpr.errors import GroundTruthError, kind_of
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import EARTH_RADIUS_M, Kind, Route

# Tracks, interpolated but never extrapolated.


Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

#: Between two points further apart, a position is unknown. A car at 50 km/h drives 70 m, the
#: tolerance of Brisbane-Event-VPR, in 5 s; the logs of that data set have gaps of 4 s.
MAX_GAP_US = 5_000_000
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
    max_gap_us : int
        Between two points further apart than this, the position is unknown.
    start_utc : datetime, optional
        The instant of time 0, where the log states a date.
    dropped : mapping of str to int
        How many entries of the log were left out, by reason.
    entries : int
        Entries of the log, those left out included; 0 where there was no log.
    """

    time_us: npt.NDArray[np.int64]
    position: Floats
    kind: Kind = "metric"
    max_gap_us: int = MAX_GAP_US
    start_utc: dt.datetime | None = None
    dropped: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    entries: int = 0

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
                "give degrees with their decimals, latitude first, then longitude"
            )
        for array in (time_us, position):
            array.setflags(write=False)
        object.__setattr__(self, "time_us", time_us)
        object.__setattr__(self, "position", position)

    @property
    def bridged(self) -> Bools:
        """Whether positions are known between each point and the next, shape (n - 1,)."""
        return np.asarray(np.diff(self.time_us) <= self.max_gap_us)

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
        position = interpolate(times_us, self.time_us, self.continuous, self.bridged)
        if self.kind == "geographic":
            wrapped = np.abs(position[:, 1]) > 180.0
            position[wrapped, 1] = (position[wrapped, 1] + 180.0) % 360.0 - 180.0
        return position


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
    at, stop = np.asarray(x, dtype=np.float64), np.asarray(points, dtype=np.float64)
    inside = (at >= stop[0]) & (at <= stop[-1])
    right = np.clip(np.searchsorted(stop, at), 1, max(stop.size - 1, 1))
    right = np.minimum(right, stop.size - 1)
    left = np.maximum(right - 1, 0)
    gap = stop[right] - stop[left]
    weight = np.where(gap > 0, (at - stop[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    if bridged is not None and stop.size > 1:
        inside &= bridged[left] | (at == stop[left]) | (at == stop[right])
    between = values[left] + weight[:, None] * (values[right] - values[left])
    # a + 1 * (b - a) may differ from b: at a point, use its own value
    between = np.where((weight == 1.0)[:, None], values[right], between)
    return np.where(inside[:, None], between, np.nan)


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


def positions_at(track: Track, times_us: npt.NDArray[Any], which: str, start_us: int = 0) -> Floats:
    """Return the positions of windows, shape (n, d), of which the track must cover one.

    Parameters
    ----------
    times_us : ndarray, shape (n,)
        Times of the windows' centres, in microseconds from the recording's start.
    which : str
        The track's name in messages, such as ``reference track``.
    start_us : int
        The recording's start on its own clock.

    Raises
    ------
    GroundTruthError
        If the track has no time in common with the windows, or its points lie too far apart.
    """
    position = track.at(times_us)
    if np.isfinite(position).all(axis=1).any():
        return position
    first, last = int(track.time_us[0]), int(track.time_us[-1])
    if first <= times_us.max() and last >= times_us.min():
        gap_s = float(np.diff(track.time_us).max(initial=0)) / 1e6
        remedy = (
            f"its points are up to {gap_s:g} s apart, and positions are unknown where they are more"
            f" than {track.max_gap_us / 1e6:g} s apart: name the unit of its times in the header, "
            "or give max_gap_s= to interpolate"
        )
    else:
        on_clock = 0 < first <= start_us <= last
        offset = f"{-(start_us if on_clock else first) / 1e6:.6f}".rstrip("0").rstrip(".")
        whose = "its times are of the recording's clock" if on_clock else "both begin together"
        remedy = "give the log of this drive, with its times in the unit that is stated" + (
            f"; or, if {whose}, shift it by {offset} s (Track.shifted)" if first else ""
        )
    raise GroundTruthError(
        f"the {which} covers {first / 1e6:,.12g} to {last / 1e6:,.12g} s in "
        f"{track.time_us.size} points and no window of {times_us.min() / 1e6:g} to "
        f"{times_us.max() / 1e6:g} s: {remedy}"
    )


# The positions of a map's places, from the track of the reference drive.


def with_positions(reference: ReferenceMap, track: Track, start_us: int = 0) -> ReferenceMap:
    """Give each place the position that the reference drive had in the middle of its window.

    Metres along the route are counted from the beginning of the first window whose place is known.

    Parameters
    ----------
    track : Track
        Of the reference drive; time 0 is the recording's start.
    start_us : int
        That start on the recording's own clock, for the message about a track on this clock.

    Raises
    ------
    GroundTruthError
        If the track covers no place.
    """
    position = positions_at(track, reference.place_time_us, "track", start_us)
    covered = np.flatnonzero(np.isfinite(position).all(axis=1))
    position[~np.isfinite(position).all(axis=1)] = np.nan
    along = np.full(len(position), np.nan)
    # distances are added between places, not between fixes: those would add the noise of the GPS
    begin = reference.places.start_us[covered[:1]] + reference.start_us
    stops = np.concatenate([track.at(begin), position[covered]])
    legs = distances(track.kind, stops[:-1], stops[1:])
    along[covered] = np.cumsum(np.nan_to_num(legs))  # a track may begin within that window
    return replace(reference, route=Route(position, along, track.kind))
