"""Accuracy of designs of several sizes on two drives, which are mapped, matched and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.pipeline import EventSource, coded_map, describe
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS, Settings
from edge_vpr.simulation import simulate_pair
from edge_vpr_tools.estimate.search import Evaluated
from edge_vpr_tools.research.experiments.simulated import TOLERANCE_M, truth_of_pair
from edge_vpr_tools.research.experiments.trial import TruthOf
from firmware_model.model.design import Design

#: J and bits that are tried, as far as the sensor has pixels and the code bits
PIXELS = (10, 25, 50, 75, 100, 150, 250, 400)
BITS = (1, 2, 3, 4, 6, 8)
#: draws of pixels; the accuracy is their mean
DRAWS = 3


@dataclass(frozen=True, eq=False)
class Drives:
    """Two drives of one route, with their ground truth.

    Attributes
    ----------
    name : str
        For the answer.
    reference, query : EventSource
    truth_of : callable
        Ground truth of places and queries at such times.
    """

    name: str
    reference: EventSource
    query: EventSource
    truth_of: TruthOf


def simulated(seed: int = 0) -> Drives:
    """Simulate a street that is driven twice, for use without recordings."""
    reference, query = (drive.keep() for drive in simulate_pair(seed))
    length = reference.world.length_m
    name = f"the simulated street of {length:g} m (seed {seed}, within {TOLERANCE_M:g} m)"
    return Drives(name, reference, query, truth_of_pair(reference, query))


def try_designs(drives: Drives, design: Design, on_start: Callable[[str], None]) -> list[Evaluated]:
    """Evaluate a design at several numbers of pixels and bits.

    Windows hold a fixed number of events, as many as a window of the design's tau does on average
    in the reference drive.

    Parameters
    ----------
    drives : Drives
    design : Design
        Matching, code, polarity, tau and exclusion are its own.
    on_start : callable
        Told what begins.

    Raises
    ------
    UsageError
        If not even the fewest pixels can be drawn.
    """
    settings = PRESETS["paper"].replaced(
        {
            "window": "count",
            "events_per_pixel": None,
            "tau_us": design.tau_us,
            "polarity": design.polarity,
            "sequence_length": design.length,
            "exclusion": design.exclusion,
            "matching": design.matching,
            "filter_steps": design.steps,
            "filter_back": design.back,
            "filter_restart": max(design.restart, 1),
            "query_mean": "running",
        },
        "the design",
    )
    found: list[Evaluated] = []
    for pixels in PIXELS:
        on_start(f"{pixels} pixels")
        draws = []
        try:
            for seed in range(DRAWS):
                changed = settings.replaced({"pixels": pixels, "seed": seed}, "draw")
                draws.append(dict(_coded(drives, changed, design)))
        except UsageError:
            if not found:
                raise
            break  # the sensor has no more
        for bits in draws[0]:
            right = [draw[bits][1] for draw in draws]
            name = f"{pixels} px, {bits} bit{'s' * (bits > 1)} {design.code}"
            found.append(Evaluated(name, sum(right) / DRAWS, draws[0][bits][2], draws[0][bits][0]))
    return found


def _coded(
    drives: Drives, settings: Settings, design: Design
) -> Iterator[tuple[int, tuple[ReferenceMap, float, int]]]:
    """Code the counts of one draw with each width; yield map, P@100R and number of queries."""
    mapped = ReferenceMap.build(drives.reference, settings)
    queries = describe(drives.query, mapped.pixel_map, mapped.settings)
    truth = drives.truth_of(mapped.places.centre_us, queries.centre_us)
    for bits in BITS:
        code: dict[str, Any] = {"counter_code": design.code, "counter_bits": bits}
        if design.own_mean:
            code |= {"counter_code": "log", "counter_scaling": "own-mean"}
        coded = mapped.settings.replaced(code, "the design")
        reference = coded_map(mapped, coded)
        matches = match_descriptors(reference.places, reference.coded(queries), coded)
        found = evaluate(matches, truth)
        yield bits, (reference, found.precision_at_100_recall, found.queries)
