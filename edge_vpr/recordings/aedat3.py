"""Polarity events of AEDAT 3.1; column 0, row 0 is the upper left pixel (``polarity.h``)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge_vpr.recordings.aedat3_file import POLARITY, Aedat3File
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import ReadOptions, Source

_EVENT = np.dtype([("data", "<u4"), ("t", "<i4")])


class Aedat3Source(Source):
    """Source of the events of one camera; times are those of its clock.

    The 32 bits of an event are column, row (15 bits each), polarity and validity. Events that the
    recorder's filters marked as invalid are left out.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._file = Aedat3File(path)
        self._camera = self._file.choose(options.topic)
        super().__init__(path, options, self._file.sensor_of(self._camera))

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a packet at a time; see :class:`Source`."""
        for packet in self._file.packets(POLARITY, self._camera, log):
            if packet.event_bytes != _EVENT.itemsize:
                raise self._file.damaged(packet.at, f"events of {packet.event_bytes} bytes")
            events = np.frombuffer(packet.data, _EVENT)
            events = events[events["data"] & 1 == 1]
            for i in range(0, len(events), self.options.chunk_events):
                part = events[i : i + self.options.chunk_events]
                data = part["data"]
                yield Columns(
                    part["t"].astype(np.int64) + packet.origin_us,
                    data >> 17,
                    data >> 2 & 0x7FFF,
                    data & 2 == 2,
                )
            self.position = self._file.position


open_source = Aedat3Source
