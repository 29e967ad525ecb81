"""Several designs on the same drives: how right each is, and what a match of it takes here."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from edge_vpr.baselines import map_all_pixels
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events
from edge_vpr.matching.drive_matching import match_descriptors
from edge_vpr.online.schedule import MatchSchedule
from edge_vpr.pipeline import EventSource, describe_query, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.energy.intervals import LEAST_PAIRS, interval_of_times
from edge_vpr_tools.energy.measurement import Plan, measure
from edge_vpr_tools.energy.sensors.sensor import Sensor, SensorError
from edge_vpr_tools.energy.workload import Workload
from edge_vpr_tools.experiments.trial import TruthOf
from edge_vpr_tools.output.messages import note

#: J of the designs, and codes of their counters
PIXELS = (10, 25, 50, 150)
FEW_BITS = {"counter_code": "log", "counter_bits": 3}


#: a map, and its energy as of `protocol.measure` or why it was not measured
Known = tuple[ReferenceMap, dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Compared:
    """A design: its name in tables and figures, and its map."""

    name: str
    reference: ReferenceMap


def of_pair(drive: EventSource, main: ReferenceMap) -> Iterator[Compared]:
    """Give a map of a drive, and map it at other numbers of pixels, with fewer bits, and at all.

    Windows by count hold as many events as those of tau do on average at the same pixels, so that
    a match is of as long a drive in all designs.
    """
    settings = main.settings.replaced({"events_per_pixel": None}, "designs")
    for pixels in PIXELS:
        mapped = main
        if pixels != settings.pixels:
            mapped = map_traverse(drive, settings.replaced({"pixels": pixels}, "designs"))
        yield Compared(f"{pixels} px", mapped)
    coded = map_traverse(drive, settings.replaced(FEW_BITS, "designs"))
    yield Compared(f"{settings.pixels} px, 3-bit log", coded)
    every = map_all_pixels(drive, settings, main.hot)
    yield Compared(f"all {len(every.pixel_map):,} px", every)


def of_map(reference: ReferenceMap) -> Iterator[Compared]:
    """Give a map's first pixels, and all of its pixels.

    Pixels are kept in the order in which they were drawn, so that the first ones are a smaller
    draw. Windows by count ended by the events of all of them, so that such a map is taken alone.
    """
    drawn, counts = reference.pixel_map, reference.places.counts
    whole = len(drawn)
    if reference.settings.window == "time":
        for pixels in (p for p in PIXELS if p < whole):
            kept = np.concatenate(
                [np.arange(start, start + pixels) for start in range(0, counts.shape[1], whole)]
            )
            scale, mean = reference.full_scale, reference.mean
            yield Compared(
                f"{pixels} px",
                replace(
                    reference,
                    settings=reference.settings.replaced({"pixels": pixels}, "designs"),
                    pixel_map=PixelMap(drawn.sensor, drawn.x[:pixels], drawn.y[:pixels]),
                    places=replace(
                        reference.places,
                        counts=np.ascontiguousarray(counts[:, kept]),
                        # codes do not tell how many of the events were at these pixels
                        selected=reference.places.activity * pixels // whole,
                    ),
                    full_scale=None if scale is None else scale[kept],
                    mean=None if mean is None else mean[kept],
                ),
            )
    yield Compared(f"{whole} px", reference)


def compare(
    designs: Iterable[Compared],
    query: EventSource,
    events: Sequence[Events],
    truth_of: TruthOf,
    sensor: Sensor | None,
    plan: Plan,
    rate: float,
    known: Known,
) -> list[dict[str, Any]]:
    """Evaluate each design, and measure what a match of it takes.

    Parameters
    ----------
    designs : iterable of Compared
    query : EventSource
        The query drive.
    events : sequence of ndarray
        Its events, cleaned: the load.
    truth_of : callable
        Ground truth of places and queries at such times.
    sensor : Sensor, optional
        For joules; without one, only processor time is told.
    plan : Plan
    rate : float
        Matches a second of the mission.
    known : tuple of ReferenceMap and dict
        A map whose energy has been measured.

    Returns
    -------
    list of dict
        Plain values. ``energy`` is None, or as of `protocol.analyse` without its trace; or, if
        the sensor failed, why.
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
        energy = None
        if sensor is not None:
            measured = known[1] if reference is known[0] else None
            energy = _energy(sensor, plan, load, rate) if measured is None else _brief(measured)
        found.append(
            {
                "name": design.name,
                "pixels": len(reference.pixel_map),
                "counter_bits": reference.counter_bits,
                "bytes_per_place": reference.packed_bytes_per_place,
                "places": len(reference),
                "precision_at_100_recall": evaluate(matches, truth).precision_at_100_recall,
                "queries": len(matches),
                "cpu_s_per_match": cpu[0],
                "cpu_s_per_match_interval": cpu[1:],
                "energy": energy,
            }
        )
    return found


def _cpu_s_per_match(load: Workload, plan: Plan) -> list[float]:
    """Processor time of a match in five slices of a window: median, low, high."""
    slices: list[float] = []
    while len(slices) < LEAST_PAIRS:
        load.reset()
        start = time.process_time()
        # at least one match, however slow the machine
        while load.matches == 0:
            load.run(plan.window_s / 10)
        slices.append((time.process_time() - start) / load.matches)
    told = interval_of_times(np.array(slices))
    return [told.value, told.low, told.high]


def _energy(sensor: Sensor, plan: Plan, load: Workload, rate: float) -> dict[str, Any]:
    try:
        return _brief(measure(sensor, plan, load.run, rate))
    except SensorError as error:
        return {"resolved": False, "not_measured_because": [str(error)]}


def _brief(energy: dict[str, Any]) -> dict[str, Any]:
    """Leave out what only a figure of the main load shows."""
    left_out = ("trace", "windows", "differences_w", "sensor")
    return {name: value for name, value in energy.items() if name not in left_out}
