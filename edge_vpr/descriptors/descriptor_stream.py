"""Conversion of a stream of events to descriptors; decides which events belong to a window."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from edge_vpr.descriptors.counters import count_events, count_frame, count_until
from edge_vpr.descriptors.descriptors import Descriptors, collect
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import MAX_WINDOWS, FixedTime, Window, WindowCounts
from edge_vpr.errors import UsageError
from edge_vpr.events import Events


class DescriptorStream:
    """Turns a stream of events into descriptors, however the stream is cut into chunks.

    Parameters
    ----------
    pixel_map : PixelMap
    window : FixedTime or FixedCount
    polarity : bool
        Count ON and OFF events apart.

    Examples
    --------
    >>> import numpy as np
    >>> from edge_vpr.events import Sensor, make_events
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> stream = DescriptorStream(two, FixedTime(tau_us=10))
    >>> stream.update(make_events(t=[0, 4, 9, 12], x=[1, 2, 1, 1], y=[0, 0, 0, 0])).counts
    array([[2, 1]], dtype=uint8)
    """

    def __init__(self, pixel_map: PixelMap, window: Window, *, polarity: bool = False) -> None:
        self._table = pixel_map.table()
        self._window = window
        self._polarity = polarity
        # if every pixel is its own slot, the counters are an image and no table is needed
        dense = not polarity and pixel_map == PixelMap.all_of(pixel_map.sensor)
        self._image_shape = self._table.shape if dense else None
        self._counts = np.zeros(len(pixel_map) * (2 if polarity else 1), dtype=np.int64)
        self._counted = 0  # events still missing in a fixed-count window
        self._events = 0  # events of the open window at any pixel
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
        """Feed the next events and yield the completed windows; `update` returns all at once."""
        if events.size == 0:
            return
        if isinstance(self._window, FixedTime):
            yield from self._fixed_time(events, self._window.tau_us)
        else:
            yield from self._fixed_count(events, self._window.events)
        self._last = int(events["t"][-1])

    def finish(self) -> Descriptors:
        """Return the incomplete last window, if it has events."""
        return collect(self.last(), self._counts.size)

    def last(self) -> Iterator[WindowCounts]:
        """Yield the incomplete last window, if it has events."""
        if self._events:
            # the end of a fixed-time window does not belong to it
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
        """Return the finished window and clear the counters."""
        taken = WindowCounts(self._counts, start, end, self._events)
        self._counts = np.zeros_like(self._counts)
        self._counted = self._events = 0
        return taken
