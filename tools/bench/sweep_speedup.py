"""How much faster a sweep is on more workers: the same plan on one and on several, on this machine.

``python tools/bench/sweep_speedup.py`` prints a table in Markdown. The cores have to be free. Each
run computes everything anew, and ends when its last trial has ended; the start of the processes
counts.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from edge_vpr_tools.research.sweep.plan import Plan, read_plan, run_sweep, sweep_store
from edge_vpr_tools.research.trials import TrialsRun, processes
from table import machine

from edge_vpr.recordings import write_recording
from edge_vpr.simulation import simulate_pair

_PLAN = """
seeds = {seeds}

[settings]
preset = "paper"

[grid]
pixels = [25, 50, 100, 150]
sequence_length = [1, 5]

[drives.street]
reference = "reference.npz"
query = "query.npz"
ground_truth = ["reference.csv", "query.csv"]
tolerance = 10
"""


def make_drives(folder: Path, length_m: float) -> None:
    """Write a simulated pair of drives, and their tracks."""
    drives = simulate_pair(0, length_m=length_m)
    for name, drive in zip(("reference", "query"), drives, strict=True):
        write_recording(folder / f"{name}.npz", drive, sensor=drive.sensor)
        rows = zip(drive.track.time_us / 1e6, drive.track.position[:, 0], strict=True)
        lines = "".join(f"{seconds:.6f},{metres:.3f}\n" for seconds, metres in rows)
        (folder / f"{name}.csv").write_text("time_s,position_m\n" + lines)


def make_plan(folder: Path, seeds: int) -> Plan:
    """Plan variants of the pair: 8 trials a seed."""
    path = folder / "sweep.toml"
    path.write_text(_PLAN.format(seeds=seeds))
    return read_plan(path)


def run_once(plan: Plan, folder: Path, workers: int) -> tuple[float, TrialsRun]:
    """Run the sweep into a new folder; seconds that it took, and what it did."""
    store = sweep_store(folder)
    begin = time.perf_counter()
    with store.opened(), processes(workers) as started:
        done = run_sweep(plan, store, started)
    return time.perf_counter() - begin, done


def report(workers: int, seeds: int, length_m: float) -> str:
    """Run on one worker and on so many, and set the table."""
    lines = ["| workers | trials | seconds | speed-up | busy |", "|--:|--:|--:|--:|--:|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_drives(folder, length_m)
        run_once(make_plan(folder, 1), folder / "warm", 1)  # kernels into their cache
        plan = make_plan(folder, seeds)
        alone = 0.0
        for count in (1, workers):
            seconds, done = run_once(plan, folder / f"on{count}", count)
            alone = alone or seconds
            lines.append(
                f"| {count} | {done.computed} | {seconds:.1f} | {alone / seconds:.2f} | "
                f"{done.busy_share:.0%} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--length", type=float, default=900.0, metavar="M")
    chosen = parser.parse_args()
    print(f"{machine()}\n\n{report(chosen.workers, chosen.seeds, chosen.length)}")
