"""Publish the matches of `edge-vpr stream --http` to ROS 2."""

from __future__ import annotations

import argparse
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from dataclasses import fields
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from typing import Any

from edge_vpr_ros.messages import (
    ERROR,
    LATCHED,
    ODOM,
    ODOM_KIND,
    TOPICS,
    Frames,
    Message,
    Translator,
    Travelled,
    diagnosis,
    host_us_of,
)

#: Longer lines are ignored.
_LONGEST = 1 << 24
#: Silence of the server in seconds after which it is asked again; it sends its health each second.
_QUIET_S = 2.5
_RETRY_S = 1.0
_CONNECT = "127.0.0.1:7000"


class RosNode:
    """A node of rclpy, whose parameters have the names of the flags and of `Frames`.

    Attributes
    ----------
    connect : str
        ``HOST:PORT`` of the server.
    odometry_to : str
        ``HOST:PORT`` of ``--odometry udp://``; empty without.
    frames : Frames
    """

    def __init__(self, arguments: argparse.Namespace, ros_words: list[str]) -> None:
        import rclpy
        from rclpy import qos
        from rosidl_runtime_py import set_message_fields
        from rosidl_runtime_py.utilities import get_message

        # rclpy ends the node on SIGINT and SIGTERM
        rclpy.init(args=ros_words)
        self._rclpy, self._fill = rclpy, set_message_fields
        self._node = node = rclpy.create_node(arguments.name)
        defaults = {each.name: getattr(arguments, each.name) for each in fields(Frames)}
        frame_ids = {
            name: node.declare_parameter(f"{name}_frame", value).value
            for name, value in defaults.items()
        }
        self.frames = Frames(**frame_ids)
        self.connect, self.odometry_to = (
            str(node.declare_parameter(name, getattr(arguments, name)).value)
            for name in ("connect", "odometry_to")
        )
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._types = {kind: get_message(kind) for kind in {*TOPICS.values(), ODOM_KIND}}
        latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._publishers = {
            topic: node.create_publisher(
                self._types[kind],
                topic if topic.startswith("/") else f"~/{topic}",
                latched if topic in LATCHED else 10,
            )
            for topic, kind in TOPICS.items()
        }
        # of any sender: one that repeats what is lost also serves a reader that does not ask for it
        self._sensor_quality = qos.qos_profile_sensor_data

    def publish(self, message: Message) -> None:
        """Publish one message."""
        if not self._rclpy.ok():  # a signal ends the node
            return
        made = self._types[message.kind]()
        self._fill(made, _with_bytes(message.fields))
        self._publishers[message.topic].publish(made)

    def stamp_us(self, host_us: int) -> int:
        """Return the time of messages for a row of this time, in microseconds.

        With simulated time, it is that of arrival.
        """
        if not self._simulated:
            return host_us
        return int(self._node.get_clock().now().nanoseconds // 1_000)

    def log(self, text: str) -> None:
        """Write a notice."""
        self._node.get_logger().warning(text)

    def subscribe(self, take: Callable[[Any], None]) -> None:
        """Call `take` with each message of the robot's odometry, in `spin`."""
        self._node.create_subscription(self._types[ODOM_KIND], ODOM, take, self._sensor_quality)

    def spin(self, ended: threading.Event) -> None:
        """Wait until `ended` is set, or a signal ends the node."""
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
    if isinstance(value, list) and name in ("status", "values"):
        return [_with_bytes(inner) for inner in value]
    return bytes([value]) if name == "level" else value


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
    """Return the row that a line is."""
    row = json.loads(line)
    if not isinstance(row, dict):
        raise ValueError(f"expected a row of JSON, got {line[:40]!r}")  # noqa: TRY004
    return row


def publish_line(line: bytes, translator: Translator, node: RosNode) -> None:
    """Publish the messages of a row; invalid rows are left out and counted."""
    try:
        row = row_of(line)
        host_us = host_us_of(row)
        stamp_us = node.stamp_us(int(1e6 * time.time()) if host_us is None else host_us)
        messages = translator.messages_of(row, stamp_us)
    except (ValueError, RecursionError) as error:
        translator.left_out = n = translator.left_out + 1
        if n & (n - 1) == 0:  # the first, second, fourth, ...: a log is not filled by them
            node.log(f"rows left out: {n:,}, the last one since {error}")
        return
    for message in messages:
        node.publish(message)


def follow_server(node: RosNode, once: bool, ended: threading.Event) -> None:
    """Publish what a server sends; connect again when it is lost, unless `once`."""
    host, port = _host_port("connect", node.connect)
    translator, said = Translator(node.frames), ""
    while not ended.is_set():
        try:
            for line in lines_from(host, port):
                publish_line(line, translator, node)
                said = ""
            text = "edge-vpr has ended"
        except OSError as error:
            text = f"no matches from {node.connect}: {error}: start edge-vpr stream --http"
        if once:
            break
        if text != said:
            node.log(f"{text}; trying again")
            said = text
        # else the last diagnosis would stay for ever
        now_us = node.stamp_us(int(1e6 * time.time()))
        node.publish(diagnosis(ERROR, text, {"connect": node.connect}, now_us))
        ended.wait(_RETRY_S)


def forward_odometry(node: RosNode) -> socket.socket:
    """Send the distance that the robot's odometry has driven to ``stream --odometry udp://``.

    Returns
    -------
    socket
        That sends; the caller closes it after `RosNode.spin`.

    Raises
    ------
    OSError
        If the address is not known.
    """
    host, port = _host_port("odometry_to", node.odometry_to)
    family = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][0]
    sender = socket.socket(family, socket.SOCK_DGRAM)
    sender.connect((host, port))
    # a node that starts again leaps by kilometres, and no distance is made of that
    travelled = Travelled(1_000.0 * (int(time.time()) % 100_000))

    def take(odometry: Any) -> None:
        metres = travelled.to(odometry.pose.pose)
        if metres is not None:
            with suppress(OSError):  # stream is not there yet
                sender.send(b"%.3f\n" % metres)

    node.subscribe(take)
    return sender


def _host_port(name: str, address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not port.isdigit() or int(port) > 65_535:
        raise ValueError(f"{name} {address}: expected HOST:PORT, as {_CONNECT}")
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
    parser.add_argument(
        "--odometry-to", default="", metavar="HOST:PORT",
        help=f"send the distance driven by {ODOM} there, to stream --odometry udp://",
    )  # fmt: skip
    parser.add_argument("--once", action="store_true", help="end when the server closes")
    # ros2 run and launch files add arguments of their own
    arguments, ros_words = parser.parse_known_args(words)
    try:
        _host_port("connect", arguments.connect)
        node = RosNode(arguments, ros_words)
        _host_port("connect", node.connect)  # a parameter overrules the flag
        odometer: AbstractContextManager[object] = (
            forward_odometry(node) if node.odometry_to else nullcontext()
        )
    except (ValueError, OSError) as error:
        parser.error(str(error))
    except ImportError as error:
        parser.error(f"{error}: source /opt/ros/DISTRIBUTION/setup.bash")
    ended, failed = threading.Event(), threading.Event()

    def follow() -> None:
        # without this, a node whose thread has ended would go on without publishing
        try:
            follow_server(node, arguments.once, ended)
        except Exception as error:
            failed.set()
            node.log(f"the node ends: {type(error).__name__}: {error}")
        finally:
            ended.set()

    threading.Thread(target=follow, daemon=True).start()
    with odometer:
        node.spin(ended)
    ended.set()
    return int(failed.is_set())


if __name__ == "__main__":
    sys.exit(main())
