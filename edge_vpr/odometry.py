"""Odometry: the distance that the robot has driven, from its wheels or another meter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, check_array, check_range
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.events import TIME_LIMIT_US

#: longest distance, in millimetres: a million kilometres
MOST_MM = 1 << 40


def check_distance_driven(odometer_mm: npt.NDArray[Any], places: int) -> None:
    """Check that there is a distance of each place, and that it never falls."""
    check_array(odometer_mm, "the distance driven", (np.int64,), (places,))
    check_range(odometer_mm, "the distance driven", 0, MOST_MM)
    if (np.diff(odometer_mm) < 0).any():
        raise MapError("the distance driven falls from place to place: expected that it rises")


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

    def since(self, start_us: int) -> Odometry:
        """Return the readings with times that count from a moment of the recording."""
        return replace(self, time_us=self.time_us - start_us)

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
    ) -> tuple[list[int | None], list[int]]:
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
        travelled_mm : list of int or None, of n
            What counts of it; None where it is not known.
        driven_mm : list of int, of n
            All of it; 0 where it is not known.
        """
        meter, before = Odometer(spacing_mm), 0
        travelled, driven = list[int | None](), list[int]()
        for count in np.searchsorted(self.time_us, end_us, side="left").tolist():
            if count > before:
                meter.read(int(self.distance_mm[count - 1]))
                before = count
            travelled.append(meter.travelled_mm)
            driven.append(0 if travelled[-1] is None else meter.driven_mm)
            meter.end_window()
        return travelled, driven


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
