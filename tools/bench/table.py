"""The table of a benchmark run, in Markdown, with the machine named."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib import metadata
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
    asked: float | None
    limit: bool
    note: str = ""


def table(entries: Iterable[Entry]) -> str:
    """One row for each contestant; ratios are of least times.

    A peer's ratio says how many times faster edge-vpr is; a limit's, which share of it is reached.
    """
    entries = list(entries)
    rows = [
        "| work | by | least | median | edge-vpr against it | asked |",
        "|---|---|--:|--:|--:|--:|",
    ]
    for work in dict.fromkeys(entry.work for entry in entries):
        ours = next((e for e in entries if e.work == work and e.library == OURS), None)
        for i, entry in enumerate(e for e in entries if e.work == work):
            ratio = _ratio(ours, entry)
            cells = [
                work if i == 0 else "",
                _name(entry),
                _seconds(entry.least),
                _seconds(entry.median),
                "" if ratio is None else f"{ratio:.2f} of it" if entry.limit else f"{ratio:.1f} x",
                "" if entry.asked is None else f"{entry.asked:g}",
            ]
            if ratio is not None and entry.asked is not None and ratio < entry.asked:
                cells[-1] += " (missed)"
            rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def page(entries: Iterable[Entry], skipped: list[str]) -> str:
    """Write out the page ``docs/benchmarks.md``."""
    entries = list(entries)
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench`; the numbers of another machine differ, the ratios less so.",
        "",
        f"Machine: {machine()}. {versions()}. One thread each.",
        "",
        "`least` and `median` are over the rounds of one run. A ratio is of least times: how",
        "many times faster edge-vpr is than a peer, or which share of a limit it reaches; `asked`",
        "is what the project set itself. Before a contestant is timed, its result must equal",
        "edge-vpr's to the bit. Conversions that a peer needs (to float32, say) are not timed.",
        "",
        table(entries),
        "",
    ]
    if skipped:
        lines += ["Not measured:", "", *[f"- {reason}" for reason in skipped], ""]
    return "\n".join(lines)


def machine() -> str:
    """Name of the processor, its cores, and the system."""
    return f"{processor_name()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Versions of Python and of the libraries that took part."""
    found = [f"Python {platform.python_version()}"]
    for library in _LIBRARIES:
        try:
            found.append(f"{library} {metadata.version(library)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join(found)


def _name(entry: Entry) -> str:
    name = f"**{OURS}**" if entry.library == OURS else entry.library
    return f"{name} ({entry.note})" if entry.note else name


def _ratio(ours: Entry | None, entry: Entry) -> float | None:
    if ours is None or entry is ours:
        return None
    return entry.least / ours.least


def _seconds(seconds: float) -> str:
    units = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6))
    unit, scale = next((u for u in units if seconds >= u[1]), units[-1])
    return f"{seconds / scale:.3g} {unit}"
