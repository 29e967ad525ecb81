"""Descriptors: the event counts of windows, or their codes, with times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.array_checks import check_array, check_range
from edge_vpr.descriptors.windows import WindowCounts
from edge_vpr.errors import MapError
from edge_vpr.events import TIME_LIMIT_US

#: dtypes of counts that can be matched: native byte order, at most 32 bits
COUNT_DTYPES = (np.uint8, np.uint16, np.uint32)


@dataclass(frozen=True)
class Descriptors:
    """Event counts at the selected pixels, or their codes, and times of n windows.

    Attributes
    ----------
    counts : ndarray of unsigned int, shape (n, J) or with polarity (n, 2 J)
        With polarity the J counts of ON events precede those of OFF events.
    start_us, end_us : ndarray of int64, shape (n,)
        A fixed-time window spans ``[start, end)``. A fixed-count window starts with its first event
        at any pixel and ends with its N-th at a selected one.
    events : ndarray of int64, shape (n,)
        Events of the whole sensor in each window.
    selected : ndarray of int64, shape (n,), optional
        Events at the selected pixels, which codes do not tell.
    """

    counts: npt.NDArray[np.unsignedinteger]
    start_us: npt.NDArray[np.int64]
    end_us: npt.NDArray[np.int64]
    events: npt.NDArray[np.int64]
    selected: npt.NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.start_us)

    def __repr__(self) -> str:
        return f"Descriptors({len(self)} windows of {self.counts.shape[-1]} counters)"

    @property
    def activity(self) -> npt.NDArray[np.int64]:
        """Number of events at the selected pixels, shape (n,); by default the sum of the counts."""
        return self.counts.sum(axis=1, dtype=np.int64) if self.selected is None else self.selected

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name, for an archive; the inverse of `from_arrays`."""
        names = ("counts", "start_us", "end_us", "events", "selected")
        columns = {name: getattr(self, name) for name in names}
        return {name: column for name, column in columns.items() if column is not None}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Descriptors:
        """Build from named arrays, for example of a file; others are ignored.

        Raises
        ------
        MapError
            If one is missing, or they are not descriptors (`check_descriptors`).
        """
        missing = {"counts", "start_us", "end_us", "events"} - arrays.keys()
        if missing:
            raise MapError(f"descriptors lack {', '.join(sorted(missing))}: expected all four")
        found = cls(
            arrays["counts"],
            arrays["start_us"],
            arrays["end_us"],
            arrays["events"],
            arrays.get("selected"),
        )
        check_descriptors(found)
        return found

    def take(self, windows: npt.NDArray[np.integer] | npt.NDArray[np.bool_] | slice) -> Descriptors:
        """Return some windows, by a slice, indices in any order, or a mask of shape (n,)."""
        return Descriptors(**{name: column[windows] for name, column in self.to_arrays().items()})

    @property
    def centre_us(self) -> npt.NDArray[np.int64]:
        """Middle of each window, in microseconds, rounded down."""
        return self.start_us + (self.end_us - self.start_us) // 2


def check_descriptors(descriptors: Descriptors, counters: int | None = None) -> None:
    """Check that all arrays have the documented dtypes and the same length.

    Parameters
    ----------
    descriptors : Descriptors
        At least one.
    counters : int, optional
        How many counts each must have.

    Raises
    ------
    MapError
        If a dtype or shape differs, a time is out of range, or a window ends before it starts.
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
    if descriptors.selected is not None:
        check_array(descriptors.selected, "selected", (np.int64,), (n,))
        check_range(descriptors.selected, "selected", 0, TIME_LIMIT_US // n)
    if (descriptors.end_us < descriptors.start_us).any():
        raise MapError("a window ends before it starts: expected end_us of start_us or later")


def narrow(counts: npt.NDArray[np.integer]) -> npt.NDArray[np.unsignedinteger]:
    """Convert counts to the narrowest unsigned dtype that holds the largest of them."""
    largest = int(counts.max()) if counts.size else 0
    for dtype in (np.uint8, np.uint16, np.uint32):
        if largest <= np.iinfo(dtype).max:
            return counts.astype(dtype)
    return counts.astype(np.uint64)


def collect(windows: Iterable[WindowCounts], counters: int) -> Descriptors:
    """Collect windows of `counters` counts each as descriptors in the narrowest dtype."""
    taken = list(windows)
    counts = [narrow(window.counts) for window in taken]
    spans = np.array([window[1:] for window in taken], dtype=np.int64).reshape(-1, 3)
    stacked = np.stack(counts) if counts else np.zeros((0, counters), dtype=np.uint8)
    return Descriptors(stacked, spans[:, 0], spans[:, 1], spans[:, 2])


def join(parts: Sequence[Descriptors]) -> Descriptors:
    """Join the descriptors of successive calls, in the narrowest common dtype.

    Parameters
    ----------
    parts : sequence of Descriptors
        At least one.
    """
    return Descriptors(
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.start_us for part in parts]),
        np.concatenate([part.end_us for part in parts]),
        np.concatenate([part.events for part in parts]),
        np.concatenate([part.activity for part in parts]),
    )
