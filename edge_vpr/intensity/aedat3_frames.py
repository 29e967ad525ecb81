"""Frames of AEDAT 3.1: a DAVIS's images as cAER recorded them (``frame.h`` of libcaer)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.intensity.first_event import start_of
from edge_vpr.intensity.frames import IntensityFrame, to_grey
from edge_vpr.recordings.aedat3_file import FRAME, POLARITY, Aedat3File, Packet
from edge_vpr.recordings.faults import FaultLog

_HEAD = np.dtype(
    [("info", "<u4"), ("start", "<i4"), ("end", "<i4"), ("exposure_start", "<i4"),
     ("exposure_end", "<i4"), ("width", "<i4"), ("height", "<i4"), ("x", "<i4"), ("y", "<i4")]
)  # fmt: skip
#: grey, red-green-blue, and the same with alpha
_CHANNELS = (1, 3, 4)


class Aedat3Frames:
    """Frames of one camera, in the middle of their exposure.

    Pixels have 16 bits, of which the upper 8 are kept. Frames that are marked as invalid are left
    out.

    Parameters
    ----------
    path : Path
    topic : str, optional
        Name or number of the camera, if there are several.

    Attributes
    ----------
    start_us : int
        Time of the first event, or of the first frame if no events were recorded.
    has_events : bool
    """

    def __init__(self, path: Path, topic: str | None = None) -> None:
        self._file = Aedat3File(path)
        self._camera = self._file.choose(topic)
        packets = self._file.packets(POLARITY, self._camera, self._log())
        self.has_events = any(packet.data for packet in packets)
        self.start_us = start_of(self, path, topic)

    def _log(self) -> FaultLog:
        return FaultLog(self._file.path, self._file.sensor_of(self._camera) or Sensor(1, 1))

    def __iter__(self) -> Iterator[IntensityFrame]:
        region = None
        for packet in self._file.packets(FRAME, self._camera, self._log()):
            if packet.event_bytes < _HEAD.itemsize:
                raise self._file.damaged(packet.at, f"frames of {packet.event_bytes} bytes")
            for first in range(0, len(packet.data), packet.event_bytes):
                head = np.frombuffer(packet.data, _HEAD, 1, first)[0]
                if not head["info"] & 1:
                    continue
                which = int(head["info"]) >> 8 & 0x7F, int(head["x"]), int(head["y"])
                region = which if region is None else region
                if which != region:
                    raise self._file.damaged(
                        packet.at, "frames of several regions of interest, and one is read"
                    )
                try:
                    yield _frame(packet, first, head)
                except ValueError as error:
                    raise self._file.damaged(packet.at, str(error)) from error


def _frame(packet: Packet, first: int, head: np.void) -> IntensityFrame:
    channels = int(head["info"]) >> 1 & 7
    width, height = int(head["width"]), int(head["height"])
    if channels not in _CHANNELS:
        raise ValueError(f"{channels} channels are neither grey, RGB nor RGBA")
    if not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE):
        raise ValueError(f"a frame of {width}x{height} pixels")
    samples = width * height * channels
    if _HEAD.itemsize + 2 * samples > packet.event_bytes:
        raise ValueError(
            f"{packet.event_bytes - _HEAD.itemsize:,} bytes for {width}x{height} pixels of "
            f"{2 * channels} bytes"
        )
    pixels = np.frombuffer(packet.data, "<u2", samples, first + _HEAD.itemsize) >> 8
    shape = (height, width) if channels == 1 else (height, width, channels)
    image = to_grey(pixels.astype(np.uint8).reshape(shape), blue_first=False)
    begin, end = int(head["exposure_start"]), int(head["exposure_end"])
    return IntensityFrame(packet.origin_us + begin + (end - begin) // 2, image)
