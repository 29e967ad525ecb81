"""Event Stream (``.es``), with faery's decoder.

Row 0 of the format is the lowest one: this module turns the rows, as faery's own streams do.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor
from edge_vpr.recordings.decoding import import_extra
from edge_vpr.recordings.reading import Columns, FaultLog, ReadOptions, Source, in_chunks

#: bytes between events, by their type: a pause, or a reset of the decoder
_PAUSES = {"dvs": b"\xfe\xff", "atis": b"\xfc\xfd\xfe\xff"}
#: longest end of a file in which its last event is looked for; 8 s of pauses
_END_BYTES = 1 << 16


def _es() -> Any:
    return import_extra("faery.extension", "an .es file", "faery", "es").es


class EsSource(Source):
    """Source of DVS and ATIS events; the format begins at time 0 and states the sensor's size."""

    position = None

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with _es().Decoder(path, 0) as decoder:
            if decoder.event_type not in ("dvs", "atis"):
                raise RecordingError(
                    f"{path} holds {decoder.event_type} events, which have no pixel and polarity: "
                    "record DVS or ATIS events"
                )
            sensor = Sensor(*decoder.dimensions)
        super().__init__(path, options, sensor, start_us=0)
        self._top = sensor.height - 1

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        last = None
        with _es().Decoder(self.path, 0) as decoder:
            atis = decoder.event_type == "atis"
            for packet in decoder:
                if packet.size:  # none in a long pause
                    last = struct.pack("<HH", packet["x"][-1], packet["y"][-1])
                if atis:  # an exposure measurement is not a change of intensity
                    packet = packet[~packet["exposure"]]
                on = packet["polarity"] if atis else packet["on"]
                t, y = packet["t"].astype(np.int64), self._top - packet["y"].astype(np.int64)
                columns = Columns(t, packet["x"], y, on)
                yield from in_chunks(columns, self.options.chunk_events)
        if last is not None:
            self._check_end(last, _PAUSES["atis" if atis else "dvs"], log)

    def _check_end(self, last: bytes, pauses: bytes, log: FaultLog) -> None:
        """Report an event that is cut off, which the decoder leaves out in silence.

        An event is one byte for time and polarity, and four for x and y.

        Parameters
        ----------
        last : bytes
            x and y of the last whole event, with which a whole file ends, or with pauses after it.
        """
        with self.path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - _END_BYTES))
            _, found, rest = file.read().rpartition(last)
        if found and 0 < len(rest.lstrip(pauses)) < 5:
            log.truncated(len(rest), f"byte {size - len(rest):,}, within an event")
