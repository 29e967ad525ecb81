"""The jobs of the commands, called from Python without a command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest
from edge_vpr_tools.cli import main
from edge_vpr_tools.commands.calibrate import calibrate
from edge_vpr_tools.commands.info import summarise
from edge_vpr_tools.truth_files import TruthFiles

from edge_vpr.map_making import describe_query, map_traverse
from edge_vpr.match_result import MatchResult
from edge_vpr.matching.drive import match_descriptors, match_query
from edge_vpr.recordings import open_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import to_json
from edge_vpr.warm_up import mapping_steps, warm_up
from tests.tools.test_commands import drive  # noqa: F401

ROOT = Path(__file__).parents[2]


def test_building_and_matching_give_what_the_commands_write(drive, tmp_path):  # noqa: F811
    """A map made of the settings of the command's map is the same, and so are the matches."""
    written = ReferenceMap.load(drive / "map.npz")
    made = ReferenceMap.build(drive / "reference.npz", written.settings)
    assert made == written

    found = made.match(drive / "query.npz")
    flags = [str(drive / "map.npz"), str(drive / "query.npz"), "--no-figures"]
    assert main(["match", *flags, "-o", str(tmp_path / "windows")]) == 0
    again = MatchResult.load(tmp_path / "windows")
    assert (again.matches, again.queries, again.reference) == (found.matches, found.queries, made)
    found.save(tmp_path / "saved")
    names = {file.name for file in (tmp_path / "windows").iterdir()} - {"report.html"}
    assert {file.name for file in (tmp_path / "saved").iterdir()} == names
    assert (tmp_path / "saved/matches.csv").read_bytes() == (
        tmp_path / "windows/matches.csv"
    ).read_bytes()
    metrics = [
        json.loads((tmp_path / n / "metrics.json").read_text()) for n in ("saved", "windows")
    ]
    assert metrics[0].keys() == metrics[1].keys()
    (recording,) = json.loads((tmp_path / "saved/run.json").read_text())["inputs"]
    assert recording["path"] == str(drive / "query.npz")

    online = made.match(drive / "query.npz", every="20ms")
    command = ["match", *flags, "--online", "--every", "20ms", "-o", str(tmp_path / "online")]
    assert main(command) == 0
    again = MatchResult.load(tmp_path / "online")
    assert (again.matches, again.queries) == (online.matches, None)

    truth = tmp_path / "truth.csv"
    truth.write_text("query_s,reference_s\n0,0\n1000,1000\n")
    times = (made.places.centre_us, found.queries.centre_us)
    known = TruthFiles((str(truth),), tolerance=0.3)(*times)
    truth.write_text("query_frame,reference_frame\n0,0\n9000,9000\n")
    of = TruthFiles((str(truth),), tolerance=0.3, frame_period="1/9", in_seconds=True)(*times)
    assert (of.error_unit, of.positions.tolerance) == ("s", 0.3)
    assert np.array_equal(of.correct, known.correct)
    learnt = calibrate(made, found.matches, known)
    assert 0 < learnt.matches <= len(found.matches) and 0 <= learnt.correct <= learnt.matches
    assert learnt.reference.confidence == learnt.confidence


def test_a_recording_is_summed_up_as_info_says(drive, capsys):  # noqa: F811
    """The record's fields are those of `--json`."""
    path = drive / "query.npz"
    found = summarise(open_recording(path))
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == to_json(found)
    assert found.events_per_s == found.events * 1e6 / found.duration_us


def test_times_are_without_compilation(drive, tmp_path, monkeypatch):  # noqa: F811
    """Kernels that load in a first call are in no time of a command."""
    calls = {"describe_query": 0, "match_query": 0, "map_traverse": 0}
    now = 0.0  # a clock that first calls alone move
    monkeypatch.setattr(time, "perf_counter", lambda: now)

    def slow(name, original):
        def call(*args, **kwargs):
            nonlocal now
            calls[name] += 1
            now += calls[name] == 1
            return original(*args, **kwargs)

        return call

    for name, at, matching, warming in (
        ("describe_query", "match_result", describe_query, describe_query),
        ("match_query", "match_result", match_query, match_descriptors),
        ("map_traverse", "map_making", map_traverse, map_traverse),
    ):
        for module, original in ((at, matching), ("warm_up", warming)):
            patched = slow(name, original)
            monkeypatch.setattr(f"edge_vpr.{module}.{original.__name__}", patched)
    out = tmp_path / "run"
    words = ["match", str(drive / "map.npz"), str(drive / "query.npz"), "-o", str(out)]
    assert main([*words, "--no-figures"]) == 0
    found = json.loads((out / "metrics.json").read_text())
    assert (found["counting_s"], found["matching_s"], now) == (0, 0, 2)
    settings = ReferenceMap.load(drive / "map.npz").settings
    warm_up(mapping_steps(settings))
    assert now == 3
    ReferenceMap.build(open_recording(drive / "query.npz"), settings)
    assert calls == {"describe_query": 2, "match_query": 2, "map_traverse": 2}


@pytest.mark.slow
def test_a_command_compiles_before_its_work(drive, tmp_path):  # noqa: F811
    """And shows which kernel of which part: one warm-up covers what the command reaches."""
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    reference, query = drive / "reference.npz", drive / "query.npz"
    driven, small = tmp_path / "driven.csv", "--pixels 20 --sigma 1 --tau 100ms"
    rows = "\n".join(f"{t / 20},{t / 10}" for t in range(40))
    driven.write_text(f"time_s,distance_m\n{rows}\n")
    commands = [
        f"map {reference} -o {tmp_path}/map.npz {small}",
        f"match {tmp_path}/map.npz {query} -o {tmp_path}/recorded --no-figures",
        f"match {tmp_path}/map.npz {query} -o {tmp_path}/live --online --no-figures",
        f"map {reference} -o {tmp_path}/driven.npz {small} --window count --odometry {driven}",
        f"match {tmp_path}/driven.npz {query} -o {tmp_path}/odometry --odometry {driven}",
        f"map {reference} -o {tmp_path}/whole.npz {small} --places-per-window 1",
        f"match {tmp_path}/whole.npz {query} -o {tmp_path}/L3 --matching sequence -L 3 "
        "--no-figures",
    ]
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests/tools/left_by_commands.py"), *commands],
        env={
            **os.environ,
            "PYTHONPATH": f"{ROOT}:{ROOT / 'tools'}",
            "NUMBA_CACHE_DIR": str(tmp_path / "kernels"),
        },
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "compiling kernels, once on each machine for each kind of work" in done.stderr
