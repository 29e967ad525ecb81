"""The container of AEDAT 4: compressed packets of FlatBuffers, each of one stream.

This is our own code for the tables that matter, over lz4 and zstd: eventcv finds no events in real
files of this format, and the package aedat has no wheel for aarch64.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from edge_vpr.errors import RecordingError
from edge_vpr.events import Sensor
from edge_vpr.recordings.chosen_stream import Wording, choose_stream
from edge_vpr.recordings.decompression import LIMIT_BYTES, lz4, zstd
from edge_vpr.recordings.faults import FaultLog

_MAGIC = b"#!AER-DAT4.0\r\n"
_LONGEST_HEADER = 1 << 22


class Stream(NamedTuple):
    """One stream of a file.

    Attributes
    ----------
    kind : str
        Four letters: ``EVTS`` for events, ``FRME`` for frames.
    name : str
    sensor : Sensor or None
        None if the file does not state it.
    """

    kind: str
    name: str
    sensor: Sensor | None


class Aedat4File:
    """Header and packets of a file.

    Attributes
    ----------
    path : Path
    streams : dict of int to Stream
    position : float
        Share of the file that has been read, 0 to 1.

    Raises
    ------
    RecordingError
        If the file is of another format, or damaged in its header.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
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
            compression, table, info = _io_header(header)
            self.streams = _streams(info)
        except (struct.error, IndexError, ValueError, ElementTree.ParseError) as error:
            raise RecordingError(
                f"{path} is damaged or cut off in its header ({error}): copy it again"
            ) from error
        file_size = path.stat().st_size
        # the table of packets follows the packets; it is absent if the recorder was killed
        self._end = table if self._begin <= table <= file_size else file_size
        self._decompress = _decompressor(compression, path)
        self.position = 0.0

    def choose(self, kind: str, what: str, wanted: str | None) -> int:
        """Return the number of the one stream of a kind.

        Parameters
        ----------
        kind : str
        what : str
            Content of such streams, for messages: ``"events"``.
        wanted : str, optional
            Name or number of the stream to choose.

        Raises
        ------
        RecordingError
            If there is none.
        UsageError
            If there are several.
        """
        names = {number: each.name for number, each in self.streams.items() if each.kind == kind}
        wording = Wording(f"stream of {what}", f"streams of {what}", f"record {what}")
        return choose_stream(self.path, names, wanted, wording)

    def packets(self, stream: int, log: FaultLog) -> Iterator[tuple[int, bytes]]:
        """Yield the packets of a stream: the byte at which each begins, and its table.

        Raises
        ------
        RecordingError
            If a packet is damaged, or the end is cut off (unless `log` allows that).
        """
        with self.path.open("rb") as file:
            file.seek(self._begin)
            for at, packet in self._compressed(file, stream, log):
                try:
                    data = self._decompress(packet)
                except (RuntimeError, ValueError) as error:
                    raise self.damaged(at, error) from error
                yield at, data

    def damaged(self, at: int, error: Exception) -> RecordingError:
        """Return the error for a packet that cannot be read."""
        return RecordingError(
            f"{self.path} is damaged in the packet at byte {at:,} ({error}): copy it again"
        )

    def _compressed(
        self, file: IO[bytes], wanted: int, log: FaultLog
    ) -> Iterator[tuple[int, bytes]]:
        at = self._begin
        while at < self._end:
            header = file.read(8)
            stream, size = struct.unpack("<ii", header) if len(header) == 8 else (0, 0)
            if len(header) < 8 or at + 8 + size > self._end or size < 0:
                log.truncated(self._end - at, f"byte {at:,}, within a packet")
                return
            if stream == wanted:
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
    """Return the compression, the position of the packet table, and the streams' description."""
    table = root_table(data)
    compression, position, text = (field_at(data, table, i) for i in range(3))
    kind = struct.unpack_from("<i", data, compression)[0] if compression else 0
    end = struct.unpack_from("<q", data, position)[0] if position else -1
    start = text + struct.unpack_from("<I", data, text)[0]
    (length,) = struct.unpack_from("<I", data, start)
    return kind, end, data[start + 4 : start + 4 + length].decode("utf-8")


def root_table(data: bytes) -> int:
    """Return the position of the root table of a FlatBuffer that begins with its size."""
    return 4 + int(struct.unpack_from("<I", data, 4)[0])


def field_at(data: bytes, table: int, index: int) -> int:
    """Return the position of a field of a FlatBuffers table; 0 if it has its default value."""
    vtable = table - struct.unpack_from("<i", data, table)[0]
    (size,) = struct.unpack_from("<H", data, vtable)
    if 4 + 2 * index >= size:
        return 0
    (offset,) = struct.unpack_from("<H", data, vtable + 4 + 2 * index)
    return table + offset if offset else 0


def _streams(info: str) -> dict[int, Stream]:
    """Read the description of the streams."""
    if "<!" in info:  # entities, which may expand without limit; DV writes none
        raise ValueError("its XML has declarations")
    streams = {}
    for node in ElementTree.fromstring(info).iterfind("./node[@name='outInfo']/node"):
        facts = {attr.get("key"): attr.text or "" for attr in node.iterfind("attr")}
        size = {a.get("key"): a.text or "" for a in node.iterfind("./node[@name='info']/attr")}
        known = {"sizeX", "sizeY"} <= size.keys()
        sensor = Sensor(int(size["sizeX"]), int(size["sizeY"])) if known else None
        number = int(node.get("name", ""))
        name = facts.get("originalOutputName", str(number))
        streams[number] = Stream(facts.get("typeIdentifier", ""), name, sensor)
    return streams


def _decompressor(kind: int, path: Path) -> Callable[[bytes], bytes]:
    what = f"{path} (AEDAT 4)"
    if kind == 0:
        return bytes
    if kind in (1, 2):
        return lz4(what, "aedat4")
    if kind in (3, 4):
        return zstd(what, "aedat4")
    raise RecordingError(f"{path} has the unknown compression {kind}: record with LZ4 or ZSTD")
