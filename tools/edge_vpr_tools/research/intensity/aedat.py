"""Frames of AEDAT 4: the intensity images that a DAVIS takes along with its events."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.aedat import Aedat4File, field_at, root_table
from edge_vpr.recordings.reading import FaultLog
from edge_vpr_tools.research.intensity.frames import IntensityFrame, start_of, to_grey

#: number of channels of each pixel format (8-bit formats of OpenCV): grey, BGR, BGRA
_CHANNELS = {0: 1, 16: 3, 24: 4}
# indices of the fields in the table of a frame: time, format, width, height, pixels
_TIME, _FORMAT, _WIDTH, _HEIGHT, _PIXELS = 0, 5, 6, 7, 10


class Aedat4Frames:
    """Frames of one stream."""

    def __init__(self, path: Path, topic: str | None = None) -> None:
        self._file = Aedat4File(path)
        self._stream = self._file.choose("FRME", "frames", topic)
        self.has_events = any(each.kind == "EVTS" for each in self._file.streams.values())
        self.start_us = start_of(self, path)

    def __iter__(self) -> Iterator[IntensityFrame]:
        sensor = self._file.streams[self._stream].sensor or Sensor(1, 1)
        for at, data in self._file.packets(self._stream, FaultLog(self._file.path, sensor)):
            try:
                frame = _frame(data)
            except (ValueError, struct.error, IndexError) as error:
                raise self._file.damaged(at, error) from error
            if frame is None:
                raise RecordingError(
                    f"{self._file.path} has a frame without pixels at byte {at:,}: copy it again"
                )
            yield frame


def _frame(data: bytes) -> IntensityFrame | None:
    table = root_table(data)

    def number(index: int, kind: str) -> int:
        at = field_at(data, table, index)
        return int(struct.unpack_from("<" + kind, data, at)[0]) if at else 0

    layout, width, height = number(_FORMAT, "b"), number(_WIDTH, "h"), number(_HEIGHT, "h")
    at = field_at(data, table, _PIXELS)
    if not at:
        return None
    if layout not in _CHANNELS:
        raise ValueError(f"pixel format {layout} is not grey, BGR or BGRA of 8 bits")
    if not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE):
        raise ValueError(f"a frame of {width}x{height} pixels")
    channels = _CHANNELS[layout]
    samples = width * height * channels
    vector = at + struct.unpack_from("<I", data, at)[0]
    (length,) = struct.unpack_from("<I", data, vector)
    if length != samples:
        raise ValueError(f"{length:,} bytes for {width}x{height} pixels of {channels} bytes")
    pixels = np.frombuffer(data, np.uint8, length, vector + 4)
    shape = (height, width) if channels == 1 else (height, width, channels)
    return IntensityFrame(number(_TIME, "q"), to_grey(pixels.reshape(shape), blue_first=True))
