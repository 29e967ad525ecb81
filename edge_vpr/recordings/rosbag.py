"""Bags of ROS 1 and ROS 2, read message by message with rosbags."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from edge_vpr.errors import EdgeVprError, MissingExtraError, RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.event_packet import (
    Cursor,
    PacketDecoder,
    read_event_array,
    read_preamble,
)
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.source import Columns, ReadOptions, Source

#: Message types of one structure an event, and of packets of a camera's own words.
_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_PACKETS = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")


class BagSource(Source):
    """The messages of one topic.

    Times of event arrays are wall-clock times. Packets have the camera's clock; there the start is
    the time stamp of the first packet, which lines up with other topics and with GPS.
    """

    def __init__(self, path: Path, options: ReadOptions, ros: int) -> None:
        self._ros = ros
        self._place = _folder(path) if ros == 2 else path
        try:
            with self._open() as reader:
                connection = _choose(reader.connections, options.topic, path)
                self._topic = connection.topic
                self._packets = connection.msgtype in _PACKETS
                self._total = sum(
                    c.msgcount for c in reader.connections if c.topic == connection.topic
                )
                preamble = self._first(reader)
        except EdgeVprError:
            raise
        except Exception as error:  # rosbags raises what its parsers raise
            raise _unreadable(path, ros, error) from error
        size = Sensor(preamble.width, preamble.height) if preamble and preamble.width else None
        super().__init__(path, options, size)
        if self._packets and preamble is not None:
            self.start_us = preamble.stamp_us
        self.position = 0.0

    def _open(self) -> Any:
        try:
            rosbags = import_module(f"rosbags.rosbag{self._ros}")
        except ImportError as error:
            raise MissingExtraError("a ROS bag", "rosbags", "ros") from error
        return rosbags.Reader(self._place)

    def _messages(self, reader: Any) -> Iterator[bytes]:
        connections = [c for c in reader.connections if c.topic == self._topic]
        for _, _, data in reader.messages(connections=connections):
            yield data

    def _first(self, reader: Any) -> Any:
        for data in self._messages(reader):
            return read_preamble(Cursor(data, self._ros), self._ros)
        return None

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a message at a time; see :class:`Source`."""
        packets = PacketDecoder()
        message = undated = 0
        try:
            with self._open() as reader:
                for message, data in enumerate(self._messages(reader), 1):
                    cursor = Cursor(data, self._ros)
                    read_preamble(cursor, self._ros)
                    columns = (
                        packets.read(cursor)
                        if self._packets
                        else read_event_array(cursor, self._ros)
                    )
                    self.position = message / max(1, self._total)
                    step = self.options.chunk_events
                    for i in range(0, columns.t.size, step):
                        yield Columns(*(column[i : i + step] for column in columns))
                    log.undated(packets.undated - undated)
                    undated = packets.undated
        except EdgeVprError:
            raise
        except struct.error as error:
            raise RecordingError(
                f"{self.path}: message {message:,} on {self._topic} is cut off ({error}): "
                "record or copy the bag again"
            ) from error
        except Exception as error:  # rosbags raises what its parsers raise
            raise _unreadable(self.path, self._ros, error) from error


def _folder(path: Path) -> Path:
    """Folder of a ROS 2 bag, of which one file may have been named."""
    if path.is_dir():
        return path
    if not (path.parent / "metadata.yaml").exists():
        raise RecordingError(
            f"{path} has no metadata.yaml beside it: make one with ros2 bag reindex"
        )
    return path.parent


def _choose(connections: Any, wanted: str | None, path: Path) -> Any:
    known = [c for c in connections if c.msgtype in _ARRAYS + _PACKETS]
    if wanted is not None:
        known = [c for c in known if c.topic == wanted]
    topics = {c.topic: c.msgtype for c in connections}
    if not known:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in topics.items()) or "none"
        raise RecordingError(
            f"{path} has no events on {wanted or 'any topic'}; its topics are: {listed}: "
            "name one of dvs_msgs/EventArray or event_camera_msgs/EventPacket with --topic"
        )
    names = list(dict.fromkeys(c.topic for c in known))
    if len(names) > 1:
        raise UsageError(f"{path} has events on {', '.join(names)}: choose one with --topic")
    return known[0]


def _unreadable(path: Path, ros: int, error: Exception) -> RecordingError:
    remedy = "rosbag reindex" if ros == 1 else "ros2 bag reindex"
    text = " ".join(str(error).split())
    return RecordingError(
        f"{path} is cut off, damaged or no ROS {ros} bag ({text}): try {remedy}, or copy it again"
    )


def open_source(path: Path, options: ReadOptions, format_name: str) -> Source:
    """Open a bag."""
    return BagSource(path, options, 1 if format_name == "rosbag1" else 2)
