"""What the adapter for ROS 2 publishes is of ROS 2's own types, and arrives."""

from __future__ import annotations

import importlib
import importlib.util
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from edge_vpr_tools.live_view import row_of
from edge_vpr_tools.publish import MatchServer

from edge_vpr.live.session import LiveMatch

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
def dds_types(package):
    pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for every machine")
    return importlib.import_module("edge_vpr_ros.dds_types")


def row(**more):
    match = LiveMatch(
        time_s=0.0, query=0, place=7, distance=0.0, second=0, second_distance=0.0, ratio=0.0,
        events=0, start_s=0.0, trust=0, misfit=0, probability=0.875, lost=False, missing=0.0,
        age_s=0.0, host_us=STAMP_US, jumps=0,
    )  # fmt: skip
    return {**json.loads(row_of(match)), **more}


ALONG = {"along_m": 40.0, "along_from_m": 37.0, "along_to_m": 43.0, "route_m": 170.0}
METRIC = {"x_m": 1.5, "y_m": -2.0, "heading_deg": 300.0, **ALONG}
ON_EARTH = {"latitude": -27.5, "longitude": 153.0, **ALONG}
STAMP_US = 1_700_000_000_250_001


def by_topic(messages, found, **frames):
    translator = messages.Translator(messages.Frames(map="street", **frames))
    return {each.topic: each.fields for each in translator.messages_of(found, STAMP_US)}


def test_a_match_is_a_pose_stamped_with_the_hosts_time_and_a_covariance(messages):
    found = by_topic(messages, row(**METRIC))
    assert set(found) == {"match", "certainty", "pose", "odometry"}
    assert found["pose"]["header"] == {
        "stamp": {"sec": 1_700_000_000, "nanosec": 250_001_000}, "frame_id": "street",
    }  # fmt: skip
    assert found["pose"]["pose"]["pose"]["position"] == {"x": 1.5, "y": -2.0, "z": 0.0}
    assert json.loads(found["match"]["data"])["place"] == 7
    assert found["certainty"]["vector"] == {"x": 0.875, "y": 0.0, "z": 0.0}
    assert found["certainty"]["header"]["stamp"] == found["pose"]["header"]["stamp"]
    assert found["odometry"]["pose"]["pose"]["position"] == {"x": 40.0}
    assert found["odometry"]["header"]["frame_id"] == "route"
    assert found["odometry"]["child_frame_id"] == "base_link"
    covariance = np.reshape(found["pose"]["pose"]["covariance"], (6, 6))
    assert np.array_equal(covariance, np.diag(np.diag(covariance)))
    # height, roll and pitch are not known
    assert (np.diag(covariance)[2:5] == messages.UNKNOWN).all()
    assert set(by_topic(messages, row(**METRIC), tf=True)) == {*found, "/tf"}


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 180.0, 300.0])
def test_the_yaw_is_the_direction_of_the_route_from_east_anticlockwise(messages, heading_deg):
    spread = []
    for probability in (1.0, 0.5, 0.0):
        given = {**METRIC, "heading_deg": heading_deg, "probability": probability}
        pose = by_topic(messages, row(**given))["pose"]["pose"]
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
    sure = by_topic(messages, row(**{**METRIC, "probability": 0.99}))
    unsure = by_topic(messages, row(**{**METRIC, "probability": 0.36}))
    spread = [math.sqrt(each["pose"]["pose"]["covariance"][0]) for each in (sure, unsure)]
    page = " ".join((ADAPTER.parents[2] / "docs/interfaces.md").read_text().split())
    low, high = spread
    assert f"{low:.0f} m (standard deviation) at probability 0.99 and {high:.0f} m at 0.36" in page


def test_a_lost_match_has_no_position_and_what_is_unknown_is_not_published(messages):
    assert set(by_topic(messages, row(lost=True, **METRIC))) == {"match", "certainty"}
    unknown = dict.fromkeys(METRIC)
    assert set(by_topic(messages, row(**{**METRIC, "probability": None}))) == {"match"}
    assert set(by_topic(messages, row(**unknown))) == {"match", "certainty"}
    found = by_topic(messages, row(**ON_EARTH))
    assert set(found) == {"match", "fix", "odometry", "certainty"}
    assert found["fix"]["header"]["frame_id"] == "camera"
    assert found["fix"]["position_covariance"][0] == found["odometry"]["pose"]["covariance"][0]
    assert not by_topic(messages, {"kind": "device", "text": "gone"})


def test_health_is_a_diagnosis_of_what_is_new(messages):
    translator = messages.Translator(messages.Frames())

    def diagnosed(**counts):
        given = {"kind": "health", "resyncs": 3, "silent_s": 0.0, "lag_us": 5, **counts}
        (message,) = translator.messages_of(given, STAMP_US)
        (status,) = message.fields["status"]
        assert {"key": "lag_us", "value": "5"} in status["values"]
        return status["level"], status["message"]

    assert diagnosed() == (messages.WARN, "more resyncs")
    assert diagnosed() == (messages.OK, "no new faults")
    assert diagnosed(resyncs=4, crc_errors=1) == (messages.WARN, "more resyncs, crc errors")
    assert diagnosed(resyncs=4, crc_errors=1, silent_s=3.2)[0] == messages.ERROR
    assert not list(translator.messages_of({"kind": "link", "text": "lost; trying again"}, 0))
    assert diagnosed(resyncs=4, crc_errors=1) == (messages.ERROR, "lost; trying again")
    list(translator.messages_of({"kind": "link", "text": "open again"}, 0))
    assert diagnosed(resyncs=4, crc_errors=1)[0] == messages.OK


HEALTH = {"kind": "health", "resyncs": 3, "silent_s": 0.5, "bytes": 7}


def test_every_type_has_the_bytes_that_ros_2_gives_it(messages, dds_types):
    typesys = pytest.importorskip("rosbags.typesys", reason="it knows the types of ROS 2")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    # of tf2_msgs, which are no common types
    tf = typesys.get_types_from_msg(
        "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
    )
    if "tf2_msgs/msg/TFMessage" not in store.fielddefs:
        store.register(tf)
    seen = set()
    translator = messages.Translator(messages.Frames(tf=True))
    for found in (row(**METRIC), row(**ON_EARTH), HEALTH):
        for message in translator.messages_of(found, STAMP_US):
            seen.add(message.kind)
            kind = dds_types.TYPES[message.kind]
            name = kind.__idl_typename__.replace(".", "::")
            package, _, last = message.kind.rpartition("/msg/")
            assert name == f"{package}::msg::dds_::{last}_"
            sample = dds_types.build(kind, dict(message.fields))
            theirs = store.deserialize_cdr(sample.serialize(), message.kind)
            assert_same(message.fields, theirs)
            again = bytes(store.serialize_cdr(theirs, message.kind))
            # some pad the end to four bytes
            assert sample.serialize().rstrip(b"\0") == again.rstrip(b"\0")
    assert seen == set(dds_types.TYPES)


def assert_same(given, theirs):
    for name, value in given.items():
        if isinstance(value, dict):
            assert_same(value, getattr(theirs, name))
        elif isinstance(value, list) and isinstance(value[0], dict):
            for one, other in zip(value, getattr(theirs, name), strict=True):
                assert_same(one, other)
        elif isinstance(value, list):
            assert list(getattr(theirs, name)) == value
        elif isinstance(value, float) and math.isnan(value):
            assert math.isnan(getattr(theirs, name))
        else:
            assert getattr(theirs, name) == value


BAD_VALUES = [
    -1e308, 1e308, math.nan, math.inf, 2**63, -(10**400), "x", "5.0", "\ud800", "\0", None, True,
    [], {"a": "\udfff"}, [math.nan],
]  # fmt: skip


class Recorder:
    """A backend that builds and writes what a reader would get."""

    def __init__(self, dds_types):
        self._dds, self.sent, self.said = dds_types, [], []

    def publish(self, message):
        sample = self._dds.build(self._dds.TYPES[message.kind], dict(message.fields))
        sample.serialize()
        self.sent.append(message)

    def stamp_us(self, host_us):
        return host_us

    def log(self, text):
        text.encode()
        self.said.append(text)


def test_a_bad_row_is_left_out_and_counted_and_the_next_one_is_published(messages, dds_types):
    """Each value of a row replaced by each that is none; numbers that are sent are finite."""
    node = importlib.import_module("edge_vpr_ros.node")
    link = {"kind": "link", "text": "lost; trying again"}
    for good in (row(**METRIC), row(**ON_EARTH), {**HEALTH, "host_us": STAMP_US}, link):
        bad = [{**good, name: value} for name in good for value in BAD_VALUES]
        bad += [{**good, value: 1} for value in ("\ud800", "\0")]
        bad += [{name: value for name, value in good.items() if name != left} for left in good]
        for each in bad:
            to, translator = Recorder(dds_types), messages.Translator(messages.Frames(tf=True))
            for line in (each, HEALTH, row(**METRIC)):
                node.publish_line(json.dumps(line).encode(), translator, to)
            topics = [message.topic for message in to.sent]
            assert topics[-6:] == ["/diagnostics", "match", "certainty", "odometry", "pose", "/tf"]
            diagnosis = to.sent[-6].fields["status"][0]
            counted = {"key": "rows_left_out", "value": str(len(to.said))}
            assert counted in diagnosis["values"]
            assert translator.left_out == len(to.said) <= 1
            assert_finite([message.fields for message in to.sent])
            if good["kind"] == "match" and to.said:
                assert len(topics) == 6  # nothing of the bad one
            if to.said and each.get("kind") != "link":
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


def test_a_node_whose_thread_dies_ends(messages, dds_types, monkeypatch, capsys):
    """It lived on, and published nothing."""
    node = importlib.import_module("edge_vpr_ros.node")

    class Broken(node.DdsBackend):
        def __init__(self, arguments):
            self.connect, self.frames = arguments.connect, messages.Frames()
            self._signalled = threading.Event()

        def publish(self, message):
            raise RuntimeError("no more topics")

    monkeypatch.setattr(node, "DdsBackend", Broken)
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
        assert node.main(["--dds", "--connect", address]) == 1
        thread.join(10)
    assert capsys.readouterr().err == "the node ends: RuntimeError: no more topics\n"


def participant_of(messages, dds_types, *topics):
    """Another participant of DDS with a reader for each topic, and its domain."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    domain = 77 + os.getpid() % 100
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)))
    readers = {}
    for topic in topics:
        name = f"rt{topic}" if topic.startswith("/") else f"rt/rover/{topic}"
        kind = dds_types.TYPES[messages.TOPICS[topic]]
        readers[topic] = DataReader(participant, Topic(participant, name, kind), qos=reliable)
    return readers, domain


def started(domain, *words):
    return subprocess.Popen(
        [sys.executable, str(ADAPTER / "edge_vpr_node.py"), "--dds", "--name", "rover", *words],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)}, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_rows_of_a_server_arrive_at_another_participant(messages, dds_types):
    topics = ("pose", "odometry", "certainty", "fix", "/diagnostics", "/tf")
    readers, domain = participant_of(messages, dds_types, *topics)
    stop = threading.Event()

    def serve(server):
        while not stop.wait(0.05):
            for each in (row(**METRIC), row(**ON_EARTH), HEALTH):
                server.send(each["kind"], json.dumps(each))

    with MatchServer("0") as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        address = server.address.removeprefix("http://").rstrip("/")
        node = started(domain, "--connect", address, "--once", "--tf")
        try:
            samples = dict.fromkeys(topics, ())
            end = time.monotonic() + 60
            while not all(samples.values()) and time.monotonic() < end and node.poll() is None:
                samples = {t: samples[t] or readers[t].take(1) for t in topics}
                time.sleep(0.02)
        finally:
            stop.set()
            thread.join()
    with node:
        try:
            assert node.wait(20) == 0, node.stderr.read()
        finally:
            node.kill()  # else leaving the block would wait for it
    pose, odometry = samples["pose"][0], samples["odometry"][0]
    assert pose.pose.pose.position.x == 1.5
    assert pose.header.frame_id == "map"
    assert pose.pose.covariance[0] == odometry.pose.covariance[0] > 1
    assert odometry.pose.pose.position.x == 40.0
    assert samples["certainty"][0].vector.x == 0.875
    assert samples["fix"][0].latitude == -27.5
    assert samples["/diagnostics"][0].status[0].name == "edge_vpr: camera"
    assert samples["/tf"][0].transforms[0].child_frame_id == "base_link"


def test_a_node_without_a_server_says_so_and_ends_on_sigterm(messages, dds_types):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with started(77, "--connect", f"127.0.0.1:{port}") as node:
        assert "start edge-vpr stream --http; trying again" in node.stderr.readline()
        node.send_signal(signal.SIGTERM)
        assert node.wait(10) == 0


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
    assert "setup.bash, or use --dds" in refused()
