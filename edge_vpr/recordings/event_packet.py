"""The ROS messages that carry events, decoded from their serialised bytes.

``dvs_msgs/EventArray`` (ROS 1 and 2) has one structure for each event.
``event_camera_msgs/EventPacket`` has the camera's own words, in the encodings ``evt3`` (Prophesee),
``libcaer``, ``libcaer_cmp`` (iniVation) and ``mono`` (one event a word, written by
event_camera_tools). Neither eventcv nor rosbags decodes these messages.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError
from edge_vpr.recordings.clock import Unwrapper
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.evt import Decoder
from edge_vpr.recordings.libcaer_cmp import LibcaerCmpDecoder


class Cursor:
    """Read the fields of one serialised message, one after another.

    Parameters
    ----------
    data : bytes
    ros : {1, 2}
        ROS 1 packs fields without gaps, ROS 2 (CDR) aligns each to its size.
    """

    def __init__(self, data: bytes, ros: int) -> None:
        self._data = memoryview(data)
        self._aligned = ros == 2
        self._at = 0
        self.order = "<"
        if self._aligned:
            self.order = "<" if data[1] & 1 else ">"
            self._data = self._data[4:]

    def number(self, kind: str) -> int:
        """Read one integer; `kind` is its format character of :mod:`struct`."""
        size = struct.calcsize(kind)
        if self._aligned:
            self._at += -self._at % size
        (value,) = struct.unpack_from(self.order + kind, self._data, self._at)
        self._at += size
        return int(value)

    def text(self) -> str:
        """Read a string."""
        return bytes(self.octets()).rstrip(b"\0").decode("utf-8", "replace")

    def octets(self) -> memoryview:
        """Read a sequence of bytes."""
        length = self.number("I")
        octets = self._data[self._at : self._at + length]
        if len(octets) < length:
            raise struct.error(f"{length:,} bytes announced, {len(octets):,} there")
        self._at += length
        return octets

    def rest(self) -> memoryview:
        """Return all remaining bytes."""
        return self._data[self._at :]


class Preamble(NamedTuple):
    """Common first fields of all messages of events."""

    stamp_us: int
    height: int
    width: int


def read_preamble(cursor: Cursor, ros: int) -> Preamble:
    """Read header, height and width."""
    if ros == 1:
        cursor.number("I")  # sequence number
    seconds, nanoseconds = cursor.number("I"), cursor.number("I")
    cursor.text()  # frame
    height, width = cursor.number("I"), cursor.number("I")
    return Preamble(seconds * 1_000_000 + nanoseconds // 1_000, height, width)


def read_event_array(cursor: Cursor, ros: int) -> Columns:
    """Read the events of ``dvs_msgs/EventArray``; times are wall-clock microseconds.

    In CDR, the column of the next event (2-byte aligned) directly follows the 13 bytes of an event.
    In strides of 16 bytes, event i + 1 therefore has its column in the last 2 bytes of one stride,
    its row in the first 2 bytes of the next, and its other fields where event 0 has them.
    """
    n = cursor.number("I")
    stride = 13 if ros == 1 else 16
    data = bytes(cursor.rest())
    needed = stride * (n - 1) + 13 if n else 0
    if len(data) < needed:
        raise struct.error(f"{n:,} events announced in {len(data):,} bytes")
    rows = np.frombuffer(data[:needed].ljust(stride * n, b"\0"), np.uint8).reshape(n, stride)

    def column(offset: int, kind: str) -> npt.NDArray[np.int64]:
        size = struct.calcsize(kind)
        octets = np.ascontiguousarray(rows[:, offset : offset + size])
        values = octets.view(np.dtype(cursor.order + kind)).reshape(n)
        return values.astype(np.int64)

    t = column(4, "I") * 1_000_000 + column(8, "I") // 1_000
    if ros == 1 or n == 0:
        return Columns(t, column(0, "H"), column(2, "H"), rows[:, 12] > 0)
    x, y = column(0, "H"), column(0, "H")
    y[0] = column(2, "H")[0]
    x[1:] = column(14, "H")[:-1]
    return Columns(t, x, y, rows[:, 12] > 0)


class PacketDecoder:
    """Decode the packets of one camera; clock and decoder state carry over between packets."""

    def __init__(self) -> None:
        self._evt3 = Decoder("evt3", 1 << 14)
        self._clock = Unwrapper(31)
        self._compressed = LibcaerCmpDecoder()

    def take_undated(self) -> int:
        """Return the number of events before the first time word, since the last call."""
        return self._evt3.take_undated()

    def read(self, cursor: Cursor) -> Columns:
        """Read the rest of ``event_camera_msgs/EventPacket``; times are on the camera's clock.

        Times of ``libcaer_cmp`` and ``mono`` count from the packet's time base.

        Raises
        ------
        RecordingError
            If this decoder does not know the encoding.
        """
        cursor.number("Q")  # sequence number
        base_ns = cursor.number("Q")  # time 0 of the sensor
        encoding = cursor.text()
        big = bool(cursor.number("B"))
        payload = cursor.octets()
        if encoding == "evt3" and not big:
            return self._evt3.decode(np.frombuffer(payload, "<u2", len(payload) // 2))
        if encoding == "libcaer" and not big:
            return self._libcaer(np.frombuffer(payload, "<u4", len(payload) // 8 * 2))
        if encoding == "libcaer_cmp" and not big:
            words = np.frombuffer(payload, "<u2", len(payload) // 2)
            return self._compressed.decode(words, base_ns // 1_000)
        if encoding == "mono" and not big:
            return _mono(np.frombuffer(payload, "<u8", len(payload) // 8), base_ns)
        raise RecordingError(
            f"event packets of encoding {encoding!r}{' (big endian)' if big else ''} are not "
            "decoded: known are evt3, libcaer, libcaer_cmp and mono; convert the bag with "
            "event_camera_tools"
        )

    def _libcaer(self, words: npt.NDArray[np.uint32]) -> Columns:
        """Decode pairs: column, row, polarity, validity in 15, 15, 1, 1 bits, then 31 bits time."""
        pairs = words.reshape(-1, 2)
        data = pairs[:, 0]
        t = self._clock.unwrap(pairs[:, 1])
        valid = (data & 1) == 1
        data, t = data[valid], t[valid]
        return Columns(t, data >> 17, data >> 2 & 0x7FFF, (data & 2) == 2)


def _mono(words: npt.NDArray[np.uint64], base_ns: int) -> Columns:
    """Decode nanoseconds from the time base, column, row, polarity in 32, 16, 15, 1 bits."""
    # a base beyond 2**62 ns (the year 2116) is invalid; the sum below must not wrap
    since = (words & np.uint64(0xFFFFFFFF)).astype(np.int64)
    t = (since + min(base_ns, 1 << 62)) // 1_000
    x = (words >> np.uint64(32) & np.uint64(0xFFFF)).astype(np.uint16)
    y = (words >> np.uint64(48) & np.uint64(0x7FFF)).astype(np.uint16)
    return Columns(t, x, y, words >> np.uint64(63) == 1)
