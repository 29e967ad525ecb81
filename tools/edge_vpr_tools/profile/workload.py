"""The load that is profiled: designs, drives, trials, and packets fed to a localiser."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edge_vpr.descriptors.counting import EventSource, cleaned
from edge_vpr.descriptors.pixels import PixelMap
from edge_vpr.errors import UsageError
from edge_vpr.evaluation.metrics import evaluate
from edge_vpr.events import Events
from edge_vpr.map_record import describe_query
from edge_vpr.matching.drive import match_descriptors
from edge_vpr.online.localiser import Localiser, MatchSchedule
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.settings import PRESETS
from edge_vpr.simulation import SimulatedRecording
from edge_vpr_tools.console import check_interrupted, note
from edge_vpr_tools.profile.measurement import (
    LEAST_PAIRS,
    Bounds,
    Energy,
    Estimate,
    NotMeasured,
    Outcome,
    Plan,
    interval_of_times,
    measure,
)
from edge_vpr_tools.profile.sensors.sensor import Sensor, SensorError
from edge_vpr_tools.research.baselines import map_all_pixels
from edge_vpr_tools.research.experiments.pairs import TruthOf, truth_of_pair

# The pipeline as a load: a recording is repeatedly fed to a localiser in packets.


#: pause between two rounds of a recording, in microseconds
_PAUSE_US = 1


class Workload:
    """Feeds events to a localiser as fast as it accepts them.

    Parameters
    ----------
    events : iterable of ndarray
        Cleaned events of the recording; held in memory.
    packet : int
        Number of events in one call, as from a camera's driver.

    Attributes
    ----------
    events, matches : int
        Numbers since the last `reset`.
    latencies_s : list of float
        Latencies of the calls that gave a match.
    events_a_round : int
        Number of events in the recording.

    Raises
    ------
    UsageError
        If one round of the recording gives no match.
    """

    def __init__(
        self,
        reference: ReferenceMap,
        events: Iterable[Events],
        every: MatchSchedule,
        packet: int = 512,
    ) -> None:
        if packet < 1:
            raise UsageError(f"packets of {packet} events: expected 1 or more")
        pieces = list(events)
        whole = np.concatenate(pieces) if pieces else None
        if whole is None or whole.size == 0:
            raise UsageError("the recording holds no events: name another one")
        self._packets = [whole[i : i + packet].copy() for i in range(0, whole.size, packet)]
        self._period = int(whole["t"][-1]) - int(whole["t"][0]) + _PAUSE_US
        self._localiser = Localiser(reference, every=every)
        self._next = 0
        self.recorded_s, self.events_a_round = self._period / 1e6, whole.size
        self.reset()
        for _ in self._packets:  # this also compiles the kernels and warms the caches
            self._feed()
        if self.matches == 0:
            raise UsageError(
                "one round of the recording gives no match: take shorter windows or a longer drive"
            )
        self.reset()

    def reset(self) -> None:
        """Reset the counts."""
        self.events = self.matches = 0
        self.latencies_s: list[float] = []

    def run(self, seconds: float) -> int:
        """Feed events for some seconds; return the number of matches."""
        end, before = time.perf_counter() + seconds, self.matches
        while time.perf_counter() < end:
            self._feed()
        return self.matches - before

    def _feed(self) -> None:
        packet = self._packets[self._next]
        start = time.perf_counter()
        found: npt.NDArray[np.void] = self._localiser.update(packet)
        took = time.perf_counter() - start
        # the same events again, one round later
        packet["t"] += self._period
        self._next = (self._next + 1) % len(self._packets)
        self.events += packet.size
        self.matches += found.size
        if found.size:
            self.latencies_s.append(took)


# Designs to compare: maps of one drive with other numbers of pixels or fewer bits.


#: numbers of pixels (J) of the designs, and codes of their counters
PIXELS = (10, 25, 50, 150)
CODED = {"counter_code": "log", "counter_bits": 3}


@dataclass(frozen=True, eq=False)
class Compared:
    """A design: its name in tables and figures, and its map."""

    name: str
    reference: ReferenceMap


def of_pair(drive: EventSource, main: ReferenceMap) -> Iterator[Compared]:
    """Yield maps of a drive: with several numbers of pixels, with fewer bits, and with all pixels.

    Fixed-count windows hold the average number of events in tau at the same pixels. A match
    therefore covers the same length of the drive in all designs.
    """
    settings = main.settings.replaced({"events_per_pixel": None}, "designs")
    for pixels in PIXELS:
        mapped = main
        if pixels != settings.pixels:
            mapped = ReferenceMap.build(drive, settings.replaced({"pixels": pixels}, "designs"))
        yield Compared(f"{pixels} px", mapped)
    coded = ReferenceMap.build(drive, settings.replaced(CODED, "designs"))
    yield Compared(f"{settings.pixels} px, 3-bit log", coded)
    every = map_all_pixels(drive, settings, main.hot)
    yield Compared(f"all {len(every.pixel_map):,} px", every)


def of_map(reference: ReferenceMap) -> Iterator[Compared]:
    """Yield maps with the first pixels of a map, and the map itself.

    Pixels are stored in the order in which they were drawn, so that the first ones are a smaller
    draw. Windows by count end by the events of all pixels; only the map itself is then yielded.
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
                        # the number of events at these pixels cannot be computed from codes
                        selected=reference.places.selected_events * pixels // whole,
                    ),
                    full_scale=None if scale is None else scale[kept],
                    mean=None if mean is None else mean[kept],
                ),
            )
    yield Compared(f"{whole} px", reference)


# Drives of a profile: the user's map and drive, or a simulated street.


#: length of the simulated street, which has about 70 places
STREET_M = 400.0


@dataclass(frozen=True, eq=False)
class Load:
    """Load: a map, the events of a query drive and, if its truth is known, designs to compare."""

    name: str  #: Name of the recording.
    reference: ReferenceMap
    events: list[Events]  #: Cleaned events of the query drive.
    query: EventSource
    designs: Iterable[Compared]
    #: Makes the ground truth from the times of places and queries; None where it is not known.
    truth_of: TruthOf | None
    inputs: Sequence[str]


def street_load(first: SimulatedRecording, query: SimulatedRecording) -> Load:
    """Map the first drive of a simulated street of `STREET_M`; the query drive is the load."""
    # N is the average number of events in a window of tau
    fixed_n = PRESETS["paper"].replaced({"window": "count", "events_per_pixel": None}, "profile")
    reference = ReferenceMap.build(first, fixed_n)
    events = list(cleaned(query, reference.settings))
    designs = of_pair(first, reference)
    name = f"simulated street of {STREET_M:g} m"
    return Load(name, reference, events, query, designs, truth_of_pair(first, query), [])


# Accuracy and measured cost of several designs on the same drives.


@dataclass(frozen=True, kw_only=True)
class DesignResult:
    """Accuracy of a design, and the cost of its match."""

    name: str
    pixels: int
    counter_bits: int
    bytes_per_place: int
    places: int
    precision_at_100_recall: float  #: Over `queries` matches.
    queries: int
    cpu_s_per_match: float  #: Processor time in seconds, with its 95 % interval.
    cpu_s_per_match_interval: Bounds
    energy: Outcome | None  #: None if there is no sensor.


def compare(
    load: Load, sensor: Sensor | None, plan: Plan, mission_rate: float, known: Outcome
) -> list[DesignResult]:
    """Evaluate each design of a load whose truth is known, and measure the cost of its match.

    Parameters
    ----------
    sensor : Sensor, optional
        Measures joules; without it, only processor time is measured.
    known : NotMeasured or Energy
        Energy of the load's own map, which has already been measured.
    """
    assert load.truth_of is not None
    found = []
    for design in load.designs:
        note(f"design: {design.name}")
        reference, settings = design.reference, design.reference.settings
        queries = describe_query(reference, load.query)
        matches = match_descriptors(reference.places, queries, settings)
        truth = load.truth_of(reference.places.centre_us, queries.centre_us)
        workload = Workload(reference, load.events, MatchSchedule.window(settings))
        cpu = _cpu_s_per_match(workload, plan)
        energy: Outcome | None = None
        if sensor is not None:
            measured = known if reference is load.reference else None
            energy = measured or _energy(sensor, plan, workload, mission_rate)
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


def _energy(sensor: Sensor, plan: Plan, load: Workload, mission_rate: float) -> Outcome:
    try:
        return measure(sensor, plan, load.run, mission_rate)
    except SensorError as error:
        return NotMeasured((str(error),))


# Speed of the load on this machine: events, matches, latency, processor time and memory.


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Speed at full load."""

    seconds: float  #: Duration of the measurement.
    events_per_s: float
    matches_per_s: float
    times_real_time: float
    #: latency_p50_s, latency_p99_s: latency of the calls that gave a match; `calls_with_a_match` is
    #: their number.
    latency_p50_s: float
    latency_p99_s: float
    calls_with_a_match: int
    #: cpu_s_per_match, cpu_share: processor time of a match, and processor time per second.
    cpu_s_per_match: float
    cpu_share: float
    peak_memory_bytes: int  #: Peak memory of the process.
    events_a_round: int  #: Number of events in the recording.


def measure_throughput(workload: Workload, seconds: float) -> Throughput:
    """Measure at full speed; the load must already be compiled and in the caches.

    Raises
    ------
    UsageError
        If there was no match.
    """
    workload.reset()
    cpu, start = time.process_time(), time.perf_counter()
    workload.run(seconds)
    check_interrupted()
    elapsed, cpu = time.perf_counter() - start, time.process_time() - cpu
    if workload.matches == 0:
        raise UsageError(f"no match within {seconds} s: take longer windows (--window-s)")
    rate = workload.events / elapsed
    p50, p99 = np.quantile(workload.latencies_s, [0.5, 0.99]).tolist()
    return Throughput(
        seconds=elapsed,
        events_per_s=rate,
        matches_per_s=workload.matches / elapsed,
        times_real_time=rate * workload.recorded_s / workload.events_a_round,
        latency_p50_s=p50,
        latency_p99_s=p99,
        calls_with_a_match=len(workload.latencies_s),
        cpu_s_per_match=cpu / workload.matches,
        cpu_share=cpu / elapsed,
        # Linux reports KiB
        peak_memory_bytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        events_a_round=workload.events_a_round,
    )
