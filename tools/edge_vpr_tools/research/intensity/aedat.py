"""Frames of AEDAT 2, 3.1 and 4."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.events import LONGEST_SIDE, Sensor
from edge_vpr.recordings.aedat import (
    FRAME,
    POLARITY,
    Aedat3File,
    Aedat4File,
    Packet,
    chip_size,
    field_at,
    read_header,
    read_pairs,
    root_table,
)
from edge_vpr.recordings.reading import CHUNK_EVENTS, FaultLog
from edge_vpr_tools.research.intensity.frames import Image, IntensityFrame, start_of, to_grey

# Frames of AEDAT 2: samples of a DAVIS, each pixel read after its reset and after its exposure.
#
# A sample has bit 31 of its address set. Bits 22 to 30 are the row and 12 to 21 the column,
# counted from the lower left pixel (columns are not mirrored, as those of events are); bits 10 and
# 11 say what was read (0: reset, 1: signal, 2: a second signal of old chips, 3: no sample but the
# IMU); bits 0 to 9 are the converter's value. An image is the reset less the signal, both of the
# same pixel, not below 0 (correlated double sampling). This is how jAER, which writes these files,
# reads them (``DavisBaseCamera.DavisEventExtractor`` and ``DavisFrameAssembler``).
#
# The order of the pixels depends on the chip, and reset and signal reads alternate column by
# column with a rolling shutter. So that neither matters, a frame ends when all pixels have both
# reads. Reset reads of pixels that already have one begin a new frame. Frames that lack samples
# are left out.


_SAMPLE, _NOT_EVENT = 1 << 31, 1 << 31 | 1 << 10
_RESET, _SIGNAL, _SECOND, _IMU = range(4)
#: from the 10 bits of the converter to 8
_DROPPED_BITS = 2
Words = npt.NDArray[np.int64]


class Aedat2Frames:
    """Frames of a file; the time of a frame is the mean over pixels of the middle of both reads.

    Raises
    ------
    RecordingError
        If the chip is unknown, or is one with a colour filter, whose readout differs.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._data_at, chip = read_header(path)
        name = chip.lower()
        size = chip_size(name)
        if size is None or "davis" not in name or "rgb" in name or "color" in name:
            raise RecordingError(
                f"{path} was recorded by the chip {chip or '(its header does not say)'}, whose "
                "frames are not read: convert it with DV to AEDAT 4"
            )
        self._sensor = size
        pairs = read_pairs(path, self._data_at, CHUNK_EVENTS, self._log())
        self.has_events = any(bool((part.address & _NOT_EVENT == 0).any()) for part in pairs)
        self.start_us = start_of(self, path)

    def _log(self) -> FaultLog:
        return FaultLog(self._path, self._sensor)

    def __iter__(self) -> Iterator[IntensityFrame]:
        frame = _Frame(self._path, self._sensor)
        for address, time_us in self._runs():
            frame.add(address, time_us)
            if frame.complete:
                yield frame.image()

    def _runs(self) -> Iterator[tuple[Words, Words]]:
        """Yield the samples in runs of one kind of read, at most as long as a frame has pixels."""
        most = self._sensor.pixels
        left = np.empty((2, 0), np.int64)
        for part in read_pairs(self._path, self._data_at, CHUNK_EVENTS, self._log()):
            kind = part.address >> 10 & 3
            samples = (part.address & _SAMPLE != 0) & (kind != _IMU)
            left = np.hstack([left, np.stack([part.address[samples], part.time_us[samples]])])
            ends = 1 + np.flatnonzero(np.diff(left[0] >> 10 & 3))
            first = 0
            for end in [*ends.tolist(), left.shape[1]]:
                while end - first >= most or (first < end < left.shape[1]):
                    last = min(end, first + most)
                    yield left[0, first:last], left[1, first:last]
                    first = last
            left = left[:, first:]
        if left.shape[1]:
            yield left[0], left[1]


class _Frame:
    """Reads of the pixels of one frame."""

    def __init__(self, path: Path, sensor: Sensor) -> None:
        self._path, self._sensor = path, sensor
        pixels = sensor.pixels
        self._value = np.zeros((2, pixels), np.int64)
        self._time_us = np.zeros((2, pixels), np.int64)
        self._read = np.zeros((2, pixels), np.bool_)

    @property
    def complete(self) -> bool:
        """Whether every pixel has both reads."""
        return bool(self._read.all())

    def add(self, address: Words, time_us: Words) -> None:
        """Add the samples of one run.

        Raises
        ------
        RecordingError
            If a sample is off the sensor, or a second signal.
        """
        kind = int(address[0] >> 10 & 3)
        x, up = address >> 12 & 0x3FF, address >> 22 & 0x1FF
        width, height = self._sensor
        if kind == _SECOND:
            raise self._damaged(f"second signal reads at {time_us[0]:,} us, of an old mode")
        if int(x.max()) >= width or int(up.max()) >= height:
            raise self._damaged(
                f"a frame sample at column {x.max()}, row {up.max()} from below, of a "
                f"{self._sensor} sensor"
            )
        pixel = (height - 1 - up) * width + x
        if kind == _RESET and self._read[_RESET, pixel].any():
            self._read[:] = False
        elif kind == _SIGNAL:  # without its reset a signal says nothing
            has_reset = self._read[_RESET, pixel]
            pixel, address, time_us = pixel[has_reset], address[has_reset], time_us[has_reset]
        self._value[kind, pixel] = address & 0x3FF
        self._time_us[kind, pixel] = time_us
        self._read[kind, pixel] = True

    def image(self) -> IntensityFrame:
        """Return the complete frame, and begin the next one."""
        self._read[:] = False
        light = np.maximum(self._value[_RESET] - self._value[_SIGNAL], 0) >> _DROPPED_BITS
        shape = self._sensor.height, self._sensor.width
        first_us = int(self._time_us.min())  # so that the sum is small
        middle_us = first_us + int((self._time_us - first_us).sum()) // self._time_us.size
        return IntensityFrame(middle_us, light.astype(np.uint8).reshape(shape))

    def _damaged(self, what: str) -> RecordingError:
        return RecordingError(f"{self._path} holds {what}: copy or record it again")


# Frames of AEDAT 3.1: a DAVIS's images as cAER recorded them (``frame.h`` of libcaer).


_HEAD = np.dtype(
    [("info", "<u4"), ("start", "<i4"), ("end", "<i4"), ("exposure_start", "<i4"),
     ("exposure_end", "<i4"), ("width", "<i4"), ("height", "<i4"), ("x", "<i4"), ("y", "<i4")]
)  # fmt: skip
#: grey, red-green-blue, and the same with alpha
_AEDAT3_CHANNELS = (1, 3, 4)


class Aedat3Frames:
    """Frames of one camera, in the middle of their exposure.

    Pixels have 16 bits, of which the upper 8 are kept. Frames that are marked as invalid are left
    out.
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
                    yield _aedat3_frame(packet, first, head)
                except ValueError as error:
                    raise self._file.damaged(packet.at, str(error)) from error


def _aedat3_frame(packet: Packet, first: int, head: np.void) -> IntensityFrame:
    channels = int(head["info"]) >> 1 & 7
    width, height = int(head["width"]), int(head["height"])
    if channels not in _AEDAT3_CHANNELS:
        raise ValueError(f"{channels} channels are neither grey, RGB nor RGBA")
    samples = _samples(width, height, channels)
    if _HEAD.itemsize + 2 * samples > packet.event_bytes:
        raise ValueError(
            f"{packet.event_bytes - _HEAD.itemsize:,} bytes for {width}x{height} pixels of "
            f"{2 * channels} bytes"
        )
    pixels = np.frombuffer(packet.data, "<u2", samples, first + _HEAD.itemsize) >> 8
    image = _grey(pixels.astype(np.uint8), width, height, blue_first=False)
    start, end = int(head["exposure_start"]), int(head["exposure_end"])
    return IntensityFrame(packet.origin_us + start + (end - start) // 2, image)


def _samples(width: int, height: int, channels: int) -> int:
    if not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE):
        raise ValueError(f"a frame of {width}x{height} pixels")
    return width * height * channels


def _grey(pixels: npt.NDArray[np.uint8], width: int, height: int, *, blue_first: bool) -> Image:
    shape = (height, width) if pixels.size == width * height else (height, width, -1)
    return to_grey(pixels.reshape(shape), blue_first)


# Frames of AEDAT 4: the intensity images that a DAVIS takes along with its events.


#: number of channels of each pixel format (8-bit formats of OpenCV): grey, BGR, BGRA
_AEDAT4_CHANNELS = {0: 1, 16: 3, 24: 4}
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
                frame = _aedat4_frame(data)
            except (ValueError, struct.error, IndexError) as error:
                raise self._file.damaged(at, error) from error
            if frame is None:
                raise RecordingError(
                    f"{self._file.path} has a frame without pixels at byte {at:,}: copy it again"
                )
            yield frame


def _aedat4_frame(data: bytes) -> IntensityFrame | None:
    table = root_table(data)

    def number(index: int, kind: str) -> int:
        at = field_at(data, table, index)
        return int(struct.unpack_from("<" + kind, data, at)[0]) if at else 0

    layout, width, height = number(_FORMAT, "b"), number(_WIDTH, "h"), number(_HEIGHT, "h")
    at = field_at(data, table, _PIXELS)
    if not at:
        return None
    if layout not in _AEDAT4_CHANNELS:
        raise ValueError(f"pixel format {layout} is not grey, BGR or BGRA of 8 bits")
    samples = _samples(width, height, _AEDAT4_CHANNELS[layout])
    vector = at + struct.unpack_from("<I", data, at)[0]
    (length,) = struct.unpack_from("<I", data, vector)
    if length != samples:
        channels = _AEDAT4_CHANNELS[layout]
        raise ValueError(f"{length:,} bytes for {width}x{height} pixels of {channels} bytes")
    pixels = np.frombuffer(data, np.uint8, length, vector + 4)
    image = _grey(pixels, width, height, blue_first=True)
    return IntensityFrame(number(_TIME, "q"), image)
