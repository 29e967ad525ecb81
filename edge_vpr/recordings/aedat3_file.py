"""The container of AEDAT 3.1, written by cAER: a text header, then packets of events of one type.

Numbers are little-endian (docs.inivation.com, "AEDAT 3.1"; ``common.h`` of libcaer). A packet
begins with 28 bytes: type and source (16 bits each), size of an event, position of the time in an
event, wraps of the 31-bit clock, capacity, number of events, number of valid ones (32 bits each).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor
from edge_vpr.recordings.aedat2 import chip_size
from edge_vpr.recordings.chosen_stream import Wording, choose_stream
from edge_vpr.recordings.decompression import LIMIT_BYTES
from edge_vpr.recordings.faults import FaultLog

#: types of packets
POLARITY, FRAME = 1, 2
_MAGIC = b"#!AER-DAT3.1\r\n"
_END = b"#!END-HEADER\r\n"
_CAMERAS = Wording("camera", "cameras", "copy it again")
_LONGEST_LINE, _LONGEST_HEADER = 1 << 16, 1 << 22
_HEADER = np.dtype(
    [("type", "<i2"), ("source", "<i2"), ("size", "<i4"), ("time_at", "<i4"), ("wraps", "<i4"),
     ("capacity", "<i4"), ("number", "<i4"), ("valid", "<i4")]
)  # fmt: skip


class Packet(NamedTuple):
    """Events of one packet.

    Attributes
    ----------
    at : int
        Byte of the file at which the packet begins.
    origin_us : int
        Is added to the 31-bit times of the events.
    event_bytes : int
        Bytes of one event.
    data : bytes
    """

    at: int
    origin_us: int
    event_bytes: int
    data: bytes


class Aedat3File:
    """Header and packets of a file.

    Attributes
    ----------
    path : Path
    sources : dict of int to str
        Cameras by their numbers.
    position : float
        Share of the file that has been read, 0 to 1.

    Raises
    ------
    RecordingError
        If the header is damaged, or the packets are compressed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._size = path.stat().st_size
        self.position = 0.0
        lines = self._read_header()
        self.sources = {
            int(match[1]): match[2].decode("ascii", "replace").strip()
            for line in lines
            if (match := re.match(rb"#Source (\d{1,5}): (.*)", line))
        }
        forms = [line[8:].strip() for line in lines if line.startswith(b"#Format:")]
        if forms != [b"RAW"]:
            form = (forms[0] if forms else b"none stated").decode("ascii", "replace")
            raise RecordingError(
                f"{path} is AEDAT 3.1 of format {form}, and only RAW is read: convert it with DV "
                "to AEDAT 4"
            )

    def sensor_of(self, source: int) -> Sensor | None:
        """Return the size of a camera's sensor; None if the camera is unknown."""
        return chip_size(self.sources.get(source, ""))

    def choose(self, wanted: str | None) -> int:
        """Return the number of the one camera, or of that which is wanted.

        Parameters
        ----------
        wanted : str, optional
            Name or number of the camera.

        Raises
        ------
        RecordingError
            If there is none.
        UsageError
            If there are several.
        """
        return choose_stream(self.path, self.sources, wanted, _CAMERAS)

    def packets(self, kind: int, source: int, log: FaultLog) -> Iterator[Packet]:
        """Yield the packets of one type and camera.

        Raises
        ------
        RecordingError
            If a packet is damaged, or the end is cut off (unless `log` allows that).
        """
        at = self._begin
        with self.path.open("rb") as file:
            file.seek(at)
            while at < self._size:
                head = file.read(_HEADER.itemsize)
                left = self._size - at
                if len(head) < _HEADER.itemsize:
                    log.truncated(left, f"byte {at:,}, within a packet")
                    return
                fields = np.frombuffer(head, _HEADER)[0]
                event_bytes, number = int(fields["size"]), int(fields["number"])
                if event_bytes <= 0 or number < 0 or fields["wraps"] < 0 or fields["type"] < 0:
                    raise self.damaged(
                        at,
                        f"{number} events of {event_bytes} bytes, type {fields['type']}, "
                        f"{fields['wraps']} wraps",
                    )
                length = event_bytes * number
                if _HEADER.itemsize + length > left:
                    log.truncated(left, f"byte {at:,}, within a packet")
                    return
                if (fields["type"], fields["source"]) == (kind, source):
                    if length > LIMIT_BYTES:
                        raise self.damaged(
                            at, f"it claims {length:,} bytes, and the most is {LIMIT_BYTES:,}"
                        )
                    origin_us = int(fields["wraps"]) << 31
                    yield Packet(at, origin_us, event_bytes, file.read(length))
                else:
                    file.seek(length, 1)
                at += _HEADER.itemsize + length
                self.position = at / self._size

    def damaged(self, at: int, why: str) -> RecordingError:
        """Return the error for a packet that cannot be read."""
        return RecordingError(
            f"{self.path} is damaged in the packet at byte {at:,} ({why}): copy it again"
        )

    def _read_header(self) -> list[bytes]:
        """Read the lines of the header, up to the one that ends it."""
        lines = []
        with self.path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise RecordingError(f"{self.path} is not AEDAT 3.1: check what recorded it")
            while (line := file.readline(_LONGEST_LINE)) != _END:
                if not line.startswith(b"#") or not line.endswith(b"\n"):
                    raise RecordingError(
                        f"{self.path} is damaged in its header at byte {file.tell() - len(line):,} "
                        "(no line #!END-HEADER): copy it again"
                    )
                if file.tell() > _LONGEST_HEADER:
                    raise RecordingError(
                        f"{self.path} is damaged: its header is longer than "
                        f"{_LONGEST_HEADER:,} bytes: copy it again"
                    )
                lines.append(line)
            self._begin = file.tell()
        return lines
