"""Counts at the selected pixels as a tonic transform; tonic itself is not needed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counters import count_events
from edge_vpr.descriptors.descriptor_stream import DescriptorStream
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.descriptors.windows import Window
from edge_vpr.errors import EventError
from edge_vpr.events import EVENT_DTYPE, Events, check_events


@dataclass(frozen=True)
class CountPixels:
    """Count the events at the selected pixels, of a whole array or of each of its windows.

    It replaces `tonic.transforms.ToFrame`: after the steps of a `tonic.transforms.Compose`, or as
    the transform of a dataset or of a `tonic.SlicedDataset`. Counts are 64 bits wide.

    Parameters
    ----------
    pixel_map : PixelMap
    window : FixedTime or FixedCount, optional
        Cut the array into windows, without the incomplete last one. Fixed-time windows start at
        time 0. If absent, all events are one window, which suits the slices of a slicer.
    polarity : bool
        Count ON and OFF events separately.

    Examples
    --------
    >>> from edge_vpr.events import Sensor, make_events
    >>> two = PixelMap(Sensor(4, 4), np.array([1, 2]), np.array([0, 0]))
    >>> CountPixels(two)(make_events(t=[0, 4, 9, 12], x=[1, 2, 1, 1], y=[0, 0, 0, 0]))
    array([3, 1])
    """

    pixel_map: PixelMap
    window: Window | None = None
    polarity: bool = False
    _table: npt.NDArray[np.signedinteger] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_table", self.pixel_map.table())

    def __call__(self, events: Events) -> npt.NDArray[np.int64]:
        """Count the events of an array.

        Parameters
        ----------
        events : structured ndarray, shape (n,)
            With the fields x and y of any integer dtype, p for polarity (greater than 0 is ON) and
            t for windows; the fields of tonic's arrays may be in any order. The array is not
            changed.

        Returns
        -------
        ndarray of int64, shape (J,), or (2 J,) with polarity
            The J counts of ON events precede those of OFF events. With `window`, there is one row
            for each window, shape (K, J) or (K, 2 J).

        Raises
        ------
        EventError
            If a field is missing, a pixel lies off the sensor, or, with `window`, time runs
            backwards or begins before 0.
        """
        columns = self._columns(events)
        if self.window is not None:
            check_events(columns, self.pixel_map.sensor, after=0)
            stream = DescriptorStream(self.pixel_map, self.window, polarity=self.polarity)
            return stream.update(columns).counts.astype(np.int64)
        counts = np.zeros(len(self.pixel_map) * (2 if self.polarity else 1), dtype=np.int64)
        p = columns["p"] if self.polarity else None
        count_events(self._table, columns["x"], columns["y"], counts, p)
        return counts

    def _columns(self, events: Events) -> Events:
        """Convert to the project's dtype; wider coordinates are checked instead of wrapped."""
        needed = (
            {"x", "y"} | ({"p"} if self.polarity else set()) | ({"t"} if self.window else set())
        )
        if not needed <= set(events.dtype.names or ()):
            raise EventError(
                f"event array has dtype {events.dtype}, without all of the fields "
                f"{', '.join(sorted(needed))}: give a structured array as tonic's datasets do"
            )
        if events.dtype == EVENT_DTYPE:
            return events
        columns = np.empty(events.shape, EVENT_DTYPE)
        for name, size in zip("xy", self.pixel_map.sensor, strict=True):
            column = events[name]
            if column.size and not (column.min() >= 0 and column.max() < size):
                raise EventError(
                    f"field {name} spans {column.min()} to {column.max()}, off the "
                    f"{self.pixel_map.sensor} sensor: give the pixel map of this camera"
                )
            columns[name] = column
        for name in needed - {"x", "y"}:
            columns[name] = events[name] > 0 if name == "p" else events[name]
        return columns
