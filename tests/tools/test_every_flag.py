"""Every flag of every verb is run once through the real command line.

A flag without a run fails the first test: add it to `RUNS`.
"""

from __future__ import annotations

import json
from functools import partial

import h5py
import numpy as np
import pytest
from edge_vpr_tools import cli
from edge_vpr_tools.cli import GENERAL_FLAGS, VERBS, find_verb

from edge_vpr.events import Sensor
from edge_vpr.recordings import write_recording
from edge_vpr.simulation import simulate_pair
from firmware_model import Design
from tests.live.devices import sent_by
from tests.streams import random_events

SENSOR = Sensor(16, 12)
SMALL = "--pixels 5 --sigma 1 --tau 100ms -L 2"
TABLE = (
    "--sensor 16x12 --on-fault drop --format csv --time-unit us --columns txyp "
    "--start 0 --end 3 --start-offset 0.001"
)
SETTINGS = (
    "--preset tiny --config {f}/settings.toml --pixels 5 --strategy random --sigma 1.5 --seed 3 "
    "--window count --tau 100ms --events-per-pixel 4 "
    "--counter-code linear --counter-bits 3 "
    "--hot-pixels {f}/hot.txt --bursts keep --sequence-length 2 --exclusion 1"
)
FILTER = "--matching filter --filter-restart 20 --gains 1 --precision 0.5 --stays-on-map"
STREAM = "stream --port {f}/sent.bin --protocol evpr"
PROFILE = "profile --map {f}/map.npz --recording {f}/query.npz --quick --window-s 0.1 --pairs 5"

#: command lines in an order in which they can run, each with the exit code that is expected of it;
#: {f} is the folder
RUNS = [
    ("simulate -o {f}/pair --sensor tiny --length 20 --seed 2 --speed 3 --speed-range 1.5 "
     "--stops 1", 0),
    ("simulate -o {f}/pair --sensor tiny --length 20 --overwrite", 0),
    ("doctor --json", 0),
    ("info {f}/table.txt --sensor 16x12 --format csv --time-unit us --columns txyp --json "
     "--start 0.1 --end 1.5 --start-offset 0.01", 0),
    ("info {f}/query.h5 --sensor 16x12 --topic left --track {f}/track.csv --track-offset 0.1", 0),
    ("info {f}/frames.npz --frame-period 1/10", 0),
    (f"convert {{f}}/table.txt {{f}}/out.csv {TABLE}", 0),
    ("convert {f}/frames.npz {f}/out.csv --frame-period 1/10 --overwrite", 0),
    ("convert {f}/query.h5 {f}/out.csv --sensor 16x12 --topic left --overwrite", 0),
    (f"map {{f}}/reference.npz -o {{f}}/map.npz {SMALL}", 0),
    (f"map {{f}}/reference.npz -o {{f}}/map.npz {SETTINGS} --overwrite", 0),
    (f"map {{f}}/reference.npz -o {{f}}/map.npz {SMALL} "
     "--clip none --places-per-window 1 --overwrite", 0),
    (f"map {{f}}/reference.npz -o {{f}}/filter_map.npz {FILTER} --pixels 5 --tau 100ms --sigma 1 "
     "--track {f}/track.csv --track-offset 0.1 --longest-gap 9 --odometry {f}/odometry.csv "
     "--places-per-window 2", 0),
    ("map {f}/map.npz {f}/reference.npz -o {f}/two.npz --same-route --json", 0),
    (f"map {{f}}/frames.npz -o {{f}}/frames_map.npz {SMALL} --frame-period 1/10 "
     "--frames-as-windows", 0),
    (f"map {{f}}/table.txt -o {{f}}/table_map.npz {SMALL} {TABLE} --no-smooth "
     "--no-stays-on-map", 0),
    (f"map {{f}}/table.txt -o {{f}}/table_map.npz {SMALL} {TABLE} --smooth --overwrite", 0),
    (f"map {{f}}/query.h5 -o {{f}}/topic_map.npz --sensor 16x12 {SMALL} --topic left", 0),
    ("match {f}/map.npz {f}/query.npz -o {f}/results -L 3 --exclusion 1 "
     "--figures png,pdf,svg --matrix {f}/distances.npy", 0),
    ("match {f}/map.npz {f}/query.npz -o {f}/results --no-figures --overwrite --json", 0),
    ("match {f}/map.npz {f}/query.npz -o {f}/online --online --every 50ms", 0),
    (f"match {{f}}/filter_map.npz {{f}}/query.npz -o {{f}}/filtered {FILTER} --smooth "
     "--odometry {f}/odometry.csv --export {f}/matched.tum", 0),
    ("replay {f}/results -o {f}/match.gif --frames 3 --start 0.5 --end 1.5", 0),
    ("replay {f}/filtered -o {f}/all_events.gif --frames 2 --all-events", 0),
    ("replay {f}/filtered -o {f}/match.gif --frames 2 --overwrite", 0),
    ("map {f}/reference.npz -o {f}/wide_map.npz --pixels 60 --sigma 0 --tau 100ms", 0),
    ("map {f}/reference.npz {f}/reference.npz -o {f}/same_pixels.npz --tau 100ms "
     "--pixel-map {f}/wide_map.npz", 0),
    ("match {f}/filter_map.npz {f}/query.npz -o {f}/fed --online --every 50ms --no-figures "
     "--no-smooth --no-stays-on-map --odometry {f}/odometry.csv", 0),
    (f"match {{f}}/map.npz {{f}}/table.txt -o {{f}}/table --no-figures {TABLE}", 0),
    ("match {f}/map.npz {f}/query.h5 -o {f}/topic --no-figures --sensor 16x12 --topic left", 0),
    ("match {f}/frames_map.npz {f}/frames.npz -o {f}/windows --no-figures --frame-period 1/10 "
     "--frames-as-windows", 0),
    ("evaluate {f}/results --ground-truth {f}/truth.csv --tolerance 0.2 --score ratio "
     "--recall-denominator all-with-place", 0),
    ("evaluate {f}/results --ground-truth {f}/frames.csv --tolerance 2 --frame-period 1/10 "
     "--figures pdf", 0),
    ("evaluate {f}/results --ground-truth {f}/truth.npy --rows reference --json", 0),
    ("evaluate {f}/filtered --ground-truth {f}/track.csv {f}/track.csv --tolerance 1 "
     "--longest-gap 9 --offset 0 0.05", 0),
    ("calibrate {f}/filtered -o {f}/calibrated.npz", 0),
    ("calibrate {f}/results -o {f}/calibrated.npz --overwrite", 0),
    (f"{STREAM} --map {{f}}/map.npz --once --sensor 16x12 --every 20ms --log {{f}}/run.jsonl "
     "--max-age 2s --state {f}/run.state "
     "--record {f}/raw.bin --json --baud 115200 --flow-control --on-overload wait --max-lag 1s",
     0),
    (f"{STREAM} --map {{f}}/map.npz --once --log {{f}}/run.jsonl --overwrite -L 3 "
     "--exclusion 1", 0),
    (f"{STREAM} --map {{f}}/filter_map.npz --once --odometry udp://127.0.0.1:0", 0),
    (f"{STREAM} --map {{f}}/filter_map.npz --once {FILTER}", 0),
    (f"{STREAM} --map {{f}}/map.npz --once --http 0 --status-every 2s", 0),
    (f"{STREAM} --map {{f}}/filter_map.npz --once --smooth", 2),
    ("match {f}/filter_map.npz {f}/query.npz -o {f}/smooth --online --smooth", 2),
    (f"{STREAM} --once --sensor 16x12 --learn -o {{f}}/learnt.npz {SETTINGS} --no-smooth "
     "--no-stays-on-map --places-per-window 2", 0),
    (f"{STREAM} --once --sensor 16x12 --learn -o {{f}}/learnt.npz {SMALL} "
     "--clip 200 --overwrite", 0),
    ("bridge {f}/query.npz --port udp://127.0.0.1:9 --protocol evpr --speed 0 --baud 9600 "
     "--flow-control --faults drop=0.01 --seed 1", 0),
    (f"bridge {{f}}/table.txt --port udp://127.0.0.1:9 --speed 0 {TABLE}", 0),
    ("bridge {f}/query.h5 --port udp://127.0.0.1:9 --sensor 16x12 --speed 0 --topic left", 0),
    ("bridge {f}/frames.npz --port udp://127.0.0.1:9 --speed 0 --frame-period 1/10", 0),
    ("ports --json", 0),
    ("estimate --pixels 5 --places 20 --counter-bits 3 --lanes 2 --event-rate 1e4 "
     "--target cortex-m4 --json", 0),
    ("estimate --places-per-window 1 --fit 64KiB --fit ram=8KiB --target cortex-m0plus", 0),
    ("estimate --design {f}/design.toml --target cortex-m4 --sources", 0),
    ("estimate --map {f}/wide_map.npz --target cortex-m4", 0),
    ("golden --design {f}/design.toml -o {f}/vectors --seed 1", 0),
    ("golden --map {f}/wide_map.npz --recording {f}/query.npz --max-windows 5 --lanes 2 "
     "--vectors 2MB -o {f}/vectors --overwrite", 0),
    ("golden --map {f}/wide_map.npz --recording {f}/query.npz --max-windows 3 --suite recording "
     "-o {f}/vectors2", 0),
    ("golden --design {f}/design.toml -o {f}/core_vectors --rtl", 0),
    ("hardware --design {f}/design.toml -o {f}/core --vectors 1MB", 0),
    ("convert {f}/wide_map.npz {f}/map.hex --address 0x08040000 --overwrite", 0),
    ("hardware --map {f}/wide_map.npz --lanes 2 -o {f}/core_of_map", (0, 2)),
    ("golden verify {f}/vectors", 0),
    # the results that it names are of another case
    ("golden verify {f}/vectors --results {f}/none.csv --case corners/none --only match", 2),
    ("golden verify {f}/vectors --port {f}/none --baud 9600 --timeout 5", 1),
    (f"{PROFILE} -o {{f}}/profile --sensor-name ina226@hwmon2 "
     "--shunt-mohm 20", 0),
    (f"{PROFILE} -o {{f}}/profile --overwrite --json --meter", 0),
    # 2: there is no such sensor
    (f"{PROFILE} -o {{f}}/refused --sensor-name none", 2),
    ("profile compare {f}/profile/profile.json {f}/profile/profile.json --json", 0),
    # 2: the meter's three readings need not follow the load
    ("profile trace {f}/profile/profile.json {f}/meter.csv --voltage 5 --time time_s:s "
     "--current power_w:a --first-load 1", (0, 2)),
    ("profile trace {f}/profile/profile.json {f}/meter.csv --power power_w", (0, 2)),
    ("sweep {f}/sweep.toml -o {f}/swept.csv --workers 1 --overwrite", 0),
    ("sweep {f}/sweep.toml --output {f}/swept.csv --workers 1 --resume", 0),
    # 2: an address without a port
    ("sweep {f}/sweep.toml -o {f}/swept.csv --resume --scheduler nowhere", 2),
    ("compare {f}/swept.csv -o {f}/compared", 0),
    ("compare {f}/swept.csv -o {f}/compared --overwrite --figures pdf,svg --measure Recall@1", 0),
    ("demo -o {f}/demo --overwrite", 0),
]  # fmt: skip


def flags_of(verb):
    """Every spelling of a flag but the short ones, by the longest of each pair."""
    for action in cli.VerbParser(verb)._actions:
        for flag in action.option_strings:
            if flag.startswith("--") and flag not in GENERAL_FLAGS:
                yield flag, set(action.option_strings)


def missing(verb, runs):
    """Flags of a verb that no run has."""
    used = set()
    for line in runs:
        verb_of_line, words = find_verb(line.split())
        if verb_of_line == verb:
            used |= set(words)
    for flag, spellings in flags_of(verb):
        # --no-x is a flag of its own
        no = flag.startswith("--no-")
        if not used & {other for other in spellings if other.startswith("--no-") == no}:
            yield flag


@pytest.mark.parametrize("verb", VERBS)
def test_every_flag_of_every_verb_has_a_run(verb):
    lines = [line for line, _ in RUNS]
    assert any(find_verb(line.split())[0] == verb for line in lines)
    assert not list(missing(verb, lines))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flags")
    rng = np.random.default_rng(0)
    for name in ("reference", "query"):
        events = random_events(rng, 4_000, SENSOR, 2_000_000)
        write_recording(folder / f"{name}.npz", [events], sensor=SENSOR)
    with h5py.File(folder / "query.h5", "w") as file:
        for name in "txyp":
            file[f"left/{name}"] = events[name].astype(np.int64)
            file[f"right/{name}"] = events[name].astype(np.int64)
    rows = [f"{t},{x},{y},{int(p)}" for t, x, y, p in events.tolist()]
    (folder / "table.txt").write_text("\n".join(rows) + "\n")
    np.savez(folder / "frames.npz", frames=rng.integers(0, 9, (12, 12, 16)))
    (folder / "sweep.toml").write_text(
        '[settings]\npreset = "paper"\npixels = 5\nsigma = 1.0\ntau = "100ms"\n'
        '[drives.flags]\nreference = "reference.npz"\nquery = "query.npz"\n'
        'ground_truth = "truth.csv"\ntolerance = 0.2\n'
    )
    (folder / "settings.toml").write_text("sigma = 2.0\n")
    (folder / "hot.txt").write_text("1, 1\n")
    (folder / "truth.csv").write_text("query_s,reference_s\n0,0\n1000,1000\n")
    (folder / "odometry.csv").write_text("time_s,speed_mps\n-1,5\n3,9\n")
    (folder / "track.csv").write_text("time_s,position_m\n-1,-10\n3,30\n")
    (folder / "frames.csv").write_text("query_frame,reference_frame\n0,0\n1000,1000\n")
    np.save(folder / "truth.npy", np.eye(19, 19, dtype=np.uint8))
    (folder / "sent.bin").write_bytes(sent_by(events, SENSOR))
    Design(width=16, height=12, pixels=3, places=4, length=2).save(folder / "design.toml")
    (folder / "none.csv").write_text("event,0,0,0\n")
    (folder / "meter.csv").write_text("time_s,power_w\n0,1\n1,2\n2,1\n")
    monitor = folder / "board/sys/class/hwmon/hwmon2"
    monitor.mkdir(parents=True)
    for name, text in {"name": "ina226", "power1_input": 2_000_000, "shunt_resistor": 10_000,
                       "update_interval": 10}.items():  # fmt: skip
        (monitor / name).write_text(f"{text}\n")
    return folder


@pytest.fixture
def small_loads(monkeypatch):
    """Short streets: what those give is the matter of other tests."""
    monkeypatch.setattr("firmware_model.vectors.standard_suites", lambda *unused: {})
    monkeypatch.setattr("edge_vpr_tools.report.traverse.write_report", lambda *unused, **more: None)
    street = partial(simulate_pair, length_m=60.0)
    monkeypatch.setattr("edge_vpr.simulation.simulate_pair", street)


@pytest.mark.slow
@pytest.mark.usefixtures("small_loads")
def test_every_command_line_ends_as_it_should(folder, capsys, monkeypatch):
    """In their order, as later ones read what earlier ones write; tells all that end otherwise."""
    wrong = []
    monkeypatch.setattr("edge_vpr_tools.profile.sensors.sensor.ROOT", folder / "board")
    for line, code in RUNS:
        ended = cli.main(line.format(f=folder).split())
        err = capsys.readouterr().err
        if ended not in (code if isinstance(code, tuple) else (code,)) or "internal error" in err:
            wrong.append(f"{line}\nended with {ended}, not {code}:\n{err}")
    assert not wrong, "\n".join(wrong)


def test_what_was_removed_is_in_the_record_of_the_run(folder, tmp_path):
    output = tmp_path / "map.npz"
    words = f"map {folder / 'reference.npz'} -o {output} {SMALL}".split()
    assert cli.main(words) == 0
    record = json.loads((tmp_path / "map.run.json").read_text())
    assert record["removed"] == {
        "events_read": 4_000, "burst_events": 0, "burst_share": 0.0, "hot_pixels": 0,
    }  # fmt: skip
