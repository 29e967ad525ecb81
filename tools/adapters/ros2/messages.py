"""Which messages of ROS 2 a row of `edge-vpr stream --serve` is."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Message:
    """A message by the names of ROS 2.

    Attributes
    ----------
    topic : str
        Below the node's own name.
    kind : str
        Type, as ``geometry_msgs/msg/PointStamped``.
    fields : mapping
        By name; messages within it are mappings. What is left out is zero.
    """

    topic: str
    kind: str
    fields: Mapping[str, Any]


#: topics and their types, which are announced before the first row
TOPICS = {
    "match": "std_msgs/msg/String",
    "health": "std_msgs/msg/String",
    "position": "geometry_msgs/msg/PointStamped",
    "fix": "sensor_msgs/msg/NavSatFix",
    "along_m": "std_msgs/msg/Float64",
    "probability": "std_msgs/msg/Float64",
}
#: of `sensor_msgs/msg/NavSatFix`: a fix without augmentation, by no known satellite system
_STATUS = {"status": 0, "service": 0}


def messages_of(row: Mapping[str, Any], frame: str) -> Iterator[Message]:
    """Yield the messages of a row.

    A match that is lost has no position: a node that steers by it would take it for one.

    Parameters
    ----------
    row : mapping
        As read.
    frame : str
        Name of the frame that positions in metres are in.

    Yields
    ------
    Message
    """
    kind = row.get("kind")
    if kind in ("match", "health"):
        yield Message(kind, TOPICS[kind], {"data": json.dumps(row)})
    if kind != "match":
        return
    values = {"probability": row["probability"]}
    if not row["lost"]:
        values["along_m"] = row.get("along_m")
        yield from _position(row, frame)
    for topic, value in values.items():
        if value is not None:
            yield Message(topic, TOPICS[topic], {"data": float(value)})


def _position(row: Mapping[str, Any], frame: str) -> Iterator[Message]:
    seconds, rest_us = divmod(int(row["host_us"]), 1_000_000)
    header = {"stamp": {"sec": seconds, "nanosec": 1_000 * rest_us}, "frame_id": frame}
    if row.get("x_m") is not None:
        point = {axis: float(row.get(f"{axis}_m") or 0.0) for axis in "xyz"}
        yield Message("position", TOPICS["position"], {"header": header, "point": point})
    if row.get("latitude") is not None:
        fix = {name: float(row[name]) for name in ("latitude", "longitude")}
        yield Message(
            "fix", TOPICS["fix"],
            # no height is known
            {"header": header, "status": _STATUS, **fix, "altitude": float("nan")},
        )  # fmt: skip
