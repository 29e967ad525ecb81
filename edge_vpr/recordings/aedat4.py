"""AEDAT 4, written by iniVation's DV: compressed packets of FlatBuffers.

Own code for the two tables that matter, over lz4 and zstd: eventcv finds no events in real
files of this format, and the package aedat has no wheel for aarch64.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.decompression import LIMIT_BYTES, lz4, zstd
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import Columns, ReadOptions, Source

_MAGIC = b"#!AER-DAT4.0\r\n"
_LONGEST_HEADER = 1 << 22
_EVENT = np.dtype(
    {
        "names": ["t", "x", "y", "p"],
        "formats": ["<i8", "<i2", "<i2", "u1"],
        "offsets": [0, 8, 10, 12],
        "itemsize": 16,
    }
)


class Aedat4Source(Source):
    """The packets of one stream of events; times are microseconds since 1970."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise RecordingError(f"{path} is not AEDAT 4.0: check what recorded it")
            size = file.read(4)
            length = int.from_bytes(size, "little")
            if length > min(path.stat().st_size, _LONGEST_HEADER):
                raise RecordingError(
                    f"{path} is damaged: its header claims {length:,} bytes: copy it again"
                )
            header = size + file.read(length)
            self._begin = file.tell()
        try:
            self._compression, table, info = _io_header(header)
            streams = _event_streams(info)
        except (struct.error, IndexError, ValueError, ElementTree.ParseError) as error:
            raise RecordingError(
                f"{path} is damaged or cut off in its header ({error}): copy it again"
            ) from error
        file_size = path.stat().st_size
        # the table of packets follows them; it is absent if the recorder was killed
        self._end = table if self._begin <= table <= file_size else file_size
        self._decompress = _decompressor(self._compression, path)
        self._stream, sensor = _choose(streams, options.topic, path)
        super().__init__(path, options, sensor)
        self.position = 0.0

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a packet at a time; see :class:`Source`."""
        with self.path.open("rb") as file:
            file.seek(self._begin)
            for at, packet in self._packets(file, log):
                try:
                    events = _events(self._decompress(packet))
                except (RuntimeError, ValueError, struct.error, IndexError) as error:
                    raise RecordingError(
                        f"{self.path} is damaged in the packet at byte {at:,} ({error}): "
                        "copy it again"
                    ) from error
                for i in range(0, len(events), self.options.chunk_events):
                    part = events[i : i + self.options.chunk_events]
                    yield Columns(part["t"], part["x"], part["y"], part["p"] != 0)

    def _packets(self, file: IO[bytes], log: FaultLog) -> Iterator[tuple[int, bytes]]:
        at = self._begin
        while at < self._end:
            header = file.read(8)
            stream, size = struct.unpack("<ii", header) if len(header) == 8 else (0, 0)
            if len(header) < 8 or at + 8 + size > self._end or size < 0:
                log.truncated(self._end - at, f"byte {at:,}, within a packet")
                return
            if stream == self._stream:
                if size > LIMIT_BYTES:
                    raise RecordingError(
                        f"{self.path} is damaged: the packet at byte {at:,} claims {size:,} bytes, "
                        f"and the most is {LIMIT_BYTES:,}: copy it again"
                    )
                yield at, file.read(size)
            else:
                file.seek(size, 1)
            at += 8 + size
            self.position = at / self._end


def _io_header(data: bytes) -> tuple[int, int, str]:
    """Compression, position of the table of packets, and the description of the streams."""
    table = _root(data)
    compression, position, text = (_field(data, table, i) for i in range(3))
    kind = struct.unpack_from("<i", data, compression)[0] if compression else 0
    end = struct.unpack_from("<q", data, position)[0] if position else -1
    start = text + struct.unpack_from("<I", data, text)[0]
    (length,) = struct.unpack_from("<I", data, start)
    return kind, end, data[start + 4 : start + 4 + length].decode("utf-8")


def _events(data: bytes) -> npt.NDArray[np.void]:
    """Events of one packet: the vector in the first field of its table."""
    field = _field(data, _root(data), 0)
    if not field:
        return np.empty(0, _EVENT)
    vector = field + struct.unpack_from("<I", data, field)[0]
    (length,) = struct.unpack_from("<I", data, vector)
    return np.frombuffer(data, _EVENT, length, vector + 4)


def _root(data: bytes) -> int:
    """Where the root table of a FlatBuffer lies that begins with its size."""
    return 4 + int(struct.unpack_from("<I", data, 4)[0])


def _field(data: bytes, table: int, index: int) -> int:
    """Where a field of a FlatBuffers table lies; 0 if it has its default value."""
    vtable = table - struct.unpack_from("<i", data, table)[0]
    (size,) = struct.unpack_from("<H", data, vtable)
    if 4 + 2 * index >= size:
        return 0
    (offset,) = struct.unpack_from("<H", data, vtable + 4 + 2 * index)
    return table + offset if offset else 0


def _event_streams(info: str) -> dict[int, tuple[str, Sensor | None]]:
    """Name and sensor of each stream of events."""
    if "<!" in info:  # entities, which may expand without end; DV writes none
        raise ValueError("its XML has declarations")
    streams = {}
    for node in ElementTree.fromstring(info).iterfind("./node[@name='outInfo']/node"):
        facts = {attr.get("key"): attr.text or "" for attr in node.iterfind("attr")}
        if facts.get("typeIdentifier") == "EVTS":
            size = {a.get("key"): a.text or "" for a in node.iterfind("./node[@name='info']/attr")}
            known = {"sizeX", "sizeY"} <= size.keys()
            sensor = Sensor(int(size["sizeX"]), int(size["sizeY"])) if known else None
            number = int(node.get("name", ""))
            streams[number] = (facts.get("originalOutputName", str(number)), sensor)
    return streams


def _choose(
    streams: dict[int, tuple[str, Sensor | None]], wanted: str | None, path: Path
) -> tuple[int, Sensor | None]:
    found = {
        number: sensor
        for number, (name, sensor) in streams.items()
        if wanted in (None, name, str(number))
    }
    listed = ", ".join(f"{number} ({name})" for number, (name, _) in streams.items()) or "none"
    if not found:
        raise RecordingError(
            f"{path} has no stream of events"
            + (f" {wanted!r}" if wanted else "")
            + f"; it has: {listed}: record events, or choose one of these with --topic"
        )
    if len(found) > 1:
        raise UsageError(f"{path} has several streams of events, {listed}: choose with --topic")
    return next(iter(found.items()))


def _decompressor(kind: int, path: Path) -> Callable[[bytes], bytes]:
    what = f"{path} (AEDAT 4)"
    if kind == 0:
        return bytes
    if kind in (1, 2):
        return lz4(what, "aedat4")
    if kind in (3, 4):
        return zstd(what, "aedat4")
    raise RecordingError(f"{path} has the unknown compression {kind}: record with LZ4 or ZSTD")


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open an AEDAT 4 file."""
    return Aedat4Source(path, options)
