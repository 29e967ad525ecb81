"""From an event's arrival to its match: a camera of a million events a second, on one core.

``python tools/bench/latency.py [FOLDER]`` prints the table; `make bench` writes it to
`docs/results`.
From the byte on a line on, `byte_to_match.py` measures.
"""

from __future__ import annotations

import csv
import gc
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_localiser import SENSOR, scene
from table import machine

from edge_vpr.events import Events, make_events
from edge_vpr.map_making import coded_map
from edge_vpr.online.localiser import Localiser
from edge_vpr.reference_map import ReferenceMap

EVENTS_PER_SECOND, SECONDS, PLACES = 1_000_000, 6, 1_000
#: so many events of the stream are fed one by one
ONE_BY_ONE = 300_000


def stream() -> Events:
    """Make a stream of events at random pixels and times."""
    rng = np.random.default_rng(0)
    n = EVENTS_PER_SECOND * SECONDS
    flat = rng.integers(0, SENSOR.pixels, n)
    times = np.sort(rng.integers(0, SECONDS * 1_000_000, n))
    return make_events(times, flat % SENSOR.width, flat // SENSOR.width)


def row(name: str, reference: ReferenceMap, events: Events, chunk: int) -> tuple[str, ...]:
    """Feed the stream in chunks of one size; microseconds of the calls that gave matches."""
    warm = EVENTS_PER_SECOND * 3
    localiser = Localiser(reference)
    for first in range(0, warm, 10_000):
        localiser.update(events[first : first + 10_000])
    stop = min(events.size, warm + ONE_BY_ONE) if chunk == 1 else events.size
    waited, matches = [], 0
    gc.disable()
    start = time.perf_counter()
    for first in range(warm, stop, chunk):
        arrived = time.perf_counter_ns()
        rows = localiser.update(events[first : first + chunk])
        if rows.size:
            waited.append(time.perf_counter_ns() - arrived)
            matches += rows.size
    took = time.perf_counter() - start
    gc.enable()
    p50, p99, worst = np.percentile(waited, [50, 99, 100]) / 1e3
    real = (stop - warm) / EVENTS_PER_SECOND / took
    cells = [name, f"{chunk:,}", f"{matches:,}"]
    return (*cells, f"{p50:.1f}", f"{p99:.1f}", f"{worst:,.0f}", f"{real:.3g}")


def filtered() -> ReferenceMap:
    """Return the map of counts as the place filter has it, in contrast codes."""
    counted = scene(PLACES).reference
    chosen = counted.settings.replaced(
        {"matching": "filter", "window": "time", "counter_code": "contrast"}, "latency"
    )
    return coded_map(replace(counted, settings=chosen.uncoded), chosen)


HEADER = (
    "matched by", "events per chunk", "matches", "p50 (µs)", "p99 (µs)", "worst (µs)",
    "times real time",
)  # fmt: skip


def main(folder: str | None = None) -> None:
    """Print the table, and write it to a folder."""
    events = stream()
    maps = {f"sequences, L = {length}": scene(PLACES, length).reference for length in (1, 5)}
    maps["place filter, contrast codes"] = filtered()
    print(
        f"{machine()}: {EVENTS_PER_SECOND:,} events/s of {SENSOR}, K = {PLACES:,}, a match for "
        "every selected event"
    )
    rows = [HEADER]
    for name, reference in maps.items():
        rows += [row(name, reference, events, chunk) for chunk in (1, 100, 10_000)]
    print("\n".join(", ".join(line) for line in rows))
    if folder is not None:
        path = Path(folder) / "latency-chunks.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
