"""The route of the reference drive: positions of its places, and the odometry of a drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, check_array
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.events import TIME_LIMIT_US

# Positions of the places of a map along the route of the reference drive.


#: what positions are: metres, or latitude and longitude
Kind = Literal["metric", "geographic"]
#: names of the coordinates, by their kind and number
_COORDINATES = {
    ("geographic", 2): ("latitude", "longitude"),
    ("metric", 1): ("x_m",),
    ("metric", 2): ("x_m", "y_m"),
    ("metric", 3): ("x_m", "y_m", "z_m"),
}
_FARTHEST_M = 1e12
#: mean radius of the Earth in metres (IUGG, R1)
EARTH_RADIUS_M = 6_371_008.8
#: columns of a table of matches after the coordinates
ALONG = ("along_m", "along_from_m", "along_to_m")


class Located(NamedTuple):
    """Positions of n matches."""

    #: Shape (n, d): of the matched place; NaN where the track did not cover it.
    position: npt.NDArray[np.float64]
    #: Shape (n,): the same as metres driven along the route; NaN as above.
    along_m: npt.NDArray[np.float64]
    #: from_m, to_m, shape (n,): interval along the route; NaN if no place in it has a position.
    from_m: npt.NDArray[np.float64]
    to_m: npt.NDArray[np.float64]


def length_m(along_m: npt.NDArray[np.float64], window_parts: int) -> float:
    """Return the length of a route, to the end of its last window.

    Parameters
    ----------
    along_m : ndarray of float64, shape (K,)
        Metres to the middle of each place, rising; NaN where not known, but not at all of them.
    window_parts : int
        Places that start in a window.
    """
    placed = np.flatnonzero(np.isfinite(along_m))
    last = np.interp([len(along_m) - 2, len(along_m) - 1], placed, along_m[placed])
    return float(last[0] + (1 + window_parts / 2) * (last[1] - last[0]))


@dataclass(frozen=True, eq=False)
class Route(EqualByValue):
    """Positions of the K places of a map."""

    #: Shape (K, d): latitude and longitude in degrees (`kind` "geographic", d = 2), or metres (d =
    #: 1, 2 or 3); rows of NaN where the position is not known.
    position: npt.NDArray[np.float64]
    #: Shape (K,): metres that the reference had driven to the middle of the place, since the drive
    #: or its track began; NaN where the position is not known.
    along_m: npt.NDArray[np.float64]
    kind: Kind = "metric"  #: {"metric", "geographic"}: what the positions are.

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise MapError(f"position_kind is {self.kind!r}: expected metric or geographic")
        check_array(self.position, "position", (np.float64,), (None, None))
        places, width = self.position.shape
        if (self.kind, width) not in _COORDINATES:
            raise MapError(f"position has {width} columns, which no {self.kind} position has")
        check_array(self.along_m, "along_m", (np.float64,), (places,))
        placed = np.isfinite(self.along_m)
        same = (np.isfinite(self.position) == placed[:, None]).all()
        if not placed.any() or not same or np.isinf(self.position).any():
            raise MapError("position and along_m are not known at the same places, at one or more")
        at = self.along_m[placed]
        if at[0] < 0 or at[-1] > _FARTHEST_M or (np.diff(at) < 0).any():
            raise MapError("along_m runs backwards, or is not a length: expected rising metres")

    def __repr__(self) -> str:
        placed = int(np.isfinite(self.along_m).sum())
        return f"Route({placed} of {len(self.along_m)} places known, {self.kind})"

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the columns of `position`, with the unit if it is metres."""
        return _COORDINATES[self.kind, self.position.shape[1]]

    @property
    def origin(self) -> npt.NDArray[np.float64]:
        """First known position, shape (d,)."""
        first: npt.NDArray[np.float64] = self.position[np.isfinite(self.along_m)][0]
        return first

    def metres(self, position: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return positions of the route's kind in metres, shape (n, d).

        Latitude and longitude become metres east and north of `origin`; lengths are exact along its
        parallel and its meridian, and wrong by less than 1 % within 50 km up to 50 degrees of
        latitude. Metric positions are returned as they are.

        Parameters
        ----------
        position : ndarray of float64, shape (n, d)

        Examples
        --------
        >>> route = Route(np.zeros((1, 2)), np.zeros(1), "geographic")
        >>> route.metres(np.array([[0.0, 0.001]])).round(1).tolist()
        [[111.2, 0.0]]
        """
        if self.kind == "metric":
            return position
        origin = self.origin
        north, east = np.radians(position - origin).T
        east = (east + np.pi) % (2 * np.pi) - np.pi  # the short way round across the 180th meridian
        return EARTH_RADIUS_M * np.column_stack([east * np.cos(np.radians(origin[0])), north])

    def locate(self, place: npt.NDArray[np.integer], within: int) -> Located:
        """Return the positions of matched places, and the interval around each.

        Parameters
        ----------
        place : ndarray of int, shape (n,)
            Index of the matched place, for each match.
        within : int
            The interval reaches from this many places before the matched one to as many after it.
            With the exclusion zone's, the probability of a match is that of the true position
            lying in the interval: the trust compares the place with those outside it.
        """
        before = np.fmin.accumulate(self.along_m[::-1])[::-1]  # at or after each place
        after = np.fmax.accumulate(self.along_m)
        first = np.maximum(place - within, 0)
        last = np.minimum(place + within, len(self.along_m) - 1)
        from_m, to_m = before[first], after[last]
        placed_before = np.concatenate([[0], np.cumsum(np.isfinite(self.along_m))])
        nothing = placed_before[last + 1] == placed_before[first]
        return Located(
            self.position[place],
            self.along_m[place],
            np.where(nothing, np.nan, from_m),
            np.where(nothing, np.nan, to_m),
        )

    def columns(
        self, place: npt.NDArray[np.integer], within: int
    ) -> dict[str, npt.NDArray[np.float64]]:
        """Return the result of `locate` as columns of a table of matches, by name, in order.

        Parameters
        ----------
        place : ndarray of int, shape (n,)
            Index of the matched place, for each match.
        within : int
            See `locate`.
        """
        located = self.locate(place, within)
        columns = (*located.position.T, located.along_m, located.from_m, located.to_m)
        return dict(zip((*self.coordinates, *ALONG), columns, strict=True))

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name, for an archive; the inverse of `from_arrays`."""
        return {"position": self.position, "along_m": self.along_m}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]
    ) -> Route | None:
        """Build from named arrays and the kind in the header; None without arrays."""
        if "position" not in arrays and "along_m" not in arrays:
            return None
        position, along_m = (arrays.get(name) for name in ("position", "along_m"))
        return cls(position, along_m, meta.get("position_kind"))  # type: ignore[arg-type]


# Odometry: the distance that the robot has driven, from its wheels or another meter.


#: longest distance, in millimetres: a million kilometres
MOST_MM = 1 << 40


@dataclass(frozen=True, eq=False)
class Odometry(EqualByValue):
    """Readings of an odometer during one drive.

    >>> odometry = Odometry(np.array([0, 1_000_000]), np.array([0, 900]))
    >>> odometry.along(np.array([250_000, 500_000])).tolist()
    [225, 450]

    Attributes
    ----------
    time_us : ndarray of int64, shape (n,)
        Rising, from the recording's start; n of at least 1.
    distance_mm : ndarray of int64, shape (n,)
        Reading in millimetres, from any zero; it falls where the robot drives backwards.
    """

    time_us: npt.NDArray[np.int64]
    distance_mm: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        for name, most in (("time_us", TIME_LIMIT_US), ("distance_mm", MOST_MM)):
            column = getattr(self, name)
            expect(column, np.ndarray, f"odometry {name}", "an array of int64, one value a reading")
            if column.dtype != np.int64 or column.shape != self.time_us.shape or column.ndim != 1:
                raise UsageError(
                    f"odometry {name} is {column.dtype} of shape {column.shape}: expected int64, "
                    "one value a reading"
                )
            if column.size == 0:
                raise UsageError("odometry without a reading: expected 1 or more")
            if column.min() < -most or column.max() > most:
                raise UsageError(
                    f"odometry {name} reaches {np.abs(column).max()}: expected at most {most}"
                )
        if (np.diff(self.time_us) <= 0).any():
            row = int(np.flatnonzero(np.diff(self.time_us) <= 0)[0]) + 1
            raise UsageError(
                f"odometry reading {row + 1} is not later than the one before: sort the readings "
                "by time, one for each"
            )

    def along(self, time_us: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Return the distance driven at times of the reference drive, since its start, shape (K,).

        Parameters
        ----------
        time_us : ndarray of int64, shape (K,)
            Centres of the places, rising. Between readings the distance is interpolated; before the
            first and after the last it is theirs.

        Returns
        -------
        ndarray of int64, shape (K,)
            Millimetres; where the robot rolled back, the distance stays what it was.
        """
        since = np.concatenate([[0], time_us])
        shown = np.rint(np.interp(since, self.time_us, self.distance_mm)).astype(np.int64)
        return (np.maximum.accumulate(shown) - shown[0])[1:]

    def beside(
        self,
        time_us: npt.NDArray[np.int64],
        route_m: float,
    ) -> str:
        """Return the metres of a drive by the odometer beside those of the route, as a sentence.

        Parameters
        ----------
        time_us : ndarray of int64, shape (m,)
            Of the matches, rising from the drive's start.
        route_m : float
            Length of the map's route.

        Raises
        ------
        UsageError
            If no match has a time between the first reading and the last.
        """
        first_us, last_us = self.time_us[[0, -1]].tolist()
        read = (first_us <= time_us) & (time_us <= last_us)
        if not read.any():
            raise UsageError(
                f"odometry has readings from {first_us / 1e6:,.1f} to {last_us / 1e6:,.1f} s, and "
                "the drive has no match there: give times in seconds from the recording's start"
            )
        first_m, last_m = np.interp([0, time_us[-1]], self.time_us, self.distance_mm / 1e3)
        return (
            f"odometry: readings at {read.sum():,} of {read.size:,} matches; "
            f"{ratio_text(last_m - first_m, route_m)}"
        )

    def of_windows(
        self, end_us: npt.NDArray[np.int64], spacing_mm: int = 0
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Return the distance driven between the ends of successive windows.

        A reading belongs to the window that ends after it. The distance of a window is known if it
        and the window before it have readings; it is the difference of the newest readings of both.
        Short ones are added up: see `Odometer`.

        Parameters
        ----------
        end_us : ndarray of int64, shape (n,)
            Ends of the windows, increasing.
        spacing_mm : int
            See `Odometer`; 0 adds up none.

        Returns
        -------
        travelled_mm, driven_mm : ndarray of int64, shape (n,)
            What counts of it, and all of it; 0 where it is not known.
        covered : ndarray of bool, shape (n,)
        """
        meter = Odometer(spacing_mm)
        travelled, driven = np.zeros((2, len(end_us)), dtype=np.int64)
        covered = np.zeros(len(end_us), dtype=np.bool_)
        read = np.searchsorted(self.time_us, end_us, side="left").tolist()
        before = 0
        for i, count in enumerate(read):
            if count > before:
                meter.read(int(self.distance_mm[count - 1]))
                before = count
            counted = meter.travelled_mm
            if counted is not None:
                travelled[i], driven[i], covered[i] = counted, meter.driven_mm, True
            meter.end_window()
        return travelled, driven, covered


def ratio_text(driven_m: float, route_m: float) -> str:
    """Return metres by the odometer beside the length of the map's route, and their ratio.

    No match has a part in them: in feet the ratio of a whole drive is 3.3, and with a wrong sign it
    is negative.
    """
    ratio = f" (ratio {driven_m / route_m:.2f})" if route_m else ""
    return f"{driven_m:,.1f} m by the odometer, route length {route_m:,.1f} m{ratio}"


class Odometer:
    """Readings of an odometer in the present window and in the one before it.

    Parameters
    ----------
    spacing_mm : int
        Mean distance between two places. If the robot drives less than half of it in a window, the
        distance counts as 0, until the windows that do not count yet make up the whole of it. The
        filter moves by whole places: otherwise a slow robot would seem to stand still in every
        window.

    Attributes
    ----------
    latest, before, anchor : int
        Newest reading, the newest of the window before, and the newest that has been counted, in
        millimetres.
    fresh, anchored : bool
        Whether there was one in this window and in the one before it.
    """

    def __init__(self, spacing_mm: int = 0) -> None:
        self.spacing_mm = spacing_mm
        self.latest = self.before = self.anchor = 0
        self.fresh = self.anchored = False

    def read(self, distance_mm: int) -> None:
        """Take a reading."""
        self.latest, self.fresh = distance_mm, True

    @property
    def travelled_mm(self) -> int | None:
        """Distance that counts in this window; None if not known."""
        if not (self.fresh and self.anchored):
            return None
        slow = 2 * abs(self.driven_mm) < self.spacing_mm
        held = self.latest - self.anchor
        return 0 if slow and abs(held) < self.spacing_mm else held

    @property
    def driven_mm(self) -> int:
        """Distance from the newest reading of the window before to that of this one."""
        return self.latest - self.before

    def end_window(self) -> None:
        """Begin the next window."""
        if self.travelled_mm is None:  # what was held is held on
            self.anchor += self.latest - self.before
        elif self.travelled_mm != 0:
            self.anchor = self.latest
        self.before, self.anchored, self.fresh = self.latest, self.fresh, False


#: A faster change is a leap: a damaged line, or an odometer that started again. Readings may come
#: in a bunch after a pause of the line.
LEAP_MM_PER_S, LEAST_GAP_US = 100_000, 100_000


class OdometerCheck:
    """Leave out readings that cannot be: leaps, which no robot could have driven.

    Attributes
    ----------
    leaps : int
        Readings that were left out.
    distance_mm : int
        Newest reading, without leaps.
    """

    def __init__(self) -> None:
        self.leaps = self.distance_mm = 0
        self._time_us, self._shown_mm = -1, 0  # of the newest reading (-1: none yet)

    def read(self, time_us: int, shown_mm: int) -> bool:
        """Take a reading, and return whether it counts.

        Parameters
        ----------
        time_us : int
            Not earlier than the one before.
        shown_mm : int
            What the odometer shows, from any zero.
        """
        first = self._time_us < 0
        step = shown_mm - (self.distance_mm if first else self._shown_mm)
        passed_us = max(time_us - self._time_us, LEAST_GAP_US)
        leapt = not first and abs(step) * 1_000_000 > LEAP_MM_PER_S * passed_us
        self._time_us, self._shown_mm = time_us, shown_mm
        if leapt:
            self.leaps += 1
        else:
            self.distance_mm += step
        return not leapt

    def to_array(self) -> npt.NDArray[np.int64]:
        """Return the state for `resume`, shape (4,)."""
        numbers = [self.leaps, self.distance_mm, self._shown_mm, self._time_us]
        return np.array(numbers, dtype=np.int64)

    def resume(self, array: npt.NDArray[np.int64]) -> None:
        """Restore the state from the array of `to_array`."""
        self.leaps, self.distance_mm, self._shown_mm, self._time_us = array.tolist()
