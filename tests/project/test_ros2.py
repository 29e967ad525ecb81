"""What the adapter for ROS 2 publishes is of ROS 2's own types, and arrives."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.publish import LineServer, MatchRows

from edge_vpr.live.session import LiveResult
from edge_vpr.online.state import MATCH_DTYPE

ADAPTER = Path(__file__).parents[2] / "tools/adapters/ros2"


def load(name):
    """Import a file of the adapter, which is no package."""
    spec = importlib.util.spec_from_file_location(f"ros2_{name}", ADAPTER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def messages():
    return load("messages")


@pytest.fixture(scope="module")
def dds_types():
    pytest.importorskip("cyclonedds", reason="cyclonedds has no wheel for every machine")
    return load("dds_types")


def row(**more):
    matches = np.zeros(1, dtype=MATCH_DTYPE)
    matches["probability"], matches["place"] = 0.875, 7
    (line,) = MatchRows().lines(LiveResult(np.empty(0), matches, False), 1_700_000_000_250_001)
    return {**json.loads(line), **more}


METRIC = {"x_m": 1.5, "y_m": -2.0, "along_m": 4.0}
ON_EARTH = {"latitude": -27.5, "longitude": 153.0, "along_m": 4.0}


def by_topic(messages, found):
    return {message.topic: message for message in messages.messages_of(found, "street")}


def test_a_match_is_a_position_stamped_with_the_hosts_time(messages):
    found = by_topic(messages, row(**METRIC))
    assert set(found) == {"match", "position", "along_m", "probability"}
    assert found["position"].fields["header"] == {
        "stamp": {"sec": 1_700_000_000, "nanosec": 250_001_000}, "frame_id": "street",
    }  # fmt: skip
    assert found["position"].fields["point"] == {"x": 1.5, "y": -2.0, "z": 0.0}
    assert json.loads(found["match"].fields["data"])["place"] == 7
    assert found["probability"].fields == {"data": 0.875}


def test_a_lost_match_has_no_position_and_what_is_unknown_is_not_published(messages):
    assert set(by_topic(messages, row(lost=True, **METRIC))) == {"match", "probability"}
    unknown = dict.fromkeys(METRIC)
    assert set(by_topic(messages, row(probability=None, **unknown))) == {"match"}
    assert set(by_topic(messages, row(**ON_EARTH))) == {
        "match", "fix", "along_m", "probability",
    }  # fmt: skip
    assert not by_topic(messages, {"kind": "link", "text": "gone"})


def test_every_type_has_the_bytes_that_ros_2_gives_it(messages, dds_types):
    typesys = pytest.importorskip("rosbags.typesys", reason="it knows the types of ROS 2")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    seen = set()
    for found in (row(**METRIC), row(**ON_EARTH)):
        for message in messages.messages_of(found, "street"):
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
        elif isinstance(value, float) and math.isnan(value):
            assert math.isnan(getattr(theirs, name))
        else:
            assert getattr(theirs, name) == value


def test_rows_of_a_server_arrive_at_another_participant(messages, dds_types, tmp_path):
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    domain = 77 + os.getpid() % 100
    participant = DomainParticipant(domain)
    kind = dds_types.TYPES["geometry_msgs/msg/PointStamped"]
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)))
    reader = DataReader(participant, Topic(participant, "rt/rover/position", kind), qos=reliable)
    stop = threading.Event()

    def serve(server):
        while not stop.wait(0.05):
            server.send("match", json.dumps(row(**METRIC)))

    with LineServer("0") as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        try:
            with subprocess.Popen(
                [sys.executable, str(ADAPTER / "edge_vpr_node.py"), "--dds", "--name", "rover",
                 "--connect", server.address.removeprefix("tcp://"), "--once"],
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)}, stderr=subprocess.PIPE,
            ) as node:  # fmt: skip
                samples = []
                end = time.monotonic() + 60
                while not samples and time.monotonic() < end and node.poll() is None:
                    samples = reader.take(1)
                    time.sleep(0.02)
                stop.set()
                thread.join()
                server.close()
                assert node.wait(20) == 0, node.stderr.read()
        finally:
            stop.set()
    assert samples[0].point.x == 1.5
    assert samples[0].header.frame_id == "map"


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
