"""The types of ROS 2 that are published, for cyclonedds: the same names and bytes as rclpy's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import new_class
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int8, int32, sequence, uint8, uint16, uint32

_HEADER, _POSE = "std_msgs/msg/Header", "geometry_msgs/msg/Pose"
_POINT, _VECTOR3 = "geometry_msgs/msg/Point", "geometry_msgs/msg/Vector3"
_WITH_COVARIANCE, _TWIST = f"{_POSE}WithCovariance", "geometry_msgs/msg/Twist"
#: Members of each type, behind the types that they are of: a type of cyclonedds, the name of one
#: above, a list of it for any number, or how many floats.
_MEMBERS: Mapping[str, Mapping[str, Any]] = {
    "builtin_interfaces/msg/Time": {"sec": int32, "nanosec": uint32},
    _HEADER: {"stamp": "builtin_interfaces/msg/Time", "frame_id": str},
    "std_msgs/msg/String": {"data": str},
    _POINT: {"x": float64, "y": float64, "z": float64},
    _VECTOR3: {"x": float64, "y": float64, "z": float64},
    f"{_VECTOR3}Stamped": {"header": _HEADER, "vector": _VECTOR3},
    "geometry_msgs/msg/Quaternion": {"x": float64, "y": float64, "z": float64, "w": float64},
    _POSE: {"position": _POINT, "orientation": "geometry_msgs/msg/Quaternion"},
    f"{_POSE}Stamped": {"header": _HEADER, "pose": _POSE},
    _WITH_COVARIANCE: {"pose": _POSE, "covariance": 36},
    f"{_WITH_COVARIANCE}Stamped": {"header": _HEADER, "pose": _WITH_COVARIANCE},
    _TWIST: {"linear": _VECTOR3, "angular": _VECTOR3},
    f"{_TWIST}WithCovariance": {"twist": _TWIST, "covariance": 36},
    "nav_msgs/msg/Odometry": {
        "header": _HEADER, "child_frame_id": str, "pose": _WITH_COVARIANCE,
        "twist": f"{_TWIST}WithCovariance",
    },
    "nav_msgs/msg/Path": {"header": _HEADER, "poses": [f"{_POSE}Stamped"]},
    "diagnostic_msgs/msg/KeyValue": {"key": str, "value": str},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": uint8, "name": str, "message": str, "hardware_id": str,
        "values": ["diagnostic_msgs/msg/KeyValue"],
    },
    "diagnostic_msgs/msg/DiagnosticArray": {
        "header": _HEADER, "status": ["diagnostic_msgs/msg/DiagnosticStatus"],
    },
    "sensor_msgs/msg/NavSatStatus": {"status": int8, "service": uint16},
    "sensor_msgs/msg/NavSatFix": {
        "header": _HEADER, "status": "sensor_msgs/msg/NavSatStatus", "latitude": float64,
        "longitude": float64, "altitude": float64, "position_covariance": 9,
        "position_covariance_type": uint8,
    },
}  # fmt: skip

#: By the names that ROS 2 gives them.
TYPES: dict[str, type[IdlStruct]] = {}


def _declare(name: str, members: Mapping[str, Any]) -> type[IdlStruct]:
    """Return a type; all that is left out of a sample is 0 or empty, and a rotation is by 0."""
    annotations, defaults = {}, {}
    for member, kind in members.items():
        if isinstance(kind, list):
            annotations[member], defaults[member] = (
                sequence[TYPES[kind[0]]],
                field(default_factory=list),
            )
        elif isinstance(kind, str):
            annotations[member], defaults[member] = TYPES[kind], field(default_factory=TYPES[kind])
        elif isinstance(kind, int):
            zeros = field(default_factory=lambda n=kind: [0.0] * n)  # type: ignore[misc]
            annotations[member], defaults[member] = array[float64, kind], zeros
        else:
            annotations[member] = kind
            defaults[member] = "" if kind is str else int(member == "w")
    package, _, last = name.rpartition("/msg/")
    content = {"__module__": __name__, "__annotations__": annotations, **defaults}
    named = {"typename": f"{package}.msg.dds_.{last}_"}
    made = new_class(last, (IdlStruct,), named, lambda space: space.update(content))
    return final(dataclass(made))


for _name, _members in _MEMBERS.items():
    TYPES[_name] = _declare(_name, _members)


def build(name: str, values: Mapping[str, Any]) -> Any:
    """Build a sample of the type of this name; mappings are messages within it."""
    made = dict(values)
    for member, kind in _MEMBERS[name].items():
        if member in made and isinstance(kind, str):
            made[member] = build(kind, made[member])
        elif member in made and isinstance(kind, list):
            made[member] = [build(kind[0], item) for item in made[member]]
    return TYPES[name](**made)
