"""Live streams, end to end: over a real pseudo-terminal and TCP, whole, cut and overloaded."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from edge_vpr_tools.cli import main
from streams import Drive, random_events

from edge_vpr.errors import MapError, UsageError
from edge_vpr.events import Sensor
from edge_vpr.localiser import Localiser
from edge_vpr.pipeline import cleaned, map_traverse
from edge_vpr.policy import Every
from edge_vpr.recordings import open_recording, write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import Settings
from edge_vpr.stream.bridge import Bridge, LineFaults
from edge_vpr.stream.links import open_device_link
from edge_vpr.stream.live import LiveLocaliser
from edge_vpr.stream.protocols import open_decoder, open_encoder

SENSOR = Sensor(64, 48)
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A folder with a query drive and a map of another."""
    folder = tmp_path_factory.mktemp("live")
    rng = np.random.default_rng(0)
    reference = Drive(random_events(rng, 60_000, SENSOR, 3_000_000), SENSOR)
    settings = Settings(pixels=20, sigma=1.0, tau_us=100_000, sequence_length=2)
    map_traverse(reference, settings).save(folder / "map.npz")
    query = random_events(rng, 40_000, SENSOR, 2_000_000)
    write_recording(folder / "query.npz", query, sensor=SENSOR)
    return folder


def offline(folder, every, *, from_first=False):
    """The matches of the recording as a file."""
    reference = ReferenceMap.load(folder / "map.npz")
    events = np.concatenate(list(open_recording(folder / "query.npz")))
    if from_first:
        events["t"] -= events["t"][0]
    localiser = Localiser(reference, every=every)
    recording = Drive(events, SENSOR)
    return np.concatenate(
        [localiser.update(part) for part in cleaned(recording, reference.settings)]
    )


def bridge_thread(port, protocol, folder, *, speed=0.0, faults=None):
    """A bridge that replays the query, and the address that a host opens."""
    recording = open_recording(folder / "query.npz", chunk_events=1_000)
    link = open_device_link(port)
    bridge = Bridge(link, open_encoder(protocol, SENSOR), speed=speed, faults=faults)

    def replay():
        bridge.run(recording)
        link.close()

    thread = threading.Thread(target=replay, daemon=True)
    thread.start()
    return bridge, link.address, thread


def rows_of(path, kind):
    return [row for row in map(json.loads, path.read_text().splitlines()) if row["kind"] == kind]


@pytest.mark.parametrize(
    ("port", "protocol"),
    [
        ("virtual", "evpr"),
        ("virtual", "edvs"),
        ("virtual", "evt3"),
        ("tcp://127.0.0.1:0", "evpr:width=3"),
        ("tcp://127.0.0.1:0", "openmv"),
        ("tcp://127.0.0.1:0", "evt2"),
    ],
)
def test_live_matches_are_the_offline_ones_to_the_bit(port, protocol, drive, tmp_path):
    bridge, address, thread = bridge_thread(port, protocol, drive)
    host = protocol.partition(":")[0]
    log, raw, events = tmp_path / "run.jsonl", tmp_path / "raw.bin", tmp_path / "events.npz"
    words = ["stream", "--port", address, "--protocol", host, "--map", drive / "map.npz", "--once"]
    words += ["--every", "event", "--log", log, "--record", raw, "--record", events]
    words += ["--on-overload", "wait", "--baud", "12000000"]
    assert main([str(word) for word in words]) == 0
    thread.join(timeout=5)
    assert not thread.is_alive()
    assert bridge.sent_events == 40_000
    expected = offline(drive, Every(events=1), from_first=not protocol.startswith("evpr"))
    assert expected.size > 100
    found = rows_of(log, "match")
    assert not any(row["incomplete"] for row in found)
    names = [name for name in expected.dtype.names if name != "ratio"]
    assert [[row[n] for n in names] for row in found] == [
        list(row) for row in expected[names].tolist()
    ]
    ratios = np.array([row["ratio"] for row in found], dtype=float)
    assert np.array_equal(ratios, expected["ratio"], equal_nan=True)
    (summary,) = rows_of(log, "summary")
    assert (summary["events"], summary["lost"], summary["resyncs"]) == (40_000, 0, 0)
    assert summary["bytes"] == raw.stat().st_size
    # what was recorded gives the same again, as events and as bytes
    again = np.concatenate(list(open_recording(events)))
    assert again.size == 40_000
    decoder = open_decoder(host, SENSOR)
    replayed = np.concatenate([decoder.feed(raw.read_bytes()), decoder.finish()])
    assert np.array_equal(replayed[["x", "y", "p"]], again[["x", "y", "p"]])


def test_a_prefix_of_a_real_walk_over_tcp_is_matched_as_offline(shared_data, tmp_path):
    frames = np.load(shared_data / "speck_walks" / "query.npz")["frames"][:120]
    np.savez(tmp_path / "frames.npz", frames=frames)
    from fractions import Fraction

    walk = open_recording(tmp_path / "frames.npz", frame_period=Fraction(1, 30))
    settings = Settings(pixels=25, sigma=3.0, tau_us=200_000, sequence_length=3)
    map_traverse(walk, settings).save(tmp_path / "map.npz")
    write_recording(tmp_path / "query.npz", walk)
    _, address, thread = bridge_thread_of(tmp_path / "query.npz", walk.sensor)
    log = tmp_path / "run.jsonl"
    words = ["stream", "--port", address, "--protocol", "evpr", "--map", tmp_path / "map.npz"]
    words += ["--once", "--every", "10ms", "--log", log, "--on-overload", "wait"]
    assert main([str(word) for word in words]) == 0
    thread.join(timeout=5)
    localiser = Localiser(ReferenceMap.load(tmp_path / "map.npz"), every=Every(interval_us=10_000))
    recording = open_recording(tmp_path / "query.npz")
    expected = np.concatenate([localiser.update(e) for e in cleaned(recording, settings)])
    found = rows_of(log, "match")
    assert expected.size > 100
    assert [(r["t"], r["place"], r["distance_sum"], r["second_sum"]) for r in found] == (
        expected[["t", "place", "distance_sum", "second_sum"]].tolist()
    )


def bridge_thread_of(path, sensor):
    link = open_device_link("tcp://127.0.0.1:0")
    bridge = Bridge(link, open_encoder("evpr", sensor), speed=0)

    def replay():
        bridge.run(open_recording(path))
        link.close()

    thread = threading.Thread(target=replay, daemon=True)
    thread.start()
    return bridge, link.address, thread


def test_what_a_bad_line_loses_is_counted_and_the_matches_around_it_are_flagged(drive, tmp_path):
    faults = LineFaults.parse("drop=1e-4,flip=1e-5,insert=1e-5,garbage=500")
    _, address, thread = bridge_thread("tcp://127.0.0.1:0", "evpr:frame=256", drive, faults=faults)
    log = tmp_path / "run.jsonl"
    words = ["stream", "--port", address, "--protocol", "evpr", "--map", drive / "map.npz"]
    words += ["--once", "--log", log, "--on-overload", "wait", "--every", "10ms"]
    assert main([str(word) for word in words]) == 0
    thread.join(timeout=5)
    (summary,) = rows_of(log, "summary")
    assert summary["lost"] > 0
    assert summary["decoded"] + summary["lost"] == 40_000
    assert summary["crc_errors"] > 0
    assert any(row["incomplete"] for row in rows_of(log, "match"))


def test_learning_over_the_line_gives_the_map_of_the_recording(drive, tmp_path, capsys):
    _, address, thread = bridge_thread("virtual", "evpr", drive)
    flags = ["--pixels", "20", "--sigma", "1", "--tau", "100ms", "-L", "2"]
    words = ["stream", "--port", address, "--protocol", "evpr", "--sensor", "64x48", "--once"]
    words += ["--on-overload", "wait", "--learn", "-o", tmp_path / "live.npz", *flags]
    assert main([str(word) for word in words]) == 0
    thread.join(timeout=5)
    words = ["map", drive / "query.npz", "-o", tmp_path / "file.npz", *flags]
    assert main([str(word) for word in words]) == 0
    live, file = (ReferenceMap.load(tmp_path / name) for name in ("live.npz", "file.npz"))
    assert np.array_equal(live.places.counts, file.places.counts)
    assert np.array_equal(live.pixel_map.x, file.pixel_map.x)


def test_an_overload_is_flagged_until_the_windows_are_whole_again(drive):
    reference = ReferenceMap.load(drive / "map.npz")
    events = np.concatenate(list(open_recording(drive / "query.npz")))
    sent = open_encoder("evpr:frame=256", SENSOR).encode(events)
    live = LiveLocaliser(open_decoder("evpr", SENSOR), reference, Every(interval_us=10_000))
    third = len(sent) // 3
    assert not live.feed(sent[:third], 0).incomplete
    cut = third + 2_000
    flags = []
    for i in range(cut, len(sent), 1_000):
        step = live.feed(sent[i : i + 1_000], 0, lost=2_000 if i == cut else 0)
        flags.append(step.incomplete)
    health = live.decoder.health
    assert flags[0]
    assert not flags[-1]
    assert flags.index(False) == sum(flags)  # flagged at first, then no more
    assert health.decoded + health.lost == events.size


def test_a_map_of_another_sensor_is_refused(drive):
    with pytest.raises(MapError, match="use the map of this camera"):
        LiveLocaliser(open_decoder("evt2", Sensor(10, 10)), ReferenceMap.load(drive / "map.npz"))


@pytest.mark.parametrize("text", ["drop=2", "drop", "colour=1", "stall=-1"])
def test_faults_that_make_no_sense_are_refused(text):
    with pytest.raises(UsageError, match="expected one of drop, flip"):
        LineFaults.parse(text)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_with_its_summary_and_its_files(number, drive, tmp_path):
    events = np.concatenate(list(open_recording(drive / "query.npz")))[:5_000]
    events["t"] -= events["t"][0]  # the stream has no frame before its first event
    sent = open_encoder("evpr", SENSOR).encode(events)
    read_end, write_end = os.pipe()
    words = ["stream", "--port", "-", "--protocol", "evpr", "--map", drive / "map.npz"]
    words += ["--record", tmp_path / "events.npz", "--log", tmp_path / "run.jsonl"]
    run = subprocess.Popen(
        [sys.executable, "-m", "edge_vpr_tools.cli", *map(str, words)],
        stdin=read_end, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'tools'}"},
    )  # fmt: skip
    os.close(read_end)
    # a run that says nothing fails this test instead of holding it up
    watchdog = threading.Timer(90, run.kill)
    watchdog.start()
    with os.fdopen(write_end, "wb") as pipe:
        pipe.write(sent)
        pipe.flush()
        assert run.stdout is not None
        lines = [""]
        while " 5,000 events" not in lines[-1]:
            lines.append(run.stdout.readline())
            assert lines[-1]
            assert len(lines) < 90, lines[-3:]
        run.send_signal(number)
        out, err = run.communicate(timeout=20)
    watchdog.cancel()
    assert run.returncode == 0, (err, lines, out)
    assert "5,000 events" in out
    assert "0 events lost on the way" in out
    recorded = np.concatenate(list(open_recording(tmp_path / "events.npz")))
    assert np.array_equal(recorded, events)
    assert rows_of(tmp_path / "run.jsonl", "summary")[0]["events"] == 5_000


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--learn"], "belong together"),
        ([], "pass --sensor WIDTHxHEIGHT or --map"),
        (["--sensor", "4x4", "--protocol", "x"], "choose one of evpr"),
        (["--sensor", "4x4", "--record", "a.npz", "--record", "b.npz"], "one file of events"),
    ],
)
def test_wrong_use_of_stream_is_one_line(words, says, capsys):
    assert main(["stream", "--port", "/dev/null0", "--protocol", "evpr", *words]) == 2
    err = capsys.readouterr().err.strip()
    assert says in err
    assert "\n" not in err


def test_ports_are_listed(capsys):
    assert main(["ports", "--json"]) == 0
    assert isinstance(json.loads(capsys.readouterr().out), list)
    assert main(["ports"]) == 0
    assert capsys.readouterr().out
