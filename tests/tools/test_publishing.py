"""The rows of --json over HTTP: to everyone who may read them, at nobody's cost."""

from __future__ import annotations

import contextlib
import dataclasses
import http.client
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edge_vpr_tools import publish
from edge_vpr_tools.cli import main
from edge_vpr_tools.live_view import row_of
from edge_vpr_tools.publish import MatchServer, parse_address

from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor
from edge_vpr.live.links import LinkError
from edge_vpr.live.session import LiveSession, Message
from edge_vpr.matching.match import Match
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.run_log import COMPILING
from edge_vpr.settings import Settings
from tests.live.devices import Clock, sent_by, wait_until
from tests.streams import Drive, random_events

SENSOR = Sensor(16, 12)
HEALTH = {"kind": "health", "silent_s": 0.0, "lost_link": "", "resyncs": 3}


def port_of(server: MatchServer) -> int:
    return server.socket.getsockname()[1]


def answer_to(server: MatchServer, request: str) -> bytes:
    """The whole answer to bytes that are sent as they are."""
    with socket.create_connection(("127.0.0.1", port_of(server)), timeout=60) as sock:
        sock.sendall(request.encode())
        with sock.makefile("rb") as answer:
            return answer.read()


def got(server: MatchServer, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=60)
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def listen(server: MatchServer) -> socket.socket:
    """A reader of /events that the server knows."""
    before = len(server._readers)
    sock = socket.create_connection(("127.0.0.1", port_of(server)), timeout=60)
    sock.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    wait_until(lambda: len(server._readers) > before)
    return sock


def rows_of(sock: socket.socket) -> list[dict]:
    with sock, sock.makefile(encoding="utf-8") as lines:
        return [json.loads(line[6:]) for line in lines if line.startswith("data: ")]


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
    (folder / "sent.bin").write_bytes(sent_by(events, SENSOR))
    return folder, reference


def stream(drive, *words):
    folder = drive[0]
    return ["stream", "--port", str(folder / "sent.bin"), "--protocol", "evpr", "--once",
            "--map", str(folder / "map.npz"), "--json", *words]  # fmt: skip


MATCH = Match(
    time_us=2**50, query=3, place=2, distance=1.5, second=-1, second_distance=math.nan,
    ratio=math.nan, ties=0, events=7, start_us=1_000_000, trust=-(2**40), misfit=5,
    probability=0.1, lost=True, missing=0.25, age_s=math.nan, host_us=-5, jumps=1,
)  # fmt: skip


def test_a_row_has_every_field_of_its_match():
    """And the coordinates that the map has, in the words of JSON, and times in seconds."""
    match = MATCH._replace(x_m=1.5, heading_deg=90.0, along_m=7.0, along_to_m=9.5, route_m=20.0)
    expected = {"kind": "match", "time_s": 2**50 / 1e6, "start_s": 1.0, **match._asdict()}
    for name in ("time_us", "start_us", "query", "ties", "y_m", "z_m", "latitude", "longitude"):
        del expected[name]
    expected |= {"second_distance": None, "ratio": None, "age_s": None}
    line = row_of(match, ["x_m"])
    assert json.loads(line) == expected
    assert json.dumps(json.loads(line), allow_nan=False) == line
    del expected["x_m"]
    assert json.loads(row_of(match)) == expected


def test_readers_get_the_rows_that_json_prints(drive, capsys, monkeypatch):
    servers, received, threads = [], [], []
    enter = MatchServer.__enter__

    def begin(server):
        enter(server)
        servers.append(server)
        for sock in (listen(server), listen(server)):
            threads.append(threading.Thread(target=lambda s=sock: received.append(rows_of(s))))
            threads[-1].start()
        return server

    monkeypatch.setattr(MatchServer, "__enter__", begin)
    before = time.time()
    assert main(stream(drive, "--http", "0")) == 0
    for thread in threads:
        thread.join()
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert received == [printed, printed]
    route, notice, *_ = printed
    assert (route["kind"], route["places"]) == ("route", len(drive[1]))
    assert route["along_m"][:3] == [None, 2.5, 5.0]
    assert notice == {"kind": "http", "text": f"matches are at {servers[0].address}"}
    assert servers[0].address.startswith("http://127.0.0.1:")
    matches = [row for row in printed if row["kind"] == "match"]
    assert len(matches) > 5
    assert before <= matches[0]["host_us"] / 1e6 <= time.time()
    assert abs(matches[-1]["along_m"] - matches[-1]["place"] * 2.5) < 3 * 2.5


def test_a_watchdog_is_told_that_kernels_are_compiled(drive, monkeypatch):
    servers, answers, enter, warm_up = [], [], MatchServer.__enter__, LiveSession.warm_up

    def begin(server):
        servers.append(server)
        return enter(server)

    def compile_(session):
        if not answers:
            session.on_message(Message("compiling", COMPILING))
            answers.append(servers[0].health())
        warm_up(session)

    monkeypatch.setattr(MatchServer, "__enter__", begin)
    monkeypatch.setattr(LiveSession, "warm_up", compile_)
    assert main(stream(drive, "--http", "0")) == 0
    assert answers[0] == {"ok": True, "why": COMPILING, "health": None, "match": None}


def test_who_comes_later_gets_the_route_and_no_match_of_before():
    """An old match would be taken for a new one."""
    with MatchServer("0") as server:
        for kind in ("route", "match", "health"):
            server.send(kind, json.dumps({"kind": kind}))
        late = listen(server)
        server.send("match", json.dumps({"kind": "match", "place": 3}))
    assert [row["kind"] for row in rows_of(late)] == ["route", "match"]


def test_a_slow_reader_loses_only_rows_of_its_own_and_is_told_how_many(monkeypatch):
    monkeypatch.setattr(publish, "WAITING_ROWS", 50)
    line = json.dumps({"kind": "match", "text": "x" * 1_000})
    n, quick_rows = 10_000, []
    with MatchServer("0") as server:
        slow = listen(server)
        (slow_reader,) = server._readers
        quick = listen(server)
        (quick_reader,) = server._readers - {slow_reader}
        thread = threading.Thread(target=lambda: quick_rows.extend(rows_of(quick)))
        thread.start()
        for i in range(n):
            server.send("match", line)
            if i % 25 == 24:  # the quick one is given time, the slow one none
                wait_until(lambda: not quick_reader._rows)
        late = []
        reading = threading.Thread(target=lambda: late.extend(rows_of(slow)))
        reading.start()
    thread.join()
    reading.join()
    left_out = sum(row["lines"] for row in late if row["kind"] == "left_out")
    assert left_out > n // 2
    assert left_out + sum(row["kind"] == "match" for row in late) == n
    assert [row["kind"] for row in quick_rows] == ["match"] * n


def test_a_reader_that_vanishes_is_forgotten_and_one_too_many_is_told_so(monkeypatch):
    monkeypatch.setattr(publish, "MOST_READERS", 1)
    with MatchServer("0") as server:
        first = listen(server)
        status, _, body = got(server, "/events")
        assert (status, body) == (503, b"503 1 readers are there: close one\n")
        first.close()

        def is_forgotten() -> bool:
            server.send("health", json.dumps(HEALTH))
            return not server._readers

        wait_until(is_forgotten)
        assert got(server, "/health")[0] == 200


@pytest.fixture(scope="module")
def running():
    with MatchServer("0") as server:
        server.send("health", json.dumps(HEALTH))
        yield server


def test_connections_are_bounded(running, monkeypatch):
    """By the threads of the whole process, of which this is one."""
    with monkeypatch.context() as patch:
        patch.setattr(publish, "MOST_THREADS", 1)
        assert answer_to(running, "") == b""
    assert got(running, "/")[0] == 200


@pytest.mark.parametrize("asked", [b"", b"GET / HT"])
def test_a_connection_that_asks_nothing_is_given_up(asked, running, monkeypatch):
    monkeypatch.setattr(publish._Request, "timeout", 0.1)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.sendall(asked)
        publish._Request(theirs, ("127.0.0.1", 1), running)  # does not wait for ever


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        ("GET /health HTTP/1.1\nHost: LOCALHOST:99\n\n", 200),
        ("GET /health?now HTTP/1.0\r\nHost: [::1]:7000\r\n\r\n", 200),
        ("GET /health HTTP/1.1\r\nHost: 10.0.0.5\r\nOrigin: http://10.0.0.5\r\n\r\n", 200),
        ("GET /health HTTP/1.1\r\nHost: rover.evil.example\r\n\r\n", 403),
        ("GET /health HTTP/1.1\r\nHost: localhost.evil.example:7000\r\n\r\n", 403),
        ("GET /health HTTP/1.1\r\nHost: \r\n\r\n", 403),
        ("GET /health HTTP/1.1\r\n\r\n", 400),
        ("GET /health HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n", 400),
        ("GET /events HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n", 403),
        ("GET /events HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\n\r\n", 403),
        ("POST /health HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\n\r\n{}", 501),
        ("HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n", 501),
        ("OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n", 501),
        ("GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        ("GET http://evil.example/ HTTP/1.1\r\nHost: localhost\r\n\r\n", 404),
        ("GET / HTTP/9.9\r\nHost: localhost\r\n\r\n", 505),
        ("GET\r\n\r\n", 400),
        ("\x16\x03\x01\x02\x00\r\n\r\n", 400),
        ("GET / HTTP/1.1\r\n" + 200 * "A: b\r\n" + "Host: localhost\r\n\r\n", 431),
    ],
)
def test_only_a_get_under_a_name_of_this_machine_is_answered(running, request_, status):
    answer = answer_to(running, request_)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.0 %d " % status)
    assert status == 200 or body.startswith(b"%d " % status)
    assert b"\x16" not in answer
    assert got(running, "/")[0] == 200  # goes on


def test_nothing_of_the_page_may_be_stored_or_framed_and_it_reads_no_other_address(running):
    _, headers, page = got(running, "/")
    assert headers["Cache-Control"] == "no-store"
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "connect-src 'self'" in policy
    # the only one is a name, which nobody asks for
    assert set(re.findall(rb"\w+://[^\"]*", page)) == {b"http://www.w3.org/2000/svg"}


def test_health_is_for_a_watchdog(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(publish, "time", clock)
    with MatchServer("0") as server:

        def health():
            status, _, body = got(server, "/health")
            answered = json.loads(body)
            assert answered["ok"] is (status == 200)
            return status, answered["why"], answered["match"]

        assert health() == (200, "edge-vpr has only just begun", None)
        server.send("health", json.dumps(HEALTH))
        assert health() == (200, "", None)
        server.send("match", json.dumps({"kind": "match", "place": 7, "age_s": 100.0}))
        status, _, match = health()
        assert (status, match["place"]) == (200, 7) and match["age_s"] >= 100
        for most, lost in ((200.0, False), (50.0, True)):
            server.send("health", json.dumps({**HEALTH, "max_age_s": most}))
            server.send("match", json.dumps({"kind": "match", "lost": False, "age_s": 100.0}))
            assert health()[2]["lost"] is lost
            assert health()[2].get("probability") == (0 if lost else None)
        server.send("health", json.dumps({**HEALTH, "silent_s": 3.2}))
        assert health()[:2] == (503, "nothing came for 3 s")
        server.send("health", json.dumps({**HEALTH, "lost_link": "port: gone"}))
        assert health()[:2] == (503, "the link is lost: port: gone")
        clock.sleep(6.0)
        assert health()[:2] == (503, "edge-vpr stands still for 6 s")


@pytest.mark.parametrize("wrong", ["", "x", "host:", "1:2:3", "70000", "-1", "tcp://h:1", "::1:70"])
def test_an_address_to_serve_on_that_is_none_is_refused(wrong):
    with pytest.raises(UsageError, match="expected a port"):
        parse_address(wrong)


def test_a_port_that_is_taken_is_told_with_its_remedy(drive, capsys):
    with MatchServer("0") as server:
        assert main(stream(drive, "--http", str(port_of(server)))) == 1
        assert "a port that is free" in capsys.readouterr().err
        with pytest.raises(LinkError, match="an address of this machine"):
            MatchServer("203.0.113.7:0")


def test_rows_go_on_to_mqtt_by_the_line_of_the_page(running, tmp_path):
    names = ("mosquitto", "mosquitto_pub", "mosquitto_sub", "curl")
    missing = [name for name in names if which(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = tmp_path / "broker.conf"
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    page = (Path(__file__).parents[2] / "docs/live.md").read_text()
    page = page[page.index("## MQTT") :]
    line = page[page.index("curl -sN") :].partition("\n```")[0]
    line = line.replace("http://127.0.0.1:7000/", running.address)
    line = line.replace("-h BROKER", f"-h 127.0.0.1 -p {port}")
    with contextlib.ExitStack() as stack:

        def started(*words: Any, **more: Any) -> subprocess.Popen[str]:
            run = subprocess.Popen(words, text=True, start_new_session=True, **more)
            stack.enter_context(run)  # waits for its end, and closes its pipe
            stack.callback(os.killpg, run.pid, signal.SIGKILL)
            return run

        started(which("mosquitto"), "-c", str(settings), stderr=subprocess.DEVNULL)
        answered = False
        while not answered:
            with (
                contextlib.suppress(ConnectionError),
                socket.create_connection(("127.0.0.1", port), 10),
            ):
                answered = True
        sub = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(port), "-t", "rover/#", "-v"]
        listener = started(*sub, stdout=subprocess.PIPE)
        started("sh", "-c", line)
        came: list[str] = []
        assert listener.stdout is not None
        reading = threading.Thread(target=lambda: came.append(listener.stdout.readline()))
        reading.start()

        def arrives() -> bool:
            running.send("match", json.dumps({"kind": "match", "place": 3}))
            return bool(came)

        wait_until(arrives)
        reading.join()
    assert came == ['rover/match {"kind": "match", "place": 3}\n']


def which(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin")


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_is_told_when_the_run_begins_and_that_it_goes_on(
    drive, monkeypatch, capsys, tmp_path, abstract
):
    address = f"\0edge-vpr-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        monkeypatch.setenv("NOTIFY_SOCKET", address.replace("\0", "@"))
        assert main(stream(drive)) == 0
        manager.setblocking(False)
        assert [manager.recv(100) for _ in range(2)] == [b"READY=1", b"WATCHDOG=1"]
    assert main(stream(drive)) == 0  # nobody listens any more
