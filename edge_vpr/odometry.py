"""Odometry: the distance that the robot has driven, from its wheels or another meter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import TIME_LIMIT_US

#: longest distance, in millimetres: a million kilometres
MOST_MM = 1 << 40


@dataclass(frozen=True, eq=False)
class Odometry:
    """Readings of an odometer during one drive.

    Attributes
    ----------
    time_us : ndarray of int64, shape (n,)
        Rising, from the recording's start; n of at least 1.
    distance_mm : ndarray of int64, shape (n,)
        Reading in millimetres, from any zero; it falls where the robot drives backwards.

    Raises
    ------
    UsageError
        If an array is of another dtype or shape, time runs backwards, or a value is too large.
    """

    time_us: npt.NDArray[np.int64]
    distance_mm: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        for name, most in (("time_us", TIME_LIMIT_US), ("distance_mm", MOST_MM)):
            column = getattr(self, name)
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
        """Return the distance driven at times of the reference drive, from 0, shape (K,).

        Parameters
        ----------
        time_us : ndarray of int64, shape (K,)
            Centres of the places, rising. Between readings the way is interpolated; before the
            first and after the last it is theirs.

        Returns
        -------
        ndarray of int64, shape (K,)
            Millimetres; where the robot rolled back, the way stays what it was.
        """
        shown = np.rint(np.interp(time_us, self.time_us, self.distance_mm)).astype(np.int64)
        return np.maximum.accumulate(shown) - shown[0]

    def of_windows(
        self, end_us: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Return the distance driven between the ends of successive windows.

        A reading belongs to the window that ends after it. The distance of a window is known if it
        and the window before it have readings; it is the difference of the newest readings of both.

        Parameters
        ----------
        end_us : ndarray of int64, shape (n,)

        Returns
        -------
        travelled_mm : ndarray of int64, shape (n,)
            0 where it is not known.
        known : ndarray of bool, shape (n,)
        """
        meter = Odometer()
        travelled = np.zeros(len(end_us), dtype=np.int64)
        known = np.zeros(len(end_us), dtype=np.bool_)
        read = np.searchsorted(self.time_us, end_us, side="left").tolist()
        before = 0
        for i, count in enumerate(read):
            if count > before:
                meter.read(int(self.distance_mm[count - 1]))
                before = count
            way = meter.travelled_mm
            if way is not None:
                travelled[i], known[i] = way, True
            meter.end_window()
        return travelled, known


class Odometer:
    """Readings of an odometer in the present window and in the one before it.

    Attributes
    ----------
    latest, anchor : int
        Newest reading, and the newest of the window before, in millimetres.
    fresh, anchored : bool
        Whether there was one in each of the two.
    """

    def __init__(self) -> None:
        self.latest = self.anchor = 0
        self.fresh = self.anchored = False

    def read(self, distance_mm: int) -> None:
        """Take a reading."""
        self.latest, self.fresh = distance_mm, True

    @property
    def travelled_mm(self) -> int | None:
        """Distance since the end of the window before; None if not known."""
        return self.latest - self.anchor if self.fresh and self.anchored else None

    def end_window(self) -> None:
        """Begin the next window."""
        self.anchor, self.anchored, self.fresh = self.latest, self.fresh, False
