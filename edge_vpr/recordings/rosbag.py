"""Events of ROS 1 and ROS 2 bags."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edge_vpr.errors import RecordingError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.recordings.columns import Columns
from edge_vpr.recordings.event_packet import Cursor, PacketDecoder, read_event_array, read_preamble
from edge_vpr.recordings.faults import FaultLog
from edge_vpr.recordings.rosbag_file import Bag
from edge_vpr.recordings.source import ReadOptions, Source

#: Message types with one structure for each event, and those with a camera's own words.
_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_PACKETS = ("event_camera_msgs/msg/EventPacket", "event_array_msgs/msg/EventArray")


class BagSource(Source):
    """Source of the messages of one topic.

    Times of event arrays are wall-clock times. Packets have the camera's clock; their start is the
    time stamp of the first packet, which fits those of other topics and of GPS.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._bag = Bag(path, 1 if options.format == "rosbag1" else 2)
        with self._bag.errors(), self._bag.open() as reader:
            connection = _choose(reader.connections, options.topic, path)
            self._topic = connection.topic
            self._packets = connection.msgtype in _PACKETS
            self._total = sum(c.msgcount for c in reader.connections if c.topic == self._topic)
            preamble = self._first(reader)
        size = Sensor(preamble.width, preamble.height) if preamble and preamble.width else None
        super().__init__(path, options, size)
        if self._packets and preamble is not None:
            self.start_us = preamble.stamp_us

    def _first(self, reader: Any) -> Any:
        for data in self._bag.messages(reader, self._topic):
            return read_preamble(Cursor(data, self._bag.ros), self._bag.ros)
        return None

    def chunks(self, log: FaultLog) -> Iterator[Columns]:
        """Yield the events, a message at a time; see :class:`Source`."""
        packets = PacketDecoder()
        ros = self._bag.ros
        with self._bag.errors(), self._bag.open() as reader:
            for message, data in enumerate(self._bag.messages(reader, self._topic), 1):
                try:
                    cursor = Cursor(data, ros)
                    read_preamble(cursor, ros)
                    columns = (
                        packets.read(cursor) if self._packets else read_event_array(cursor, ros)
                    )
                except struct.error as error:
                    raise RecordingError(
                        f"{self.path}: message {message:,} on {self._topic} is cut off "
                        f"({error}): record or copy the bag again"
                    ) from error
                self.position = message / max(1, self._total)
                step = self.options.chunk_events
                for i in range(0, columns.t.size, step):
                    yield Columns(*(column[i : i + step] for column in columns))
                log.undated(packets.take_undated())


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


open_source = BagSource
