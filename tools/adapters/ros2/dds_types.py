"""The types of ROS 2 that are published, for cyclonedds: the same names and bytes as rclpy's.

cyclonedds reads annotations as they are: none may be postponed by ``from __future__``.
"""

from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, get_type_hints

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int8, int32, uint8, uint16, uint32


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    """builtin_interfaces/msg/Time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
@final
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    """std_msgs/msg/Header."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
@final
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    """std_msgs/msg/String."""

    data: str = ""


@dataclass
@final
class Float64(IdlStruct, typename="std_msgs.msg.dds_.Float64_"):
    """std_msgs/msg/Float64."""

    data: float64 = 0.0


@dataclass
@final
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    """geometry_msgs/msg/Point."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
@final
class PointStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PointStamped_"):
    """geometry_msgs/msg/PointStamped."""

    header: Header = field(default_factory=Header)
    point: Point = field(default_factory=Point)


@dataclass
@final
class NavSatStatus(IdlStruct, typename="sensor_msgs.msg.dds_.NavSatStatus_"):
    """sensor_msgs/msg/NavSatStatus."""

    status: int8 = 0
    service: uint16 = 0


@dataclass
@final
class NavSatFix(IdlStruct, typename="sensor_msgs.msg.dds_.NavSatFix_"):
    """sensor_msgs/msg/NavSatFix."""

    header: Header = field(default_factory=Header)
    status: NavSatStatus = field(default_factory=NavSatStatus)
    latitude: float64 = 0.0
    longitude: float64 = 0.0
    altitude: float64 = 0.0
    position_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)
    position_covariance_type: uint8 = 0


TYPES: dict[str, type[IdlStruct]] = {
    "std_msgs/msg/String": String,
    "std_msgs/msg/Float64": Float64,
    "geometry_msgs/msg/PointStamped": PointStamped,
    "sensor_msgs/msg/NavSatFix": NavSatFix,
}


def build(kind: type[Any], values: dict[str, Any]) -> Any:
    """Build a sample of named values; mappings are messages within it."""
    hints = get_type_hints(kind, include_extras=True)
    made = {}
    for each in fields(kind):
        if each.name in values:
            value, inner = values[each.name], hints[each.name]
            made[each.name] = build(inner, value) if is_dataclass(inner) else value
    return kind(**made)
