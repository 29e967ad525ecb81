"""Tracks: positions of the camera over time, interpolated but never extrapolated."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import GroundTruthError
from edge_vpr.events import TIME_LIMIT_US

Kind = Literal["geographic", "metric"]
Floats = npt.NDArray[np.float64]

#: Mean radius of the Earth in metres (IUGG, R1).
EARTH_RADIUS_M = 6_371_008.8


@dataclass(frozen=True, eq=False)
class Track:
    """Positions over time.

    Attributes
    ----------
    time_us : ndarray of int64, shape (n,)
        Times in microseconds from the recording's start, strictly increasing.
    position : ndarray of float64, shape (n, d)
        Latitude and longitude in degrees (`kind` "geographic", d = 2), or metres (d = 1, 2 or 3).
    kind : {"metric", "geographic"}
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
        time_us = np.array(self.time_us, dtype=np.int64)
        position = np.array(self.position, dtype=np.float64)
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


def distances(kind: Kind, a: Floats, b: Floats) -> Floats:
    """Return the distances between positions of a kind, in metres, shape (...).

    Parameters
    ----------
    kind : {"metric", "geographic"}
    a, b : ndarray of float64, shape (..., d)
        Broadcast against each other.
    """
    if kind == "geographic":
        return great_circle(a, b)
    return np.asarray(np.sqrt(((a - b) ** 2).sum(axis=-1)))
