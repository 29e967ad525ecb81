"""Live streams, end to end: over a real pseudo-terminal and TCP, whole, cut and overloaded."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import io
import json
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from edge_vpr_tools import live_view

from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Sensor, join_events, make_events
from edge_vpr.live.bridge import Bridge, LineFaults, open_device_link
from edge_vpr.live.protocols import open_decoder, open_encoder
from edge_vpr.live.session import LiveStatus, LiveStep
from edge_vpr.live.stream_matcher import MOST_TICKS, StreamMatcher
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.route import Route
from edge_vpr.settings import Settings
from tests.live.devices import (
    Clock,
    bytes_waiting,
    greeted,
    play,
    rows_of,
    send_all,
    sent_by,
    wait_until,
)
from tests.streams import Drive, random_events, read_events, split_events

SENSOR = Sensor(64, 48)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a query drive and a map of another."""
    folder = tmp_path_factory.mktemp("live")
    rng = np.random.default_rng(0)
    reference = Drive(random_events(rng, 60_000, SENSOR, 3_000_000), SENSOR)
    settings = Settings(pixels=20, sigma=1.0, tau_us=100_000, sequence_length=2)
    ReferenceMap.build(reference, settings).save(folder / "map.npz")
    query = random_events(rng, 40_000, SENSOR, 2_000_000)
    write_recording(folder / "query.npz", query, sensor=SENSOR)
    return folder


@pytest.fixture(scope="module")
def reference(drive):
    return ReferenceMap.load(drive / "map.npz")


@pytest.fixture
def events(drive):
    """The events of the query."""
    return read_events(drive / "query.npz")


@pytest.fixture(scope="module")
def sent(drive):
    """The query as a file of bytes."""
    path = drive / "sent.bin"
    path.write_bytes(sent_by(open_recording(drive / "query.npz"), SENSOR))
    return path


@pytest.fixture
def streamed(run):
    """Run `stream`; return what it printed."""
    return lambda *words, code=0: run("stream", "--protocol", "evpr", *words, code=code)


def test_what_a_bad_line_loses_is_counted_and_the_matches_around_it_are_flagged(
    drive, tmp_path, streamed
):
    faults = LineFaults.parse("drop=1e-4,flip=1e-5,insert=1e-5,garbage=500")
    recording = open_recording(drive / "query.npz", chunk_events=1_000)
    address, _, thread = play(recording, SENSOR, "evpr:frame=256", faults=faults)
    log = tmp_path / "run.jsonl"
    words = ["--port", address, "--map", drive / "map.npz", "--once", "--log", log]
    streamed(*words, "--on-overload", "wait", "--every", "10ms")
    thread.join()
    (summary,) = rows_of(log, "summary")
    assert summary["lost"] > 0
    assert summary["decoded"] + summary["lost"] == 40_000
    assert summary["crc_errors"] > 0
    shares = [row["missing"] for row in rows_of(log, "match")]
    assert 0 < max(shares) < 1
    assert np.mean(shares) == pytest.approx(summary["lost"] / 40_000, rel=0.3)


def whole(lines):
    """Events decoded or known to be lost, as the newest line of health says."""
    for line in reversed(lines):
        row = json.loads(line)
        if row["kind"] == "health":
            return row["decoded"] + row["lost"]
    return 0


@pytest.mark.slow
def test_a_host_that_is_held_up_goes_on_with_the_newest_and_says_what_is_gone(drive):
    """Nobody reads its output for a while, so that matching stands still while bytes come."""
    rng = np.random.default_rng(5)
    flood = random_events(rng, 600_000, SENSOR, 6_000_000)
    calm = random_events(rng, 60_000, SENSOR, 3_000_000)
    calm.t += 6_000_000
    link = open_device_link("virtual")
    encoder = open_encoder("evpr", SENSOR)
    run = Running(
        "--port", link.address, "--protocol", "evpr", "--map", drive / "map.npz", "--json",
        "--every", "event", "--max-lag", "60s",
    )  # fmt: skip
    greeted(link)
    send_all(link, encoder.start())
    for part in split_events(flood, 60):  # more than waits for a host
        send_all(link, encoder.encode(part))
    out: list[str] = []
    reader = threading.Thread(target=lambda: out.extend(run.process.stdout), daemon=True)
    reader.start()

    def caught_up(number, now_us):
        send_all(link, encoder.idle(now_us))
        time.sleep(0.1)
        return whole(out) == number

    wait_until(lambda: caught_up(600_000, 6_000_000), 120)
    send_all(link, encoder.encode(calm))
    wait_until(lambda: caught_up(660_000, int(calm["t"][-1])), 120)
    run.process.send_signal(signal.SIGTERM)
    reader.join()
    run.stop()
    link.close()
    rows = [json.loads(line) for line in out]
    health = rows[-1]
    assert health["kind"] == "summary"
    assert health["overruns"] > 0
    assert health["lost"] > 0
    assert health["decoded"] + health["lost"] == 660_000
    matches = [row for row in rows if row["kind"] == "match"]
    assert any(row["missing"] for row in matches)
    assert not matches[-1]["missing"]
    assert matches[-1]["time_s"] > 8.9


@pytest.mark.parametrize("tells", ["event", "pause", "silence"])
def test_a_jump_of_the_clock_gives_one_match_and_is_counted(tells, reference, events):
    """One undamaged frame may say anything: 599 s are 1.2 million ticks of 500 us."""
    last, jump_us = int(events["t"][-1]), 599_000_000
    encoder = open_encoder("evpr", SENSOR)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, MatchSchedule(interval_us=500))
    step = live.feed(encoder.start() + encoder.encode(events), 0)
    assert not any(match.missing for match in step.matches)
    later = events.copy()
    later.t += last + jump_us
    if tells == "silence":
        sent = encoder.idle(last + jump_us)
    elif tells == "event":
        sent = encoder.encode(later[:1])
    else:
        sent = encoder.encode(join_events([events[-1:], later[:1]]))
    step = live.feed(sent, 0)
    # ticks that the burst filter held back, and one of the jump
    assert 1 <= len(step.matches) <= 10
    if tells == "silence":
        assert step.matches[-1].time_us == (last + jump_us) // 500 * 500
    step = live.feed(encoder.encode(later[1:10_000]), 0)
    assert step.matches[0].missing == 1.0
    assert live.decoder.health.clock_jumps == 1
    assert "1 clock jump" in str(live.decoder.health)


def test_a_piece_that_spans_more_ticks_than_are_matched_at_once_is_matched_at_all_of_them(
    reference,
):
    events = make_events([0, 700_000, 1_400_000, 1_410_000], [1, 2, 5, 6], [3, 4, 6, 7])
    every = MatchSchedule(interval_us=25)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, every)
    step = live.feed(open_encoder("evpr", SENSOR).encode(events), 0)
    assert live.decoder.health.clock_jumps == 0
    times = [match.time_us for match in step.matches]
    assert times == list(range(times[0], 1_400_001, 25))
    assert len(times) > 4 * MOST_TICKS


def test_a_clock_that_is_set_back_while_silent_moves_nothing(drive):
    encoder = open_encoder("evpr", SENSOR)
    decoder = open_decoder("evpr", SENSOR)
    decoder.feed(encoder.start() + encoder.idle(50_000))
    assert decoder.reached_us == 50_000
    decoder.feed(encoder.idle(40_000))
    assert decoder.reached_us == 50_000
    decoder.feed(encoder.idle(10**12))  # no clock leaps by 11 days
    assert decoder.reached_us == 50_000


def test_a_flag_of_matching_needs_a_map(sent, refused):
    words = ["stream", "--protocol", "evpr", "--port", sent, "--sensor", "64x48"]
    assert "precision: nothing is matched without --map" in refused(*words, "--precision", 0.9)


def test_a_map_of_another_sensor_is_refused(drive):
    with pytest.raises(MapError, match="use the map of this camera"):
        StreamMatcher(open_decoder("evt2", Sensor(10, 10)), ReferenceMap.load(drive / "map.npz"))


@pytest.mark.parametrize(
    "text", ["drop=2", "drop", "colour=1", "stall=-1", "stall=2@", "stall=2@x", "stall=2@nan"]
)
def test_faults_that_make_no_sense_are_refused(text):
    with pytest.raises(UsageError, match="expected one of drop, flip"):
        LineFaults.parse(text)


# lines come ten times as often, or most of a test's time would be spent on waiting for them
PROGRAM = """
import sys
from edge_vpr_tools import cli, live_view
live_view._LINE_S = 0.1
sys.exit(cli.main())
"""


class Running:
    """The command as a process; one that says nothing fails its test instead of holding it up."""

    def __init__(self, *words, stdin=None):
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, "stream", *map(str, words)],
            stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._watchdog = threading.Timer(240, self.process.kill)
        self._watchdog.start()

    def wait_for(self, said):
        """Read lines until one of them is what is waited for; return it."""
        assert self.process.stdout is not None
        lines = [""]
        while not said(lines[-1]):
            lines.append(self.process.stdout.readline())
            assert lines[-1], (lines[-3:], self.process.stderr.read())
            assert len(lines) < 10_000, lines[-3:]
        return lines[-1]

    def stop(self, number=signal.SIGTERM):
        """Send a signal; return what else was printed."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        out, err = self.process.communicate(timeout=60)
        self._watchdog.cancel()
        assert self.process.returncode == 0, (err, out)
        return out


def at_once(scenario, *choices):
    """Play a scenario for each choice, at the same time: processes take a second to start."""
    with ThreadPoolExecutor() as pool:
        for _ in pool.map(scenario, choices):
            pass


@pytest.mark.slow
def test_a_signal_ends_a_run_with_its_summary_and_its_files(drive, tmp_path):
    events = read_events(drive / "query.npz")[:5_000]
    events.t -= events["t"][0]  # the stream has no frame before its first event
    sent = open_encoder("evpr", SENSOR).encode(events)

    def interrupted_by(number):
        recording, log = (tmp_path / f"{number.name}{end}" for end in (".npz", ".jsonl"))
        words = ["--port", "-", "--protocol", "evpr", "--map", drive / "map.npz"]
        run = Running(*words, "--record", recording, "--log", log, stdin=subprocess.PIPE)
        run.process.stdin.buffer.write(sent)
        run.process.stdin.flush()
        run.wait_for(lambda line: " 5,000 events" in line)
        out = run.stop(number)
        assert "5,000 events" in out
        assert "0 events lost on the way" in out
        assert "from byte to match" in out
        recorded = read_events(recording)
        assert np.array_equal(recorded, events)
        assert rows_of(log, "summary")[0]["events"] == 5_000

    at_once(interrupted_by, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.slow
@pytest.mark.parametrize("reader", ["leaves", "sleeps"])
def test_a_reader_that_reads_no_more_costs_no_file(reader, drive, tmp_path):
    """One that leaves ends the run; for one that does not read, it takes a second signal."""
    flood, files = tmp_path / "flood.bin", [tmp_path / "events.npz", tmp_path / "run.jsonl"]
    rng, encoder = np.random.default_rng(5), open_encoder("evpr", SENSOR)
    flood.write_bytes(encoder.encode(random_events(rng, 1_000_000, SENSOR, 10_000_000)))
    run = Running(
        "--port", flood, "--protocol", "evpr", "--map", drive / "map.npz", "--json",
        "--every", "event", "--record", files[0], "--log", files[1],
    )  # fmt: skip
    run.process.stdout.readline()
    if reader == "leaves":
        run.process.stdout.close()
    else:
        # far more is said than a pipe holds
        size = fcntl.fcntl(run.process.stdout, fcntl.F_GETPIPE_SZ)
        wait_until(lambda: bytes_waiting(run.process.stdout) > 0.8 * size)
        assert run.process.poll() is None
        for wait_s in (0.5, 20, 20):  # two that come together are one
            if run.process.poll() is None:
                run.process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.process.wait(wait_s)
    assert run.process.wait(timeout=60) == 0
    assert run.process.stderr.read() == ""
    run.stop()
    (summary,) = rows_of(files[1], "summary")
    recorded = sum(part.size for part in open_recording(files[0]))
    assert 0 < recorded == summary["events"] < 1_000_000


def test_what_is_read_is_never_written_over(drive, sent, streamed):
    before, reference = sent.read_bytes(), drive / "map.npz"
    other = drive / ".." / drive.name / "sent.bin"
    for words in (["--record", sent], ["--record", other], ["--record", reference], ["--log", sent],
                  ["--log", reference], ["--record", "a.bin", "--log", "a.bin"],
                  ["--record", "a.bin", "--record", "a.bin"]):  # fmt: skip
        said = streamed("--port", sent, "--map", reference, "--overwrite", *words, code=2).err
        assert "is the input" in said or "is named twice" in said
    assert sent.read_bytes() == before
    assert len(ReferenceMap.load(reference)) > 1


def test_a_camera_that_is_not_there_costs_no_file_of_the_run_before(drive, tmp_path, streamed):
    files = [tmp_path / name for name in ("raw.bin", "run.jsonl", "events.npz")]
    for file in files:
        file.write_bytes(b"of the run before")
    words = ["--record", files[0], "--log", files[1], "--record", files[2], "--overwrite", "--once"]
    streamed("--port", tmp_path / "ttyNone", "--map", drive / "map.npz", *words, code=1)
    assert {file.read_bytes() for file in files} == {b"of the run before"}


def test_a_full_disk_ends_its_file_and_not_the_run(drive, sent, tmp_path, streamed):
    full = tmp_path / "full.bin"
    full.symlink_to("/dev/full")
    log = tmp_path / "run.jsonl"
    words = ["--port", sent, "--map", drive / "map.npz", "--overwrite", "--every", "10ms"]
    told = streamed(*words, "--record", full, "--log", log, code=1)
    assert f"{full} ends early: No space left on device: check" in told.out
    assert "going on without it" in told.out
    assert "ends early" in told.err
    assert rows_of(log, "summary")[0]["events"] == 40_000
    assert len(rows_of(log, "file")) == 1
    events = tmp_path / "events.npz"
    told = streamed(*words, "--log", "/dev/full", "--record", events, code=1)
    assert "/dev/full ends early" in told.err
    assert sum(part.size for part in open_recording(events)) == 40_000


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_disk_that_fills_under_a_recording_ends_it_and_not_the_run(
    suffix, drive, sent, tmp_path, streamed, files_end_at
):
    target = tmp_path / f"events{suffix}"
    with files_end_at(50_000):
        told = streamed("--port", sent, "--map", drive / "map.npz", "--record", target, code=1)
    assert f"{target} cannot be written: " in told.out
    assert "File too large" in told.out and "going on without it" in told.out
    assert "40,000 events in" in told.out
    assert "File too large" in told.err
    assert not list(tmp_path.iterdir())


def test_a_killed_run_that_learns_is_cleared_at_the_next_one(sent, tmp_path):
    words = ["-", "--protocol", "evpr", "--sensor", "64x48", "--learn", "-o", tmp_path / "map.npz"]
    program = [sys.executable, "-m", "edge_vpr_tools.cli", "stream", "--port", *map(str, words)]
    run = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        run.stdin.write(sent.read_bytes())
        run.stdin.flush()
        wait_until(lambda: list(tmp_path.glob(".*/.*/drive.npz*")), 60)
    finally:
        run.kill()
        run.wait()
        run.stdin.close()
    assert len(list(tmp_path.iterdir())) == 1
    write_recording(tmp_path / "next.npz", open_recording(sent.parent / "query.npz"))
    assert [path.name for path in tmp_path.iterdir()] == ["next.npz"]


def test_a_quiet_run_prints_nothing_and_writes_what_it_should(sent, drive, tmp_path, streamed):
    output, log = tmp_path / "map.npz", tmp_path / "run.jsonl"
    words = ["--port", sent, "--sensor", "64x48", "--learn", "-o", output, "--pixels", 20]
    assert streamed(*words, "--sigma", 1, "--tau", "100ms", "-q") == ("", "")
    assert output.exists()
    words = ["--port", sent, "--map", drive / "map.npz", "--log", log, "-q"]
    assert streamed(*words) == ("", "")
    assert rows_of(log, "match")


def test_a_map_of_few_places_is_told_when_it_is_made_and_used(sent, tmp_path, streamed):
    output = tmp_path / "map.npz"
    words = ["--port", sent, "--sensor", "64x48", "--learn", "-o", output, "--pixels", 20]
    made = streamed(*words, "--sigma", 1, "--tau", "100ms").err
    places = len(ReferenceMap.load(output))
    assert places < 50
    for said in (made, streamed("--port", sent, "--map", output).err):
        assert f"{output} has {places} places: with fewer than 50, probabilities are" in said


def test_json_rows_have_the_position_of_a_map_with_a_track(sent, tmp_path, streamed, reference):
    """That of the robot at `time_s`, where the map knows it."""
    along = np.where(np.arange(len(reference)) % 9 == 3, np.nan, np.arange(len(reference)) * 2.5)
    route = Route(np.stack([along, 7 + along], axis=1), along, "metric")
    located = dataclasses.replace(reference, route=route)
    located.save(tmp_path / "map.npz")
    words = ["--port", sent, "--map", tmp_path / "map.npz", "--every", "100ms", "--json"]
    matches = rows_of(streamed(*words).out, "match")
    assert len(matches) > 10
    placed = [row for row in matches if row["along_m"] is not None]
    assert 0 < len(placed) < len(matches)
    for row in placed:
        assert row["x_m"] == row["along_m"] == pytest.approx(row["y_m"] - 7)
        assert row["heading_deg"] == 45.0
        assert row["along_from_m"] <= row["along_m"] <= row["along_to_m"]
        assert row["route_m"] == (len(reference) - 0.5) * 2.5
    assert all(row["x_m"] is None for row in matches if row["along_m"] is None)


def test_a_drive_that_makes_no_map_is_kept(sent, tmp_path, streamed):
    output = tmp_path / "map.npz"
    words = ["--sensor", "64x48", "--learn", "-o", output, "--pixels", 100_000, "--port"]
    for name in ("map_drive.npz", "map_drive1.npz"):
        err = streamed(*words, sent, code=2).err
        assert f"the drive is kept: edge-vpr map {tmp_path / name} -o {output}" in err
        assert sum(part.size for part in open_recording(tmp_path / name)) == 40_000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map_drive.npz", "map_drive1.npz"]
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"")
    assert f"no events came from {empty}" in streamed(*words, empty, code=1).err
    assert not output.exists()


@pytest.mark.parametrize(
    ("protocol", "name"),
    [("evpr", "a.bin"), ("evt3", "a.bin"), ("edvs", "a.bin"), ("evt3", "a.raw")],
)
def test_bytes_of_another_protocol_are_told_at_once(protocol, name, tmp_path, run):
    """Also in a file that is called like a recording, and lacks its header."""
    (tmp_path / name).write_bytes(np.random.default_rng(0).bytes(30_000))
    words = ["stream", "--port", tmp_path / name, "--sensor", "64x48", "--protocol", protocol]
    told = run(*words, code=1)
    for text in told:
        assert "of this protocol: check --protocol" in text
    assert "events lost on the way" not in told.out


def test_a_camera_that_sent_nothing_is_an_error(tmp_path, streamed):
    (tmp_path / "empty.bin").write_bytes(b"")
    said = streamed("--port", tmp_path / "empty.bin", "--sensor", "64x48", code=1).err
    assert "no bytes came: check that this is the camera's port" in said


def test_a_recording_is_no_port(drive, tmp_path, streamed):
    raw = tmp_path / "camera.raw"
    raw.write_bytes(b"% evt 3.0\n% end\n" + bytes(64))
    for recording in (drive / "query.npz", raw):
        said = streamed("--port", recording, "--sensor", "64x48", code=2).err
        assert "match it with edge-vpr match --online" in said


def test_events_of_another_sensor_are_told_at_once(sent, streamed):
    said = streamed("--port", sent, "--sensor", "8x48", code=1).out
    assert " events are not on this sensor: check --sensor" in said


@pytest.mark.parametrize(
    ("protocol", "host"), [("aer:layout=jaer8", "aer:layout=jaer8"), ("evpr:width=3", "evpr")]
)
def test_the_bridge_says_how_it_is_read(protocol, host, drive, run):
    """A layout cannot be found out from the bytes, and a width is in every frame."""
    words = ["bridge", drive / "query.npz", "--protocol", protocol, "--speed", 0]
    said = f"edge-vpr stream --port udp://127.0.0.1:9 --protocol {host} --sensor 64x48 --map "
    assert said in run(*words, "--port", "udp://127.0.0.1:9").out


def test_a_bridge_that_is_stopped_twice_has_no_file_to_speak_of(drive, monkeypatch, run):
    """As by `timeout`, which signals the command and its group."""

    def stopped(bridge, recording):
        for _ in range(2):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(Bridge, "run", stopped)
    out, err = run("bridge", drive / "query.npz")
    assert out.splitlines()[-1] == "sent 0 events in 0 bytes" and err == ""


@pytest.mark.slow
def test_a_device_over_udp_needs_no_greeting_and_loses_nothing_unsaid(drive, events):
    """It sends no faster than the host takes, or the system would drop more."""
    run = Running("--port", "udp://127.0.0.1:0", "--protocol", "evpr", "--map",
                  drive / "map.npz", "--json", "--max-lag", "60s")  # fmt: skip
    told = json.loads(run.wait_for(lambda line: '"stalled"' in line))
    link, encoder = open_device_link(told["text"].rpartition(" ")[2]), open_encoder("evpr", SENSOR)
    for number, piece in enumerate(split_events(events, 8)):
        data, sent = encoder.encode(piece), 5_000 * (number + 1)
        if number != 3:
            send_all(link, data)
            run.wait_for(lambda line, sent=sent: '"health"' in line and whole([line]) == sent)
    health = json.loads(run.stop().splitlines()[-1])
    link.close()
    assert (health["events"], health["lost"]) == (35_000, 5_000)


def step_of(result, at_s=0.0):
    """The step of a session that gave this result."""
    matches = tuple(match._replace(age_s=0.0) for match in result.matches)
    return LiveStep(result.events, at_s, matches=matches)


def test_the_terminal_shows_where_we_are_and_what_is_wrong(sent, monkeypatch, reference):
    from edge_vpr_tools.live_view import Panel
    from rich.console import Console

    shown = []

    class Live:
        console = Console(file=io.StringIO())

        def update(self, drawn, *, refresh):
            console = Console(width=120, record=True, file=io.StringIO())
            console.print(drawn)
            shown.append(console.export_text())

    clock = Clock()
    monkeypatch.setattr(live_view, "time", clock)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, MatchSchedule(events=1))
    view = live_view.View(False, None, reference, Panel(Live()))
    data = sent.read_bytes()
    for part in (data[:10_000], data[10_000:80_000], data[90_000:]):
        clock.sleep(1.0)
        step = live.feed(part, 0)
        view.matches(step_of(step, clock.monotonic() - 0.0123))
        view.tick(LiveStatus(live.decoder.health, live.filled))
    assert "waiting for the first match: " in shown[0]
    last = step.matches[-1]
    assert f"place {last.place} of 29 ({100 * last.place / 28:.0f} % of the route)" in shown[2]
    (newest,) = step_of(step).matches[-1:]
    view.matches(step_of(step)._replace(matches=(newest._replace(lost=True),)))
    clock.sleep(1.0)
    view.tick(LiveStatus(live.decoder.health, live.filled))
    assert f"lost, at best place {last.place} of 29" in shown[-1]
    assert "ratio" not in shown[-1]  # of a place where the robot is not
    for age_s, place in ((0.1, "place"), (3.0, "lost, last at place")):
        sure = newest._replace(probability=0.97, age_s=age_s)
        view.matches(step_of(step)._replace(matches=(sure,)))
        clock.sleep(1.0)
        view.tick(LiveStatus(live.decoder.health, live.filled, max_age_s=2.0))
        assert f"place  {place}" in shown[-1]
        assert ("probability 0.97" in shown[-1]) == (age_s < 2.0)
    assert f"ratio {last.ratio:.3f}, {100 * last.missing:.0f} % of its events lost" in shown[2]
    assert "12.3 ms from byte to match" in shown[2]
    assert "no faults" in shown[1]
    assert "1 sequence gap" in shown[2]
    assert f"{live.decoder.health.lost:,} lost" in shown[2]


def test_a_line_of_status_comes_in_time_and_at_each_change(sent, capsys, monkeypatch, reference):
    """A journal gets a line a minute; that the link or the place is lost waits for none."""
    monkeypatch.setattr(live_view, "_LINE_S", 0.0)
    live = StreamMatcher(open_decoder("evpr", SENSOR), reference, MatchSchedule(events=1))
    log = io.StringIO()
    view = live_view.View(False, log, reference, None, line_s=60.0)
    health = live.decoder.health

    def lines_after(lost_link="", data=b""):
        view.matches(step_of(live.feed(data, 0)))
        for _ in range(3):
            view.tick(LiveStatus(health, live.filled, lost_link))
        return capsys.readouterr().out.splitlines()

    assert len(lines_after()) == 1
    assert lines_after() == []
    (line,) = lines_after(data=sent.read_bytes())
    assert "place " in line
    assert lines_after() == []
    assert json.loads(log.getvalue().splitlines()[-1])["accounting"] == "exact"
    health.cut_off = True
    (line,) = lines_after("the cable is gone")
    assert "link lost" in line
    assert "lost, last at place " in line
    # nobody counts what is sent now
    assert json.loads(log.getvalue().splitlines()[-1])["accounting"] == "unknown"
    health.cut_off = False
    assert len(lines_after()) == 1
