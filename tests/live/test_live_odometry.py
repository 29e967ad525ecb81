"""Odometry of a live run: lines of an odometer, good and bad, and what a run does with them."""

from __future__ import annotations

import re
import socket
import sys
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from edge_vpr_tools.cli import main

from edge_vpr.descriptors.counting import cleaned
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.tables import load_odometry
from edge_vpr.events import Sensor
from edge_vpr.live import session as session_module
from edge_vpr.live.odometer import OdometerLine, OdometerReader
from edge_vpr.live.protocols import open_encoder
from edge_vpr.live.reader import Chunk
from edge_vpr.live.session import LiveSession
from edge_vpr.odometry import OdometerCheck
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.odometry_feed import OdometryFeed
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from tests.live.devices import Pipe, TimedCamera, fed, rows_of
from tests.streams import Drive, random_events, read_events, split_events

SENSOR = Sensor(64, 48)


@pytest.mark.parametrize("seed", range(20))
def test_the_cut_of_the_bytes_changes_no_reading(seed):
    rng = np.random.default_rng(seed)
    metres = np.round(np.cumsum(rng.normal(0.1, 0.2, 100)), 3)
    end = "\r\n" if seed % 2 else "\n"
    data = "".join(f"{metre}{end}" for metre in metres).encode()
    line, readings = OdometerLine(), []
    cuts = [0, *np.sort(rng.integers(0, len(data), 30)).tolist(), len(data)]
    for begin, last in pairwise(cuts):
        if line.feed(data[begin:last]):
            readings.append(line.distance_mm)
    assert line.refused == 0
    assert set(readings) <= set(np.rint(1e3 * metres).astype(int).tolist())
    assert readings[-1] == round(1e3 * metres[-1])


@pytest.mark.parametrize(
    "text", [b"x", b"1.0,2.0", b"nan", b"inf", b"1e10", b"\xff\xfe", b"1" * 65, b"0x10", b"1_000"]
)
def test_a_line_that_is_no_reading_is_counted_and_moves_nothing(text):
    line = OdometerLine()
    assert line.feed(b"1.0\n2.0\n")
    assert not line.feed(text + b"\n\n")
    assert line.feed(b"2.5\n")
    assert (line.distance_mm, line.readings, line.refused) == (2_500, 2, 1)


def reader_of(monkeypatch, take, say=lambda *_, **__: None):
    """A reader of an odometer that takes these chunks at once."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        reader = OdometerReader(address, say, retry=False)
    monkeypatch.setattr(reader._reader, "take", take)
    monkeypatch.setattr("edge_vpr.live.odometer._LOOK_S", 0.0)
    return reader


@pytest.mark.parametrize("block", [b"1.5\n" * 16_384, b"1" * 65_536, b"\n" * 65_536])
def test_an_odometer_that_never_pauses_keeps_nothing_waiting(block, monkeypatch):
    """Parsed line by line, at 2 MB/s it took all the time that matching and SIGTERM had."""
    taken = []
    reader = reader_of(monkeypatch, lambda _: taken.append(1) or Chunk(block, 0.0))
    calls = Counter()
    sys.setprofile(lambda _, event, __: calls.update([event]))
    try:
        readings = {reader.look() for _ in range(20)}
    finally:
        sys.setprofile(None)
    assert len(taken) == 40
    assert calls.total() < 100 * len(taken)
    assert readings == ({1_500} if b"1.5" in block else {None})
    reader.stop()


def test_lines_that_are_no_readings_are_said_once(monkeypatch):
    said, pieces = [], [Chunk(b"what is this?\n", 0.0), None] * 3
    reader = reader_of(monkeypatch, lambda _: pieces.pop(0), lambda *words, **_: said.append(words))
    assert [reader.look() for _ in range(3)] == [None] * 3
    reader.stop()
    ((kind, text),) = said
    assert kind == "odometer"
    assert "brings lines that are no readings of an odometer" in text


def test_a_leap_moves_nothing_neither_there_nor_back():
    check = OdometerCheck()

    def at(time_s, *shown_m):
        for shown in shown_m:
            check.read(round(1e6 * time_s), round(1e3 * shown))
        return check.leaps, check.distance_mm

    at(0.0, 105.0, 105.5)
    # a digit was lost on the way
    assert at(0.1, 5.9, 106.3, 106.7) == (2, 105_900)
    # the robot's computer has started again
    assert at(0.3, 106.7) == (2, 105_900)
    assert at(2.3, 106.7) == (2, 105_900)
    assert at(2.4, 0.0, 0.4) == (3, 106_300)
    # a line that was away for long; 52 m/s
    assert at(12.0, 500.0) == (3, 605_900)


def test_what_was_begun_before_a_gap_is_no_reading():
    line = OdometerLine()
    line.feed(b"1.0\n1")
    line.feed(b"2.0\n", after_loss=True)
    assert line.distance_mm == 2_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a query drive, and a map that knows how far its places are from each other."""
    folder = tmp_path_factory.mktemp("odometry")
    rng = np.random.default_rng(3)
    events = random_events(rng, 60_000, SENSOR, 3_000_000)
    settings = Settings(
        pixels=20, sigma=1.0, tau_us=100_000, matching="filter", counter_code="contrast"
    )
    reference = ReferenceMap.build(Drive(events, SENSOR), settings)
    places = np.arange(len(reference), dtype=np.int64)
    replace(reference, odometer_mm=500 * places).save(folder / "map.npz")
    by_sequence = replace(settings.uncoded, matching="sequence", sequence_length=2)
    ReferenceMap.build(Drive(events, SENSOR), by_sequence).save(folder / "by_sequence.npz")
    write_recording(
        folder / "query.npz", random_events(rng, 40_000, SENSOR, 2_000_000), sensor=SENSOR
    )
    return folder


class TalkingOdometer:
    """Stands in for the reader of an odometer, which at each look says how far is driven."""

    address, lost_link = "odometer", ""

    def __init__(self, metres):
        self._metres = metres
        self._says = True

    def take(self, timeout):
        says, self._says = self._says, not self._says
        return Chunk(f"{self._metres():.4f}\n".encode(), 0.0) if says else None

    def stop(self):
        pass


@pytest.fixture
def streamed(drive, clock, monkeypatch):
    """Run `stream` with a camera, and an odometer that shows `shown_m` of the time.

    Returns the events that were sent.
    """

    def streamed(*words, shown_m=lambda time_s: 1_000 + 5 * time_s, fails=0):
        events = read_events(drive / "query.npz")
        camera = TimedCamera(clock, events, SENSOR)
        odometer = TalkingOdometer(lambda: shown_m(camera.now_s))
        monkeypatch.setattr("edge_vpr.live.session.LinkReader", lambda *_, **__: camera)
        monkeypatch.setattr("edge_vpr.live.odometer.LinkReader", lambda *_, **__: odometer)
        monkeypatch.setattr("edge_vpr_tools.live_view.time", clock)
        line = ["--port", "tcp://127.0.0.1:1", "--odometry", "tcp://127.0.0.1:2", "--once"]
        line += ["--protocol", "evpr", *map(str, words)]
        assert main(["stream", *line]) == fails
        return events

    return streamed


def test_a_run_with_an_odometer_is_the_offline_one_with_the_readings_of_its_log(
    streamed, drive, tmp_path
):
    log = tmp_path / "run.jsonl"
    events = streamed("--every", "100ms", "--map", drive / "map.npz", "--log", log)
    assert not rows_of(log, "odometer")
    reference = ReferenceMap.load(drive / "map.npz")
    live = [
        [round(1e6 * row["time_s"]), row["place"], row["distance"], row["trust"]]
        for row in rows_of(log, "match")
    ]

    def offline(odometry):
        localiser = Localiser(reference, every=MatchSchedule(interval_us=100_000))
        feed = OdometryFeed(localiser, odometry)
        parts = cleaned(Drive(events, SENSOR), reference.settings)
        rows = np.concatenate([row for part in parts for row in feed.update(part)])
        return [list(row) for row in rows[["time_us", "place", "distance", "trust"]].tolist()]

    assert live == offline(load_odometry(log))
    assert live != offline(None)


def test_what_is_driven_while_the_line_stands_still_is_read_with_the_events_of_the_way(
    drive, monkeypatch, clock
):
    """The events are kept and come late; the odometer goes on."""
    shown, read, pipe = [], [], Pipe()
    stand_in = SimpleNamespace(look=lambda: shown.pop() if shown else None, stop=lambda: None)
    monkeypatch.setattr(session_module, "OdometerReader", lambda *_, **__: stand_in)
    events, encoder = read_events(drive / "query.npz"), open_encoder("evpr", SENSOR)
    with LiveSession(
        pipe, protocol="evpr", reference=drive / "map.npz", odometry="/dev/null0"
    ) as session:
        monkeypatch.setattr(session.files, "take_reading", lambda *reading: read.append(reading))
        fed(session, pipe, encoder.start())
        begin_s, kept = clock.monotonic(), []
        for n, piece in enumerate(split_events(events, 200)):  # of 10 ms
            clock.sleep(0.01)
            shown.append(round(5_000 * (clock.monotonic() - begin_s)))
            kept.append(encoder.encode(piece))
            if not 100 <= n < 199:
                while kept:
                    fed(session, pipe, kept.pop(0))
            else:
                session.poll()
    time_us, distance_mm = np.array(read).T
    assert len(set(distance_mm.tolist())) > 150
    # 5 m/s; readings do not wait for the newest 50 ms
    assert np.abs(distance_mm - distance_mm[0] - 5e-3 * (time_us - time_us[0])).max() < 500


def test_a_map_that_is_learnt_with_an_odometer_knows_its_distances(streamed, tmp_path, capsys):
    target, log = tmp_path / "map.npz", tmp_path / "run.jsonl"
    words = ["--sensor", "64x48", "--learn", "-o", target, "--sigma", "1", "--log", log]
    events = streamed(*words, "--pixels", "20", "--tau", "100ms")
    learnt, odometry = ReferenceMap.load(target), load_odometry(log)
    expected = ReferenceMap.build(Drive(events, SENSOR), learnt.settings, odometry=odometry)
    assert learnt == expected
    assert learnt.odometer_mm[-1] > 2_000


def test_a_drive_that_makes_no_map_is_kept_with_its_odometry(streamed, tmp_path, capsys):
    words = ["--sensor", "64x48", "--learn", "-o", tmp_path / "map.npz", "--tau", "3600s"]
    streamed(*words, fails=2)
    err = capsys.readouterr().err
    table = tmp_path / "map_drive.csv"
    assert f"-o {tmp_path / 'map.npz'} --odometry {table}" in err
    assert len(load_odometry(table).time_us) > 50
    again = ["map", str(tmp_path / "map_drive.npz"), "-o", str(tmp_path / "map.npz"), "--pixels"]
    assert main([*again, "20", "--tau", "100ms", "--sigma", "1", "--odometry", str(table)]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensor", "64x48"], "--odometry is for --map and --learn"),
        (["--map", "map.npz", "--port", "udp://:5001"], "is the camera's --port"),
        (["--map", "map.npz", "--odometry", "map.npz"], "edge-vpr match --odometry"),
        (["--map", "by_sequence.npz"], "odometry is for the place filter"),
        (["--map", "map.npz", "--odometry", "tcp://127.0.0.1:1"], "Connection refused"),
    ],
)
def test_odometry_that_cannot_be_is_refused_before_the_run(
    words, message, drive, tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(drive)
    (tmp_path / "empty.bin").touch()
    command = ["stream", "--port", tmp_path / "empty.bin", "--protocol", "evpr", "--once"]
    code = 1 if "Connection" in message else 2
    assert message in refused(*command, "--odometry", "udp://:5001", *words, code=code)


def test_a_session_takes_no_file_as_the_odometer(drive, tmp_path):
    """A whole file would be read at once, in the first window."""
    (tmp_path / "wheel.csv").write_text("time_s,distance_m\n0,0\n3,30\n")
    arguments = {"protocol": "evpr", "reference": drive / "map.npz"}
    with pytest.raises(UsageError, match="is a file, and a live odometer is read as the robot"):
        LiveSession("sent.bin", **arguments, odometry=str(tmp_path / "wheel.csv"))


def test_a_run_counts_the_leaps_of_its_odometer_and_goes_on_without_it(streamed, drive, capsys):
    """Of millimetres, every reading leaps."""
    words = ["--map", drive / "map.npz", "--json"]
    streamed(*words, shown_m=lambda time_s: 5_000 * time_s)
    out = capsys.readouterr().out
    ((said,), (health,)) = rows_of(out, "odometer"), rows_of(out, "summary")
    assert said["text"].startswith("the odometer leapt to ")
    assert "such readings are left out; send metres" in said["text"]
    assert rows_of(out, "match")
    assert health["odometer_leaps"] > 20


def test_a_live_run_shows_the_odometer_s_metres_beside_the_length_of_the_route(
    streamed, drive, tmp_path, capsys
):
    """A wrong sign is seen whatever is matched."""
    log = tmp_path / "run.jsonl"
    words = ["--map", drive / "map.npz", "--precision", "0.99", "--log", log]
    streamed(*words, shown_m=lambda time_s: 1_000 - 5 * time_s)
    text = "".join(capsys.readouterr())
    assert re.search(
        r"\| -\d+\.\d m by the odometer, route length 14\.\d m \(ratio -\d+\.\d\d\)", text
    )
    (health,) = rows_of(log, "summary")
    assert health["odometer_leaps"] == 0
    first_mm, *_, last_mm = load_odometry(log).distance_mm.tolist()
    assert health["odometer_m"] == (last_mm - first_mm) / 1e3 < 0


def test_an_odometer_that_never_speaks_is_told(streamed, drive, capsys, monkeypatch):
    """The matches are those of a run without odometry."""
    words = ["--map", drive / "map.npz", "--precision", "0.99"]
    monkeypatch.setattr(TalkingOdometer, "take", lambda *_: None)
    streamed(*words)
    text = "".join(capsys.readouterr())
    assert "| no reading of the odometer has come |" in text
    assert "\nno reading of the odometer has come: matched without it\n" in text


@pytest.mark.parametrize("scale", [0.85, 1.0, 3.28, -1.0])
def test_an_odometer_in_its_declared_unit_always_counts(scale):
    """With slip of a tenth, at a stop of 80 s, after a restart from zero, and in a wrong unit."""
    rng, rate = np.random.default_rng(0), 20.0
    t = np.arange(0, 240.0, 1 / rate)
    speed = np.where((t > 20) & (t < 100), 0.0, 5.0 + 3.0 * np.sin(t / 3))
    shown_m = scale * np.cumsum(speed) / rate + np.cumsum(rng.normal(0, 0.03, t.size))
    for restart_s in (np.inf, 15.0):
        check = OdometerCheck()
        counts = [
            check.read(round(1e6 * at), round(1e3 * (metres - 100.0 * (at > restart_s))))
            for at, metres in zip(t, shown_m, strict=True)
        ]
        assert counts.count(False) == check.leaps == (restart_s < np.inf)
