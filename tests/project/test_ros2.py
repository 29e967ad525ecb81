"""What the adapter for ROS 2 publishes is of ROS 2's own types, and arrives."""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
import re
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from edge_vpr_tools.live_view import row_of
from edge_vpr_tools.publish import MatchServer

from edge_vpr.matching.match import Match
from tests.live.devices import wait_until

ADAPTER = Path(__file__).parents[2] / "tools/adapters/ros2"


@pytest.fixture(scope="module", autouse=True)
def package():
    """The adapter as a package, as colcon installs it."""
    sys.path.insert(0, str(ADAPTER))
    yield
    sys.path.remove(str(ADAPTER))


@pytest.fixture(scope="module")
def messages(package):
    return importlib.import_module("edge_vpr_ros.messages")


@pytest.fixture(scope="module")
def types():
    """The types of ROS 2, with their bytes."""
    typesys = pytest.importorskip("rosbags.typesys", reason="it knows the types of ROS 2")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def built(types, kind, fields):
    """Build a message as rclpy does: what is left out is 0 or empty, and a rotation is by 0."""
    names = [name for name, _ in types.get_msgdef(kind).fields]
    assert set(fields) <= set(names)
    return types.types[kind](
        *(value_of(types, of, fields.get(name), name) for name, of in types.get_msgdef(kind).fields)
    )


def value_of(types, of, value, name):
    sort, what = of[0].name, of[1]
    if sort == "NAME":
        return built(types, what, value or {})
    if sort == "BASE":
        return value if value is not None else "" if what[0] == "string" else int(name == "w")
    inner, number = what
    items = value or [0] * number
    assert sort == "SEQUENCE" or len(items) == number
    if inner[0].name == "NAME":
        return [built(types, inner[1], item) for item in items]
    return np.array(items, dtype=inner[1][0])


def row(**more):
    match = Match(
        time_us=0, query=0, place=7, distance=0.0, second=0, second_distance=0.0, ratio=0.0,
        ties=0, events=0, start_us=0, trust=0, misfit=0, probability=0.875, lost=False, missing=0.0,
        age_s=0.0, host_us=STAMP_US, jumps=0,
    )  # fmt: skip
    return {**json.loads(row_of(match)), **more}


ALONG = {"along_m": 40.0, "along_from_m": 37.0, "along_to_m": 43.0, "route_m": 170.0}
METRIC = {"x_m": 1.5, "y_m": -2.0, "heading_deg": 300.0, **ALONG}
ON_EARTH = {"latitude": -27.5, "longitude": 153.0, **ALONG}
STAMP_US = 1_700_000_000_250_001


def by_topic(messages, message, **frames):
    translator = messages.Translator(messages.Frames(map="street", **frames))
    return {each.topic: each.fields for each in translator.messages_of(message, STAMP_US)}


def test_a_match_is_a_pose_stamped_with_the_hosts_time_and_a_covariance(messages):
    topics_of_row = by_topic(messages, row(**METRIC))
    assert set(topics_of_row) == {"match", "certainty", "pose", "odometry"}
    assert topics_of_row["pose"]["header"] == {
        "stamp": {"sec": 1_700_000_000, "nanosec": 250_001_000}, "frame_id": "street",
    }  # fmt: skip
    assert topics_of_row["pose"]["pose"]["pose"]["position"] == {"x": 1.5, "y": -2.0, "z": 0.0}
    assert json.loads(topics_of_row["match"]["data"])["place"] == 7
    assert topics_of_row["certainty"]["vector"] == {"x": 0.875, "y": 0.0, "z": 0.0}
    assert topics_of_row["certainty"]["header"]["stamp"] == topics_of_row["pose"]["header"]["stamp"]
    assert topics_of_row["odometry"]["pose"]["pose"]["position"] == {"x": 40.0}
    assert topics_of_row["odometry"]["header"]["frame_id"] == "route"
    assert topics_of_row["odometry"]["child_frame_id"] == "base_link"
    covariance = np.reshape(topics_of_row["pose"]["pose"]["covariance"], (6, 6))
    assert np.array_equal(covariance, np.diag(np.diag(covariance)))
    # height, roll and pitch are not known
    assert (np.diag(covariance)[2:5] == messages.UNKNOWN).all()


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 180.0, 300.0])
def test_the_yaw_is_the_direction_of_the_route_from_east_anticlockwise(messages, heading_deg):
    spread = []
    for probability in (1.0, 0.5, 0.0):
        fields = {**METRIC, "heading_deg": heading_deg, "probability": probability}
        pose = by_topic(messages, row(**fields))["pose"]["pose"]
        turned = pose["pose"]["orientation"]
        ahead = complex(turned["w"], turned["z"]) ** 2  # a quaternion has half of the angle
        north, east = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
        assert ahead == pytest.approx(complex(east, north))
        spread.append(pose["covariance"][-1])
    assert spread == sorted(spread)
    # a uniform angle on the circle
    assert spread[-1] == pytest.approx(math.pi**2 / 3)
    unknown = by_topic(messages, row(**{**METRIC, "heading_deg": None}))["pose"]["pose"]
    assert unknown["covariance"][-1] == messages.UNKNOWN


def test_the_variance_is_that_of_where_the_robot_can_be(messages):
    """Within the interval with the match's probability, anywhere on the route otherwise."""
    rng = np.random.default_rng(0)
    for probability in (1.0, 0.875, 0.36, 0.0):
        n = 400_000
        near, far = rng.uniform(37, 43, n), rng.uniform(0, 170, n)
        true = np.where(rng.random(n) < probability, near, far)
        variance = messages.variance_m2(row(**{**METRIC, "probability": probability}))
        assert variance == pytest.approx(np.mean((true - 40.0) ** 2), rel=0.02)
        pose = by_topic(messages, row(**{**METRIC, "probability": probability}))["pose"]["pose"]
        assert pose["covariance"][0] == variance


def test_a_lost_match_has_no_position_and_what_is_unknown_is_not_published(messages):
    assert set(by_topic(messages, row(lost=True, **METRIC))) == {"match", "certainty"}
    unknown = dict.fromkeys(METRIC)
    assert set(by_topic(messages, row(**{**METRIC, "probability": None}))) == {"match"}
    assert set(by_topic(messages, row(**unknown))) == {"match", "certainty"}
    topics_of_row = by_topic(messages, row(**ON_EARTH))
    assert set(topics_of_row) == {"match", "fix", "odometry", "certainty"}
    assert topics_of_row["fix"]["header"]["frame_id"] == "camera"
    assert (
        topics_of_row["fix"]["position_covariance"][0]
        == topics_of_row["odometry"]["pose"]["covariance"][0]
    )
    assert not by_topic(messages, {"kind": "device", "text": "gone"})


def test_health_is_a_diagnosis_of_what_is_new(messages):
    translator = messages.Translator(messages.Frames())

    def diagnosed(**counts):
        faults = {"resyncs": 3, **counts.pop("faults", {})}
        health = {"kind": "health", "faults": faults, "silent_s": 0.0, "lag_us": 5, **counts}
        (message,) = translator.messages_of(health, STAMP_US)
        (status,) = message.fields["status"]
        assert {"key": "lag_us", "value": "5"} in status["values"]
        return status["level"], status["message"]

    assert diagnosed() == (messages.WARN, "more resyncs")
    assert diagnosed() == (messages.OK, "no new faults")
    more = {"resyncs": 4, "crc_errors": 1}
    assert diagnosed(faults=more) == (messages.WARN, "more resyncs, crc errors")
    assert diagnosed(faults=more, silent_s=3.2)[0] == messages.ERROR
    lost = diagnosed(faults=more, lost_link="/dev/ttyACM0 was lost")
    assert lost == (messages.ERROR, "the link is lost: /dev/ttyACM0 was lost")
    assert diagnosed(faults=more, lost_link="")[0] == messages.OK


def test_the_route_is_a_path_of_the_places_whose_position_is_known(messages):
    route = {"kind": "route", "places": 3, "x_m": [1.0, None, 3.0], "y_m": [0.0, None, 4.0]}
    route |= {"along_m": [0.0, None, 4.5], "heading_deg": [90.0, None, None]}
    path = by_topic(messages, route)["path"]
    assert path["header"]["frame_id"] == "street"
    poses = [each["pose"] for each in path["poses"]]
    assert [each["position"] for each in poses] == [
        {"x": 1.0, "y": 0.0, "z": 0.0}, {"x": 3.0, "y": 4.0, "z": 0.0},
    ]  # fmt: skip
    assert [each["orientation"]["w"] for each in poses] == [1.0, 1.0]  # both look along x
    for unplaced in ({"kind": "route", "places": 3}, {"kind": "route", "latitude": [1.0]}):
        assert not by_topic(messages, unplaced)
    for bad in ({"y_m": [0.0]}, {"x_m": 1.0}, {"x_m": ["1", 2.0, 3.0]}):
        with pytest.raises(ValueError):
            by_topic(messages, {**route, **bad})


def test_a_jump_sets_the_pose_of_other_filters_once_the_match_is_sure(messages):
    translator = messages.Translator(messages.Frames())

    def topics(**more):
        return [each.topic for each in translator.messages_of(row(**METRIC, **more), STAMP_US)]

    def reset(**more):
        published = topics(**more)
        assert ("pose" in published) == (not more.get("lost"))
        return "/initialpose" in published

    assert not reset(probability=0.95, jumps=2)  # at first: the filter starts anywhere
    assert not reset(probability=0.95, jumps=2)
    assert not reset(probability=0.5, jumps=3)  # it may jump back
    assert not reset(probability=0.95, jumps=3, lost=True)
    assert reset(probability=0.95, jumps=3)
    assert not reset(probability=0.95, jumps=3)
    assert reset(probability=0.95, jumps=0)  # another run


def pose(x, y, yaw, **more):
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return SimpleNamespace(
        position=SimpleNamespace(x=x, y=y, z=0.0), orientation=SimpleNamespace(**{**turned, **more})
    )


def test_odometry_is_the_distance_along_the_robots_direction(messages):
    travelled = messages.Travelled(100.0)
    # east, then round to north, then back without turning, then carried sideways
    along = [
        travelled.to(pose(*each))
        for each in ((5, 5, 0), (7, 5, 0), (7, 5, math.pi / 2), (7, 8, math.pi / 2),
                     (7, 7, math.pi / 2), (9, 7, math.pi / 2))
    ]  # fmt: skip
    assert along == pytest.approx([100, 102, 102, 105, 104, 104])
    assert travelled.to(pose(math.nan, 0, 0)) is None
    assert travelled.to(pose(9, 9, 0, w=math.inf)) is None
    assert travelled.to(pose(9, 8, math.pi / 2)) == pytest.approx(105)


ROUTE = {"kind": "route", "places": 2, "x_m": [1.0, 2.0], "y_m": [3.0, 4.0]}
HEALTH = {"kind": "health", "faults": {"resyncs": 3}, "silent_s": 0.5, "bytes": 7}


def test_every_message_has_the_fields_that_ros_2_gives_it(messages, types):
    seen = set()
    translator = messages.Translator(messages.Frames())
    for source in (row(**METRIC), row(**ON_EARTH), HEALTH, ROUTE):
        for message in translator.messages_of(source, STAMP_US):
            seen.add(message.kind)
            assert types.serialize_cdr(built(types, message.kind, message.fields), message.kind)
    assert seen == set(messages.TOPICS.values())


BAD_VALUES = [
    -1e308, 1e308, math.nan, math.inf, 2**63, -(10**400), "x", "5.0", "\ud800", "\0", None, True,
    [], {"a": "\udfff"}, [math.nan],
]  # fmt: skip


class Recorder:
    """A node that builds and writes what a reader would get."""

    def __init__(self, types):
        self._types, self.sent, self.said = types, [], []

    def publish(self, message):
        made = built(self._types, message.kind, message.fields)
        self._types.serialize_cdr(made, message.kind)
        self.sent.append(message)

    def stamp_us(self, host_us):
        return host_us

    def log(self, text):
        text.encode()
        self.said.append(text)


def test_a_bad_row_is_left_out_and_counted_and_the_next_one_is_published(messages, types):
    """Each value of a row replaced by each that is none; numbers that are sent are finite."""
    node = importlib.import_module("edge_vpr_ros.node")
    lost = {**HEALTH, "host_us": STAMP_US, "lost_link": "gone"}
    for good in (row(**METRIC), row(**ON_EARTH), lost, ROUTE):
        bad = [{**good, name: value} for name in good for value in BAD_VALUES]
        bad += [{**good, value: 1} for value in ("\ud800", "\0")]
        bad += [{name: value for name, value in good.items() if name != left} for left in good]
        for each in bad:
            to, translator = Recorder(types), messages.Translator(messages.Frames())
            for line in (each, HEALTH, row(**METRIC)):
                node.publish_line(json.dumps(line).encode(), translator, to)
            topics = [message.topic for message in to.sent]
            for_sure = [each for each in topics if each != "/initialpose"]
            assert for_sure[-5:] == ["/diagnostics", "match", "certainty", "odometry", "pose"]
            diagnosis = next(each for each in to.sent[::-1] if each.topic == "/diagnostics")
            diagnosis = diagnosis.fields["status"][0]
            counted = {"key": "rows_left_out", "value": str(len(to.said))}
            assert counted in diagnosis["values"]
            assert translator.left_out == len(to.said) <= 1
            assert_finite([message.fields for message in to.sent])
            if good["kind"] == "match" and to.said:
                assert len(topics) == 5  # nothing of the bad one
            if to.said:
                assert (diagnosis["level"], "rows left out" in diagnosis["message"]) == (1, True)


def assert_finite(fields):
    if isinstance(fields, dict):
        for name, value in fields.items():
            if name == "data":
                json.loads(value, parse_constant=pytest.fail)
            elif name != "altitude":  # it is never known
                assert_finite(value)
    elif isinstance(fields, list):
        for each in fields:
            assert_finite(each)
    elif isinstance(fields, float):
        assert math.isfinite(fields)


@pytest.mark.parametrize(
    "line", [b"\xff\n", b"[]\n", b"GET / HTTP/1.1\r\n", b"1" * 5_000, b"[" * 100_000, b'{"kind": ']
)
def test_a_line_that_is_no_row_is_counted(messages, line):
    node = importlib.import_module("edge_vpr_ros.node")
    to, translator = Recorder(None), messages.Translator(messages.Frames())
    for _ in range(5):
        node.publish_line(line, translator, to)
    assert translator.left_out == 5
    assert [text.split(",")[0] for text in to.said] == [f"rows left out: {n}" for n in (1, 2, 4)]
    assert max(map(len, to.said)) < 300


def test_a_node_whose_thread_dies_ends(messages, monkeypatch, capsys):
    """It lived on, and published nothing."""
    node = importlib.import_module("edge_vpr_ros.node")

    class Broken(Recorder):
        def __init__(self, arguments, words):
            super().__init__(None)
            self.connect, self.odometry_to, self.frames = arguments.connect, "", messages.Frames()

        def publish(self, message):
            raise RuntimeError("no more topics")

        def log(self, text):
            print(text, file=sys.stderr)

        def spin(self, ended):
            ended.wait()

    monkeypatch.setattr(node, "RosNode", Broken)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            sock, _ = server.accept()
            with sock:
                head = b"HTTP/1.0 200 OK\r\n\r\n"
                sock.sendall(head + b"data: " + json.dumps(HEALTH).encode() + b"\n\n")
                sock.recv(1)

        thread = threading.Thread(target=serve)
        thread.start()
        address = f"127.0.0.1:{server.getsockname()[1]}"
        assert node.main(["--connect", address]) == 1
        thread.join()
    assert capsys.readouterr().err == "the node ends: RuntimeError: no more topics\n"


def test_rows_of_a_server_are_published_until_it_is_gone_which_is_said(messages, types):
    """Its last diagnosis does not stay on what it was."""
    node = importlib.import_module("edge_vpr_ros.node")
    to, ended = Recorder(types), threading.Event()
    to.frames = messages.Frames()
    topics = {*messages.TOPICS} - {"/initialpose"}
    with MatchServer("0") as server:
        to.connect = server.address.removeprefix("http://").rstrip("/")
        thread = threading.Thread(target=node.follow_server, args=(to, False, ended))
        thread.start()

        def all_came():
            for each in (ROUTE, row(**METRIC), row(**ON_EARTH), HEALTH):
                server.send(each["kind"], json.dumps(each))
            return {each.topic for each in [*to.sent]} >= topics

        wait_until(all_came)
    number = len(to.sent)
    wait_until(lambda: to.said)
    ended.set()
    thread.join()
    assert "; trying again" in to.said[0]
    levels = [
        each.fields["status"][0]["level"] for each in to.sent[number - 1 :]
        if each.topic == "/diagnostics"
    ]  # fmt: skip
    assert levels[-1] == messages.ERROR


def install(monkeypatch, doubles):
    """Put doubles of modules, with what is called of them, in the place of ROS 2."""
    for name, content in doubles.items():
        double = ModuleType(name)
        vars(double).update(content)
        monkeypatch.setitem(sys.modules, name, double)


class Node:
    """What of a node of rclpy the adapter uses."""

    def __init__(self, parameters):
        self.parameters, self.published, self.heard, self.quality = parameters, {}, {}, {}

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=self.parameters.get(name, value))

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters.get(name))

    def create_publisher(self, kind, topic, quality):
        self.quality[topic] = quality
        return SimpleNamespace(publish=lambda made: self.published.setdefault(topic, made))

    def create_subscription(self, kind, topic, take, quality):
        self.heard[topic], self.quality[topic] = take, quality


def test_a_node_of_rclpy_has_the_names_and_qualities_of_service(messages, monkeypatch):
    """In place of ROS 2 is a double of what is called of it."""
    doubles = {
        "rclpy": {"ok": lambda: True, "init": lambda args: None},
        "rclpy.qos": {
            "QoSProfile": SimpleNamespace,
            "qos_profile_sensor_data": "of a sensor",
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="latched"),
        },
        "rosidl_runtime_py": {"set_message_fields": lambda made, fields: vars(made).update(fields)},
        "rosidl_runtime_py.utilities": {"get_message": lambda kind: SimpleNamespace},
    }
    install(monkeypatch, doubles)
    sys.modules["rclpy"].qos = sys.modules["rclpy.qos"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as odometer:
        odometer.bind(("127.0.0.1", 0))
        to = f"127.0.0.1:{odometer.getsockname()[1]}"
        parameters = {"map_frame": "street", "odometry_to": to, "use_sim_time": False}
        ros = Node(parameters)
        sys.modules["rclpy"].create_node = lambda name: ros
        node = importlib.import_module("edge_vpr_ros.node")
        flags = {"name": "rover", "connect": "127.0.0.1:1", "odometry_to": ""}
        backend = node.RosNode(SimpleNamespace(**flags, **vars(messages.Frames())), [])
        translator = messages.Translator(backend.frames)
        for each in (ROUTE, row(**METRIC), HEALTH):
            node.publish_line(json.dumps(each).encode(), translator, backend)
        with node.forward_odometry(backend):
            ros.heard["/odom"](SimpleNamespace(pose=SimpleNamespace(pose=pose(1.0, 2.0, 0.0))))
        assert odometer.recv(100).endswith(b".000\n")
    assert set(ros.quality) == {
        "~/match", "~/certainty", "~/pose", "~/odometry", "~/fix", "~/path", "/diagnostics",
        "/initialpose", "/odom",
    }  # fmt: skip
    assert vars(ros.quality["~/path"]) == {"depth": 1, "durability": "latched"}
    assert ros.quality["/odom"] == "of a sensor"
    assert ros.published["~/pose"].header["frame_id"] == "street"
    assert len(ros.published["~/path"].poses) == 2
    assert ros.published["/diagnostics"].status[0]["level"] == bytes([messages.WARN])


@pytest.mark.parametrize(
    ("launch_arguments", "started"),
    [
        ({}, ["edge_vpr", "ekf_filter_node"]),
        ({"ekf": "false"}, ["edge_vpr"]),
        (
            {"stream": "--port '/dev/tty A' --map map.npz", "odometry_to": "127.0.0.1:7001"},
            ["edge-vpr stream", "edge_vpr", "ekf_filter_node"],
        ),
    ],
)
def test_the_launch_file_starts_stream_node_and_filter(monkeypatch, launch_arguments, started):
    """In place of ROS 2 is a double of what is called of it."""

    def kept(**named):
        return SimpleNamespace(**named)

    def configuration(name):
        return SimpleNamespace(perform=lambda context: context[name])

    doubles = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: ADAPTER},
        "launch": {"Action": object, "LaunchContext": dict, "LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **rest: (name, rest["default_value"]),
            "ExecuteProcess": kept, "OpaqueFunction": kept,
        },
        "launch.substitutions": {"LaunchConfiguration": configuration},
        "launch_ros.actions": {"Node": kept},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: value},
    }  # fmt: skip
    install(monkeypatch, doubles)
    spec = importlib.util.spec_from_file_location(
        "edge_vpr_launch", ADAPTER / "launch/edge_vpr.launch.py"
    )
    launch = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(launch)
    *declared, opaque = launch.generate_launch_description()
    actions = opaque.function({**dict(declared), **launch_arguments})
    assert [getattr(each, "name", "edge-vpr stream") for each in actions] == started
    for each in actions:
        for parameters in getattr(each, "parameters", ()):
            if isinstance(parameters, str):  # a file of this package
                assert f"\n{each.name}:\n" in f"\n{Path(parameters).read_text()}"
            else:
                assert "" not in parameters.values()
    if launch_arguments.get("stream"):
        assert actions[0].cmd == [
            "edge-vpr", "stream", "--http", "127.0.0.1:7000", "--port", "/dev/tty A",
            "--map", "map.npz", "--odometry", "udp://127.0.0.1:7001",
        ]  # fmt: skip
        assert actions[1].parameters[1]["odometry_to"] == "127.0.0.1:7001"


def test_the_package_names_the_files_that_it_installs():
    """`colcon build` is not tried: no package index has ROS 2."""
    for path in re.findall(
        r'"((?:resource|launch|config)/[^"]+)"', (ADAPTER / "setup.py").read_text()
    ):
        assert (ADAPTER / path).is_file()
    package = ElementTree.parse(ADAPTER / "package.xml").getroot()
    needed = {each.text for each in package.findall("exec_depend")}
    used = re.findall(r'"(\w+)/msg/', (ADAPTER / "edge_vpr_ros/messages.py").read_text())
    assert set(used) <= needed
    assert package.findtext("name") == "edge_vpr_ros"


def refused(*words):
    command = [sys.executable, str(ADAPTER / "edge_vpr_node.py"), *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    return run.stderr


def test_an_address_that_is_none_is_refused():
    assert "expected HOST:PORT" in refused("--connect", "nowhere")


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="ROS 2 is installed")
def test_without_ros_2_the_remedy_is_told():
    assert "source /opt/ros/DISTRIBUTION/setup.bash" in refused()
