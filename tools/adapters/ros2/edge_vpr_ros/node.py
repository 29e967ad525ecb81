"""Publish the matches of `edge-vpr stream --http` to ROS 2.

It is a node where ROS 2 (rclpy) is installed; with ``--dds`` it needs cyclonedds alone, and nodes
of ROS 2 on the same domain read it all the same.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from typing import Any, Protocol

from edge_vpr_ros.messages import TOPICS, Frames, Message, Translator, host_us_of

#: A longer line is none of ours.
_LONGEST = 1 << 24
#: Silence of the server in seconds after which it is asked again.
_QUIET_S = 5.0
_RETRY_S = 1.0
_CONNECT = "127.0.0.1:7000"


class Backend(Protocol):
    """Publishes messages.

    Attributes
    ----------
    connect : str
        ``HOST:PORT`` of the server.
    frames : Frames
    """

    connect: str
    frames: Frames

    def publish(self, message: Message) -> None:
        """Publish one."""

    def stamp_us(self, host_us: int) -> int:
        """Return the time of messages for a row of this time, in microseconds."""

    def log(self, text: str) -> None:
        """Write a notice."""

    def spin(self, ended: threading.Event) -> None:
        """Wait until `ended` is set, or a signal ends the node."""


class RosBackend:
    """A node of rclpy, whose parameters have the names of the flags and of `Frames`."""

    def __init__(self, arguments: argparse.Namespace, ros_words: list[str]) -> None:
        import rclpy
        from rosidl_runtime_py import set_message_fields
        from rosidl_runtime_py.utilities import get_message

        # rclpy ends the node on SIGINT and SIGTERM
        rclpy.init(args=ros_words)
        self._rclpy, self._fill = rclpy, set_message_fields
        self._node = node = rclpy.create_node(arguments.name)
        defaults = {each.name: getattr(arguments, each.name) for each in fields(Frames)}
        found = {
            name: node.declare_parameter(f"{name}_frame" if name != "tf" else name, value).value
            for name, value in defaults.items()
        }
        self.frames = Frames(**found)
        self.connect = str(node.declare_parameter("connect", arguments.connect).value)
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._types = {kind: get_message(kind) for kind in TOPICS.values()}
        self._publishers = {
            topic: node.create_publisher(
                self._types[kind], topic if topic.startswith("/") else f"~/{topic}", 10
            )
            for topic, kind in TOPICS.items()
        }

    def publish(self, message: Message) -> None:
        """See `Backend.publish`."""
        if not self._rclpy.ok():  # a signal ends the node
            return
        made = self._types[message.kind]()
        self._fill(made, _with_bytes(message.fields))
        self._publishers[message.topic].publish(made)

    def stamp_us(self, host_us: int) -> int:
        """See `Backend.stamp_us`; with simulated time, the time is that of arrival."""
        if not self._simulated:
            return host_us
        return int(self._node.get_clock().now().nanoseconds // 1_000)

    def log(self, text: str) -> None:
        """See `Backend.log`."""
        self._node.get_logger().warning(text)

    def spin(self, ended: threading.Event) -> None:
        """See `Backend.spin`."""
        from rclpy.executors import ExternalShutdownException

        try:
            while self._rclpy.ok() and not ended.is_set():
                self._rclpy.spin_once(self._node, timeout_sec=0.1)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        finally:
            self._node.destroy_node()
            self._rclpy.try_shutdown()


def _with_bytes(value: Any, name: str = "") -> Any:
    """Return fields with the level of a diagnosis as rclpy has a `byte`."""
    if isinstance(value, dict):
        return {each: _with_bytes(inner, each) for each, inner in value.items()}
    if isinstance(value, list) and name in ("status", "values", "transforms"):
        return [_with_bytes(inner) for inner in value]
    return bytes([value]) if name == "level" else value


class DdsBackend:
    """A participant of DDS whose topics and types have the names that ROS 2 gives them."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        from edge_vpr_ros.dds_types import TYPES, build

        self.connect = arguments.connect
        self.frames = Frames(
            **{each.name: getattr(arguments, each.name) for each in fields(Frames)}
        )
        self._types: dict[str, Any] = TYPES
        self._build = build
        participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        quality = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10)
        )
        self._writers = {
            topic: DataWriter(
                participant,
                Topic(
                    participant,
                    f"rt{topic}" if topic.startswith("/") else f"rt/{arguments.name}/{topic}",
                    TYPES[kind],
                ),
                qos=quality,
            )
            for topic, kind in TOPICS.items()
        }
        self._signalled = threading.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._signalled.set())

    def publish(self, message: Message) -> None:
        """See `Backend.publish`."""
        sample = self._build(self._types[message.kind], dict(message.fields))
        self._writers[message.topic].write(sample)

    def stamp_us(self, host_us: int) -> int:
        """See `Backend.stamp_us`."""
        return host_us

    def log(self, text: str) -> None:
        """See `Backend.log`."""
        print(text, file=sys.stderr, flush=True)

    def spin(self, ended: threading.Event) -> None:
        """See `Backend.spin`."""
        while not self._signalled.is_set() and not ended.wait(0.1):
            pass


def lines_from(host: str, port: int) -> Iterator[bytes]:
    """Yield the rows that a server sends, until it closes; a longer one in pieces.

    Raises
    ------
    OSError
        If it cannot be reached, is lost, or sends nothing, not even the health of each second.
    """
    with closing(HTTPConnection(host, port, timeout=_QUIET_S)) as connection:
        try:
            connection.request("GET", "/events")
            answer = connection.getresponse()
            if answer.status != HTTPStatus.OK:
                raise ConnectionError(answer.read(200).decode(errors="replace").strip())
            while line := answer.readline(_LONGEST):
                name, _, row = line.partition(b": ")
                if name == b"data":
                    yield row
        except HTTPException as error:
            raise ConnectionError(f"it answers as no edge-vpr: {type(error).__name__}") from error


def row_of(line: bytes) -> dict[str, Any]:
    """Return the row that a line is.

    Raises
    ------
    ValueError
        If it is none.
    """
    row = json.loads(line)
    if not isinstance(row, dict):
        raise ValueError(f"expected a row of JSON, got {line[:40]!r}")  # noqa: TRY004
    return row


def publish_line(line: bytes, translator: Translator, backend: Backend) -> None:
    """Publish the messages of a row; what is none is left out and counted."""
    try:
        row = row_of(line)
        host_us = host_us_of(row)
        stamp_us = backend.stamp_us(int(1e6 * time.time()) if host_us is None else host_us)
        messages = translator.messages_of(row, stamp_us)
    except (ValueError, RecursionError) as error:
        translator.left_out = n = translator.left_out + 1
        if n & (n - 1) == 0:  # the first, second, fourth, ...: a log is not filled by them
            backend.log(f"rows left out: {n:,}, the last one since {error}")
        return
    for message in messages:
        backend.publish(message)


def follow_server(backend: Backend, once: bool, ended: threading.Event) -> None:
    """Publish what a server sends; connect again when it is lost, unless `once`."""
    host, port = _host_port(backend.connect)
    translator, said = Translator(backend.frames), ""
    while not ended.is_set():
        try:
            for line in lines_from(host, port):
                publish_line(line, translator, backend)
                said = ""
            text = "edge-vpr has ended"
        except OSError as error:
            text = f"no matches from {backend.connect}: {error}: start edge-vpr stream --http"
        if once:
            break
        if text != said:
            backend.log(f"{text}; trying again")
            said = text
        ended.wait(_RETRY_S)


def _host_port(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not port.isdigit():
        raise ValueError(f"connect {address}: expected HOST:PORT, as {_CONNECT}")
    return host.strip("[]") or "127.0.0.1", int(port)


def main(words: list[str] | None = None) -> int:
    """Publish until a signal ends the node; with ``--once``, until the server closes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--connect", default=_CONNECT, metavar="HOST:PORT")
    parser.add_argument("--name", default="edge_vpr", help="of the node (default: %(default)s)")
    for each, what in (
        ("map", "positions in metres"),
        ("route", "metres along the route"),
        ("child", "the robot"),
        ("sensor", "the camera, for GPS positions"),
    ):
        parser.add_argument(
            f"--{each}-frame", dest=each, default=getattr(Frames, each),
            help=f"frame of {what} (default: %(default)s)",
        )  # fmt: skip
    parser.add_argument("--tf", action="store_true", help="publish the transform to the robot")
    parser.add_argument("--dds", action="store_true", help="publish by cyclonedds, without rclpy")
    parser.add_argument("--once", action="store_true", help="end when the server closes")
    # ros2 run and launch files add arguments of their own
    arguments, ros_words = parser.parse_known_args(words)
    try:
        _host_port(arguments.connect)
        backend: Backend
        backend = DdsBackend(arguments) if arguments.dds else RosBackend(arguments, ros_words)
        _host_port(backend.connect)
    except ValueError as error:
        parser.error(str(error))
    except ImportError as error:
        remedy = (
            "pip install cyclonedds" if arguments.dds
            else "source /opt/ros/DISTRIBUTION/setup.bash, or use --dds"
        )  # fmt: skip
        parser.error(f"{error}: {remedy}")
    ended, failed = threading.Event(), threading.Event()

    def follow() -> None:
        # a node whose thread is gone would live on, and publish nothing
        try:
            follow_server(backend, arguments.once, ended)
        except Exception as error:
            failed.set()
            backend.log(f"the node ends: {type(error).__name__}: {error}")
        finally:
            ended.set()

    threading.Thread(target=follow, daemon=True).start()
    backend.spin(ended)
    ended.set()
    return int(failed.is_set())


if __name__ == "__main__":
    sys.exit(main())
