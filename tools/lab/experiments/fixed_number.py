"""Windows of a fixed number of events against windows of fixed time, where speeds differ.

Simulated streets are driven at constant speeds in the light of the reference, so that nothing but
the speed and the traffic differs. Recorded drives are compared as they are. The speed of a drive is
compared by its duration, since both drives of a pair cover one route.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from edge_vpr.recordings.reading import EventSource
from edge_vpr.simulation import REFERENCE, simulate_pair
from lab.drives import LENGTH_M, event_drives
from lab.loop import Draw, Drives, Experiment, Row
from lab.pairs import SIMULATED, Pair
from lab.variants import Variant

#: speeds of the query as multiples of the reference's
SPEEDS = (0.5, 1.0, 1.7, 2.0, 4.0)
VARIANTS = tuple(
    Variant(f"{pixels} pixels, fixed {name}", {"pixels": pixels, "window": window})
    for pixels in (25, 150)
    for name, window in (("tau", "time"), ("N", "count"))
)


class Extent(NamedTuple):
    """Number of events of a drive, and the time from the first to the last."""

    events: int
    duration_us: int


def extent(drive: EventSource) -> Extent:
    """Count the events of a drive, and measure how long it took."""
    events, first_us, last_us = 0, 0, 0
    for chunk in drive:
        if chunk.size:
            first_us = first_us if events else int(chunk.t[0])
            last_us = int(chunk.t[-1])
            events += int(chunk.size)
    return Extent(events, last_us - first_us)


def street(seed: int) -> list[tuple[str, Pair]]:
    """Simulate a street of this seed, with a query at each speed."""
    still = replace(REFERENCE, speed_range=1.0)
    pairs = []
    reference = None
    for speed in SPEEDS:
        other = replace(still, speed_mps=speed * still.speed_mps)
        first, query = simulate_pair(seed, length_m=LENGTH_M, reference=still, query=other)
        reference = first.keep() if reference is None else reference
        query.keep()
        pairs.append((f"speed x {speed:g}", Pair.simulated(reference, query)))
    return pairs


def measure(draw: Draw) -> Iterator[Row]:
    """Match in every way, and measure the drives."""
    recorded = isinstance(draw.pair, Pair)
    queries: list[tuple[str, Pair]] = [("as recorded", draw.pair)] if recorded else draw.pair
    reference = extent(queries[0][1].events[0])
    for name, pair in queries:
        query = extent(pair.events[1])
        for variant in VARIANTS:
            yield {
                "query": name,
                "variant": variant.name,
                DURATION: query.duration_us / max(1, reference.duration_us),
                EVENTS: query.events / max(1, reference.events),
                "P@100R": variant.of(pair, draw.seed).correct(),
            }


#: of the query, as shares of the reference's
DURATION, EVENTS = "duration (share)", "events (share)"


def drives(data: Path | None) -> list[Drives]:
    """Return streets with queries of several speeds, and recorded pairs."""
    _, *recorded = event_drives(data)
    return [Drives(SIMULATED, street, varied=True), *recorded]


EXPERIMENT = Experiment(drives=drives, names=("query", "variant"), measure=measure)
