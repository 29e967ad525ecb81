"""What the benchmarks share: a race between libraries on one work, and the table of its results.

``python -m pytest tools/bench`` prints the table; ``--write=FILE`` also writes it as CSV.
Every contestant runs on one thread. Its result is compared with ours before it is timed.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

# before any of the libraries is loaded
for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from table import HEADER, OURS, Entry, machine, rows, versions, write_csv  # noqa: E402

Race = Callable[..., None]


def pytest_addoption(parser):
    parser.addoption("--write", type=Path, metavar="FILE", help="write the table as CSV, too")


@pytest.fixture
def race(benchmark) -> Race:
    """Time one contestant of a work.

    ``race(work, library, run, expected, rounds=20, target=None, limit=False)``: `run` returns the
    result, which must equal `expected` (None: it has none that could be compared). `target` is the
    ratio to this contestant that the project set itself. A limit is not a peer that does the same
    work, but what the work cannot do without, such as reading its input once.
    """

    def time(work, library, run, expected, *, rounds=20, target=None, limit=False):
        result = run()
        if expected is not None:
            np.testing.assert_array_equal(np.asarray(result).astype(np.int64), expected)
        benchmark.group = work
        benchmark.extra_info |= {"library": library, "target": target, "limit": limit}
        benchmark.pedantic(run, rounds=rounds, iterations=1, warmup_rounds=1)

    return time


def pytest_terminal_summary(terminalreporter, config):
    session = getattr(config, "_benchmarksession", None)
    entries = [
        Entry(
            bench.group,
            bench.extra_info["library"],
            bench.stats.min,
            bench.stats.median,
            bench.extra_info["target"],
            bench.extra_info["limit"],
            bench.extra_info.get("note", ""),
        )
        for bench in (session.benchmarks if session else [])
        if "library" in bench.extra_info
    ]
    if not any(entry.library == OURS for entry in entries):
        return
    terminalreporter.section("edge-vpr against its peers and its limits")
    terminalreporter.write_line(f"{machine()}. {versions()}")
    for line in (HEADER, *rows(entries)):
        terminalreporter.write_line(" | ".join(line))
    if config.option.write:
        config.option.write.parent.mkdir(parents=True, exist_ok=True)
        write_csv(config.option.write, entries)
        terminalreporter.write_line(f"written to {config.option.write}")
