"""The table of a benchmark run, and the machine that it ran on."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from edge_vpr.results import processor_name

#: the contestant that all others are compared with
OURS = "edge-vpr"
# peers whose version decides what was measured
_LIBRARIES = ("numpy", "numba", "scipy", "faiss-cpu", "torch", "tonic")


class Entry(NamedTuple):
    """Seconds that one contestant took for one work."""

    work: str
    library: str
    least: float
    median: float
    target: float | None
    limit: bool
    note: str = ""


HEADER = ("work", "by", "least", "median", "edge-vpr against it", "target", "note")


def rows(entries: Iterable[Entry]) -> list[tuple[str, ...]]:
    """Return one row for each contestant, with its columns as in `HEADER`; ratios of least times.

    A peer's ratio says how many times faster edge-vpr is; a limit's, which share of it is reached.
    """
    entries, table = list(entries), []
    for work in dict.fromkeys(entry.work for entry in entries):
        ours = next((e for e in entries if e.work == work and e.library == OURS), None)
        for entry in (e for e in entries if e.work == work):
            ratio = _ratio(ours, entry)
            target = "" if entry.target is None else f"{entry.target:g}"
            if ratio is not None and entry.target is not None and ratio < entry.target:
                target += " (missed)"
            against = ""
            if ratio is not None:
                against = f"{ratio:.2f} of it" if entry.limit else f"{ratio:.1f} x"
            times = _seconds(entry.least), _seconds(entry.median)
            table.append((work, entry.library, *times, against, target, entry.note))
    return table


def write_csv(path: Path, entries: Iterable[Entry]) -> None:
    """Write ``docs/results/benchmarks.csv``."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows(entries)])


def machine() -> str:
    """Return the name of the processor, its cores, and the system."""
    return f"{processor_name()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Return the versions of Python and of the libraries that took part."""
    names = [f"Python {platform.python_version()}"]
    for library in _LIBRARIES:
        try:
            names.append(f"{library} {metadata.version(library)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join(names)


def _ratio(ours: Entry | None, entry: Entry) -> float | None:
    if ours is None or entry is ours:
        return None
    return entry.least / ours.least


def _seconds(seconds: float) -> str:
    units = (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6))
    unit, scale = next((u for u in units if seconds >= u[1]), units[-1])
    return f"{seconds / scale:.3g} {unit}"
