"""Prophesee DAT, version 2: 32 bits of time, 14 of column, 14 of row, polarity.

The decoder is our own: eventcv loads these files whole and does not unwrap their 32-bit clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import Events, Sensor
from edge_vpr.recordings.clock import Unwrapper
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.prophesee import header_lines, read_header
from edge_vpr.recordings.records import read_records
from edge_vpr.recordings.source import ReadOptions, Source

_EVENT = np.dtype([("t", "<u4"), ("pixel", "<u4")])
_KINDS = (0, 12)  # Event2d of version 2, EventCD


class DatSource(Source):
    """Source of a DAT file: header lines, a byte each for the events' kind and size, and events."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        header = read_header(path)
        super().__init__(path, options, header.sensor)
        self._skip = header.n_bytes + 2
        with path.open("rb") as file:
            file.seek(header.n_bytes)
            kind = file.read(2)
        if len(kind) < 2 or kind[0] not in _KINDS or kind[1] != _EVENT.itemsize:
            raise RecordingError(
                f"{path} holds events of kind {kind.hex() or 'none'}, and not change detection "
                "events (00 or 0c) of 8 bytes: convert it"
            )
        if header.start_us is not None:
            self.start_us, self.relative = header.start_us, True

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        clock = Unwrapper(32)
        n = self.options.chunk_events
        for events, position in read_records(self.path, self._skip, _EVENT, n, log):
            self.position = position
            pixel = events["pixel"]
            yield Columns(
                clock.unwrap(events["t"]),
                (pixel & 0x3FFF).astype(np.uint16),
                (pixel >> 14 & 0x3FFF).astype(np.uint16),
                (pixel & 1 << 28) != 0,
            )


open_source = DatSource


class DatSink:
    """Write DAT version 2, whose clock wraps at 32 bits."""

    def __init__(self, path: Path, sensor: Sensor, start_us: int) -> None:
        if max(sensor) > 1 << 14:
            raise RecordingError(f"DAT holds up to 16384x16384 pixels, and not {sensor}: use .h5")
        self._file = path.open("wb")
        self._file.write(header_lines("dat", sensor, start_us) + bytes((12, _EVENT.itemsize)))
        self._last = 0

    def write(self, events: Events) -> None:
        """Append events.

        Raises
        ------
        RecordingError
            If there is a gap of more than 35 minutes, which looks like a wrapped clock.
        """
        t = events["t"]
        gap = int(np.diff(t, prepend=self._last).max())
        if t[0] < 0 or gap >= 1 << 31:
            raise RecordingError(
                f"a gap of {gap / 6e7:.1f} minutes, or a negative time, cannot be "
                "distinguished from a wrapped clock in DAT: use .npz"
            )
        rows = np.empty(events.size, _EVENT)
        rows["t"] = t & 0xFFFFFFFF
        rows["pixel"] = (
            events["x"].astype(np.uint32)
            | events["y"].astype(np.uint32) << 14
            | events["p"].astype(np.uint32) << 28
        )
        self._file.write(rows.tobytes())
        self._last = int(t[-1])

    def close(self) -> None:
        """End the file."""
        self._file.close()


open_sink = DatSink
