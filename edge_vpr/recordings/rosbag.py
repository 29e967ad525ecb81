"""Events of ROS 1 and ROS 2 bags."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_vpr.compiling import kernel
from edge_vpr.errors import EdgeVprError, RecordingError, UsageError, import_extra
from edge_vpr.events import Columns, Sensor, empty_columns
from edge_vpr.recordings.decoding import Unwrapper
from edge_vpr.recordings.prophesee import EvtWordDecoder
from edge_vpr.recordings.reading import FaultLog, ReadOptions, Source, in_chunks
from edge_vpr.recordings.table import match_columns, tidy

# The encoding ``libcaer_cmp`` of ``event_camera_msgs/EventPacket``: iniVation events, compressed.
#
# Words of 16 bits, the kind in the upper four (``libcaer_cmp_types.h`` of event_camera_codecs):
#
# ====  ==================  ========================================================================
# kind  lower 12 bits       meaning
# ====  ==================  ========================================================================
# 0     time >> 12          upper half of the microseconds from the packet's time base
# 1     time                lower half
# 2     column              of the events that follow
# 3     row, polarity << 11 one event
# 4     row, polarity << 11 first row of the vectors that follow
# 5     bits 0 to 7         an event for each bit that is set, in this row and the seven after it
# ====  ==================  ========================================================================


_EVENTS_A_WORD = 8
#: column, row and polarity carry over from packet to packet
STATE_DTYPE = np.dtype([("column", "<i8"), ("row", "<i8"), ("polarity", "?")])


@kernel
def _decode(words, state, t, x, y, p):  # type: ignore[no-untyped-def]
    """Decode one packet; return the number of events, or -1 - i if word i is of an unknown kind."""
    n = 0
    high, low = np.int64(0), np.int64(0)
    column, row, polarity = state.column, state.row, state.polarity
    for i in range(words.size):
        word = np.int64(words[i])
        kind, value = word >> 12, word & 4095
        if kind == 0:
            high = value << 12
        elif kind == 1:
            low = value
        elif kind == 2:
            column = value & 2047
        elif kind == 3:
            t[n], x[n], y[n], p[n] = high | low, column, value & 2047, value > 2047
            n += 1
        elif kind == 4:
            row, polarity = value & 2047, value > 2047
        elif kind == 5:
            for bit in range(8):
                if value >> bit & 1:
                    t[n], x[n], y[n], p[n] = high | low, column, row + bit, polarity
                    n += 1
            row = min(row + 8, 65535 - 8)
        else:
            return -1 - i
    state.column, state.row, state.polarity = column, row, polarity
    return n


class LibcaerCmpDecoder:
    """Decode packet by packet; column, row and polarity carry over between packets."""

    def __init__(self) -> None:
        self._state = np.rec.array(np.zeros(1, STATE_DTYPE))

    def decode(self, words: npt.NDArray[Any], base_us: int) -> Columns:
        """Decode the words of one packet.

        Parameters
        ----------
        words : ndarray of uint16, shape (n,)
            Payload of one packet.
        base_us : int
            The packet's time base in microseconds.

        Raises
        ------
        RecordingError
            If a word is of an unknown kind.
        """
        t, x, y, p = empty_columns(words.size * _EVENTS_A_WORD)
        n = _decode(words, self._state[0], t, x, y, p)
        if n < 0:
            kind = int(words[-1 - n]) >> 12
            raise RecordingError(
                f"word {-1 - n:,} of a libcaer_cmp packet is of the unknown kind {kind}: the bag "
                "is damaged, or written by a newer driver"
            )
        return Columns(t[:n] + base_us, x[:n], y[:n], p[:n])


# The ROS messages that carry events, decoded from their serialised bytes.
#
# ``dvs_msgs/EventArray`` (ROS 1 and 2) has one structure for each event.
# ``event_camera_msgs/EventPacket`` has the camera's own words, in the encodings ``evt3``
# (Prophesee), ``libcaer``, ``libcaer_cmp`` (iniVation) and ``mono`` (one event a word, written by
# event_camera_tools). Neither eventcv nor rosbags decodes these messages.


class Cursor:
    """Read the fields of one serialised message, one after another.

    Parameters
    ----------
    ros : {1, 2}
        ROS 1 packs fields without gaps, ROS 2 (CDR) aligns each to its size.
    """

    def __init__(self, data: bytes, ros: int) -> None:
        self._data = memoryview(data)
        self.ros = ros
        self._at = 0
        self.order = "<"
        if ros == 2:
            self.order = "<" if data[1] & 1 else ">"
            self._data = self._data[4:]

    def number(self, kind: str) -> int:
        """Read one number; `kind` is its format character of :mod:`struct`."""
        self._at = self.aligned(self._at, kind)
        (value,) = struct.unpack_from(self.order + kind, self._data, self._at)
        self._at += struct.calcsize(kind)
        return int(value)

    def aligned(self, at: int, kind: str) -> int:
        """Return the position of a number that follows position `at`."""
        return at + (-at % struct.calcsize(kind) if self.ros == 2 else 0)

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

    def structures(self, fields: Mapping[str, str]) -> dict[str, npt.NDArray[Any]]:
        """Read a sequence of structures, as columns.

        Parameters
        ----------
        fields : dict of str to str
            Format characters of :mod:`struct` by the names of the fields.
        """
        n = self.number("I")
        # in CDR the first structure may be aligned in another way than the others, which are alike
        ends, places = [self._at], list[list[int]]()
        for _ in range(3):
            at, starts = ends[-1], []
            for kind in fields.values():
                starts.append(self.aligned(at, kind))
                at = starts[-1] + struct.calcsize(kind)
            ends.append(at)
            places.append(starts)
        stride = ends[3] - ends[2]
        end = ends[min(n, 2)] + max(n - 2, 0) * stride
        if end > len(self._data):
            left = len(self._data) - self._at
            raise struct.error(f"{n:,} events announced in {left:,} bytes")
        columns = {}
        for i, (name, kind) in enumerate(fields.items()):
            dtype = np.dtype(self.order + kind.replace("?", "B"))
            column = np.empty(n, dtype.newbyteorder("="))
            if n:
                column[0] = np.ndarray(1, dtype, self._data, places[0][i])[0]
            if n > 1:
                column[1:] = np.ndarray(n - 1, dtype, self._data, places[1][i], (stride,))
            columns[name] = column
        self._at = end
        return columns


def read_preamble(cursor: Cursor) -> tuple[int, int, int]:
    """Read the first fields of all messages of events: time stamp in us, height and width."""
    if cursor.ros == 1:
        cursor.number("I")  # sequence number
    seconds, nanoseconds = cursor.number("I"), cursor.number("I")
    cursor.text()  # frame
    height, width = cursor.number("I"), cursor.number("I")
    return seconds * 1_000_000 + nanoseconds // 1_000, height, width


#: Fields of ``dvs_msgs/Event`` and ``prophesee_event_msgs/Event``.
_EVENT = {"x": "H", "y": "H", "ts.sec": "I", "ts.nanosec": "I", "polarity": "?"}


def read_event_array(cursor: Cursor) -> Columns:
    """Read the events of ``dvs_msgs/EventArray``; times are wall-clock microseconds."""
    events = cursor.structures(_EVENT)
    return Columns(_stamps_us(events, "ts"), events["x"], events["y"], events["polarity"] > 0)


def _stamps_us(events: Mapping[str, npt.NDArray[Any]], name: str) -> npt.NDArray[np.int64]:
    seconds, nanoseconds = events[f"{name}.sec"], events[f"{name}.nanosec"]
    return seconds.astype(np.int64) * 1_000_000 + nanoseconds // 1_000


# Event arrays of other packages, such as ``dv_ros_msgs``, by the definition that the bag holds.


_KINDS = {
    "bool": "?", "octet": "B", "byte": "B", "char": "B", "float32": "f", "float64": "d",
    **{f"{sign}int{bits}": kind.upper() if sign else kind
       for sign in ("", "u") for bits, kind in ((8, "b"), (16, "h"), (32, "i"), (64, "q"))},
}  # fmt: skip
_STAMPS = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


class ArrayLayout:
    """Layout of a message with a sequence of events.

    Parameters
    ----------
    types : dict
        Types by their names, as rosbags parses them: lists of fields, each with name and kind.
    name : str
        Type of the message.

    Raises
    ------
    KeyError
        If the message has no sequence of structures with column, row and time, or a type is not
        defined.
    """

    def __init__(self, types: Mapping[str, Any], name: str) -> None:
        self._types = types
        self._before: list[tuple[str, Any]] = []
        for field, kind in types[name][1]:
            node, what = kind
            if node.name == "SEQUENCE" and what[0][0].name == "NAME":
                events = self._flat(what[0])
                named = match_columns(dict.fromkeys(each.split(".")[0] for each in events))
                if named is not None:
                    self._events, self._named = events, named
                    return
            self._before.append((field, kind))
        raise KeyError(f"{name} has no events")

    def _flat(self, kind: Any, name: str = "") -> dict[str, str]:
        """Return the numbers that a field of a structure consists of, by their dotted names."""
        node, what = kind
        if node.name == "BASE":
            return {name: _KINDS[what[0]]}
        if node.name != "NAME":
            raise KeyError(f"{name} has no fixed size")
        if what in _STAMPS:
            return {f"{name}.sec": "I", f"{name}.nanosec": "I"}
        flat: dict[str, str] = {}
        for field, inner in self._types[what][1]:
            flat |= self._flat(inner, f"{name}.{field}" if name else field)
        return flat

    def read_before(self, cursor: Cursor) -> Sensor | None:
        """Read the fields before the events, and return the size of the sensor, if it is there."""
        fields = {field: self._read(cursor, kind) for field, kind in self._before}
        sides = [fields.get(name) for name in ("width", "height")]
        width, height = (side if isinstance(side, int) else 0 for side in sides)
        return Sensor(width, height) if width else None

    def _read(self, cursor: Cursor, kind: Any) -> Any:
        node, what = kind
        if node.name == "BASE":
            text = what[0] in ("string", "wstring")
            return cursor.text() if text else cursor.number(_KINDS[what[0]])
        if node.name == "NAME":
            if what in _STAMPS:
                return cursor.number("I"), cursor.number("I")
            return [self._read(cursor, inner) for _, inner in self._types[what][1]]
        n = what[1] if node.name == "ARRAY" else cursor.number("I")
        return [self._read(cursor, what[0]) for _ in range(n)]

    def read_events(self, cursor: Cursor, unit: str | None, log: FaultLog) -> Columns:
        """Read the events; times of no stated unit are microseconds, or seconds with a fraction."""
        events = cursor.structures(self._events)
        columns = {}
        for column, field in self._named.fields.items():
            if f"{field}.sec" in events:
                columns[column], unit = _stamps_us(events, field), "us"
            else:
                columns[column] = events[field]
        return tidy(columns, unit or self._named.unit, log, log.entries)


def _layout_of(connection: Any) -> ArrayLayout | None:
    """Return the layout of the messages of a connection, if they are arrays of events."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    definition, name = connection.msgdef, connection.msgtype
    try:
        if definition.format.name == "IDL":
            return ArrayLayout(get_types_from_idl(definition.data), name)
        return ArrayLayout(get_types_from_msg(definition.data, name), name)
    except Exception:  # the parsers of rosbags raise exceptions of many kinds
        return None


class PacketDecoder:
    """Decode the packets of one camera; clock and decoder state carry over between packets."""

    def __init__(self) -> None:
        self._evt3 = EvtWordDecoder("evt3", 1 << 14)
        self._clock = Unwrapper(31)
        self._compressed = LibcaerCmpDecoder()

    def take_undated(self) -> int:
        """Return the number of events before the first time word, since the last call."""
        return self._evt3.take_counts()[1]

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


# Bags of ROS 1 and ROS 2, read message by message with rosbags.


_LISTING = "metadata.yaml"


class _BoundedFile(io.BufferedReader):
    """File whose reads are limited to the rest of the file: rosbags trusts announced sizes."""

    def __init__(self, raw: io.RawIOBase, size: int) -> None:
        super().__init__(raw)
        self._size = size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


class _BoundedPath(type(Path())):  # type: ignore[misc]  # of the platform's own kind
    """Path that opens its files as :class:`_BoundedFile`."""

    def open(self, mode: str = "r", *args: Any, **options: Any) -> Any:
        """Open the file; reads of bytes are bounded."""
        if mode != "rb":
            return super().open(mode, *args, **options)
        file = super().open(mode, buffering=0)
        return _BoundedFile(file, os.fstat(file.fileno()).st_size)


@contextmanager
def opened_bag(path: Path, ros: int) -> Iterator[Any]:
    """Open a ROS 1 bag, or a folder or file of a ROS 2 bag, with rosbags.

    Errors of its parsers become a RecordingError with a remedy.
    """
    library = import_extra(f"rosbags.rosbag{ros}", "a ROS bag", "rosbags", "ros")
    if path.is_dir() and not (path / _LISTING).exists():
        raise RecordingError(
            f"{path} has no {_LISTING}: make it with ros2 bag reindex, or name one file of the bag"
        )
    try:
        with library.Reader(_BoundedPath(path)) as reader:
            yield reader
    except (EdgeVprError, MemoryError, OSError):
        raise
    except Exception as error:
        remedy = "rosbag reindex" if ros == 1 else "ros2 bag reindex"
        if path.suffix == ".mcap":
            remedy = f"mcap recover {path.name} -o NEW.mcap"
        elif path.is_dir():
            remedy += ", or name one file of the bag"
        raise RecordingError(
            f"{path} is cut off, damaged or no ROS {ros} bag ({' '.join(str(error).split())}): try "
            f"{remedy}, or copy it again"
        ) from error


def messages_of(reader: Any, topic: str) -> Iterator[bytes]:
    """Yield the serialised messages of a topic."""
    connections = [c for c in reader.connections if c.topic == topic]
    for _, _, data in reader.messages(connections=connections):
        yield bytes(data)


#: Message types with one structure for each event, and those with a camera's own words.
_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_PACKETS = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")


class BagSource(Source):
    """Source of the messages of one topic.

    Times of event arrays are wall-clock times. Packets have the camera's clock; their start is the
    time stamp of the first packet, which fits those of other topics and of GPS.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._ros = 1 if options.format == "rosbag1" else 2
        with opened_bag(path, self._ros) as reader:
            connection, self._layout = _choose(reader.connections, options.topic, path)
            self._topic = connection.topic
            self._packets = connection.msgtype in _PACKETS
            self._total = sum(c.msgcount for c in reader.connections if c.topic == self._topic)
            first = next(messages_of(reader, self._topic), None)
            cursor = None if first is None else Cursor(first, self._ros)
            size, stamp_us = (None, None) if cursor is None else self._begin(cursor)
        super().__init__(path, options, size)
        if self._packets:
            self.start_us = stamp_us

    def _begin(self, cursor: Cursor) -> tuple[Sensor | None, int | None]:
        """Read a message up to its events; return the size of the sensor, and the time stamp."""
        if self._layout is not None:
            return self._layout.read_before(cursor), None
        stamp_us, height, width = read_preamble(cursor)
        return Sensor(width, height) if width else None, stamp_us

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a message at a time; see :class:`Source`."""
        packets = PacketDecoder()
        with opened_bag(self.path, self._ros) as reader:
            for message, data in enumerate(messages_of(reader, self._topic), 1):
                try:
                    cursor = Cursor(data, self._ros)
                    self._begin(cursor)
                    if self._layout is not None:
                        columns = self._layout.read_events(cursor, self.options.time_unit, log)
                    elif self._packets:
                        columns = packets.read(cursor)
                    else:
                        columns = read_event_array(cursor)
                except struct.error as error:
                    raise RecordingError(
                        f"{self.path}: message {message:,} on {self._topic} is cut off "
                        f"({error}): record or copy the bag again"
                    ) from error
                self.position = message / max(1, self._total)
                yield from in_chunks(columns, self.options.chunk_events)
                log.undated(packets.take_undated())


def _choose(connections: Any, wanted: str | None, path: Path) -> tuple[Any, ArrayLayout | None]:
    """Return the connection to read, and its layout if that is not one of those known here."""
    of_events = list[tuple[Any, ArrayLayout | None]]()
    for connection in connections:
        ours = connection.msgtype in _ARRAYS + _PACKETS
        layout = None if ours else _layout_of(connection)
        if (ours or layout is not None) and wanted in (None, connection.topic):
            of_events.append((connection, layout))
    topics = {c.topic: c.msgtype for c in connections}
    if not of_events:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in topics.items()) or "none"
        raise RecordingError(
            f"{path} has no events on {wanted or 'any topic'}; its topics are: {listed}: events "
            "are in dvs_msgs/EventArray, event_camera_msgs/EventPacket, and in other messages "
            "whose definition is in the bag, with a list of x, y and time"
        )
    names = list(dict.fromkeys(c.topic for c, _ in of_events))
    if len(names) > 1:
        raise UsageError(f"{path} has events on {', '.join(names)}: choose one with topic=")
    return of_events[0]
