"""Places that can be reached in one window, and their prices: by steps, odometry and jumps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.matching.move_kernels import (
    JUMP_REACH,
    RATE_BITS,
    StepTable,
    leads_to,
    mark_following,
    predict,
    predict_travelled,
)
from edge_vpr.matching.step_prices import FRACTION_BITS, QUIET_STEPS, Metrics, StepPrices
from edge_vpr.odometry import MOST_MM

#: with odometry, the price of being one mean spacing away from where the distance leads
OFF_BY_A_PLACE = 2
_NO_JUMPS = np.zeros((0, 2), dtype=np.int32)


class Moves:
    """Places that can be reached from each place of a map in one window.

    Parameters
    ----------
    places : int
        K.
    prices : StepPrices
    jumps : ndarray of int32, shape (n, 2), optional
        Pairs of places: from the first, one step leads to the second too, as where a loop closes
        or two routes meet. Steps of more places may pass the pair.
    along_mm : ndarray of int64, shape (K,), optional
        Millimetres that the reference had driven at each place, not falling: what odometry of a
        query is compared with.

    Raises
    ------
    UsageError
        If there is no place, or a jump or a way is none of this map.

    Examples
    --------
    >>> moves = Moves(4, StepPrices(restart=5), jumps=np.array([[3, 0]], dtype=np.int32))
    >>> moves.by_steps(np.array([9, 9, 9, 0], dtype=np.int32)).tolist()  # back at the start
    [0, 4, 9, 4]
    """

    def __init__(
        self,
        places: int,
        prices: StepPrices,
        jumps: npt.NDArray[np.int32] | None = None,
        along_mm: npt.NDArray[np.int64] | None = None,
    ) -> None:
        if places < 1:
            raise UsageError(f"a map of {places} places: expected at least 1")
        self.places, self.prices = places, prices
        self.jumps = _NO_JUMPS if jumps is None else np.asarray(jumps, dtype=np.int32)
        check_jumps(self.jumps, places)
        self.by_step = StepTable(
            prices.scaled, np.array(QUIET_STEPS, dtype=np.int32) << FRACTION_BITS,
            prices.first, prices.last, prices.restart << FRACTION_BITS, self.jumps,
        )  # fmt: skip
        self._along = along_mm
        self._spacing = self._rate = 0
        if along_mm is not None:
            check_along(along_mm, places)
            self._spacing = int(along_mm[-1] - along_mm[0]) // max(places - 1, 1)
            self._rate = (OFF_BY_A_PLACE << FRACTION_BITS << RATE_BITS) // max(self._spacing, 1)

    def reversed(self) -> Moves:
        """Return the moves in the opposite direction, with the order of the places reversed."""
        jumps = self.places - 1 - self.jumps[:, ::-1]
        along = None if self._along is None else self._along[-1] - self._along[::-1]
        return Moves(self.places, self.prices, jumps, along)

    def check_odometry(self) -> None:
        """Raise UsageError if the map does not hold the distances between its places."""
        self._checked_along()

    def by_steps(self, metric: Metrics) -> Metrics:
        """Return the price of each place one window later, shape (K,)."""
        steps = self.by_step
        return predict(metric, steps.prices, steps.first, steps.restart, steps.jumps)

    def if_quiet(self, metric: Metrics) -> Metrics:
        """Return the price of each place after a quiet window, shape (K,)."""
        steps = self.by_step
        return predict(metric, steps.quiet, 0, steps.restart, steps.jumps)

    def by_distance(self, metric: Metrics, travelled_mm: int) -> Metrics:
        """Return the price of each place after a distance of `travelled_mm`, shape (K,).

        Raises
        ------
        UsageError
            If the map does not say how far its places are from each other.
        """
        return predict_travelled(
            metric, self._checked_along(), _limited(travelled_mm), (self._rate, self._spacing),
            self.by_step.restart, self.jumps,
        )  # fmt: skip

    def following(self, place: int, travelled_mm: int | None) -> npt.NDArray[np.bool_]:
        """Return which places can be reached from `place` without a restart, shape (K,).

        Parameters
        ----------
        place : int
        travelled_mm : int or None
            None where it is not known: what a step leads to follows.
        """
        follows = np.zeros(self.places, dtype=np.bool_)
        if travelled_mm is None:
            mark_following(place, self.by_step, follows)
            return follows
        along, travelled = self._checked_along(), _limited(travelled_mm)
        off = np.abs(along - along[place] - travelled)
        follows |= (off * self._rate) >> RATE_BITS < self.by_step.restart
        for begin, end in self.jumps[self._jumps_near(place, JUMP_REACH)].tolist():
            beyond = slice(end, end + JUMP_REACH)
            way = along[begin] - along[place] + self._spacing + along[beyond] - along[end]
            price = (np.abs(way - travelled) * self._rate) >> RATE_BITS
            follows[beyond] |= price < self.by_step.restart
        return follows

    def lead_to(self, place: int, next_place: int, travelled_mm: int | None) -> bool:
        """Return whether `next_place` can be reached from `place` without a restart."""
        steps = self.by_step
        if travelled_mm is None:
            return bool(leads_to(place, next_place, steps.first, steps.last, steps.jumps))
        return bool(self.following(place, travelled_mm)[next_place])

    def _jumps_near(self, place: int, reach: int) -> npt.NDArray[np.bool_]:
        before = self.jumps[:, 0] - place
        return np.asarray((before >= 0) & (before < reach))

    def _checked_along(self) -> npt.NDArray[np.int64]:
        if self._along is None:
            raise UsageError(
                "the map does not say how far its places are from each other: make it with the "
                "reference drive's --odometry or --track"
            )
        if self._spacing < 1:
            raise UsageError(
                "the reference drive of this map did not move by its odometry or track: map a "
                "drive that moves, or match without odometry"
            )
        return self._along


def check_jumps(jumps: npt.NDArray[np.integer], places: int) -> None:
    """Check that every jump leads from a place of the map to another one."""
    for begin, end in jumps.tolist():
        if not (0 <= begin < places and 0 <= end < places) or begin == end:
            raise UsageError(
                f"jump from place {begin} to {end}: expected two places from 0 to {places - 1}"
            )


def check_along(along_mm: npt.NDArray[np.int64], places: int) -> None:
    """Check that there is a distance driven for each place, which never decreases."""
    if along_mm.shape != (places,) or (np.diff(along_mm) < 0).any():
        raise UsageError(
            f"way to each of {places} places: expected as many millimetres, which do not fall"
        )
    if not 0 <= along_mm[0] <= along_mm[-1] <= MOST_MM:
        raise UsageError(f"way of {along_mm[0]} to {along_mm[-1]} mm: expected 0 to {MOST_MM}")


def _limited(travelled_mm: int) -> int:
    return min(max(travelled_mm, -MOST_MM), MOST_MM)
