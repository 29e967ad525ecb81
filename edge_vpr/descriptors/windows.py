"""Windows: the spans of time, or of events, that descriptors are counted in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.events import TIME_LIMIT_US

#: more windows than this in one recording, or ticks in one jump of time, are taken as a fault: the
#: clock has jumped, or the length of a window was given in a wrong unit
MAX_WINDOWS = 1_000_000


@dataclass(frozen=True)
class FixedTime:
    """Windows ``[k tau, (k+1) tau)`` from the recording's start, without gaps or overlap.

    A window is complete once an event at or after its end has arrived. Windows without events are
    descriptors of zeros.

    Parameters
    ----------
    tau_us : int
        Length, in microseconds.
    """

    tau_us: int

    def __str__(self) -> str:
        return f"{self.tau_us / 1e6:g} s"

    def __post_init__(self) -> None:
        if not 1 <= self.tau_us <= TIME_LIMIT_US:
            raise UsageError(
                f"window of {self.tau_us} us: expected 1 us or more, to {TIME_LIMIT_US}"
            )


@dataclass(frozen=True)
class FixedCount:
    """Windows that close with their N-th event at a selected pixel; the next event opens another.

    Parameters
    ----------
    events : int
        N, at the selected pixels.
    """

    events: int

    def __str__(self) -> str:
        return f"{self.events} events at the selected pixels"

    def __post_init__(self) -> None:
        if not 1 <= self.events <= TIME_LIMIT_US:
            raise UsageError(
                f"window of {self.events} events: expected 1 event or more, to {TIME_LIMIT_US}"
            )


Window = FixedTime | FixedCount


class WindowCounts(NamedTuple):
    """One finished window.

    Attributes
    ----------
    counts : ndarray of int64, shape (J,) or with polarity (2 J,)
    start_us, end_us : int
    events : int
        At any pixel.
    """

    counts: npt.NDArray[np.int64]
    start_us: int
    end_us: int
    events: int
