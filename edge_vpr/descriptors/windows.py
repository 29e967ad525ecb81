"""Windows of fixed time or of a fixed number of events, and the descriptors counted in them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.archive import EqualByValue, check_array, check_range, present
from edge_vpr.errors import MapError, UsageError, expect
from edge_vpr.events import TIME_LIMIT_US
from edge_vpr.settings import Settings

# Windows: the spans of time, or of events, that descriptors are counted in.


#: Most windows in one recording, and most ticks in one jump of time. More of them are a fault: the
#: clock has jumped, or the length of a window is in a wrong unit.
MAX_WINDOWS = 1_000_000


@dataclass(frozen=True)
class FixedTime:
    """Windows ``[k tau, (k+1) tau)`` from the recording's start, without gaps or overlap.

    >>> str(FixedTime(500_000))
    '0.5 s'

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
        expect(self.tau_us, (int, np.integer), "tau_us", "whole microseconds")
        if not 1 <= self.tau_us <= TIME_LIMIT_US:
            raise UsageError(
                f"window of {self.tau_us} us: expected 1 us or more, to {TIME_LIMIT_US}"
            )


@dataclass(frozen=True)
class FixedCount:
    """Windows that close with their N-th event at a selected pixel; the next event opens another.

    >>> str(FixedCount(450))
    '450 events at the selected pixels'

    Parameters
    ----------
    events : int
        N, at the selected pixels.
    """

    events: int

    def __str__(self) -> str:
        return f"{self.events} events at the selected pixels"

    def __post_init__(self) -> None:
        expect(self.events, (int, np.integer), "events", "a whole number of events")
        if not 1 <= self.events <= TIME_LIMIT_US:
            raise UsageError(
                f"window of {self.events} events: expected 1 event or more, to {TIME_LIMIT_US}"
            )


Window = FixedTime | FixedCount


def window_of(settings: Settings) -> Window:
    """Return the kind and length of window of the settings."""
    if settings.window == "time":
        return FixedTime(settings.tau_us)
    return FixedCount(settings.events_per_window)


class WindowCounts(NamedTuple):
    """One finished window."""

    counts: npt.NDArray[np.int64]  #: Shape (J,): of each slot.
    start_us: int
    end_us: int
    events: int  #: At any pixel.
    unseen: int = 0  #: Halves of a window, see `UnseenTime`.


# Descriptors: the event counts of windows, or their codes, with times.


#: dtypes of counts that can be matched: native byte order, at most 32 bits
COUNT_DTYPES = (np.uint8, np.uint16, np.uint32)


@dataclass(frozen=True, eq=False)
class Descriptors(EqualByValue):
    """Event counts at the selected pixels, or their codes, and times of n windows.

    >>> counts, start = np.array([[3, 0], [1, 2]], dtype=np.uint8), np.array([0, 1_000_000])
    >>> windows = Descriptors(counts, start, start + 1_000_000, events=np.array([40, 35]))
    >>> windows, windows.centre_us.tolist()
    (Descriptors(2 windows of 2 counters), [500000, 1500000])

    Attributes
    ----------
    counts : ndarray of unsigned int, shape (n, J)
    start_us, end_us : ndarray of int64, shape (n,)
        A fixed-time window spans ``[start, end)``. A fixed-count window starts with its first event
        at any pixel and ends with its N-th at a selected one.
    events : ndarray of int64, shape (n,)
        Events of the whole sensor in each window.
    selected : ndarray of int64, shape (n,), optional
        Events at the selected pixels, which cannot be computed from codes.
    unseen : ndarray of int64, shape (n,), optional
        Time in which nothing was seen, as known in each window and in halves of a window, see
        `UnseenTime`; absent if there is none.
    counted : ndarray of int64, shape (n,), optional
        Those of them that tell the speed, see `codes.counted_events`; by default all.
    summed : ndarray of uint8, shape (n, 2, J), optional
        Codes of the newest 2 and 4 windows together, for a filter over gains.
    """

    counts: npt.NDArray[np.unsignedinteger]
    start_us: npt.NDArray[np.int64]
    end_us: npt.NDArray[np.int64]
    events: npt.NDArray[np.int64]
    selected: npt.NDArray[np.int64] | None = None
    unseen: npt.NDArray[np.int64] | None = None
    counted: npt.NDArray[np.int64] | None = None
    summed: npt.NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.start_us)

    def __repr__(self) -> str:
        return f"Descriptors({len(self)} windows of {self.counts.shape[-1]} counters)"

    @property
    def selected_events(self) -> npt.NDArray[np.int64]:
        """Number of events at the selected pixels, shape (n,); by default the sum of the counts."""
        return self.counts.sum(axis=1, dtype=np.int64) if self.selected is None else self.selected

    @property
    def counted_events(self) -> npt.NDArray[np.int64]:
        """Number of events that tell the speed, shape (n,)."""
        return self.selected_events if self.counted is None else self.counted

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name, for an archive; the inverse of `from_arrays`."""
        return present(**{each.name: getattr(self, each.name) for each in fields(self)})

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Descriptors:
        """Build from named arrays, for example of a file; others are ignored."""
        optional = {name: arrays.get(name) for name in ("selected", "unseen", "counted", "summed")}
        return cls(
            arrays["counts"], arrays["start_us"], arrays["end_us"], arrays["events"], **optional
        )

    def take(self, windows: npt.NDArray[np.integer] | npt.NDArray[np.bool_] | slice) -> Descriptors:
        """Return some windows, by a slice, indices in any order, or a mask of shape (n,)."""
        return Descriptors(**{name: column[windows] for name, column in self.to_arrays().items()})

    @property
    def centre_us(self) -> npt.NDArray[np.int64]:
        """Middle of each window, in microseconds, rounded down."""
        return self.start_us + (self.end_us - self.start_us) // 2

    @property
    def window_us(self) -> int:
        """Length of a window in microseconds; the median, if they differ."""
        return int(np.median(self.end_us - self.start_us))


def overlapping(pieces: Descriptors, number: int) -> Descriptors:
    """Return the windows of `number` successive pieces each, starting at each piece.

    Parameters
    ----------
    pieces : Descriptors
        n pieces of counts, not codes.

    Returns
    -------
    Descriptors
        n - number + 1 windows, or none.
    """
    n = len(pieces)
    first = np.arange(max(n - number + 1, 0))
    last = first + number - 1

    def summed(values: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        total = np.zeros((n + 1, *values.shape[1:]), dtype=np.int64)
        np.cumsum(values, axis=0, dtype=np.int64, out=total[1:])
        return np.asarray(total[last + 1] - total[first])

    return Descriptors(
        narrow(summed(pieces.counts)),
        pieces.start_us[first],
        pieces.end_us[last],
        summed(pieces.events),
        summed(pieces.selected_events),
    )


def check_descriptors(descriptors: Descriptors, counters: int) -> None:
    """Check that all arrays have the documented dtypes and the same length.

    Parameters
    ----------
    descriptors : Descriptors
        At least one.
    counters : int
        How many counts each must have.
    """
    check_array(descriptors.counts, "counts", COUNT_DTYPES, (None, counters))
    n = len(descriptors.counts)
    if not descriptors.counts.size:
        raise MapError(
            f"counts are of shape {descriptors.counts.shape}: expected one window or more, with "
            "one count or more"
        )
    for name in ("start_us", "end_us", "events"):
        check_array(getattr(descriptors, name), name, (np.int64,), (n,))
    for name in ("start_us", "end_us"):
        check_range(getattr(descriptors, name), name, -TIME_LIMIT_US, TIME_LIMIT_US)
    check_range(descriptors.events, "events", 0, TIME_LIMIT_US)
    for name in ("selected", "counted"):
        if getattr(descriptors, name) is not None:
            check_array(getattr(descriptors, name), name, (np.int64,), (n,))
            check_range(getattr(descriptors, name), name, 0, TIME_LIMIT_US // n)
    if descriptors.summed is not None:
        check_array(descriptors.summed, "summed", (np.uint8,), (n, 2, counters))
    if descriptors.unseen is not None:
        check_array(descriptors.unseen, "unseen", (np.int64,), (n,))
        check_range(descriptors.unseen, "unseen", 0, TIME_LIMIT_US)
    if (descriptors.end_us < descriptors.start_us).any():
        raise MapError("a window ends before it starts: expected end_us of start_us or later")


def narrow(counts: npt.NDArray[np.integer]) -> npt.NDArray[np.unsignedinteger]:
    """Convert counts to the narrowest unsigned dtype that holds the largest of them."""
    largest = int(counts.max()) if counts.size else 0
    for dtype in (np.uint8, np.uint16, np.uint32):
        if largest <= np.iinfo(dtype).max:
            return counts.astype(dtype)
    return counts.astype(np.uint64)


#: windows that are narrowed at once
_BLOCK = 1 << 12


def collect(windows: Iterable[WindowCounts], counters: int) -> Descriptors:
    """Collect windows of `counters` counts each as descriptors in the narrowest dtype."""
    counts = [np.zeros((0, counters), dtype=np.uint8)]
    spans = [np.zeros((0, 4), dtype=np.int64)]
    rest = iter(windows)
    while block := list(itertools.islice(rest, _BLOCK)):
        counts.append(narrow(np.stack([window.counts for window in block])))
        spans.append(np.array([window[1:] for window in block], dtype=np.int64))
    start_us, end_us, events, unseen = np.concatenate(spans).T.copy()
    return Descriptors(
        np.concatenate(counts), start_us, end_us, events, unseen=unseen if unseen.any() else None
    )
