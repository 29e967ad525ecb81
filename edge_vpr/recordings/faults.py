"""Handling of faulty events: checks, counts and messages."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import EVENT_DTYPE, TIME_LIMIT_US, Events, Sensor
from edge_vpr.recordings.columns import Columns

_REMEDY = "read with --on-fault drop (on_fault='drop') to leave {them} out and count {them}"


@dataclass
class Faults:
    """Number of dropped entries of each kind in a pass over a recording so far.

    Attributes
    ----------
    backwards : int
        Events earlier than an event before them.
    off_sensor : int
        Events whose pixel does not exist.
    unreadable : int
        Entries that are not events: a line without four numbers, or a time that is not a number or
        lies beyond 2**60 us.
    undated : int
        Events before the stream's first time word, of a camera that was already running when the
        recording began. They have no time and are therefore dropped and counted, even when faults
        are errors.
    truncated : int
        Bytes at a cut-off end that do not make up an event, or a packet of events.
    """

    backwards: int = 0
    off_sensor: int = 0
    unreadable: int = 0
    undated: int = 0
    truncated: int = 0

    @property
    def total(self) -> int:
        """Number of dropped entries; a cut-off end counts as one."""
        events = self.backwards + self.off_sensor + self.unreadable + self.undated
        return events + bool(self.truncated)

    def __str__(self) -> str:
        parts = [
            f"{getattr(self, field.name):,} {field.name.replace('_', ' ')}"
            + (" bytes" if field.name == "truncated" else "")
            for field in fields(self)
            if getattr(self, field.name)
        ]
        return ", ".join(parts) or "none"


class FaultLog:
    """Check raw columns, convert them to event arrays, and count faulty events.

    Parameters
    ----------
    path : Path
        Named in messages.
    sensor : Sensor
    on_fault : {"error", "drop"}
    origin_us : int or None
        Time that is subtracted from all times; None stands for that of the first good event.
    """

    def __init__(
        self, path: Path, sensor: Sensor, on_fault: str = "error", origin_us: int | None = None
    ) -> None:
        check_policy(on_fault)
        self.path = path
        self.sensor = sensor
        self.drop = on_fault == "drop"
        self.origin_us = origin_us
        self.faults = Faults()
        self.entries = 0  #: events of the file seen so far, good or bad
        self._last_us: int | None = None

    def admit(self, columns: Columns) -> Events:
        """Check one chunk; chunks must come in the order of the file.

        An event is late if any good event before it has a later time. A single wrong time far in
        the future therefore makes all events after it late, which the count shows.

        Returns
        -------
        ndarray of EVENT_DTYPE, shape (n,)
            The good events, in the order of the file; a new array.

        Raises
        ------
        RecordingError
            At the first faulty event, unless faults are dropped.
        """
        t, x, y, p = columns
        if t.size and not self._clean(columns):
            t, x, y, p = self._sift(columns)
        self.entries += columns.t.size
        events = np.empty(t.size, EVENT_DTYPE)
        if t.size:
            if self.origin_us is None:
                self.origin_us = int(t[0])
            self._last_us = int(t[-1])
            np.subtract(t, self.origin_us, out=events["t"], casting="unsafe")
            events["x"], events["y"] = x, y
            events["p"] = p if p.dtype == np.bool_ else p > 0
        return events

    def truncated(self, n_bytes: int, where: str) -> None:
        """Report a cut-off end, with `n_bytes` left over at `where`."""
        if not self.drop:
            raise RecordingError(
                f"{self.path} is cut off: {n_bytes:,} bytes too many or too few at {where}: "
                + _REMEDY.format(them="the rest")
            )
        self.faults.truncated += n_bytes

    def unreadable(self, n: int, where: str) -> None:
        """Report `n` entries that are not events, the first of them at `where`."""
        if not self.drop:
            raise RecordingError(f"{self.path}: {where}: " + _REMEDY.format(them="such entries"))
        self.faults.unreadable += n

    def undated(self, n: int) -> None:
        """Report `n` events before the first time word; never an error."""
        self.faults.undated += n

    def _clean(self, columns: Columns) -> bool:
        t, x, y, _ = columns
        width, height = self.sensor
        return bool(
            x.max() < width
            and y.max() < height
            and (x.dtype.kind == "u" or x.min() >= 0)
            and (y.dtype.kind == "u" or y.min() >= 0)
            and t[0] >= (-TIME_LIMIT_US if self._last_us is None else self._last_us)
            and (t[1:] >= t[:-1]).all()
            and t[-1] <= TIME_LIMIT_US
        )

    def _sift(self, columns: Columns) -> Columns:
        t, x, y, _ = columns
        width, height = self.sensor
        known = (t >= -TIME_LIMIT_US) & (t <= TIME_LIMIT_US)
        on = (x >= 0) & (x < width) & (y >= 0) & (y < height) & known
        # latest good time before each event; events outside the sensor do not change it
        floor = np.iinfo(np.int64).min
        times = np.full(t.shape, floor, np.int64)
        times[on] = t[on]
        latest = np.empty_like(times)
        latest[0] = floor if self._last_us is None else self._last_us
        latest[1:] = np.maximum(np.maximum.accumulate(times)[:-1], latest[0])
        late = on & (times < latest)
        good = on & ~late
        if not self.drop:
            i = int(np.flatnonzero(~good)[0])
            if on[i]:
                what = f"time runs backwards, from {latest[i]} to {t[i]} us"
            elif known[i]:
                what = f"pixel ({x[i]}, {y[i]}) at {t[i]} us lies off the {self.sensor} sensor"
            else:
                what = f"time {t[i]} us lies beyond 2**60 us; if it is in ns, pass --time-unit ns"
            raise RecordingError(
                f"{self.path}: event {self.entries + i:,}: {what}: "
                + _REMEDY.format(them="such events")
            )
        self.faults.unreadable += int(np.count_nonzero(~known))
        self.faults.off_sensor += int(np.count_nonzero(~on & known))
        self.faults.backwards += int(np.count_nonzero(late))
        return Columns(*(column[good] for column in columns))


def check_policy(on_fault: str) -> None:
    """Raise :class:`UsageError` unless `on_fault` is ``"error"`` or ``"drop"``."""
    if on_fault not in ("error", "drop"):
        raise UsageError(f"on_fault {on_fault!r} is unknown: choose error or drop")
