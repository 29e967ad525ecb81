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
from edge_vpr_tools.commands.calibrate import calibrate
from edge_vpr_tools.truth_files import TruthFiles
from numba.core import event

from edge_vpr.match_result import MatchResult, describe_query
from edge_vpr.matching.drive import match_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.run_log import COMPILING

ROOT = Path(__file__).parents[2]


def test_building_and_matching_give_what_the_commands_write(drive, tmp_path, run):
    """A map made of the settings of the command's map is the same, and so are the matches."""
    written = ReferenceMap.load(drive / "map.npz")
    made = ReferenceMap.build(drive / "reference.npz", written.settings)
    assert made == written

    result = made.match(drive / "query.npz")
    match = ["match", drive / "map.npz", drive / "query.npz", "--no-figures", "-o"]
    run(*match, tmp_path / "windows")
    again = MatchResult.load(tmp_path / "windows")
    assert (again.matches, again.queries, again.reference) == (result.matches, result.queries, made)
    result.save(tmp_path / "saved")
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
    run(*match, tmp_path / "online", "--online", "--every", "20ms")
    again = MatchResult.load(tmp_path / "online")
    assert (again.matches, again.queries) == (online.matches, None)

    truth = tmp_path / "truth.csv"
    truth.write_text("query_s,reference_s\n0,0\n1000,1000\n")
    times = (made.places.centre_us, result.queries.centre_us)
    truth_of_files = TruthFiles((str(truth),), tolerance=0.3)(*times)
    truth.write_text("query_frame,reference_frame\n0,0\n9000,9000\n")
    of = TruthFiles((str(truth),), tolerance=0.3, frame_period="1/9", in_seconds=True)(*times)
    assert (of.error_unit, of.positions.tolerance) == ("s", 0.3)
    assert np.array_equal(of.correct, truth_of_files.correct)
    learnt = calibrate(made, result.matches, truth_of_files)
    assert 0 < learnt.matches <= len(result.matches) and 0 <= learnt.correct <= learnt.matches
    assert learnt.reference.confidence == learnt.confidence


def test_times_are_without_compilation(drive, monkeypatch):
    """A second in which the compiler has its lock, of a clock that goes in no other way."""
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    now = 0.0
    monkeypatch.setattr(time, "perf_counter", lambda: now)

    def slow(original, compiling_s, working_s):
        def call(*args, **kwargs):
            nonlocal now
            with event.trigger_event("numba:compiler_lock"):
                now += compiling_s
            now += working_s
            return original(*args, **kwargs)

        return call

    for original, working_s in ((describe_query, 3.0), (match_query, 5.0)):
        patched = slow(original, 100.0, working_s)
        monkeypatch.setattr(f"edge_vpr.match_result.{original.__name__}", patched)
    metrics = ReferenceMap.load(drive / "map.npz").match(drive / "query.npz").metrics
    assert (metrics.counting_s, metrics.matching_s, now) == (3.0, 5.0, 208.0)


@pytest.mark.slow
def test_a_command_compiles_once_and_says_so(drive, tmp_path):
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    map_, query = drive / "map.npz", drive / "query.npz"
    words = ["match", map_, query, "-o", tmp_path / "run", "--overwrite", "--no-figures"]
    errors = [
        subprocess.run(
            [sys.executable, "-m", "edge_vpr_tools.cli", *map(str, words)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
            capture_output=True, text=True, check=True, timeout=300,
        ).stderr
        for _ in range(2)
    ]  # fmt: skip
    assert errors == [f"edge-vpr: {COMPILING}\n", ""]
