"""From an event's arrival to its match: a camera of a million events a second, on one core.

``python tools/bench/latency.py`` prints the table in Markdown; `make bench` adds it to the page.
"""

from __future__ import annotations

import gc
import time
import tracemalloc

import numpy as np
from bench_localiser import SENSOR, scene
from table import machine

from edge_vpr.events import Events, make_events
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


def row(reference: ReferenceMap, events: Events, chunk: int) -> tuple[str, ...]:
    """Feed the stream in chunks of one size; microseconds of the calls that gave matches."""
    warm = EVENTS_PER_SECOND * 3
    localiser = Localiser(reference)
    for begin in range(0, warm, 10_000):
        localiser.update(events[begin : begin + 10_000])
    stop = min(events.size, warm + ONE_BY_ONE) if chunk == 1 else events.size
    waited, matches = [], 0
    gc.disable()
    start = time.perf_counter()
    for begin in range(warm, stop, chunk):
        arrived = time.perf_counter_ns()
        found = localiser.update(events[begin : begin + chunk])
        if found.size:
            waited.append(time.perf_counter_ns() - arrived)
            matches += found.size
    took = time.perf_counter() - start
    gc.enable()
    p50, p99, worst = np.percentile(waited, [50, 99, 100]) / 1e3
    real = (stop - warm) / EVENTS_PER_SECOND / took
    length = reference.settings.sequence_length
    cells = [str(length), f"{chunk:,}", f"{matches:,}"]
    return (*cells, f"{p50:.1f}", f"{p99:.1f}", f"{worst:,.0f}", f"{real:.3g}")


def memory(reference: ReferenceMap, events: Events) -> int:
    """Measure the most bytes that a localiser holds at once beside its map, chunk by chunk."""
    tracemalloc.start()
    localiser = Localiser(reference)
    for begin in range(0, events.size // 2, 1_000):
        localiser.update(events[begin : begin + 1_000])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak - localiser.map_bytes


def main() -> None:
    """Print the table."""
    events = stream()
    header = ("L", "events a chunk", "matches", "p50 us", "p99 us", "worst us", "x real time")
    lines = [header, ("---",) * len(header)]
    for length in (1, 5):
        counted = scene(PLACES, length).reference
        for chunk in (1, 100, 10_000):
            lines.append(row(counted, events, chunk))
    print("\n## From an event's arrival to its match\n")
    print(
        f"Machine: {machine()}. A camera of {EVENTS_PER_SECOND:,} events a second at random pixels "
        f"of {SENSOR}, 150 of them selected, K = {PLACES:,}, windows of N = 450 events, a match "
        "for every selected event, garbage collection off. Microseconds from the call with a chunk "
        "to its return with matches.\n"
    )
    for line in lines:
        print("| " + " | ".join(line) + " |")
    held = memory(scene(PLACES, 5).reference, events)
    print(
        f"\nMost memory held beside the map, at 1,000 events a chunk, L = 5: {held / 1e3:,.0f} kB."
    )


if __name__ == "__main__":
    main()
