"""Small files of camera formats, written for tests word by word, and plain decoders of them.

Nothing here is imported from the readers: the two state the formats independently.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

Event = tuple[int, int, int, bool]
EVT_WORDS = {"evt2": "<u4", "evt21": "<u8", "evt3": "<u2"}


class PlainDecoder:
    """The meaning of EVT words, one after another."""

    def __init__(self, encoding):
        self.encoding, self.undated = encoding, 0
        self.base = self.stride = self.polarity = 0
        self.before = -1
        self.lose()

    def lose(self):
        self.high = self.low = self.row = self.first = -1

    def decode(self, words):
        step = self._evt3 if self.encoding == "evt3" else self._evt2
        return [event for word in words.tolist() for event in step(word)]

    def _evt2(self, word):
        columns = [0]
        if self.encoding == "evt21":
            columns = [bit for bit in range(32) if word >> bit & 1]
            word >>= 32
        kind = word >> 28
        if kind == 8:
            high = word & 0xFFFFFFF
            step = (high - self.before + (1 << 27)) % (1 << 28) - (1 << 27)
            self.base = high if self.before < 0 else self.base + step
            self.high = self.before = high
        if kind > 1 or self.high < 0:
            self.undated += len(columns) * (kind < 2)
            return []
        time, x, y = self.base * 64 + (word >> 22 & 63), word >> 11 & 2047, word & 2047
        return [(time, x + column, y, kind == 1) for column in columns]

    def _evt3(self, word):
        kind, value = word >> 12, word & 4095
        events, x = [], value & 2047
        if kind == 0:
            self.row = value & 2047
        elif kind == 2:
            events = [(x, value > 2047)]
        elif kind == 3:
            self.first, self.polarity = x, value > 2047
        elif kind in (4, 5):
            width = 12 if kind == 4 else 8
            on = [bit for bit in range(width) if value >> bit & 1]
            events = [(self.first + bit, self.polarity) for bit in on]
            if self.first < 0:
                self.undated += len(events)
                return []
            self.first = min(self.first + width, 2048)
        elif kind == 6 and self.high >= 0:
            self.low = value
        elif kind == 8 and value != self.high:
            self._turn(value)
            self.high = self.before = value
            self.low = min(self.low, 0)
        if self.high < 0 or self.low < 0 or self.row < 0:
            self.undated += len(events)
            return []
        return [(self.base * 4096 + self.low, x, self.row, bool(p)) for x, p in events]

    def _turn(self, high):
        if self.before < 0:
            self.base, self.stride = high, 1024
            return
        step = high - self.before
        if step >= 4086:
            step -= 4096
        elif step <= max(10, 2 * self.stride) - 4096:
            step += 4096
        self.base += step
        step = min(step, 2 * self.stride + 16, 1024)
        self.stride = max(step, self.stride - (self.stride + 15) // 16)


def encode_evt3(events: list[Event], vectors: bool = False) -> bytes:
    """Words for events; with `vectors`, each event is a vector of one column."""
    words, high, low, row = [], None, None, None
    for t, x, y, p in events:
        if t >> 12 & 4095 != high:
            high, low = t >> 12 & 4095, None
            words.append(8 << 12 | high)
        if t & 4095 != low:
            low = t & 4095
            words.append(6 << 12 | low)
        if y != row:
            row = y
            words.append(y)
        if vectors:
            words += [3 << 12 | p << 11 | x, 4 << 12 | 1]
        else:
            words.append(2 << 12 | p << 11 | x)
    return struct.pack(f"<{len(words)}H", *words)


def encode_evt21(events: list[Event], endianness: str) -> bytes:
    """Words of one event each."""
    words, high = [], None
    for t, x, y, p in events:
        if t >> 6 != high:
            high = t >> 6
            words.append(8 << 60 | (high & 0xFFFFFFF) << 32)
        words.append(p << 60 | (t & 63) << 54 | (x // 32 * 32) << 43 | y << 32 | 1 << x % 32)
    if endianness == "legacy":
        words = [word >> 32 | (word & 0xFFFFFFFF) << 32 for word in words]
    return struct.pack(f"{'>' if endianness == 'big' else '<'}{len(words)}Q", *words)


def raw_header(version: str, width: int, height: int, *more: str) -> bytes:
    """Header of a RAW file."""
    lines = (f"evt {version}", f"geometry {width}x{height}", *more, "end")
    return "".join(f"% {line}\n" for line in lines).encode()


def aedat2(chip: str, addresses: list[tuple[int, int]]) -> bytes:
    """AEDAT 2 file of pairs (address, time)."""
    header = f"#!AER-DAT2.0\r\n# raw AE data\r\n# AEChip: {chip}\r\n".encode()
    return header + b"".join(struct.pack(">II", address, t) for address, t in addresses)


def aedat3(*packets: bytes, sources: str = "#Source 0: DAVIS240C", form: str = "RAW") -> bytes:
    """AEDAT 3.1 file of finished packets."""
    lines = ("#!AER-DAT3.1", f"#Format: {form}", sources, "#Start-Time: 2016-06-07", "#!END-HEADER")
    return "".join(f"{line}\r\n" for line in lines).encode() + b"".join(packets)


def aedat3_packet(
    kind: int, events: list[bytes], time_at: int, wraps: int = 0, source: int = 0
) -> bytes:
    """Packet of events of one size."""
    n, size = len(events), len(events[0]) if events else 8
    return struct.pack("<hhiiiiii", kind, source, size, time_at, wraps, n, n, n) + b"".join(events)


def aedat3_polarity(
    events: list[Event], wraps: int = 0, valid: bool = True, source: int = 0
) -> bytes:
    """Packet of polarity events; times without their wraps."""
    words = [struct.pack("<Ii", x << 17 | y << 2 | p << 1 | valid, t) for t, x, y, p in events]
    return aedat3_packet(1, words, 4, wraps, source)


def event_array(events: list[Event], width: int, height: int, ros: int) -> bytes:
    """`dvs_msgs/EventArray`, serialised; the events' times are microseconds since 1970."""
    out = bytearray()

    def put(kind: str, value: int) -> None:
        size = struct.calcsize(kind)
        if ros == 2:
            out.extend(bytes(-len(out) % size))
        out.extend(struct.pack("<" + kind, value))

    if ros == 1:
        put("I", 7)
    put("I", 1_600_000_000)
    put("I", 5_000)
    frame = b"cam\0" if ros == 2 else b"cam"
    put("I", len(frame))
    out.extend(frame)
    for number in (height, width, len(events)):
        put("I", number)
    for t, x, y, p in events:
        put("H", x)
        put("H", y)
        put("I", t // 1_000_000)
        put("I", t % 1_000_000 * 1_000 + 999)  # below the microsecond: cut off
        put("B", p)
    return (b"\0\1\0\0" if ros == 2 else b"") + bytes(out)


def event_packet(encoding: str, payload: bytes, width: int, height: int, base_ns: int = 0) -> bytes:
    """`event_camera_msgs/EventPacket` of ROS 2, serialised."""
    head = struct.pack("<III", 1_600_000_000, 123_456_000, 4) + b"cam\0"
    head += struct.pack("<II", height, width)
    head += bytes(-len(head) % 8) + struct.pack("<QQ", 1, base_ns)
    name = encoding.encode() + b"\0"
    head += struct.pack("<I", len(name)) + name + b"\0"
    head += bytes(-len(head) % 4) + struct.pack("<I", len(payload)) + payload
    return b"\0\1\0\0" + head


def payloads(folder: Path) -> Iterator[bytes]:
    """What the packets of a bag of ROS 2 hold, straight out of its database."""
    with sqlite3.connect(f"file:{next(folder.glob('*.db3'))}?mode=ro", uri=True) as database:
        rows = database.execute("select data from messages order by timestamp").fetchall()
    database.close()
    for (data,) in rows:
        name = data.index(b"evt3\0") if b"evt3\0" in data[:120] else data.index(b"libcaer\0")
        at = data.index(b"\0", name) + 2  # the name's end, then the byte order
        at += -(at - 4) % 4
        (n,) = struct.unpack_from("<I", data, at)
        yield data[at + 4 : at + 4 + n]


def write_bag(
    path: Path,
    ros: int,
    messages: list[tuple[str, bytes]],
    types: dict[str, str] | None = None,
    definitions: dict[str, str] | None = None,
    *,
    storage: str = "SQLITE3",
    compression: str = "",
) -> None:
    """Bag of pairs (topic, message), compressed by a format of ROS 1 or by a mode of ROS 2."""
    pytest.importorskip("rosbags", reason="rosbags is not installed (extra ros)")
    from rosbags import rosbag1, rosbag2

    if ros == 1:
        writer: Any = rosbag1.Writer(path)
        if compression:
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    else:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
        if compression:
            mode = rosbag2.CompressionMode[compression]
            writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    digest = {"md5sum": "0" * 32} if ros == 1 else {"rihs01": "RIHS01_" + "0" * 64}
    with writer:
        connections: dict[str, Any] = {}
        for i, (topic, data) in enumerate(messages):
            if topic not in connections:
                kind = (types or {}).get(topic, "dvs_msgs/msg/EventArray")
                definition = (definitions or {}).get(topic, "uint8 x\n")
                connections[topic] = writer.add_connection(topic, kind, msgdef=definition, **digest)
            writer.write(connections[topic], 10**18 + i, data)


def encode_libcaer_cmp(events: list[Event]) -> bytes:
    """Words of `libcaer_cmp`, times modulo 2**24 us; each second event is a vector of one row."""
    words, high, low = [], 0, 0
    for i, (t, x, y, p) in enumerate(events):
        if t >> 12 & 4095 != high:
            high = t >> 12 & 4095
            words.append(0 << 12 | high)
        if t & 4095 != low:
            low = t & 4095
            words.append(1 << 12 | low)
        words.append(2 << 12 | x)
        words += [4 << 12 | p << 11 | y, 5 << 12 | 1] if i % 2 else [3 << 12 | p << 11 | y]
    return struct.pack(f"<{len(words)}H", *words)


def encode_mono(events: list[Event]) -> bytes:
    """Words of `mono`: times in nanoseconds from the packet's time base, below 4.2 s."""
    return b"".join(
        struct.pack("<Q", p << 63 | y << 48 | x << 32 | t * 1000) for t, x, y, p in events
    )


def aedat4_header(*streams: tuple[int, str, int, int], compression: int = 0) -> bytes:
    """Header of AEDAT 4 with streams (number, name, width, height) and no table of packets."""
    nodes = "".join(
        f'<node name="{n}"><attr key="originalOutputName">{name}</attr>'
        '<attr key="typeIdentifier">EVTS</attr><node name="info">'
        f'<attr key="sizeX">{w}</attr><attr key="sizeY">{h}</attr></node></node>'
        for n, name, w, h in streams
    )
    text = f'<dv version="2.0"><node name="outInfo">{nodes}</node></dv>'.encode()
    # a FlatBuffer: root offset, vtable (size, table size, 3 fields), table, string
    vtable = struct.pack("<5H2x", 10, 12, 8, 0, 4)
    table = struct.pack("<iIi", len(vtable), 8, compression)
    buffer = struct.pack("<I", 4 + len(vtable)) + vtable + table
    buffer += struct.pack("<I", len(text)) + text
    return b"#!AER-DAT4.0\r\n" + struct.pack("<I", len(buffer)) + buffer


def aedat4_packet(stream: int, events: list[Event], compression: int = 0) -> bytes:
    """Packet of events, compressed by nothing (0), LZ4 (1) or ZSTD (3)."""
    vtable = struct.pack("<3H2x", 6, 8, 4)
    table = struct.pack("<iI", len(vtable), 4)
    rows = b"".join(struct.pack("<qhh?3x", *event) for event in events)
    buffer = struct.pack("<I", 4 + len(vtable)) + vtable + table
    buffer += struct.pack("<I", len(events)) + rows
    buffer = struct.pack("<I", len(buffer)) + buffer
    if compression == 1:
        import lz4.frame

        buffer = lz4.frame.compress(buffer)
    elif compression == 3:
        import sys

        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
        buffer = zstd.compress(buffer)
    return struct.pack("<ii", stream, len(buffer)) + buffer
