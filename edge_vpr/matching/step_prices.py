"""Prices of steps from place to place, in the units of the metrics of the place filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.settings import Settings

Metrics = npt.NDArray[np.int32]

#: fraction bits of metrics, evidence and prices
FRACTION_BITS = 2
#: largest metric: 10 bits
METRIC_TOP = (1 << 10) - 1
#: prices of a step of 0, 1, 2 ... places in a quiet window
QUIET_STEPS = (0, 0, 1)


@dataclass(frozen=True)
class StepPrices:
    """Prices of moves from place to place in one window.

    Parameters
    ----------
    forward : tuple of int
        Price of a step of 0, 1, 2 ... places.
    back : tuple of int
        Price of a step of -1, -2 ... places; empty if the route is never driven backwards.
    restart : int
        Price of getting anywhere else: the robot was carried, or the filter is wrong.

    Raises
    ------
    UsageError
        If a price does not fit the metric, or there is none.
    """

    forward: tuple[int, ...] = (1, 0, 1)
    back: tuple[int, ...] = ()
    restart: int = 16

    def __post_init__(self) -> None:
        most = (METRIC_TOP >> FRACTION_BITS) - 1
        prices = (*self.forward, *self.back, self.restart)
        if not self.forward or min(prices) < 0 or max(prices) > most:
            raise UsageError(
                f"filter prices {self.forward} forward, {self.back} back and {self.restart} for a "
                f"restart: expected 0 to {most}, and at least one step forward"
            )

    @classmethod
    def of(cls, settings: Settings) -> StepPrices:
        """Return the prices of the settings; the default depends on the kind of window."""
        forward = settings.filter_steps
        if forward is None:
            forward = (1, 0, 1) if settings.window == "time" else (1, 0, 0, 1)
        return cls(forward, settings.filter_back, settings.filter_restart)

    @property
    def first(self) -> int:
        """Smallest step, in places: 0, or below."""
        return -len(self.back)

    @property
    def last(self) -> int:
        """Largest step, in places; a match that is farther away is a jump."""
        return max(len(self.forward), len(QUIET_STEPS)) - 1

    @property
    def scaled(self) -> npt.NDArray[np.int32]:
        """Prices from the smallest to the largest step, with fraction bits."""
        return np.array([*reversed(self.back), *self.forward], dtype=np.int32) << FRACTION_BITS
