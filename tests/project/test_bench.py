"""Every program of `tools/bench` runs on its smallest input, so that none breaks unseen."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[2] / "tools" / "bench"
#: what the programs share, and what `byte_to_match.py` starts
PARTS = {"conftest.py", "table.py", "robot_program.py"}
#: arguments of the smallest run, and what is printed at its end
SMALLEST = {
    "byte_to_match.py": (["--matches", "9", "--rates", "2000"], "in the reader of `stream`: "),
    "gaps.py": (["--seeds", "1", "--length", "40"], "smoothed recording,cut out,4,"),
    "starts.py": (["--times", "1", "--length", "40"], '--no-figures",kept,'),
    "soak.py": (["--minutes", "0.02"], "the device itself was late by "),
}
RACES = """
import sys

sys.path.insert(0, sys.argv[1])
import bench_counting, bench_decoding, bench_map, pytest

bench_decoding.EVENTS = bench_counting.EVENTS = 4_000
bench_map.CHUNK, bench_map.CHUNKS = 20_000, 3
few = "not 100000 and not 8000 and not 89960"
words = [sys.argv[1], "-c", sys.argv[1] + "/pytest.ini", "--rootdir", sys.argv[1], "-k", few]
sys.exit(pytest.main([*words, "--benchmark-disable"]))
"""
LATENCY = """
import sys

sys.path.insert(0, sys.argv[1])
import latency

latency.EVENTS_PER_SECOND, latency.SECONDS, latency.PLACES = 600_000, 4, 100
latency.ONE_BY_ONE = 9_000
latency.main(sys.argv[2])
"""

pytestmark = pytest.mark.slow


def run(*words):
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout[-2_000:] + done.stderr[-2_000:]
    return done.stdout


def test_the_races_are_run_once():
    pytest.importorskip("pytest_benchmark", reason="pytest-benchmark is not installed")
    said = run("-c", RACES, BENCH)
    assert " passed" in said and " failed" not in said


def test_the_latency_of_chunks_is_measured(tmp_path):
    run("-c", LATENCY, BENCH, tmp_path)
    with (tmp_path / "latency-chunks.csv").open(encoding="utf-8") as file:
        matches = [int(row["matches"].replace(",", "")) for row in csv.DictReader(file)]
    assert len(matches) == 9 and min(matches) > 0


@pytest.mark.parametrize(
    "name",
    sorted(
        each.name for each in BENCH.glob("*.py")
        if each.name not in {*PARTS, "latency.py"} and not each.name.startswith("bench_")
    ),
)  # fmt: skip
def test_a_program_runs(name):
    words, last = SMALLEST.get(name, (["--help"], "usage: "))
    assert last in run(BENCH / name, *words)
