"""From an event's arrival to its match: a camera of a million events a second, on one core.

``python tools/bench/latency.py [FOLDER]`` prints the tables; `make bench` writes them to
`docs/results`.
From the byte on a line on, `byte_to_match.py` measures.
"""

from __future__ import annotations

import csv
import gc
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_localiser import SENSOR, scene
from byte_to_match import WARM, byte_to_match
from table import machine

from edge_vpr.events import Events, make_events
from edge_vpr.map_record import coded_map
from edge_vpr.online.localiser import Localiser
from edge_vpr.reference_map import ReferenceMap

EVENTS_PER_SECOND, SECONDS, PLACES = 1_000_000, 6, 1_000
#: so many events of the stream are fed one by one
ONE_BY_ONE = 300_000
#: and so many, all of them at selected pixels
ONE_A_CALL = 20_000


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
        found = localiser.update(events[first : first + chunk])
        if found.size:
            waited.append(time.perf_counter_ns() - arrived)
            matches += found.size
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
        {
            "matching": "filter", "query_mean": "running",
            "counter_code": "log", "counter_scaling": "contrast",
        },
        "latency",
    )  # fmt: skip
    return coded_map(replace(counted, settings=chosen.uncoded), chosen)


def line_rows(rates: tuple[float, ...] = (20_000.0, 296_000.0)) -> list[tuple[str, ...]]:
    """Measure the time from a frame on a pseudo-terminal to the line with its match."""
    rows = []
    for burst_filter in ("causal", "exact"):
        for rate in rates:
            taken = byte_to_match(rate, 1_000, burst_filter)
            p50, p99, worst = np.percentile(taken, [50, 99, 100])
            cells = (f"{rate:,.0f}", burst_filter, f"{p50:,.0f}", f"{p99:,.0f}", f"{worst:,.0f}")
            rows.append(cells)
    return rows


def one_a_call(name: str, reference: ReferenceMap) -> tuple[str, ...]:
    """Feed events at selected pixels one by one, each of which gives a match."""
    rng, pixels = np.random.default_rng(1), reference.pixel_map
    slots = rng.integers(0, len(pixels), 2 * ONE_A_CALL)
    stream = make_events(20 * np.arange(slots.size), pixels.x[slots], pixels.y[slots])
    localiser = Localiser(reference)
    localiser.update(stream[:ONE_A_CALL])
    taken, matches = [], 0
    gc.disable()
    for i in range(ONE_A_CALL, stream.size):
        event = stream[i : i + 1]
        arrived = time.perf_counter_ns()
        matches += localiser.update(event).size
        taken.append(time.perf_counter_ns() - arrived)
    gc.enable()
    assert matches == len(taken)
    p10, p50, p99 = np.percentile(taken, [10, 50, 99]) / 1e3
    return name, f"{p10:.1f}", f"{p50:.1f}", f"{p99:.1f}"


def memory(reference: ReferenceMap, events: Events) -> int:
    """Measure the most bytes that a localiser holds at once beside its map, chunk by chunk."""
    tracemalloc.start()
    localiser = Localiser(reference)
    for first in range(0, events.size // 2, 1_000):
        localiser.update(events[first : first + 1_000])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak - localiser.map_bytes


#: files by what they hold, with their columns
TABLES = {
    "latency-chunks": (
        "matched by", "events per chunk", "matches", "p50 (µs)", "p99 (µs)", "worst (µs)",
        "times real time",
    ),
    "latency-calls": ("matched by", "p10 (µs)", "p50 (µs)", "p99 (µs)"),
    "latency-stream": ("events/s", "burst filter", "p50 (µs)", "p99 (µs)", "worst (µs)"),
}  # fmt: skip


def main(folder: str | None = None) -> None:
    """Print the tables, and write them to a folder."""
    events = stream()
    maps = {f"sequences, L = {length}": scene(PLACES, length).reference for length in (1, 5)}
    maps["place filter, contrast codes"] = filtered()
    rows = {
        "latency-chunks": [
            row(name, reference, events, chunk)
            for name, reference in maps.items()
            for chunk in (1, 100, 10_000)
        ],
        "latency-calls": [one_a_call(name, reference) for name, reference in maps.items()],
        "latency-stream": line_rows(),
    }
    print(
        f"{machine()}: {EVENTS_PER_SECOND:,} events/s of {SENSOR}, K = {PLACES:,}, a match for "
        f"every selected event; latency-stream: 1,000 matches after the first {WARM}"
    )
    for name, header in TABLES.items():
        table = [header, *rows[name]]
        print(f"\n{name}\n" + "\n".join(", ".join(line) for line in table))
        if folder is not None:
            with (Path(folder) / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(table)
    held = memory(scene(PLACES, 5).reference, events)
    print(f"\nmost memory beside the map, at 1,000 events per chunk, L = 5: {held / 1e3:,.0f} kB")


if __name__ == "__main__":
    main(*sys.argv[1:])
