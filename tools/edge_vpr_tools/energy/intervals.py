"""Statistics of pairs of idle and load periods: median, interval, and whether it is resolved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr_tools.energy.sampling import Trace, Window

Floats = npt.NDArray[np.float64]

LEAST_PAIRS = 5
_RESAMPLES = 2_000


@dataclass(frozen=True)
class Estimate:
    """Median of paired differences.

    Attributes
    ----------
    value : float
    low, high : float
        95 % interval by block bootstrap.
    pairs : int
    """

    value: float
    low: float
    high: float
    pairs: int

    @property
    def resolved(self) -> bool:
        """Whether the whole interval is above zero."""
        return self.low > 0

    def with_gain(self, error: float) -> tuple[float, float]:
        """Widen the interval by the gain error of a meter, which repetition does not reduce."""
        low, high = self.low, self.high
        return (
            low / (1 + error) if low > 0 else low / (1 - error),
            high / (1 - error) if high > 0 else high / (1 + error),
        )

    def pairs_needed(self) -> int | None:
        """Return the number of pairs that would resolve the median; None if it is not above 0.

        The spread is assumed to stay the same; an interval narrows with the square root of the
        number.
        """
        if self.value <= 0:
            return None
        half = (self.high - self.low) / 2
        return max(self.pairs + 1, int(np.ceil(self.pairs * (1.2 * half / self.value) ** 2)))


def paired_energy(trace: Trace, windows: Sequence[Window]) -> tuple[Floats, Floats]:
    """Return the mean power of each pair's idle and load window.

    Parameters
    ----------
    trace : Trace
    windows : sequence of Window
        An even number: each two consecutive windows are a pair, in either order.

    Returns
    -------
    idle_w, load_w : ndarray of float64, shape (pairs,)
    """
    watts = [
        (window.load, trace.energy(window.start_s, window.end_s) / (window.end_s - window.start_s))
        for window in windows
    ]
    idle = np.array([power for load, power in watts if not load])
    load = np.array([power for loaded, power in watts if loaded])
    return idle, load


def interval(differences: Floats) -> Estimate:
    """Return the median of paired differences, and its interval by a circular block bootstrap.

    Neighbouring pairs share slow changes of the board's temperature. Blocks of neighbours are
    therefore drawn together: two pairs from 27 pairs on, and three from 126 on; with fewer pairs,
    each is drawn by itself. The unit is always a pair of windows and never a sample, so that
    duplicates of samples do not narrow the interval.

    Parameters
    ----------
    differences : ndarray of float64, shape (pairs,)

    Raises
    ------
    UsageError
        If there are fewer than five pairs.
    """
    n = differences.size
    if n < LEAST_PAIRS:
        raise UsageError(f"{n} pairs of windows: an interval needs {LEAST_PAIRS} or more")
    block = max(1, int(n ** (1 / 3) / 2 + 0.5))
    rng = np.random.default_rng(0)
    starts = rng.integers(0, n, (_RESAMPLES, -(-n // block)))
    at = (starts[:, :, None] + np.arange(block)) % n
    medians = np.median(differences[at.reshape(_RESAMPLES, -1)[:, :n]], axis=1)
    low, high = np.quantile(medians, [0.025, 0.975]).tolist()
    value, wider = float(np.median(differences)), _small_sample(n)
    return Estimate(value, value + wider * (low - value), value + wider * (high - value), n)


def interval_of_times(seconds: Floats) -> Estimate:
    """Return the median of repeated timings or ratios, and the interval from their logarithms.

    Logarithms are used because disturbances multiply a timing, and no timing is below zero.

    Parameters
    ----------
    seconds : ndarray of float64, shape (n,)
        Above zero.

    Raises
    ------
    UsageError
        See `interval`.
    """
    of_logs = interval(np.log(seconds))
    value, low, high = np.exp([of_logs.value, of_logs.low, of_logs.high]).tolist()
    return Estimate(value, low, high, of_logs.pairs)


def _small_sample(n: int) -> float:
    """Return the factor by which to widen a bootstrap interval of few values (Hesterberg, 2015).

    The bootstrap resamples with the variance of n instead of n - 1, and has quantiles of a normal
    instead of Student's distribution, whose quantile is expanded here (Abramowitz and Stegun,
    26.7.5).
    """
    z, degrees = 1.959964, n - 1
    student = (
        z
        + (z**3 + z) / (4 * degrees)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * degrees**2)
    )  # fmt: skip
    return float(student / z * np.sqrt(n / degrees))
