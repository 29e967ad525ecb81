"""``edge-vpr map`` of 200 million events: a process with its memory, and mapping alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from table import OURS

from edge_vpr.events import Sensor, make_events
from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap

SENSOR = Sensor(346, 260)
CHUNK, CHUNKS = 1_000_000, 200
#: 200 s at a million events a second
PERIOD_US = 1_000_000
MEMORY_MB = 400

DECODE = """
import sys
from edge_vpr.recordings import open_recording
print(sum(events.size for events in open_recording(sys.argv[1])))
"""

# A process inherits its parent's peak, and pytest's is large: a small one stands between.
WITNESS = """
import os, subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
child.returncode = os.waitstatus_to_exitcode(status)
print(usage.ru_maxrss)
sys.exit(child.returncode)
"""


class Drive:
    """Random events, more at some places and moments than at others, made as they are read."""

    sensor = SENSOR

    def __iter__(self):
        rng = np.random.default_rng(200)
        for k in range(CHUNKS):
            t = np.sort(rng.integers(k * PERIOD_US, (k + 1) * PERIOD_US, CHUNK))
            x = (rng.random(CHUNK) ** rng.uniform(0.8, 1.2) * SENSOR.width).astype(np.uint16)
            y = rng.integers(0, SENSOR.height, CHUNK)
            yield make_events(t, x, y, rng.integers(0, 2, CHUNK))


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """Write an EVT 2.0 file of 800 MB."""
    path = tmp_path_factory.mktemp("map") / "drive.raw"
    assert write_recording(path, Drive()) == CHUNK * CHUNKS
    yield path
    path.unlink()


def run(command: list[str]) -> float:
    """Run a process to its end, and return its peak memory in MB."""
    output = subprocess.run(
        [sys.executable, "-c", WITNESS, *command], check=True, capture_output=True, text=True
    )
    return float(output.stdout.split()[-1]) / (1e6 if sys.platform == "darwin" else 1e3)


@pytest.mark.parametrize(
    ("library", "how"), [(OURS, {}), ("decoding alone", {"limit": True, "target": 0.5})]
)
def bench_map(race, benchmark, drive, tmp_path, library, how):
    """Map with the default settings; within twice the time of decoding alone, below 400 MB."""
    commands = {
        OURS: ["-m", "edge_vpr_tools.cli", "map", str(drive), "-o", str(tmp_path / "map.npz")],
        "decoding alone": ["-c", DECODE, str(drive)],
    }
    command = [sys.executable, *commands[library]]
    if library == OURS:
        command.append("--overwrite")
    peaks = []

    def time_once():
        peaks.append(run(command))

    race("edge-vpr map, 200 M events in EVT 2.0", library, time_once, None, rounds=2, **how)
    benchmark.extra_info["note"] = f"peak {max(peaks):.0f} MB"
    assert max(peaks) < MEMORY_MB


def bench_map_alone(race, benchmark, drive):
    """Map in a process that runs already: what an event takes, without the start of a command."""
    work = "map 200 M events in EVT 2.0, without start-up"
    race(work, OURS, lambda: ReferenceMap.build(drive), None, rounds=2)
    if benchmark.stats is not None:  # it is timed
        least_ns = 1e9 * benchmark.stats.stats.min / (CHUNK * CHUNKS)
        benchmark.extra_info["note"] = f"{least_ns:.1f} ns an event"
