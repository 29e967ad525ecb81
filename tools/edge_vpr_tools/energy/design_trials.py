"""Accuracy and measured cost of several designs on the same drives."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import EventSource, describe_query
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.energy.designs import Compared
from edge_vpr_tools.energy.energy_record import Bounds, Energy, NotMeasured, Outcome
from edge_vpr_tools.energy.intervals import LEAST_PAIRS, Estimate, interval_of_times
from edge_vpr_tools.energy.measurement import Plan, measure
from edge_vpr_tools.energy.sensors.sensor import Sensor, SensorError
from edge_vpr_tools.energy.workload import Workload
from edge_vpr_tools.experiments.trial import TruthOf
from edge_vpr_tools.output.messages import note

#: a map, and its measured energy or the reason why it was not measured
Known = tuple[ReferenceMap, Outcome]


@dataclass(frozen=True, kw_only=True)
class DesignResult:
    """Accuracy of a design, and the cost of its match.

    Attributes
    ----------
    name : str
    pixels, counter_bits, bytes_per_place, places : int
    precision_at_100_recall : float
        Over `queries` matches.
    cpu_s_per_match : float
        Processor time in seconds, with its 95 % interval.
    energy : Energy, NotMeasured or None
        None if there is no sensor.
    """

    name: str
    pixels: int
    counter_bits: int
    bytes_per_place: int
    places: int
    precision_at_100_recall: float
    queries: int
    cpu_s_per_match: float
    cpu_s_per_match_interval: Bounds
    energy: Outcome | None


def compare(
    designs: Iterable[Compared],
    query: EventSource,
    events: Sequence[Events],
    truth_of: TruthOf,
    sensor: Sensor | None,
    plan: Plan,
    rate: float,
    known: Known,
) -> list[DesignResult]:
    """Evaluate each design, and measure the cost of its match.

    Parameters
    ----------
    designs : iterable of Compared
    query : EventSource
        The query drive.
    events : sequence of ndarray
        Its cleaned events, which are the load.
    truth_of : callable
        Returns the ground truth for the times of places and queries.
    sensor : Sensor, optional
        Measures joules; without it, only processor time is measured.
    plan : Plan
    rate : float
        Matches per second of the mission.
    known : tuple of ReferenceMap and Energy
        A map whose energy has already been measured.
    """
    found = []
    for design in designs:
        note(f"design: {design.name}")
        reference, settings = design.reference, design.reference.settings
        queries = describe_query(reference, query)
        matches = match_descriptors(reference.places, queries, settings)
        truth = truth_of(reference.places.centre_us, queries.centre_us)
        load = Workload(reference, events, MatchSchedule.window(settings))
        cpu = _cpu_s_per_match(load, plan)
        energy: Outcome | None = None
        if sensor is not None:
            measured = known[1] if reference is known[0] else None
            energy = measured or _energy(sensor, plan, load, rate)
        found.append(
            DesignResult(
                name=design.name,
                pixels=len(reference.pixel_map),
                counter_bits=reference.counter_bits,
                bytes_per_place=reference.packed_bytes_per_place,
                places=len(reference),
                precision_at_100_recall=evaluate(matches, truth).precision_at_100_recall,
                queries=len(matches),
                cpu_s_per_match=cpu.value,
                cpu_s_per_match_interval=(cpu.low, cpu.high),
                energy=energy.brief() if isinstance(energy, Energy) else energy,
            )
        )
    return found


def _cpu_s_per_match(load: Workload, plan: Plan) -> Estimate:
    """Measure the processor time of a match in several short slices of load."""
    slices: list[float] = []
    while len(slices) < LEAST_PAIRS:
        load.reset()
        start = time.process_time()
        # at least one match, even on a slow machine
        while load.matches == 0:
            load.run(plan.window_s / 10)
        slices.append((time.process_time() - start) / load.matches)
    return interval_of_times(np.array(slices))


def _energy(sensor: Sensor, plan: Plan, load: Workload, rate: float) -> Outcome:
    try:
        return measure(sensor, plan, load.run, rate)
    except SensorError as error:
        return NotMeasured((str(error),))
