"""Matches for other programs: the rows of --json over TCP and MQTT, at nobody's cost."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import math
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools import publish as line_server
from edge_vpr_tools.cli import main
from edge_vpr_tools.live_view import row_of
from edge_vpr_tools.publish import (
    LineServer,
    MqttPublisher,
    RareNotices,
    open_mqtt,
    parse_address,
    parse_url,
)
from streams import Drive, random_events

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.live.links import LinkError
from edge_vpr.live.protocols import open_encoder
from edge_vpr.live.session import LiveMatch
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.settings import Settings

SENSOR = Sensor(16, 12)
ROOT = Path(__file__).parents[2]


def connect(server: LineServer) -> socket.socket:
    host, port = server.address.removeprefix("tcp://").rsplit(":", 1)
    known = len(server._readers)
    sock = socket.create_connection((host, int(port)), timeout=60)
    end = time.monotonic() + 10
    while len(server._readers) == known and time.monotonic() < end:
        time.sleep(0.001)
    return sock


def rows_of(sock: socket.socket) -> list[dict]:
    with sock, sock.makefile(encoding="utf-8") as lines:
        return [json.loads(line) for line in lines]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A map with positions, and a query as bytes."""
    folder = tmp_path_factory.mktemp("publish")
    rng = np.random.default_rng(0)
    events = random_events(rng, 6_000, SENSOR, 2_000_000)
    settings = Settings(pixels=20, sigma=1.0, tau_us=100_000, sequence_length=2, exclusion=1)
    reference = ReferenceMap.build(Drive(events, SENSOR), settings)
    along = np.arange(len(reference)) * 2.5
    along[0] = np.nan
    reference = dataclasses.replace(reference, route=Route(along[:, None].copy(), along))
    reference.save(folder / "map.npz")
    encoder = open_encoder("evpr", SENSOR)
    (folder / "sent.bin").write_bytes(encoder.start() + encoder.encode(events))
    return folder, reference


def stream(drive, *words):
    folder = drive[0]
    return ["stream", "--port", str(folder / "sent.bin"), "--protocol", "evpr", "--once",
            "--map", str(folder / "map.npz"), "--json", *words]  # fmt: skip


MATCH = LiveMatch(
    time_s=2**50 / 1e6, query=3, place=2, distance=1.5, second=-1, second_distance=math.nan,
    ratio=math.nan, events=7, start_s=1.0, trust=-(2**40), misfit=5, probability=0.1, lost=True,
    missing=0.25, age_s=math.nan, host_us=-5, jumps=1,
)  # fmt: skip


def test_a_row_has_every_field_of_its_match():
    """And the coordinates that the map has, in the words of JSON."""
    match = MATCH._replace(x_m=1.5, heading_deg=90.0, along_m=7.0, along_to_m=9.5, route_m=20.0)
    expected = {"kind": "match", **match._asdict()}
    for name in ("query", "y_m", "z_m", "latitude", "longitude"):
        del expected[name]
    expected |= {"second_distance": None, "ratio": None, "age_s": None}
    line = row_of(match, ["x_m"])
    assert json.loads(line) == expected
    assert json.dumps(json.loads(line), allow_nan=False) == line
    del expected["x_m"]
    assert json.loads(row_of(match)) == expected


def test_readers_get_the_rows_that_json_prints(drive, capsys, monkeypatch):
    servers, found = [], []
    start = LineServer.__init__

    def begin(server, address):
        start(server, address)
        servers.append(server)
        socks = [connect(server), connect(server)]
        threads = [threading.Thread(target=lambda s=s: found.append(rows_of(s))) for s in socks]
        servers.extend(threads)
        for thread in threads:
            thread.start()

    monkeypatch.setattr(LineServer, "__init__", begin)
    before = time.time()
    assert main(stream(drive, "--serve", "0")) == 0
    for thread in servers[1:]:
        thread.join(10)
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert found == [printed, printed]
    matches = [row for row in printed if row["kind"] == "match"]
    assert len(matches) > 5
    assert before <= matches[0]["host_us"] / 1e6 <= time.time()
    assert abs(matches[-1]["along_m"] - matches[-1]["place"] * 2.5) < 3 * 2.5
    (notice,) = (row for row in printed if row["kind"] == "serve")
    assert notice["text"] == f"matches are at {servers[0].address}"
    assert servers[0].address.startswith("tcp://127.0.0.1:")


def test_a_slow_reader_loses_only_lines_of_its_own_and_is_told_how_many(monkeypatch):
    monkeypatch.setattr(line_server, "WAITING_LINES", 50)
    line = json.dumps({"kind": "match", "text": "x" * 1_000})
    n = 10_000
    with LineServer("0") as server:
        slow, quick = connect(server), connect(server)
        got = []
        thread = threading.Thread(target=lambda: got.append(rows_of(quick)))
        thread.start()
        begin = time.process_time()
        for i in range(n):
            server.send("match", line)
            while server._readers and i % 25 == 24:
                # the quick one is given time; what is measured is that nobody waits for the slow
                others = [r for r in server._readers if r.waits]
                if len(others) <= 1:
                    break
                time.sleep(0.0005)
        assert time.process_time() - begin < 30
        late = []
        reading = threading.Thread(target=lambda: late.append(rows_of(slow)))
        reading.start()
    thread.join(10)
    reading.join(10)
    rows = late[0]
    left_out = sum(row["lines"] for row in rows if row["kind"] == "left_out")
    assert left_out > n // 2
    assert left_out + sum(row["kind"] == "match" for row in rows) == n
    assert [row["kind"] for row in got[0]] == ["match"] * n


def test_a_reader_that_vanishes_is_forgotten_and_one_too_many_is_turned_away(monkeypatch):
    monkeypatch.setattr(line_server, "MOST_READERS", 1)
    with LineServer("0") as server:
        first = connect(server)
        host, port = server.address.removeprefix("tcp://").rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=10) as second:
            assert second.recv(1) == b""
        assert [good for _, good in server.notices()] == [True, False]
        first.close()
        end = time.monotonic() + 10
        while server._readers and time.monotonic() < end:
            time.sleep(0.001)
        assert not server._readers
        server.send("match", "{}")


def test_without_a_free_descriptor_the_server_pauses_and_goes_on_later(monkeypatch):
    """It called accept without end, with a whole core."""
    real, calls = socket.socket.accept, []

    def exhausted(sock):
        calls.append(sock)
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(line_server, "_PAUSE_S", 0.2)
    with LineServer("0") as server:
        monkeypatch.setattr(socket.socket, "accept", exhausted)
        host, port = server.address.removeprefix("tcp://").rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=10) as waiting:
            time.sleep(0.5)
            assert 1 <= len(calls) <= 4
            monkeypatch.setattr(socket.socket, "accept", real)
            end = time.monotonic() + 10
            while not server._readers and time.monotonic() < end:
                time.sleep(0.01)
            server.send("match", "{}")
            assert waiting.recv(10) == b"{}\n"
        texts = [text for text, _ in server.notices()]
        assert texts[1:] == ["no reader can connect: Too many open files"]


def test_a_thousand_refused_connections_are_one_line_and_a_count_a_minute(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(line_server, "MOST_READERS", 0)
    with LineServer("0") as server:
        server._notices._clock = lambda: now[0]
        address = server.address.removeprefix("tcp://").rsplit(":", 1)
        for _ in range(1_000):
            with socket.create_connection((address[0], int(address[1])), timeout=10) as sock:
                assert sock.recv(1) == b""
        refusal = "0 readers are there, another is refused"
        assert [text for text, _ in server.notices()][1:] == [refusal]
        now[0] = 59.0
        assert list(server.notices()) == []
        now[0] = 61.0
        assert list(server.notices()) == [(f"{refusal} (999 times in 61 s)", False)]
        now[0] = 200.0
        assert list(server.notices()) == []


def test_notices_of_many_texts_take_little_memory():
    notices = RareNotices()
    for i in range(10_000):
        notices.add(str(i), True)
    assert len(list(notices.take())) == 100
    assert len(notices._given) <= 100


@pytest.mark.parametrize("wrong", ["", "x", "host:", "1:2:3", "70000", "-1", "tcp://h:1", "::1:70"])
def test_an_address_to_serve_on_that_is_none_is_refused(wrong):
    with pytest.raises(UsageError, match="expected a port"):
        parse_address(wrong)


def test_a_port_that_is_taken_is_told_with_its_remedy(drive, capsys):
    with LineServer("0") as server:
        port = server.address.rsplit(":", 1)[1]
        assert main(stream(drive, "--serve", port)) == 1
        assert "a port that is free" in capsys.readouterr().err
        with pytest.raises(LinkError, match="an address of this machine"):
            LineServer("203.0.113.7:0")


@pytest.mark.parametrize(
    "wrong", ["localhost/x", "mqtt://host", "mqtt://host/", "mqtt://h:0/x", "mqtt://h:99999/x",
              "mqtt://h/a/+", "mqtt://h/a%23", "mqtt://u:secret@h/x", "mqtt://h/x?qos=2",
              "mqtt://h/x?ca=a.pem", "mqtts://h/x?colour=1"],
)  # fmt: skip
def test_an_address_of_a_broker_that_is_none_is_refused(wrong):
    with pytest.raises(UsageError, match="--mqtt"):
        parse_url(wrong)


def test_parts_of_a_brokers_address_are_found():
    plain = ("::1", 99, "a/b c", "rover", False, None, 0)
    assert parse_url("mqtt://rover@[::1]:99/a/b%20c") == plain
    secret = ("h", 8883, "x", None, True, "/a b.pem", 1)
    assert parse_url("mqtts://h/x?ca=/a%20b.pem&qos=1") == secret


@pytest.fixture
def paho():
    return pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is an extra")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return sock.getsockname()[1]


@contextlib.contextmanager
def running_broker(paho, folder, more=""):
    """A broker's port, and what is published there under `rover`."""
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port = free_port()
    settings = folder / "broker.conf"
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n{more}")
    broker = subprocess.Popen([program, "-c", str(settings)], stderr=subprocess.DEVNULL)
    try:
        listener = paho.Client(paho.CallbackAPIVersion.VERSION2)
        came, ready = [], threading.Event()
        listener.on_connect = lambda client, *rest: client.subscribe("rover/#")
        listener.on_subscribe = lambda *rest: ready.set()
        listener.on_message = lambda client, data, message: came.append(
            (message.topic, json.loads(message.payload))
        )
        listener.reconnect_delay_set(1, 1)
        listener.connect_async("127.0.0.1", port)
        listener.loop_start()
        assert ready.wait(20)
        yield port, came
        listener.disconnect()
        listener.loop_stop()
    finally:
        broker.terminate()
        broker.wait(10)


@pytest.fixture
def mosquitto(paho, tmp_path):
    with running_broker(paho, tmp_path) as found:
        yield found


def test_a_broker_of_mqtt_gets_the_rows_that_json_prints(drive, mosquitto, capsys):
    port, came = mosquitto
    assert main(stream(drive, "--mqtt", f"mqtt://127.0.0.1:{port}/rover")) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    end = time.monotonic() + 10
    while len(came) < len(printed) and time.monotonic() < end:
        time.sleep(0.01)
    rows = [row for _, row in came]
    assert [row["status"] for row in rows if row["kind"] == "status"] == ["online", "ended"]
    assert [row for row in rows if row["kind"] != "status"] == printed
    assert {topic for topic, row in came if row["kind"] == "match"} == {"rover"}
    assert [topic for topic, _ in came[-2:]] == ["rover/summary", "rover/status"]


def wait_for_status(came, status):
    end = time.monotonic() + 30
    while ("rover/status", {"kind": "status", "status": status}) not in came:
        assert time.monotonic() < end, came[-3:]
        time.sleep(0.02)


def test_a_dead_stream_is_told_from_a_lost_robot(drive, paho, mosquitto):
    """The broker itself says so, also to who comes later."""
    port, came = mosquitto
    words = stream(drive, "--mqtt", f"mqtt://127.0.0.1:{port}/rover?qos=1")
    words[words.index("--port") + 1] = "-"
    with subprocess.Popen(
        [sys.executable, "-m", "edge_vpr_tools.cli", *words],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'tools'}"},
    ) as run:  # fmt: skip
        wait_for_status(came, "online")
        run.kill()
    wait_for_status(came, "lost")
    late, seen = paho.Client(paho.CallbackAPIVersion.VERSION2), []
    late.on_connect = lambda client, *rest: client.subscribe("rover/status")
    late.on_message = lambda client, data, message: seen.append(
        (message.retain, json.loads(message.payload)["status"])
    )
    late.connect("127.0.0.1", port)
    end = time.monotonic() + 20
    while not seen and time.monotonic() < end:
        late.loop(0.1)
    late.disconnect()
    assert seen == [(True, "lost")]


# paho does not close the socket of a broker whose certificate it refuses
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_broker_is_reached_by_tls_and_its_certificate_is_checked(drive, paho, tmp_path, capsys):
    openssl, files = shutil.which("openssl"), [tmp_path / "broker.pem", tmp_path / "broker.key"]
    if openssl is None:
        pytest.skip("openssl, which makes the certificate, is not installed")
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj"]
    command += ["/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-out", str(files[0])]
    subprocess.run([*command, "-keyout", str(files[1])], check=True, capture_output=True)
    for file in files:
        file.chmod(0o644)
    tls_port = free_port()
    more = f"listener {tls_port} 127.0.0.1\ncertfile {files[0]}\nkeyfile {files[1]}\n"
    with running_broker(paho, tmp_path, f"{more}user root\n") as (_, came):
        url = f"mqtts://127.0.0.1:{tls_port}/rover?qos=1"
        assert main(stream(drive, "--mqtt", f"{url}&ca={files[0]}")) == 0
        wait_for_status(came, "ended")
        assert any(row["kind"] == "match" for _, row in came)
        before = len(came)
        capsys.readouterr()
        assert main(stream(drive, "--mqtt", url)) == 0
        assert "none whose certificate is valid" in capsys.readouterr().out
        assert len(came) == before
        assert main(stream(drive, "--mqtt", f"{url}&ca={files[0]}x")) == 2
        assert "certificate cannot be read" in capsys.readouterr().err


def test_a_broker_that_is_not_there_costs_the_run_nothing_but_a_notice(drive, paho, capsys):
    begin = time.monotonic()
    assert main(stream(drive, "--mqtt", f"mqtt://127.0.0.1:{free_port()}/rover")) == 0
    assert time.monotonic() - begin < 30
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["text"].split(";")[1] for row in rows if row["kind"] == "mqtt"] == [" trying again"]
    assert any(row["kind"] == "match" for row in rows)


def test_what_waits_for_a_broker_that_hangs_is_bounded(paho, monkeypatch):
    """The system takes some MB for a socket that nobody reads; of the rest a thousand wait."""
    with socket.create_server(("127.0.0.1", 0)) as broker, ThreadedBroker(broker):
        port = broker.getsockname()[1]
        with open_mqtt(f"mqtt://127.0.0.1:{port}/rover") as publisher:
            assert isinstance(publisher, MqttPublisher)
            for _ in range(3_000):
                publisher.send("match", "x" * 10_000)
            assert 0 < len(publisher._client._out_packet) <= 1_000
            (text,) = [text for text, good in publisher.notices() if not good]
            assert text.startswith("1,000 messages wait for 127.0.0.1")
            begin = time.monotonic()
        assert time.monotonic() - begin < 5


def test_what_is_kept_for_a_broker_that_never_acknowledges_and_leaves_is_bounded(paho):
    """With QoS 1 the client keeps what is not acknowledged over all connections."""
    with socket.create_server(("127.0.0.1", 0)) as broker:
        leave = [threading.Event() for _ in range(3)]

        def connections():
            for gone in leave:
                sock, _ = broker.accept()
                with sock:
                    sock.recv(1000)
                    sock.sendall(bytes([0x20, 2, 0, 0]))  # CONNACK
                    gone.wait(30)

        thread = threading.Thread(target=connections)
        thread.start()
        with open_mqtt(f"mqtt://127.0.0.1:{broker.getsockname()[1]}/rover?qos=1") as publisher:
            publisher._client.reconnect_delay_set(1, 1)
            for gone in leave:
                assert publisher._there.wait(30)
                for _ in range(3_000):
                    publisher.send("match", "x" * 100)
                assert 0 < len(publisher._client._out_messages) <= 1_000
                gone.set()
                end = time.monotonic() + 30
                while publisher._there.is_set() and time.monotonic() < end:
                    time.sleep(0.01)
        thread.join(30)


@pytest.mark.parametrize(
    "hostile",
    [
        bytes([0x30, 0xFF, 0xFF, 0xFF, 0x7F]),  # a message of 256 MB
        bytes([0x20, 0xFF, 0xFF, 0xFF, 0x7F]),  # an answer of 256 MB
        bytes([0x34, 9, 0, 1]) + b"a" + bytes(6),  # QoS 2: stored until it is released
        bytes([0x50, 2, 0, 1]),  # each is answered
        bytes([0xC0, 0]),
    ],
)
def test_a_broker_that_sends_what_was_not_asked_for_is_left(paho, hostile):
    """It filled the memory: 980 MB in 15 s."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        sent = []

        def broker():
            sock, _ = server.accept()
            with sock, suppress(OSError):
                sock.settimeout(10)
                sock.recv(1000)
                sock.sendall(bytes([0x20, 2, 0, 0]) + hostile)  # CONNACK
                for _ in range(64):
                    sock.sendall(bytes(1 << 20) if hostile[1] == 0xFF else hostile * 200_000)
                    sent.append(1)

        thread = threading.Thread(target=broker)
        thread.start()
        with open_mqtt(f"mqtt://127.0.0.1:{server.getsockname()[1]}/rover") as publisher:
            thread.join()
            kept = publisher._client
            assert len(kept._in_packet["packet"]) < 1_000
            assert not kept._in_messages and len(kept._out_packet) < 2
        assert len(sent) < 32  # the client has left


class ThreadedBroker:
    """Answers a connection, and reads nothing of what follows."""

    def __init__(self, server: socket.socket) -> None:
        self._server = server
        self._thread = threading.Thread(target=self._answer)
        self._done = threading.Event()

    def _answer(self) -> None:
        sock, _ = self._server.accept()
        with sock:
            sock.recv(1000)
            sock.sendall(bytes([0x20, 2, 0, 0]))  # CONNACK
            self._done.wait(30)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *error: object) -> None:
        self._done.set()
        self._thread.join(10)
