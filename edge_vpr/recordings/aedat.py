"""AEDAT: version 2 (jAER), version 3.1 (cAER) and version 4 (iniVation)."""

from __future__ import annotations

import re
import struct
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import RecordingError, UsageError, import_extra
from edge_vpr.events import Columns, Sensor
from edge_vpr.recordings.decoding import RecordFile, Unwrapper, is_text
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source, in_chunks

# AEDAT 2.0, written by jAER: pairs of a 32-bit address and a 32-bit time, big endian.
#
# The address layout depends on the chip (docs.inivation.com, "AEDAT 2.0"). jAER stores columns
# mirrored and rows from the lowest up, and mirrors the columns back when it reads: its extractors
# (``DavisBaseCamera.DavisEventExtractor``, ``DVS128.Extractor``) compute ``sizeX - 1 - column``.
# For the DVS128 the polarity bit of an ON event is 0. The cameras' drivers (libcaer, rpg_dvs_ros)
# undo the same mirroring, so that this reader gives the events as AEDAT 4 or a ROS bag of the same
# camera has them.
#
# The decoder is our own: eventcv loads these files whole, leaves the columns mirrored, refuses
# DVS128 files, and reads them as DAVIS files if a sensor size is given.


_AEDAT2_EVENT = np.dtype([("address", ">u4"), ("t", ">u4")])


class _Layout(NamedTuple):
    """Position of column, row and polarity in the address.

    `on` is the value of the polarity bit of an ON event; `other` has the bits of all other events.
    """

    x_shift: int
    x_mask: int
    y_shift: int
    y_mask: int
    p_bit: int
    on: int
    other: int


# bit 31 marks frames and IMU samples, bit 10 external edges; DVS128 marks these with bit 15
_DAVIS = _Layout(12, 0x3FF, 22, 0x1FF, 11, 1, 1 << 31 | 1 << 10)
_DVS128 = _Layout(1, 0x7F, 8, 0x7F, 0, 0, 1 << 15)

_DVS128_SIZE = Sensor(128, 128)
_CHIPS = {
    r"dvs128": _DVS128_SIZE,
    r"davis240": Sensor(240, 180),
    r"davis(rgb)?346": Sensor(346, 260),
    r"davis(rgb)?640": Sensor(640, 480),
    r"davis208": Sensor(208, 192),
    r"davis128": Sensor(128, 128),
}


def chip_size(name: str) -> Sensor | None:
    """Return the size of the sensor of a chip; None if the chip is unknown."""
    return next((size for chip, size in _CHIPS.items() if re.search(chip, name.lower())), None)


class Aedat2Source(Source):
    """Source of an AEDAT 2 file: header lines that begin with ``#``, then pairs.

    Columns and rows are turned so that pixel (0, 0) is the upper left one, as in all other sources.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._file = RecordFile(path, read_header)
        chip = self._file.header
        size = chip_size(chip)
        if size is None and chip:
            raise RecordingError(
                f"{path} was recorded by the chip {chip}, whose addresses are not known here: "
                "convert it with jAER or DV to AEDAT 4"
            )
        sensor = size or options.sensor or options.default.sensor
        if sensor not in _CHIPS.values():
            sensors = ", ".join(sorted({str(each) for each in _CHIPS.values()}))
            raise UsageError(
                f"{path} does not name the chip that recorded it: pass sensor=, one of {sensors}, "
                "of which 128x128 is a DVS128 and each other one a DAVIS"
            )
        # without a name, 128x128 is the older and far more common chip
        self._layout = _DAVIS if "davis" in chip.lower() or sensor != _DVS128_SIZE else _DVS128
        super().__init__(path, options, size)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events; see :class:`Source`."""
        layout = self._layout
        assert self.sensor is not None  # of a chip
        right, top = self.sensor.width - 1, self.sensor.height - 1
        clock, n = Unwrapper(32), self.options.chunk_events
        for pairs, position in self._file.blocks(_AEDAT2_EVENT, n, log):
            self.position = position
            address, t = pairs["address"].astype(np.int64), clock.unwrap(pairs["t"])
            change = address & layout.other == 0
            address, t = address[change], t[change]
            yield Columns(
                t,
                right - (address >> layout.x_shift & layout.x_mask),
                top - (address >> layout.y_shift & layout.y_mask),
                (address >> layout.p_bit & 1) == layout.on,
            )


def read_header(file: BinaryIO) -> tuple[str, int]:
    """Return the chip that the header names, "" if it names none, and the length of the header."""
    n, chip = 0, ""
    # data may begin with the byte of "#", too
    while (line := file.readline(1 << 16)).startswith(b"#") and is_text(line):
        n += len(line)
        if match := re.match(rb"#\s*AEChip:\s*(\S+)", line):
            chip = match[1].decode("ascii", "replace")
        if line.startswith((b"# End Of ASCII", b"#End Of ASCII")):
            break
    return chip, n


#: Most bytes of one packet, which an AEDAT 4 packet may expand to as well.
LIMIT_BYTES = 1 << 26

# Choice of one of the streams of a file, by its name or its number.


def choose_stream(
    path: Path, names: Mapping[int, str], wanted: str | None, what: str, remedy: str
) -> int:
    """Return the number of the one stream, or of that which is wanted.

    Parameters
    ----------
    names : mapping of int to str
        Names of the streams by their numbers.
    wanted : str, optional
        Name or number of the stream.
    what, remedy : str
        What messages call a stream, and what to do if there is none.

    Raises
    ------
    RecordingError
        If there is none.
    UsageError
        If there are several.
    """
    numbers = [number for number, name in names.items() if wanted in (None, name, str(number))]
    listed = ", ".join(f"{number} ({name})" for number, name in names.items()) or "none"
    if not numbers:
        raise RecordingError(
            f"{path} has no {what}{f' {wanted!r}' if wanted else ''}; it has: {listed}: {remedy}, "
            "or choose one of these with topic="
        )
    if len(numbers) > 1:
        raise UsageError(f"{path} has several {what}s, {listed}: choose with topic=")
    return numbers[0]


# The container of AEDAT 3.1, written by cAER: a text header, then packets of events of one type.
#
# Numbers are little-endian (docs.inivation.com, "AEDAT 3.1"; ``common.h`` of libcaer). A packet
# begins with 28 bytes: type and source (16 bits each), size of an event, position of the time in an
# event, wraps of the 31-bit clock, capacity, number of events, number of valid ones (32 bits each).


#: type of the packets of polarity events
_POLARITY = 1
_AEDAT3_MAGIC = b"#!AER-DAT3.1\r\n"
_END = b"#!END-HEADER\r\n"
_LONGEST_LINE, _LONGEST_AEDAT3_HEADER = 1 << 16, 1 << 22
_HEADER = np.dtype(
    [("type", "<i2"), ("source", "<i2"), ("size", "<i4"), ("time_at", "<i4"), ("wraps", "<i4"),
     ("capacity", "<i4"), ("number", "<i4"), ("valid", "<i4")]
)  # fmt: skip


def _damaged(path: Path, at: int, why: object) -> RecordingError:
    """Return the error for a packet that cannot be read."""
    return RecordingError(f"{path} is damaged in the packet at byte {at:,} ({why}): copy it again")


# Polarity events of AEDAT 3.1; column 0, row 0 is the upper left pixel (``polarity.h``).


_AEDAT3_EVENT = np.dtype([("data", "<u4"), ("t", "<i4")])


class Aedat3Source(Source):
    """Source of the events of one camera; times are those of its clock.

    The 32 bits of an event are column, row (15 bits each), polarity and validity. Events that the
    recorder's filters marked as invalid are left out.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        lines, self._start = _read_lines(path)
        cameras = {
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
        self._size = path.stat().st_size
        self._camera = choose_stream(path, cameras, options.topic, "camera", "copy it again")
        super().__init__(path, options, chip_size(cameras[self._camera]))

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a packet at a time; see :class:`Source`."""
        for origin_us, packet in self._packets(log):
            events = np.frombuffer(packet, _AEDAT3_EVENT)
            events = events[events["data"] & 1 == 1]
            t, data = events["t"].astype(np.int64) + origin_us, events["data"]
            columns = Columns(t, data >> 17, data >> 2 & 0x7FFF, data & 2 == 2)
            yield from in_chunks(columns, self.options.chunk_events)

    def _packets(self, log: FaultLog) -> Iterator[tuple[int, bytes]]:
        """Yield the camera's packets of polarity events: what to add to their times, and events."""
        at = self._start
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
                    raise _damaged(
                        self.path,
                        at,
                        f"{number} events of {event_bytes} bytes, type {fields['type']}, "
                        f"{fields['wraps']} wraps",
                    )
                length = event_bytes * number
                if _HEADER.itemsize + length > left:
                    log.truncated(left, f"byte {at:,}, within a packet")
                    return
                if (fields["type"], fields["source"]) == (_POLARITY, self._camera):
                    if length > LIMIT_BYTES:
                        raise _damaged(
                            self.path, at, f"it claims {length:,} bytes, of {LIMIT_BYTES:,} at most"
                        )
                    if event_bytes != _AEDAT3_EVENT.itemsize:
                        raise _damaged(self.path, at, f"events of {event_bytes} bytes")
                    yield int(fields["wraps"]) << 31, file.read(length)
                else:
                    file.seek(length, 1)
                at += _HEADER.itemsize + length
                self.position = at / self._size


def _read_lines(path: Path) -> tuple[list[bytes], int]:
    """Return the lines of the header, up to the one that ends it, and where the packets begin."""
    lines = []
    with path.open("rb") as file:
        if file.read(len(_AEDAT3_MAGIC)) != _AEDAT3_MAGIC:
            raise RecordingError(f"{path} is not AEDAT 3.1: check what recorded it")
        while (line := file.readline(_LONGEST_LINE)) != _END:
            if not line.startswith(b"#") or not line.endswith(b"\n"):
                raise RecordingError(
                    f"{path} is damaged in its header at byte {file.tell() - len(line):,} "
                    "(no line #!END-HEADER): copy it again"
                )
            if file.tell() > _LONGEST_AEDAT3_HEADER:
                raise RecordingError(
                    f"{path} is damaged: its header is longer than "
                    f"{_LONGEST_AEDAT3_HEADER:,} bytes: copy it again"
                )
            lines.append(line)
        return lines, file.tell()


# The container of AEDAT 4: compressed packets of FlatBuffers, each of one stream.
#
# This is our own code for the tables that matter, over lz4 and zstd: eventcv finds no events in
# real files of this format, and the package aedat has no wheel for aarch64. faery 0.7.1 gives the
# same events, but no AEDAT 2 or 3.1. It reserves what a packet claims (2 GB for a file of 0.4 MB),
# and of 1,500 damaged files it panicked at 40 and ended the process at 2. It is slower, too: by
# 11 % with ZSTD, by 15 % with LZ4, and by half without compression.


_AEDAT4_MAGIC = b"#!AER-DAT4.0\r\n"
_LONGEST_AEDAT4_HEADER = 1 << 22


class Stream(NamedTuple):
    """One stream of a file."""

    kind: str  #: Four letters: ``EVTS`` for events.
    name: str
    sensor: Sensor | None  #: None if the file does not state it.


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
        states_size = {"sizeX", "sizeY"} <= size.keys()
        sensor = Sensor(int(size["sizeX"]), int(size["sizeY"])) if states_size else None
        number = int(node.get("name", ""))
        name = facts.get("originalOutputName", str(number))
        streams[number] = Stream(facts.get("typeIdentifier", ""), name, sensor)
    return streams


# Decompression with a limit: a few bytes cannot become gigabytes of memory.


#: Bytes that are expanded at a time.
PIECE_BYTES = 1 << 20


def _decompressor(kind: int, path: Path) -> Callable[[bytes], bytes]:
    """Return a function that decompresses LZ4 or Zstandard frames, or bytes as they are."""
    if kind == 0:
        return bytes
    if kind in (1, 2):
        frame = import_extra("lz4.frame", f"{path} (AEDAT 4), LZ4", "lz4", "aedat4")
        return lambda data: expand(frame.LZ4FrameDecompressor, data, (RuntimeError, EOFError))
    if kind in (3, 4):
        package = "compression" if sys.version_info >= (3, 14) else "backports"
        what = f"{path} (AEDAT 4), ZSTD"
        library = import_extra(f"{package}.zstd", what, "backports.zstd", "aedat4")
        errors = (library.ZstdError, EOFError)
        return lambda data: expand(library.ZstdDecompressor, data, errors)
    raise RecordingError(f"{path} has the unknown compression {kind}: record with LZ4 or ZSTD")


def expand(new: Callable[[], Any], data: bytes, errors: tuple[type[Exception], ...]) -> bytes:
    """Decompress one or more frames, and stop at `LIMIT_BYTES`.

    Parameters
    ----------
    new : callable
        Function that makes a decompressor with the interface of :class:`bz2.BZ2Decompressor`.
    errors : tuple of exception types
        Exceptions that the decompressor raises for damaged data.

    Raises
    ------
    ValueError
        If the data is damaged, cut off, or expands to more than the limit.
    """
    parts, size, rest = list[bytes](), 0, data
    while rest:
        frame = new()
        while not frame.eof:
            if frame.needs_input and not rest:
                raise ValueError("the compressed data is cut off")
            try:
                part = frame.decompress(rest, max_length=min(PIECE_BYTES, LIMIT_BYTES + 1 - size))
            except errors as error:
                raise ValueError(str(error)) from error
            rest = b""  # the decompressor keeps the bytes that it has not used
            size += len(part)
            if size > LIMIT_BYTES:
                raise ValueError(f"it expands to more than {LIMIT_BYTES:,} bytes")
            if not (part or frame.eof or frame.needs_input):
                raise ValueError("the compressed data gives nothing")
            parts.append(part)
        rest = frame.unused_data
    return b"".join(parts)


# Events of AEDAT 4, written by iniVation's DV.


_AEDAT4_EVENT = np.dtype(
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
        with path.open("rb") as file:
            if file.read(len(_AEDAT4_MAGIC)) != _AEDAT4_MAGIC:
                raise RecordingError(f"{path} is not AEDAT 4.0: check what recorded it")
            size = file.read(4)
            length = int.from_bytes(size, "little")
            if length > min(path.stat().st_size, _LONGEST_AEDAT4_HEADER):
                raise RecordingError(
                    f"{path} is damaged: its header claims {length:,} bytes: copy it again"
                )
            header = size + file.read(length)
            self._start = file.tell()
        try:
            compression, table, info = _io_header(header)
            streams = _streams(info)
        except (struct.error, IndexError, ValueError, ElementTree.ParseError) as error:
            raise RecordingError(
                f"{path} is damaged or cut off in its header ({error}): copy it again"
            ) from error
        file_size = path.stat().st_size
        # the table of packets follows the packets; it is absent if the recorder was killed
        self._end = table if self._start <= table <= file_size else file_size
        self._decompress = _decompressor(compression, path)
        names = {number: each.name for number, each in streams.items() if each.kind == "EVTS"}
        self._stream = choose_stream(path, names, options.topic, "event stream", "record events")
        super().__init__(path, options, streams[self._stream].sensor)

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a packet at a time; see :class:`Source`."""
        for at, packet in self._packets(log):
            try:
                events = _events(self._decompress(packet))
            except (RuntimeError, ValueError, struct.error, IndexError) as error:
                raise _damaged(self.path, at, error) from error
            columns = Columns(events["t"], events["x"], events["y"], events["p"] != 0)
            yield from in_chunks(columns, self.options.chunk_events)

    def _packets(self, log: FaultLog) -> Iterator[tuple[int, bytes]]:
        """Yield the packets of the stream: the byte at which each begins, and what follows it."""
        at = self._start
        with self.path.open("rb") as file:
            file.seek(at)
            while at < self._end:
                header = file.read(8)
                stream, size = struct.unpack("<ii", header) if len(header) == 8 else (0, 0)
                if len(header) < 8 or at + 8 + size > self._end or size < 0:
                    log.truncated(self._end - at, f"byte {at:,}, within a packet")
                    return
                if stream == self._stream:
                    if size > LIMIT_BYTES:
                        raise _damaged(
                            self.path, at, f"it claims {size:,} bytes, of {LIMIT_BYTES:,} at most"
                        )
                    yield at, file.read(size)
                else:
                    file.seek(size, 1)
                at += 8 + size
                self.position = at / self._end


def _events(data: bytes) -> npt.NDArray[np.void]:
    """Return the events of one packet: the vector in the first field of its table."""
    field = field_at(data, root_table(data), 0)
    if not field:
        return np.empty(0, _AEDAT4_EVENT)
    vector = field + struct.unpack_from("<I", data, field)[0]
    (length,) = struct.unpack_from("<I", data, vector)
    return np.frombuffer(data, _AEDAT4_EVENT, length, vector + 4)
