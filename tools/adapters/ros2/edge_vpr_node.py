"""Publish the matches of `edge-vpr stream --serve` to ROS 2.

`python3 edge_vpr_node.py --connect 127.0.0.1:7000` is a node where ROS 2 (rclpy) is installed; with
``--dds`` it needs cyclonedds alone, and nodes of ROS 2 on the same domain read it all the same.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from typing import Any, Protocol

from messages import TOPICS, Message, messages_of

#: A longer line is none of ours.
_LONGEST = 1 << 20
_RETRY_S = 1.0


class Backend(Protocol):
    """Publishes messages."""

    def publish(self, message: Message) -> None:
        """Publish one."""

    def log(self, text: str) -> None:
        """Write a notice."""

    def is_running(self) -> bool:
        """Tell whether more is to be published."""


class RosBackend:
    """A node of rclpy."""

    def __init__(self, name: str) -> None:
        import rclpy
        from rosidl_runtime_py import set_message_fields
        from rosidl_runtime_py.utilities import get_message

        rclpy.init()
        self._rclpy, self._fill = rclpy, set_message_fields
        self._node = rclpy.create_node(name)
        self._types = {kind: get_message(kind) for kind in TOPICS.values()}
        self._publishers = {
            topic: self._node.create_publisher(self._types[kind], f"~/{topic}", 10)
            for topic, kind in TOPICS.items()
        }

    def publish(self, message: Message) -> None:
        """See `Backend.publish`."""
        made = self._types[message.kind]()
        self._fill(made, dict(message.fields))
        self._publishers[message.topic].publish(made)

    def log(self, text: str) -> None:
        """See `Backend.log`."""
        self._node.get_logger().info(text)

    def is_running(self) -> bool:
        """See `Backend.is_running`."""
        return bool(self._rclpy.ok())


class DdsBackend:
    """A participant of DDS whose topics and types have the names that ROS 2 gives them."""

    def __init__(self, name: str) -> None:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration
        from dds_types import TYPES, build

        self._types: dict[str, Any] = TYPES
        self._build = build
        participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        quality = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10)
        )
        self._writers = {
            topic: DataWriter(
                participant, Topic(participant, f"rt/{name}/{topic}", TYPES[kind]), qos=quality
            )
            for topic, kind in TOPICS.items()
        }

    def publish(self, message: Message) -> None:
        """See `Backend.publish`."""
        sample = self._build(self._types[message.kind], dict(message.fields))
        self._writers[message.topic].write(sample)

    def log(self, text: str) -> None:
        """See `Backend.log`."""
        print(text, file=sys.stderr)

    def is_running(self) -> bool:
        """See `Backend.is_running`."""
        return True


def rows_from(host: str, port: int) -> Iterator[dict[str, Any]]:
    """Yield the rows that a server sends, until it closes.

    Raises
    ------
    OSError
        If it cannot be reached, or is lost.
    ValueError
        If what it sends is no line of JSON.
    """
    with socket.create_connection((host, port), timeout=5) as sock, sock.makefile("rb") as lines:
        sock.settimeout(None)
        while line := lines.readline(_LONGEST):
            row = json.loads(line)
            if not isinstance(row, dict):
                raise ValueError(f"{host}:{port} sends what is no row: {line[:40]!r}")  # noqa: TRY004
            yield row


def main(words: list[str] | None = None) -> int:
    """Publish until interrupted; with ``--once``, until the server closes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--connect", default="127.0.0.1:7000", metavar="HOST:PORT")
    parser.add_argument("--name", default="edge_vpr", help="of the node (default: %(default)s)")
    parser.add_argument("--frame", default="map", help="frame of positions (default: %(default)s)")
    parser.add_argument("--dds", action="store_true", help="publish by cyclonedds, without rclpy")
    parser.add_argument("--once", action="store_true", help="end when the server closes")
    # ros2 run adds arguments of its own
    arguments, _ = parser.parse_known_args(words)
    host, _, port = arguments.connect.rpartition(":")
    if not port.isdigit():
        parser.error(f"--connect {arguments.connect}: expected HOST:PORT, as 127.0.0.1:7000")
    try:
        backend: Backend = (DdsBackend if arguments.dds else RosBackend)(arguments.name)
    except ImportError as error:
        remedy = (
            "pip install cyclonedds" if arguments.dds
            else "source /opt/ros/DISTRIBUTION/setup.bash, or use --dds"
        )  # fmt: skip
        parser.error(f"{error}: {remedy}")
    said = ""
    try:
        while backend.is_running():
            try:
                for row in rows_from(host.strip("[]") or "127.0.0.1", int(port)):
                    said = ""
                    for message in messages_of(row, arguments.frame):
                        backend.publish(message)
                text = "edge-vpr has ended"
            except (OSError, ValueError) as error:
                text = f"no matches from {arguments.connect}: {error}"
            if arguments.once:
                break
            if text != said:
                backend.log(f"{text}; trying again")
                said = text
            time.sleep(_RETRY_S)
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
