"""Messages of ROS 2 for the rows of `edge-vpr stream --http`.

Every value of a row is checked here, so that no row can stop the node or make a wrong message.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Message:
    """A message by the names of ROS 2.

    Attributes
    ----------
    topic : str
        Of `TOPICS`; below the node's own name, unless it begins with a slash.
    fields : mapping
        By name; messages within it are mappings. What is left out is zero.
    """

    topic: str
    fields: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """Type, as ``nav_msgs/msg/Odometry``."""
        return TOPICS[self.topic]


@dataclass(frozen=True)
class Frames:
    """Names of frames."""

    map: str = "map"  #: Of positions in metres.
    route: str = "route"  #: Of metres along the route, on its x axis.
    child: str = "base_link"  #: Of the robot.
    sensor: str = "camera"  #: Of the camera, for GPS positions.


#: Topics and their types, which are announced before the first row.
TOPICS = {
    "match": "std_msgs/msg/String",
    "certainty": "geometry_msgs/msg/Vector3Stamped",
    "pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
    "fix": "sensor_msgs/msg/NavSatFix",
    "path": "nav_msgs/msg/Path",
    "/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
#: Topics whose newest message also goes to readers that come later.
LATCHED = {"path"}
#: The robot's own odometry, which is read.
ODOM, ODOM_KIND = "/odom", "nav_msgs/msg/Odometry"
#: Probability from which a match whose position has jumped moves other filters along.
SURE = 0.9
#: Variance of what a match does not measure, in square metres or radians: filters ignore it.
UNKNOWN = 1e6
#: Standard deviation across the route in metres, and the least one along it.
_ACROSS_M = 1.0
#: Variance in square radians of the robot's yaw against the route's direction, of which
#: 15 degrees are assumed, and of a yaw anywhere on the circle.
_ALIGNED, _ANY_YAW = math.radians(15) ** 2, math.pi**2 / 3
#: Of `sensor_msgs/msg/NavSatFix`: a fix without augmentation, by no known satellite system, and a
#: covariance that is approximated.
_STATUS, _APPROXIMATED = {"status": 0, "service": 0}, 1
#: Of `diagnostic_msgs/msg/DiagnosticStatus`.
OK, WARN, ERROR = 0, 1, 2
#: Silence in seconds that is an error.
_SILENT_S = 2.0


#: Largest distance in metres, and largest time in seconds.
_FARTHEST_M, _LONGEST_S = 1e9, 1e9
#: Least and largest value of each number that messages are made of.
_RANGES = {
    "probability": (0.0, 1.0),
    "missing": (0.0, 1.0),
    "latitude": (-90.0, 90.0),
    "longitude": (-180.0, 180.0),
    "silent_s": (0.0, _LONGEST_S),
    "heading_deg": (-360.0, 360.0),
    "jumps": (0, 1e15),
    **dict.fromkeys(
        ("x_m", "y_m", "z_m", "along_m", "along_from_m", "along_to_m", "route_m"),
        (-_FARTHEST_M, _FARTHEST_M),
    ),
}
#: End of the times that a header can have, in microseconds.
_STAMP_END_US = 2**31 * 1_000_000


def host_us_of(row: Mapping[str, Any]) -> int | None:
    """Return when a row was written, in microseconds; None for rows without a time of their own."""
    host_us = row.get("host_us")
    if host_us is None:
        return None
    if type(host_us) is not int or not 0 <= host_us < _STAMP_END_US:
        raise ValueError(f"host_us {_shown(host_us)}: expected microseconds since 1970")
    return host_us


def _number(row: Mapping[str, Any], name: str) -> float | None:
    """Return a number of a row, checked; None if it is not known."""
    value = row.get(name)
    if value is None:
        return None
    low, high = _RANGES[name]
    # NaN is in no range
    if type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(f"{name} {_shown(value)}: expected {low:g} to {high:g}")
    return float(value)


def _flag(row: Mapping[str, Any], name: str) -> bool:
    value = row.get(name)
    if type(value) is not bool:
        raise ValueError(f"{name} {_shown(value)}: expected true or false")
    return value


def _shown(value: object) -> str:
    return _text(repr(value)[:40])


def _text(value: object) -> str:
    """Return text that every message can hold: without NUL and lone surrogates."""
    return str(value).encode(errors="backslashreplace").decode().replace("\0", "\\0")


def variance_m2(row: Mapping[str, Any]) -> float | None:
    """Return the variance of a match along the route, in square metres; None if it is not known.

    The true place lies in the interval of the exclusion zone with the match's probability, and
    anywhere on the route otherwise; within both, no place is more likely than another.

    Parameters
    ----------
    row : mapping
        Of a match on a map with positions.
    """
    needed = ("along_m", "along_from_m", "along_to_m", "route_m", "probability")
    numbers = [number for name in needed if (number := _number(row, name)) is not None]
    if len(numbers) < len(needed):
        return None
    along_m, from_m, to_m, route_m, probability = numbers
    if from_m > to_m or route_m < 0:
        raise ValueError(f"from {from_m} to {to_m} of {route_m} m: expected an interval of a route")
    near = _around(along_m, from_m, to_m)
    return max(probability * near + (1 - probability) * _around(along_m, 0, route_m), _ACROSS_M**2)


def _around(middle: float, low: float, high: float) -> float:
    """Return the mean square distance from `middle` of a point anywhere between two others."""
    if high <= low:
        return 0.0
    return float(((high - middle) ** 3 - (low - middle) ** 3) / (3 * (high - low)))


class Travelled:
    """Adds up the distance along the robot's own direction, from poses of its odometry.

    Parameters
    ----------
    zero_m : float
        Distance at the first pose, in metres.
    """

    def __init__(self, zero_m: float) -> None:
        self._metres, self._before = zero_m, (math.nan, math.nan)

    def to(self, pose: Any) -> float | None:
        """Return the distance at a pose, in metres; None if the pose is not a number.

        Parameters
        ----------
        pose : object
            Of the type ``geometry_msgs/msg/Pose``.
        """
        at, turned = pose.position, pose.orientation
        east = 1 - 2 * (turned.y**2 + turned.z**2)
        north = 2 * (turned.x * turned.y + turned.w * turned.z)
        if not math.isfinite(at.x + at.y + east + north):
            return None
        x, y = self._before
        if not math.isnan(x):
            self._metres += (at.x - x) * east + (at.y - y) * north
        self._before = at.x, at.y
        return self._metres


class Translator:
    """Convert rows to messages; compare each row of health and match with the previous one.

    Attributes
    ----------
    left_out : int
        Invalid rows, counted by the caller; part of the diagnosis.
    """

    def __init__(self, frames: Frames) -> None:
        self.left_out = 0
        self._frames = frames
        self._before: dict[str, int] = {}
        self._jumps: float | None = None  # at the last sure pose

    def messages_of(self, row: Mapping[str, Any], stamp_us: int) -> list[Message]:
        """Return the messages of a row.

        A match that is lost, or whose probability is not known, has no position: a node that
        steers by it would take it for one.

        Parameters
        ----------
        row : mapping
            As read.
        stamp_us : int
            Time of the messages, in microseconds.

        Raises
        ------
        ValueError
            If a value is of another type than edge-vpr writes, or out of its range.
        """
        kind = row.get("kind")
        if kind == "match":
            return list(self._of_match(row, stamp_us))
        if kind == "health":
            return [self._health(row, stamp_us)]
        if kind == "route" and "x_m" in row:
            return [self._path(row, stamp_us)]
        return []

    def _of_match(self, row: Mapping[str, Any], stamp_us: int) -> Iterator[Message]:
        frames, probability, lost = self._frames, _number(row, "probability"), _flag(row, "lost")
        missing, variance = _number(row, "missing"), variance_m2(row)
        # lone surrogates and NUL are escaped in it
        text = json.dumps(row, allow_nan=False)
        yield Message("match", {"data": text})
        if probability is not None:
            vector = {"x": probability, "y": float(lost), "z": missing or 0.0}
            yield Message("certainty", {"header": _header(stamp_us, frames.map), "vector": vector})
        if lost or variance is None:
            return
        along = {"x": float(row["along_m"])}
        odometry = {
            "header": _header(stamp_us, frames.route),
            "child_frame_id": frames.child,
            "pose": _pose(along, (variance, _ACROSS_M**2, UNKNOWN)),
            # the speed is not known from a match
            "twist": {"covariance": _diagonal((UNKNOWN,) * 6)},
        }
        yield Message("odometry", odometry)
        if row.get("x_m") is not None:
            yield from self._pose(row, variance, stamp_us)
        latitude, longitude = _number(row, "latitude"), _number(row, "longitude")
        if latitude is not None and longitude is not None:
            fix = {
                "header": _header(stamp_us, frames.sensor),
                "status": _STATUS,
                "latitude": latitude,
                "longitude": longitude,
                "altitude": 0.0,  # no height is known; navsat_transform throws a NaN away
                "position_covariance": _diagonal((variance, variance, UNKNOWN)),
                "position_covariance_type": _APPROXIMATED,
            }
            yield Message("fix", fix)

    def _pose(self, row: Mapping[str, Any], variance: float, stamp_us: int) -> Iterator[Message]:
        # one variance for all of the plane: the interval can lie round a bend
        point, turned = _placed(row)
        height = UNKNOWN if row.get("z_m") is None else variance
        pose = _pose(point, (variance, variance, height))
        probability, jumps = _number(row, "probability") or 0.0, _number(row, "jumps")
        if turned is not None:
            pose["pose"]["orientation"] = turned
            pose["covariance"][-1] = probability * _ALIGNED + (1 - probability) * _ANY_YAW
        fields = {"header": _header(stamp_us, self._frames.map), "pose": pose}
        yield Message("pose", fields)
        if probability >= SURE:
            if self._jumps not in (None, jumps):
                yield Message("/initialpose", fields)
            self._jumps = jumps

    def _path(self, row: Mapping[str, Any], stamp_us: int) -> Message:
        header, poses = _header(stamp_us, self._frames.map), []
        names = [name for name in ("x_m", "y_m", "z_m", "heading_deg") if name in row]
        columns = [row[name] for name in names]
        if not all(isinstance(column, list) for column in columns):
            raise ValueError(f"route of {_shown(columns)}: expected lists of numbers")
        for values in zip(*columns, strict=True):
            place = dict(zip(names, values, strict=True))
            if place["x_m"] is not None:
                point, turned = _placed(place)
                pose = {"position": point, "orientation": turned or {"w": 1.0}}
                poses.append({"header": header, "pose": pose})
        return Message("path", {"header": header, "poses": poses})

    def _health(self, row: Mapping[str, Any], stamp_us: int) -> Message:
        silent_s = _number(row, "silent_s") or 0.0
        values = {**row, "rows_left_out": self.left_out}
        faults = values.pop("faults", {})
        if type(faults) is not dict or not all(type(count) is int for count in faults.values()):
            raise ValueError(f"faults {_shown(faults)}: expected counts by their names")
        counts = {**faults, "rows_left_out": self.left_out}
        grown = [
            _text(name).replace("_", " ")
            for name, value in counts.items()
            if value > self._before.get(name, 0)
        ]
        self._before = counts
        level, text = OK, "no new faults"
        if grown:
            level, text = WARN, f"more {', '.join(grown)}"
        if silent_s > _SILENT_S:
            level, text = ERROR, f"nothing came for {silent_s:.0f} s"
        if row.get("lost_link"):
            level, text = ERROR, f"the link is lost: {_text(row['lost_link'])}"
        return diagnosis(level, text, values, stamp_us)


def diagnosis(level: int, text: str, values: Mapping[str, Any], stamp_us: int) -> Message:
    """Return a diagnosis of the camera.

    Parameters
    ----------
    level : int
        `OK`, `WARN` or `ERROR`.
    text : str
        For people.
    values : mapping
        Counts beside it, by name.
    stamp_us : int
        Time of the message, in microseconds.
    """
    status = {
        "level": level, "name": "edge_vpr: camera", "message": _text(text),
        "values": [{"key": _text(name), "value": _text(each)} for name, each in values.items()],
        "hardware_id": "event camera",
    }  # fmt: skip
    fields = {"header": _header(stamp_us, ""), "status": [status]}
    return Message("/diagnostics", fields)


def _header(stamp_us: int, frame: str) -> dict[str, Any]:
    seconds, rest_us = divmod(stamp_us, 1_000_000)
    return {"stamp": {"sec": seconds, "nanosec": 1_000 * rest_us}, "frame_id": frame}


def _placed(row: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, float] | None]:
    """Return the point of a row in the plane of the map, and its orientation if it is known."""
    point = {axis: _number(row, f"{axis}_m") or 0.0 for axis in "xyz"}
    heading_deg = _number(row, "heading_deg")
    if heading_deg is None:
        return point, None
    # clockwise from north, against anticlockwise from east (REP 103)
    half = math.radians(90 - heading_deg) / 2
    return point, {"z": math.sin(half), "w": math.cos(half)}


def _pose(point: dict[str, float], variances: tuple[float, float, float]) -> dict[str, Any]:
    """Return a pose with covariance, whose direction is not known."""
    return {
        "pose": {"position": point, "orientation": {"w": 1.0}},
        "covariance": _diagonal((*variances, UNKNOWN, UNKNOWN, UNKNOWN)),
    }


def _diagonal(variances: tuple[float, ...]) -> list[float]:
    """Return a diagonal matrix, row by row."""
    n = len(variances)
    return [variances[i] if i == j else 0.0 for i in range(n) for j in range(n)]
