"""Where a window ends: the one place that decides which events make one descriptor."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counters import count_events, count_frame, count_until
from edge_vpr.descriptors.descriptor_checks import check_descriptors
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import TIME_LIMIT_US, Events
from fixedpoint.codes import CounterCode, PixelCodes

#: more windows than this in one recording, or ticks in one jump of time, are a fault: of a clock
#: that jumps, or of a window that was asked for in the wrong unit
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
        Or what they are coded as.
    start_us, end_us : int
    events : int
        At any pixel.
    """

    counts: npt.NDArray[np.int64]
    start_us: int
    end_us: int
    events: int

    def coded(self, code: CounterCode | PixelCodes | None) -> WindowCounts:
        """Put codes in place of the counts; None leaves them."""
        if code is None:
            return self
        return self._replace(counts=code.encode(self.counts).astype(np.int64))


@dataclass(frozen=True)
class Descriptors:
    """Event counts of n windows at the selected pixels, or their codes, and when each window was.

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
        """Events at the selected pixels, shape (n,); if not stated, the sum of the counts."""
        return self.counts.sum(axis=1, dtype=np.int64) if self.selected is None else self.selected

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Name the arrays, for an archive; `from_arrays` takes them back."""
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

    def first(self, n: int) -> Descriptors:
        """Take the first n windows; views."""
        return Descriptors(self.counts[:n], self.start_us[:n], self.end_us[:n], self.events[:n])

    def take(self, windows: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> Descriptors:
        """Take some windows, by their indices in any order, or by a mask of shape (n,)."""
        return Descriptors(**{name: column[windows] for name, column in self.to_arrays().items()})

    @property
    def centre_us(self) -> npt.NDArray[np.int64]:
        """Middle of each window, in microseconds, rounded down."""
        return self.start_us + (self.end_us - self.start_us) // 2


def narrow(counts: npt.NDArray[np.integer]) -> npt.NDArray[np.unsignedinteger]:
    """Store counts in the narrowest unsigned dtype that holds the largest of them."""
    largest = int(counts.max()) if counts.size else 0
    for dtype in (np.uint8, np.uint16, np.uint32):
        if largest <= np.iinfo(dtype).max:
            return counts.astype(dtype)
    return counts.astype(np.uint64)


class DescriptorStream:
    """Turns a stream of events into descriptors, however the stream is cut into chunks.

    Parameters
    ----------
    pixel_map : PixelMap
    window : FixedTime or FixedCount
    polarity : bool
        Count ON and OFF events apart.
    code : CounterCode or PixelCodes, optional
        What a descriptor holds in place of the counts; clipping is a `CounterCode.saturating`.

    Examples
    --------
    >>> import numpy as np
    >>> from edge_vpr.events import Sensor, make_events
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> stream = DescriptorStream(two, FixedTime(tau_us=10))
    >>> stream.update(make_events(t=[0, 4, 9, 12], x=[1, 2, 1, 1], y=[0, 0, 0, 0])).counts
    array([[2, 1]], dtype=uint8)
    """

    def __init__(
        self,
        pixel_map: PixelMap,
        window: Window,
        *,
        polarity: bool = False,
        code: CounterCode | PixelCodes | None = None,
    ) -> None:
        self._table = pixel_map.table()
        self._window = window
        self._polarity = polarity
        self._code = code
        # where every pixel is its own slot, the counters are an image and need no table
        dense = not polarity and pixel_map == PixelMap.all_of(pixel_map.sensor)
        self._image_shape = self._table.shape if dense else None
        self._counts = np.zeros(len(pixel_map) * (2 if polarity else 1), dtype=np.int64)
        self._counted = 0  # of a fixed-count window's budget
        self._events = 0  # of the open window, at any pixel
        self._start = 0
        self._last = 0

    def update(self, events: Events) -> Descriptors:
        """Feed the next events.

        Parameters
        ----------
        events : ndarray with fields t, x, y and, for polarity, p; shape (n,)
            In time order and on the sensor, after all those before (see `check_events`).

        Returns
        -------
        Descriptors
            Of the windows that these events completed; may be none.

        Raises
        ------
        UsageError
            If the recording lasts more than a million windows.
        """
        return collect(self.windows(events), self._counts.size)

    def windows(self, events: Events) -> Iterator[WindowCounts]:
        """Feed the next events and take one completed window at a time, as `update` does at once.

        Yields
        ------
        WindowCounts
        """
        if events.size == 0:
            return
        if isinstance(self._window, FixedTime):
            yield from self._fixed_time(events, self._window.tau_us)
        else:
            yield from self._fixed_count(events, self._window.events)
        self._last = int(events["t"][-1])

    def finish(self) -> Descriptors:
        """Take the incomplete last window, if any event fell into it."""
        return collect(self.last(), self._counts.size)

    def last(self) -> Iterator[WindowCounts]:
        """Take the incomplete last window as `windows` does, if any event fell into it."""
        if self._events:
            # a fixed-time window is open at its end
            end = self._last + 1 if isinstance(self._window, FixedTime) else self._last
            yield self._take(self._start, end)

    def _fixed_time(self, events: Events, tau: int) -> Iterator[WindowCounts]:
        t = events["t"]
        windows = (int(t[-1]) - self._start) // tau
        if int(t[-1]) // tau > MAX_WINDOWS:
            raise UsageError(
                f"time runs to {t[-1]} us, over more than {MAX_WINDOWS} windows of {tau} us: "
                "check the recording's clock, or take longer windows"
            )
        ends = self._start + tau * np.arange(1, windows + 1)
        cut = 0
        for end, upto in zip(ends.tolist(), np.searchsorted(t, ends).tolist(), strict=True):
            self._count(events[cut:upto])
            yield self._take(end - tau, end)
            self._start, cut = end, upto
        self._count(events[cut:])

    def _fixed_count(self, events: Events, budget: int) -> Iterator[WindowCounts]:
        t, x, y = events["t"], events["x"], events["y"]
        p = events["p"] if self._polarity else None
        cut = 0
        while cut < events.size:
            if not self._events:
                self._start = int(t[cut])
            consumed, counted = count_until(
                self._table,
                x[cut:],
                y[cut:],
                self._counts,
                budget - self._counted,
                None if p is None else p[cut:],
            )
            cut += consumed
            self._events += consumed
            self._counted += counted
            if self._counted == budget:
                yield self._take(self._start, int(t[cut - 1]))

    def _count(self, events: Events) -> None:
        if events.size:
            if self._image_shape is not None:
                count_frame(events["x"], events["y"], self._counts.reshape(self._image_shape))
            else:
                p = events["p"] if self._polarity else None
                count_events(self._table, events["x"], events["y"], self._counts, p)
            self._events += events.size

    def _take(self, start: int, end: int) -> WindowCounts:
        """Hand the finished window over and clear the counters."""
        taken = WindowCounts(self._counts, start, end, self._events).coded(self._code)
        self._counts = np.zeros_like(self._counts)
        self._counted = self._events = 0
        return taken


def collect(windows: Iterable[WindowCounts], counters: int) -> Descriptors:
    """Gather windows, `counters` counts in each, to descriptors in the narrowest dtype."""
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
