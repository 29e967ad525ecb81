"""Windows of a fixed number of events against windows of fixed time, where speeds differ.

Simulated streets are driven at constant speeds in the light of the reference, so that nothing but
the speed and the traffic differs. Recorded drives are compared as they are. The speed of a drive is
compared by its duration, since both drives of a pair cover one route.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from edge_vpr.pipeline import EventSource
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import REFERENCE, simulate_pair
from edge_vpr_tools.report.style import legend_below, log_ticks, look, mean_line, panels, save
from edge_vpr_tools.research.experiments.drives import absent_events, event_pairs
from edge_vpr_tools.research.experiments.simulated import SIMULATED, truth_of_pair
from edge_vpr_tools.research.experiments.trial import (
    Summary,
    TruthOf,
    Variant,
    markdown_table,
    run_trial,
)

LENGTH_M = 450.0
#: speeds of the query as multiples of the reference's
SPEEDS = (0.5, 1.0, 1.7, 2.0, 4.0)
#: ticks of the figure, in shares of the reference's duration
DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)
VARIANTS = tuple(
    Variant(f"{pixels} pixels, fixed {name}", {"pixels": pixels, "window": window})
    for pixels in (25, 150)
    for name, window in (("tau", "time"), ("N", "count"))
)


class Drives(NamedTuple):
    """Pair of drives, and the seed of a draw of pixels.

    Attributes
    ----------
    group : str
        Panel of the figure.
    name : str
        Row of the table.
    """

    group: str
    name: str
    reference: EventSource
    query: EventSource
    truth_of: TruthOf
    settings: Settings


class Extent(NamedTuple):
    """Number of events of a drive, and the time from the first to the last."""

    events: int
    duration_us: int


@dataclass(eq=False)
class Row:
    """Trials of one pair: shares of the reference's duration and events, and P@100R by variant."""

    group: str
    durations: list[float] = field(default_factory=list)
    events: list[float] = field(default_factory=list)
    right: dict[str, list[float]] = field(default_factory=dict)


def extent(drive: EventSource) -> Extent:
    """Count the events of a drive, and measure how long it took."""
    events, first_us, last_us = 0, 0, 0
    for chunk in drive:
        if chunk.size:
            first_us = first_us if events else int(chunk["t"][0])
            last_us = int(chunk["t"][-1])
            events += int(chunk.size)
    return Extent(events, last_us - first_us)


def simulated_drives(seed: int) -> Iterator[Drives]:
    """Simulate a street of this seed, with a query at each speed."""
    still = replace(REFERENCE, speed_range=1.0)
    settings = PRESETS["paper"].replaced({"seed": seed}, "seed")
    reference = None
    for speed in SPEEDS:
        other = replace(still, speed_mps=speed * still.speed_mps)
        first, query = simulate_pair(seed, length_m=LENGTH_M, reference=still, query=other)
        reference = first.keep() if reference is None else reference
        query.keep()
        name, truth_of = f"{SIMULATED}, speed x {speed:g}", truth_of_pair(reference, query)
        yield Drives(SIMULATED, name, reference, query, truth_of, settings)


def recorded_drives(data: Path | None, seeds: int) -> Iterator[Drives]:
    """Yield each recorded pair with every seed."""
    for pair in event_pairs(data):
        for seed in range(seeds):
            settings = pair.settings.replaced({"seed": seed}, "seed")
            group = pair.name.split(",")[0]
            yield Drives(group, pair.name, pair.reference, pair.query, pair.truth_of, settings)


def run(data: Path | None, seeds: int, on_start: Callable[[str], None], *figures: Path) -> str:
    """Compare both kinds of window on simulated pairs, and on recorded ones of a folder."""
    found: dict[str, Row] = {}
    for seed in range(seeds):
        on_start(f"street {seed + 1} of {seeds}")
        reference = None
        for each in simulated_drives(seed):  # all of one reference
            reference = extent(each.reference) if reference is None else reference
            add(each, (reference, extent(each.query)), found)
    extents: dict[str, tuple[Extent, Extent]] = {}
    for each in recorded_drives(data, seeds):
        on_start(f"{each.name}, draw {each.settings.seed + 1} of {seeds}")
        if each.name not in extents:  # the drives are the same for every draw
            extents[each.name] = extent(each.reference), extent(each.query)
        add(each, extents[each.name], found)
    if figures:
        save(draw(found), *figures)
    return _table(found) + absent_events(data, [row.group for row in found.values()])


def add(drives: Drives, extents: tuple[Extent, Extent], found: dict[str, Row]) -> None:
    """Match a pair in every way, and add the figures to `found`."""
    row = found.setdefault(drives.name, Row(drives.group))
    reference, query = extents
    row.durations.append(query.duration_us / max(1, reference.duration_us))
    row.events.append(query.events / max(1, reference.events))
    match = partial(run_trial, drives.reference, drives.query, drives.truth_of, drives.settings)
    for variant in VARIANTS:
        right = match(variant).evaluation.precision_at_100_recall
        row.right.setdefault(variant.name, []).append(right)


def _table(found: Mapping[str, Row]) -> str:
    header = ("drives", "duration", "events", *(variant.name for variant in VARIANTS))
    rows = [
        [name, str(Summary(row.durations)), str(Summary(row.events))]
        + [str(Summary(row.right[variant.name])) for variant in VARIANTS]
        for name, row in found.items()
    ]
    return (
        "P@100R; duration and number of events of the query as shares of the reference's:\n\n"
        + markdown_table(header, rows)
    )


def draw(found: Mapping[str, Row]) -> Figure:
    """Draw right matches and the events of the query against its duration; a column each group."""
    groups = list(dict.fromkeys(row.group for row in found.values()))
    with panels(2, len(groups), 4.2 * len(groups) + 1.5, 7.0, sharex=True) as (drawing, grid):
        for column, group in enumerate(groups):
            rows = sorted(
                (row for row in found.values() if row.group == group),
                key=lambda row: float(np.mean(row.durations)),
            )
            across = [float(np.mean(row.durations)) for row in rows]
            above, below = grid[:, column]
            for i, variant in enumerate(VARIANTS):
                values = [row.right[variant.name] for row in rows]
                mean_line(above, across, values, label=variant.name, **look(i))
            mean_line(below, across, [row.events for row in rows], color="gray")
            below.axhline(1.0, color="gray", lw=0.8, linestyle=":")
            above.set(title=group, ylim=(0, 1.03))
            below.set(xlabel="duration of the query / of the reference", ylim=(0, None))
            log_ticks(below, DURATIONS)
            below.set_xlim(0.2, 5.0)
        grid[0, 0].set_ylabel("P@100R")
        grid[1, 0].set_ylabel("events, share of the reference's")
        legend_below(drawing, grid[0], 2)
    return drawing
