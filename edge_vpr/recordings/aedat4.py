"""Events of AEDAT 4, written by iniVation's DV."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.recordings.aedat4_file import Aedat4File, field_at, root_table
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import ReadOptions, Source

_EVENT = np.dtype(
    {
        "names": ["t", "x", "y", "p"],
        "formats": ["<i8", "<i2", "<i2", "u1"],
        "offsets": [0, 8, 10, 12],
        "itemsize": 16,
    }
)


class Aedat4Source(Source):
    """Source of the events of one stream; times are microseconds since 1970."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._file = Aedat4File(path)
        self._stream = self._file.choose("EVTS", "events", options.topic)
        super().__init__(path, options, self._file.streams[self._stream].sensor)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a packet at a time; see :class:`Source`."""
        for at, data in self._file.packets(self._stream, log):
            try:
                events = _events(data)
            except (ValueError, struct.error, IndexError) as error:
                raise self._file.damaged(at, error) from error
            for i in range(0, len(events), self.options.chunk_events):
                part = events[i : i + self.options.chunk_events]
                yield Columns(part["t"], part["x"], part["y"], part["p"] != 0)
            self.position = self._file.position


def _events(data: bytes) -> npt.NDArray[np.void]:
    """Return the events of one packet: the vector in the first field of its table."""
    field = field_at(data, root_table(data), 0)
    if not field:
        return np.empty(0, _EVENT)
    vector = field + struct.unpack_from("<I", data, field)[0]
    (length,) = struct.unpack_from("<I", data, vector)
    return np.frombuffer(data, _EVENT, length, vector + 4)


open_source = Aedat4Source
