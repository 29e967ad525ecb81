"""A live session: every protocol, and links of all kinds."""

from __future__ import annotations

import os
import pty
import re
import socket
import subprocess
import sys
import threading
import time
import tty
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

import edge_vpr as ev
from edge_vpr import LiveSession, SessionFiles
from edge_vpr.compiling import to_kernel_state
from edge_vpr.errors import UsageError
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.live.bridge import Bridge, open_device_link
from edge_vpr.live.links import LinkError
from edge_vpr.live.position import Locator, PathPosition
from edge_vpr.live.protocols import Health, open_encoder
from edge_vpr.live.watches import LagWatch, MisfitWatch
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.settings import Settings
from tests.live.devices import (
    DEVICES,
    Pipe,
    fed,
    greeted,
    play,
    polled,
    send_all,
    sent_by,
    wait_until,
)
from tests.streams import Drive, matched_live, random_events, read_events, split_events

ROOT = Path(__file__).parents[2]


def paced(pipe, events, clock, pieces):
    """Yield after each piece of events of 10 ms, which comes when it is seen."""
    encoder = open_encoder("evpr", SENSOR)
    pipe.fill(encoder.start())
    cuts = np.searchsorted(events["t"], np.arange(1, pieces + 1) * 10_000)
    for piece in split_events(events, cuts)[:-1]:
        clock.sleep(0.01)
        pipe.fill(encoder.encode(piece))
        wait_until(lambda: not pipe.waiting)
        yield


@pytest.mark.parametrize("taken", ["iterated", "polled"])
def test_a_slow_program_gets_matches_of_now(taken, route, clock):
    """20 matches come a second, and it takes 5."""
    events = random_events(np.random.default_rng(2), 60_000, SENSOR, 6_000_000)
    pipe, seen = Pipe(), []
    with LiveSession(
        ev.Line(pipe, max_lag="1s"), protocol="evpr", reference=route, heartbeat="1s"
    ) as session:
        matches = iter(session)
        for n, _ in enumerate(paced(pipe, events, clock, 500), 1):
            if n % 20 or n == 20:  # the first match is of 0.2 s
                continue
            match = next(matches) if taken == "iterated" else (session.poll() or [None])[-1]
            if match is not None and match.place >= 0:
                seen.append(match)
                assert clock.time() - match.host_us / 1e6 == pytest.approx(match.age_s, abs=0.1)
        assert session.health.lost == session.health.overruns == 0
    assert len(seen) > 10
    assert max(match.age_s for match in seen) < 1.0
    assert [match.query for match in seen] == sorted({match.query for match in seen})


@pytest.mark.parametrize(("limit", "window_s"), [(None, 0.2), ("400ms", 0.4)])
def test_a_match_that_comes_late_is_lost(limit, window_s, route, clock):
    """Of a host that slept, with a limit of its own and the default of two windows."""
    events = random_events(np.random.default_rng(2), 60_000, SENSOR, 6_000_000)
    pipe, matches = Pipe(), []
    with LiveSession(
        ev.Line(pipe, max_lag="10s"), protocol="evpr", reference=route, max_age=limit
    ) as session:
        for n, _ in enumerate(paced(pipe, events, clock, 300)):
            if n < 150:
                matches += fed(session, pipe, b"")
        late = fed(session, pipe, b"")
    assert len(matches) >= 20 and not any(match.lost for match in matches)
    assert max(match.age_s for match in late) > 1.0
    assert [match.lost for match in late] == [match.age_s > window_s for match in late]
    # who looks at the probability alone is not told that this place is of now
    assert {match.probability for match in late if match.lost} == {0}


#: fields of a match that may be NaN
UNKNOWN = ("ratio", "probability", "second_distance")
#: a host, and what its device sends
PROTOCOLS = [(each.host, each.sends) for each in DEVICES if each.typical]
SENSOR = Sensor(64, 48)


@pytest.fixture(scope="module")
def route():
    """A map of 29 places 3 m apart; those of the end have no position."""
    events = random_events(np.random.default_rng(0), 60_000, SENSOR, 3_000_000)
    settings = Settings(pixels=20, sigma=1.0, tau_us=100_000, sequence_length=2)
    reference = ReferenceMap.build(Drive(events, SENSOR), settings)
    along = np.where(np.arange(len(reference)) < 25, 3.0 * np.arange(len(reference)), np.nan)
    return replace(reference, route=Route(along[:, None], along, "metric"))


@pytest.fixture(scope="module")
def query():
    return random_events(np.random.default_rng(1), 40_000, SENSOR, 2_000_000)


def offline(reference, events):
    """The matches of a recording."""
    return matched_live(reference, Drive(events, SENSOR), "50ms")


def write_sent(path, events, sensor=SENSOR):
    """Write what a camera sends of events, in one piece or in some; return the path."""
    path.write_bytes(sent_by(events, sensor))
    return path


@pytest.mark.usefixtures("greets_once")
@pytest.mark.parametrize("taken", ["iterated", "polled"])
@pytest.mark.parametrize(("host", "device"), PROTOCOLS)
def test_the_matches_of_every_protocol_are_those_of_the_recording(
    host, device, taken, route, query
):
    events = query.copy()
    if not device.startswith("evpr"):
        events.t -= events["t"][0]  # time 0 is then that of the first event
    address, _, thread = play(Drive(events, SENSOR), SENSOR, device)
    matches = []
    line = ev.Line(address, reconnect=False, on_overload="wait")
    with LiveSession(line, protocol=host, reference=route, max_age="60s") as session:
        if taken == "iterated":
            matches = list(session)
        matches += polled(session, lambda: session.ended)
    thread.join()
    expected = offline(route, events)
    assert expected.size > 30
    assert [match.query for match in matches] == list(range(len(matches)))
    for name in set(expected.dtype.names) - {"query"}:
        of_all = [getattr(match, name) for match in matches]
        assert np.array_equal(of_all, expected[name], equal_nan=name in UNKNOWN), name
    position, locator = PathPosition(route.settings), Locator(route)
    at = [
        position.update(row["time_us"], row["time_us"] - row["start_us"], row["place"])
        for row in expected
    ]
    assert [match.along_m for match in matches] == [locator.locate(each)["along_m"] for each in at]
    assert matches[-1].jumps == position.jumps > 0
    assert not any(match.missing > 0 for match in matches)
    assert all(abs(match.host_us / 1e6 - time.time()) < 60 for match in matches)
    assert session.health.events == 40_000
    assert session.health.losses == 0


class Line:
    """An open link in two halves: what a camera writes, a host reads."""

    def __init__(self, kind):
        self.kind = kind
        if kind == "pty":
            self.master, self.host = pty.openpty()
            tty.setraw(self.host)
        elif kind == "pipe":
            read, self.master = os.pipe()
            self.host = os.fdopen(read, "rb", buffering=0)
        else:
            near, self.host = socket.socketpair()
            self.master = near.detach()

    def write(self, data):
        while data:
            data = data[os.write(self.master, data) :]

    def close(self):
        os.close(self.master)


@pytest.mark.parametrize("kind", ["pty", "pipe", "socket"])
def test_a_link_that_is_open_already_is_taken(kind, route, query):
    line, sent = Line(kind), sent_by(Drive(query, SENSOR), SENSOR)
    expected = offline(route, query)["place"].tolist()
    places = []
    with LiveSession(
        ev.Line(line.host, on_overload="wait"), protocol="evpr", reference=route, max_age="60s"
    ) as session:
        writing = threading.Thread(target=line.write, args=(sent,), daemon=True)
        writing.start()
        for match in session:
            places.append(match.place)
            if len(places) == len(expected) - 1:
                session.stop()
    writing.join()
    assert places == expected[: len(places)]
    assert len(places) > 30
    assert session.health.decoded >= 38_000
    line.close()
    if kind != "pty":
        line.host.close()  # was not closed by the session


def test_a_heartbeat_comes_when_nothing_else_does(route):
    """It is no match by any of its fields, so that a rover needs no branch for it."""
    line = Line("pty")
    begin = time.monotonic()
    with LiveSession(line.host, protocol="evpr", reference=route, heartbeat="50ms") as session:
        begin = time.monotonic()
        beats = [beat for beat, _ in zip(session, range(4), strict=False)]
        took = time.monotonic() - begin
        while not (more := session.poll()):
            assert time.monotonic() - begin < 60
    assert took > 0.15
    for beat in (*beats, *more):
        assert (beat.place, beat.probability, beat.lost) == (-1, 0.0, True)
        assert beat.along_m is None
        assert beat.missing == 1
        assert beat.query == 0
    line.close()


@pytest.mark.parametrize("every", ["50ms", "change"])
def test_a_camera_that_falls_silent_is_told_by_its_match_that_is_lost(every, route, query, clock):
    """A program that reads nothing but matches would take the last one to hold for ever."""
    pipe, encoder = Pipe(), open_encoder("evpr", SENSOR)
    before, after = split_events(query, 2)
    with LiveSession(
        pipe, protocol="evpr", reference=route, every=every, max_age="600ms"
    ) as session:
        clock.sleep(1.0)
        newest = fed(session, pipe, encoder.start() + encoder.encode(before))[-1]
        clock.sleep(2.0)
        again = next(iter(session))
        assert again.age_s > 0.6
        same = {"lost": True, "probability": 0.0, "age_s": again.age_s}
        assert again._asdict() == pytest.approx({**newest._asdict(), **same}, nan_ok=True)
        assert session.poll() == []  # once a silence
        assert not fed(session, pipe, encoder.encode(after))[-1].lost


@pytest.mark.parametrize("kind", ["network", "cable"])
def test_a_link_that_dies_and_returns_is_told_and_costs_what_was_sent_meanwhile(
    kind, route, query, tmp_path, any_baud
):
    before, meanwhile, after = split_events(query, [15_000, 25_000])
    encoder, said = open_encoder("evpr", SENSOR), []
    port = tmp_path / "event-camera"  # a name of its own, as udev gives it

    def plug_in(address="tcp://127.0.0.1:0"):
        device = open_device_link(address if kind == "network" else "virtual")
        if kind == "cable":
            port.symlink_to(device.address)
        return device

    def send(data):
        greeted(device)
        send_all(device, data)

    device = plug_in()
    address = device.address if kind == "network" else port
    line = ev.Line(address, max_lag="60s")
    with LiveSession(line, protocol="evpr", reference=route, heartbeat="20ms") as session:
        # a host that is held up takes the line to be silent
        session.on_message = lambda message: said.append(message) if message.kind == "link" else 0
        send(encoder.start() + encoder.encode(before))
        assert len(polled(session, lambda: session.health.decoded == 15_000)) > 5
        device.close()
        port.unlink(missing_ok=True)
        encoder.encode(meanwhile)
        assert all(match.lost for match in polled(session, lambda: said))
        assert session.status.lost_link
        assert "is not known" in session.health.describe_losses()
        device = plug_in(device.address)
        polled(session, lambda: len(said) > 1)
        send(encoder.encode(after))
        matches = polled(session, lambda: session.health.decoded == 30_000)
    device.close()
    assert [each.over for each in said] == [False, True]
    assert "trying again" in said[0].text
    health = session.health
    assert (health.decoded, health.lost, health.reopened) == (30_000, 10_000, 1)
    assert health.describe_losses() == "10,000 events lost on the way"
    assert any(match.missing > 0 for match in matches if match.place >= 0)


def test_a_camera_that_comes_back_under_another_name_is_told_to_the_end(route, query, any_baud):
    """Nobody can count what it sends there."""
    device = open_device_link("virtual")
    line = ev.Line(device.address, max_lag="60s")
    with LiveSession(line, protocol="evpr", reference=route) as session:
        send_all(device, sent_by(query[:500], SENSOR))
        polled(session, lambda: session.health.decoded == 500)
        device.close()
        polled(session, lambda: session.status.lost_link)
    assert session.health.cut_off
    assert session.health.lost == 0
    said = session.health.describe_losses()
    assert said == (
        "0 events lost on the way before the link was lost; what was sent after that is not known"
    )


class Board:
    """A camera on a line that never disconnects, whose power comes and goes."""

    def __init__(self, protocol):
        self.link, self._protocol = open_device_link("virtual"), protocol
        self._boots, self.opened = 0, threading.Event()

    def power_on(self, events):
        """Start; what the host sent before this is gone."""
        while self.link.read(0.01):
            pass
        self._boots += 1
        boot = f":boot={self._boots}" if self._protocol == "evpr" else ""
        self.bridge = Bridge(self.link, open_encoder(self._protocol + boot, SENSOR), speed=0)
        parts = self._sent(events)
        self._thread = threading.Thread(target=self.bridge.run, args=(parts,), daemon=True)
        self._thread.start()

    def _sent(self, events):
        self.opened.wait()  # while a host opens a terminal, it discards what came before
        yield from split_events(events, 10)

    def power_off(self):
        self.bridge.stopping.set()
        self._thread.join(timeout=10)


@pytest.mark.parametrize("order", ["camera first", "host first", "reset in mid-run"])
@pytest.mark.parametrize(("host", "device"), PROTOCOLS)
def test_a_camera_that_starts_whenever_it_likes_is_heard(order, host, device, query, any_baud):
    """Also on a line that is open all the time, on which the opening was sent to nobody."""
    board, events = Board(device), query[:5_000]
    line = ev.Line(board.link.address, on_overload="wait")
    session = LiveSession(line, protocol=host, sensor=SENSOR)
    if order == "camera first":
        board.power_on(events)
    with session:
        board.opened.set()
        if order != "camera first":
            session.poll()
            time.sleep(0.1)
            board.power_on(events)
        polled(session, lambda: session.health.events >= 4_900)
        if order == "reset in mid-run":
            board.power_off()
            board.power_on(events)
            polled(session, lambda: session.health.events >= 9_700)
        board.power_off()
    assert session.status.dead_s == 0
    board.link.close()


def test_a_port_that_is_absent_at_first_is_waited_for_unless_told_otherwise(
    query, tmp_path, any_baud
):
    said, port = [], tmp_path / "event-camera"
    with pytest.raises(LinkError, match="there is no such file or port"):
        LiveSession(ev.Line(port, reconnect=False), protocol="evpr", sensor=SENSOR).open()
    with pytest.raises(LinkError, match="there is no such file"):  # a file will not be plugged in
        LiveSession(tmp_path / "raw.bin", protocol="evpr", sensor=SENSOR).open()
    line = ev.Line(port, max_lag="60s")
    with LiveSession(line, protocol="evpr", sensor=SENSOR, on_message=said.append) as session:
        polled(session, lambda: said)
        assert "there is no such file or port" in said[0].text
        assert session.status.dead_s > 0
        board = Board("evpr")
        port.symlink_to(board.link.address)
        board.power_on(query[:5_000])
        polled(session, lambda: len(said) > 1)
        board.opened.set()
        polled(session, lambda: session.health.events == 5_000)
        assert session.health.reopened == 0
        assert session.status.lost_link == ""
        board.power_off()
    assert [message.over for message in said[:2]] == [False, True]
    board.link.close()


def test_a_host_that_is_starved_says_how_late_it_is(route, clock):
    """By the camera's clock: bytes wait at the system, where no time from `read` on shows it."""
    pipe, encoder, said = Pipe(), open_encoder("evpr", SENSOR), []
    with LiveSession(
        ev.Line(pipe, max_lag="60s"), protocol="evpr", reference=route, on_message=said.append
    ) as session:
        fed(session, pipe, encoder.start())
        for late_us in (0, 0, 500_000, 0):
            clock.sleep(1.0)
            now_us = round(1e6 * clock.monotonic())
            fed(session, pipe, encoder.encode(make_events([now_us - late_us], [1], [1])))
            assert session.health.lag_us == pytest.approx(late_us, abs=10)
        assert session.health.longest_lag_us == pytest.approx(500_000, abs=10)
    assert [(message.kind, message.over) for message in said] == [("lag", False), ("lag", True)]
    assert "the line stood still, or" in said[0].text


def test_a_lag_after_a_silence_is_the_line_s_and_nothing_else_is_suspected():
    said, health = [], Health()
    watch = LagWatch(health, 1e6, lambda *words, over=False: said.append(words[1]), live=True)

    for time_s, at_s in ((1, 1.0), (2, 10.0), (12, 12.0), (13, 20.0)):
        health.stalls = int(time_s > 1)
        watch.look(make_events([1_000_000 * time_s], [1], [1]), 0, at_s)
    assert [text.partition("late: ")[2] for text in said] == [
        "the line stood still", "", "the line stood still, or is slower than the camera, or this "
        "machine is busy with something else",
    ]  # fmt: skip


def test_a_known_route_is_matched_while_the_drive_is_recorded_and_mapped(route, query, tmp_path):
    """With other settings than those of the map; all files are complete when the block ends."""
    sent, places = write_sent(tmp_path / "sent.bin", query), len(route)
    names = "raw.bin", "events.npz", "events.csv", "map.npz"
    raw, events, text, mapped = (tmp_path / name for name in names)
    settings = replace(route.settings, pixels=10)
    files = SessionFiles(record=[raw, events, text], learn=mapped, settings=settings)
    with LiveSession(sent, protocol="evpr", reference=route, files=files) as session:
        matched = [match.place for match in session]
    assert matched == offline(route, query)["place"].tolist() and len(route) == places
    assert raw.read_bytes() == sent.read_bytes()
    for recorded in (open_recording(events), open_recording(text, sensor=SENSOR)):
        assert np.array_equal(join_events(list(recorded)), query)
    again = ReferenceMap.build(Drive(query, SENSOR), settings)
    assert ReferenceMap.load(mapped) == files.learnt == again
    assert files.update is None
    assert {path.name for path in tmp_path.iterdir()} == {"sent.bin", *names}


def test_the_same_files_serve_one_session_after_another(route, query, tmp_path):
    raw, sent = tmp_path / "raw.bin", write_sent(tmp_path / "sent.bin", query)
    files = SessionFiles(record=raw, overwrite=True)
    for _ in range(2):
        with LiveSession(sent, protocol="evpr", reference=route, files=files) as session:
            assert list(session)
        assert raw.read_bytes() == sent.read_bytes()
        raw.unlink()


def test_a_known_map_learns_the_drive_that_it_is_matched_with(street, tmp_path, run):
    """As it does from a recording, with its own settings, and not those of matching live."""
    (map_path, events, _), target, sent = street, tmp_path / "learnt.npz", tmp_path / "sent.bin"
    reference = ReferenceMap.load(map_path)
    sensor = reference.pixel_map.sensor
    write_sent(sent, Drive(events, sensor), sensor)
    words = ["stream", "--port", sent, "--protocol", "evpr", "--map", map_path]
    shown = run(*words, "--learn", "-o", target).out
    expected = reference.update(map_path.with_name("query.npz"))
    assert ReferenceMap.load(target) == expected.reference != reference
    places = f"{len(reference)} places (at half windows) at 150 pixels"
    assert f"{target}: {places}; {expected}" in shown
    # of a preset, the number of places per window is auto: the map's
    settings = replace(reference.settings, places_per_window=None)
    files = SessionFiles(learn=target, settings=settings, overwrite=True)
    with LiveSession(sent, protocol="evpr", reference=reference, files=files) as session:
        assert len(list(session)) > 0
    assert files.learnt == expected.reference
    part = events[events["t"] < 0.6 * events["t"][-1]]
    write_sent(sent, part, sensor)
    shown = run(*words, "--learn", "-o", tmp_path / "more.npz", code=2).err
    assert re.search(r"the drive shows \d+% of the route, and at least 90% is needed", shown)
    assert "more_drive.npz -o " in shown
    assert "more.npz makes a new map of it, and adds nothing to the old one\n" in shown


def test_settings_that_do_not_exist_or_are_the_map_s_are_refused(route):
    with pytest.raises(UsageError, match="LiveSession has the unknown setting 'hartbeat'"):
        LiveSession("/dev/null0", protocol="evpr", reference=route, hartbeat="500ms")
    with pytest.raises(UsageError, match="setting tau_us = 1, and the map was made with"):
        LiveSession("/dev/null0", protocol="evpr", reference=route, tau_us=1)


def test_a_map_in_place_of_a_port_is_called_a_map(route, tmp_path):
    route.save(tmp_path / "map.npz")
    with pytest.raises(UsageError, match=r"map.npz is a map, .* give the map as reference="):
        LiveSession(tmp_path / "map.npz", protocol="evpr", sensor=SENSOR)


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"record": "here.npz"}, "exists: name another, or replace it with overwrite=True"),
        ({"learn": "here.npz"}, "exists: name another, or replace it with overwrite=True"),
        ({"record": "no/new.npz"}, "is not a folder"),
        ({"learn": "no/new.npz"}, "is not a folder"),
        ({"record": "drive.xyz"}, r"drive.*: expected \.bin for bytes, or \.npz"),
        ({"record": "drive"}, r"drive.*: expected \.bin for bytes, or \.npz"),
        ({"learn": "x.txt"}, r"x.txt does not end in .npz: name the map"),
        ({"state": "run.state", "learn": "new.npz"}, "leave out learn="),
        ({"state": "run.state"}, "give reference="),
    ],
)
def test_files_are_looked_at_before_the_link_is_opened(files, says, tmp_path, monkeypatch):
    """Also the map to learn, which would replace that of another drive."""
    monkeypatch.chdir(tmp_path)
    Path("here.npz").touch()
    with pytest.raises(UsageError, match=says):
        LiveSession("/dev/null0", protocol="evpr", sensor=SENSOR, files=SessionFiles(**files))


def test_a_remark_on_the_camera_is_a_message(route, tmp_path):
    """Frames of a smaller sensor than the map's, which is that of a stream without `sensor=`."""
    sensor, said = Sensor(32, 24), []
    events = random_events(np.random.default_rng(0), 9_000, sensor, 1_000_000)
    link = write_sent(tmp_path / "sent.bin", events, sensor)
    with LiveSession(link, protocol="evpr", reference=route, on_message=said.append) as session:
        assert list(session)
    assert any("sensor is smaller than 64x48" in each.text for each in said)


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"record": "sent.bin"}, "is the input"),
        ({"record": "map.npz"}, "is the input"),
        ({"learn": "sent.bin"}, "is the input"),
        ({"record": ["a.bin", "a.bin"]}, "is named twice"),
        ({"record": "a.npz", "learn": "a.npz"}, "is named twice"),
        ({"state": "run.npz"}, "such as live.state"),
        ({"state": "missing/run.state"}, "no folder missing"),
    ],
)
def test_a_file_of_a_session_has_a_place_and_replaces_no_other(
    files, says, route, query, tmp_path, monkeypatch
):
    """Not even with `overwrite`; a map may be replaced by itself, with what it has learnt."""
    monkeypatch.chdir(tmp_path)
    route.save("map.npz")
    Path("sent.bin").write_bytes(open_encoder("evpr", SENSOR).encode(query))
    arguments = {"protocol": "evpr", "reference": "map.npz"}
    with pytest.raises(UsageError, match=says):
        LiveSession("sent.bin", **arguments, files=SessionFiles(**files, overwrite=True))
    assert ReferenceMap.load("map.npz") == route and Path("sent.bin").stat().st_size > 0
    LiveSession("sent.bin", **arguments, files=SessionFiles(learn="map.npz", overwrite=True))


def test_a_session_that_is_not_open_yet_has_a_state():
    session = LiveSession("/dev/null0", protocol="evpr", sensor=SENSOR)
    assert (session.address, session.status.dead_s) == ("/dev/null0", 0.0)


def test_a_program_that_fails_leaves_whole_files(route, query, tmp_path):
    events, sent = tmp_path / "events.npz", write_sent(tmp_path / "sent.bin", query)
    files = SessionFiles(record=events)
    with (
        pytest.raises(ZeroDivisionError),
        LiveSession(sent, protocol="evpr", reference=route, files=files) as session,
    ):
        for match in session:
            if match.query == 5:
                raise ZeroDivisionError
    recorded = read_events(events)
    assert 0 < recorded.size == session.health.events


def test_a_session_is_used_once(route):
    line = Line("pty")
    with LiveSession(line.host, protocol="evpr", reference=route) as session:
        session.stop()
        assert list(session) == session.poll() == []
    with pytest.raises(UsageError, match="make a new one"):
        list(session)
    line.close()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"sensor": None}, "pass sensor='WIDTHxHEIGHT' or reference="),
        ({"protocol": "x"}, "choose one of evpr"),
        ({"link": 3.5}, "expected a port such as"),
        ({"link": b"/dev/ttyACM0"}, "expected a port such as"),
        ({"heartbeat": "often"}, "expected a time such as"),
        ({"heartbeat": 0.5}, "heartbeat is a float (0.5): give a text"),
        ({"every": 3}, "every is an int (3): give a text"),
        ({"protocol": None}, "protocol is None: give its name"),
        ({"sensor": 5}, "sensor 5 is no width and height"),
        ({"reference": 5}, "reference is an int (5): give a ReferenceMap"),
        ({"odometry": 5}, "odometry is an int (5): give"),
        ({"precision": 0.9}, "precision: nothing is matched without reference="),
    ],
)
def test_wrong_arguments_are_one_sentence(wrong, says):
    arguments = {"link": "/dev/null0", "protocol": "evpr", "sensor": SENSOR, **wrong}
    with pytest.raises(UsageError, match=re.escape(says)):
        LiveSession(arguments.pop("link"), **arguments)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ev.Line("/dev/null0", on_overload="cry"), "expected 'drop', 'wait' or None"),
        (lambda: ev.Line("/dev/null0", max_lag="long"), "expected a time such as"),
        (lambda: SessionFiles(record=5), "path of a file to record is an int"),
        (lambda: SessionFiles(learn=5), "path of the map to learn is an int"),
    ],
)
def test_wrong_lines_and_files_are_one_sentence(make, says):
    with pytest.raises(UsageError, match=re.escape(says)):
        make()


def test_without_a_listener_problems_go_to_the_log(caplog, route):
    line = Line("pty")
    with LiveSession(line.host, protocol="evpr", reference=route, heartbeat="100ms") as session:
        line.write(np.random.default_rng(0).bytes(30_000))
        end = time.monotonic() + 60
        for _ in session:
            if "are not of this protocol" in caplog.text:
                break
            assert time.monotonic() < end
    line.close()


@pytest.mark.slow
def test_nothing_is_compiled_once_the_link_is_open():
    """With any protocol, in a process that has compiled nothing before."""
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    protocols = [device for _, device in PROTOCOLS]
    protocols.append("edvs:format=E1")
    folder = Path(to_kernel_state.stats.cache_path)
    noted = set(folder.glob("work-*.nbw"))
    for state in ("cold", "warm"):
        done = subprocess.run(
            [
                sys.executable, str(ROOT / "tests/live/left_to_compile.py"),
                state, str(os.getpid()), *protocols,
            ],
            env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'tools'}"},
            capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    for file in set(folder.glob("work-*.nbw")) - noted:
        file.unlink()


def test_a_camera_that_has_not_begun_does_not_stall(query, monkeypatch):
    """It is silent, which is said; a stall begins after the first byte."""
    monkeypatch.setattr("edge_vpr.live.watches.SILENT_S", 0.05)
    line, said = Line("pty"), []
    with LiveSession(line.host, protocol="evpr", sensor=SENSOR, on_message=said.append) as session:
        polled(session, lambda: said)
        assert session.health.stalls == 0
        line.write(sent_by(query[:500], SENSOR))
        polled(session, lambda: session.health.stalls == 1)
    line.close()
    told = [(message.kind, message.over) for message in said]
    assert told == [("stalled", over) for over in (False, True, False)]


def test_another_place_is_counted_in_the_health(street, tmp_path):
    """The query in a mirror is no place of the map."""
    reference, events = ReferenceMap.load(street[0]), street[1].copy()
    sensor = reference.pixel_map.sensor
    events.x = sensor.width - 1 - events["x"]
    sent = write_sent(tmp_path / "sent.bin", Drive(events, sensor), sensor)
    with LiveSession(sent, protocol="evpr", reference=reference) as session:
        misfits = sum(match.misfit >= 64 for match in session)
    assert session.health.misfits == misfits > 0
    assert str(session.health) == f"{misfits:,} misfits"


def test_it_says_once_that_this_place_or_light_is_not_the_map_s():
    health, said = Health(), []
    watch = MisfitWatch(health, lambda kind, text, over=False: said.append((kind, text, over)))
    for misfit in (-1, 63, 64, 200, 32, 64, 31, 0):
        watch.look([0, misfit])
    watch.look([])
    assert [(kind, over) for kind, _, over in said] == [("misfit", False), ("misfit", True)]
    assert "not the map's" in said[0][1]
    assert health.misfits == 3
