"""How long commands take from nothing: with an empty cache of kernels, and with a filled one.

``python tools/bench/starts.py > docs/results/starts.csv`` simulates a street, and starts each
command in a process of its own. Processor time, which other work on the machine lengthens little:
the least counts.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from edge_vpr.recordings import write_recording
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.simulation import simulate_pair

#: words of each command; {f} is the folder
COMMANDS = (
    "--help",
    "stream --help",
    "map {f}/first.raw -o {f}/again.npz --overwrite",
    "match {f}/map.npz {f}/second.raw -o {f}/run --overwrite",
    "match {f}/map.npz {f}/second.raw -o {f}/run --overwrite --no-figures",
)


def start(words: list[str], cache: Path) -> float:
    """Run a command; return its processor time in seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "edge_vpr_tools.cli", *words],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        check=True, capture_output=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--length", type=float, default=1_000.0)
    args = parser.parse_args()
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["command", "kernels", "processor [s]"])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first, second = simulate_pair(0, length_m=args.length)
        write_recording(folder / "first.raw", first)
        events = write_recording(folder / "second.raw", second)
        ReferenceMap.build(folder / "first.raw").save(folder / "map.npz")
        for command in COMMANDS:
            words = command.format(f=folder).split()
            # in turns, so that other work on the machine meets both
            taken: dict[str, list[float]] = {"none": [], "kept": []}
            for i in range(args.times):
                cache = folder / f"kernels {command} {i}".replace("/", " ")
                taken["none"].append(start(words, cache))
                taken["kept"].append(start(words, cache))
            shown = command.replace("{f}/", "").replace("second.raw", f"RAW of {events:,} events")
            for kernels, times in taken.items():
                table.writerow([shown, kernels, f"{min(times):.2f}"])
                sys.stdout.flush()


if __name__ == "__main__":
    main()
