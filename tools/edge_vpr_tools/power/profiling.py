"""One profile: the load, the conditions, the speed, and the joules where there is a sensor."""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.events import Events
from edge_vpr.matches import match_descriptors
from edge_vpr.pipeline import EventSource, cleaned, describe, map_traverse
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.power.conditions import Conditions, void_because
from edge_vpr_tools.power.protocol import Plan, analyse, measure, take_turns
from edge_vpr_tools.power.sensor import About, Missing, Sensor, find_sensors
from edge_vpr_tools.power.trace import Trace, Window, align, read_csv
from edge_vpr_tools.power.workload import Workload
from edge_vpr_tools.provenance import run_record

Pair = tuple[EventSource, EventSource]

PROFILE = "profile.json"
SCHEMA = 1
#: of the simulated street, long enough for 5 windows in a sequence many times over
_STREET_M = 200.0


def profile(args: argparse.Namespace, plan: Plan) -> dict[str, Any]:
    """Measure what the command line asks for.

    Parameters
    ----------
    args : argparse.Namespace
        Of `edge-vpr profile`.
    plan : Plan

    Returns
    -------
    dict
        Plain values; ``energy`` says "not measured" and why where there is no sensor.

    Raises
    ------
    EdgeVprError
        If map, recording or sensor cannot be used.
    """
    root = Path(args.sysroot)
    reference, events, pair, inputs = _load(args)
    from edge_vpr_tools.online import parse_every

    workload = Workload(reference, events, parse_every(args.every, reference), args.packet)
    sensor, missing = _choose(find_sensors(root), args.sensor_name)
    before = Conditions.now(root)
    found = {"schema": SCHEMA, "quick": plan.quick, "throughput": _throughput(workload, plan)}
    energy = _not_measured(missing)
    if sensor is not None:
        energy = {"measured": True} | measure(sensor, plan, workload.run, args.mission_rate)
    elif args.meter:
        energy["windows"] = [window._asdict() for window in take_turns(plan, workload.run)]
    after = Conditions.now(root)
    void = void_because(before, after)
    if void and energy.get("measured"):
        energy["resolved"] = False
        energy["marginal_j_per_match"] = energy["matches_per_joule"] = None
    return found | {
        "load": {
            "recording": args.recording or "simulated street",
            "every": args.every,
            "packet": args.packet,
            "events_a_round": workload.events_a_round,
        },
        "map": {
            "places": len(reference),
            "pixels": len(reference.pixel_map),
            "bytes_per_place": reference.packed_bytes_per_place,
            "sequence_length": reference.settings.sequence_length,
        },
        # last: all pixels take memory that the method does not
        "sparse_against_all": None if pair is None else _against_all(reference, pair),
        "energy": energy,
        "conditions": {"before": asdict(before), "after": asdict(after), "void_because": void},
        "run": run_record(reference.settings.to_dict(), inputs),
    }


def with_meter(path: Path, meter: Path, rate: float) -> dict[str, Any]:
    """Add the joules of an external meter's trace to a profile that took turns for it.

    Raises
    ------
    UsageError
        If the profile took no turns, or the trace does not hold them.
    """
    found = load(path)
    told = found["energy"].get("windows")
    if not told or found["energy"].get("measured"):
        raise UsageError(f"{path} took no turns for a meter: make it with --meter")
    windows = [Window(**window) for window in told]
    time_s, watts = read_csv(meter)
    ahead = align(windows, time_s, watts)
    about = About(
        name=meter.name,
        kind="power",
        scope="what the external meter feeds",
        period_s=float(np.median(np.diff(time_s))),
        detail=f"its clock is {ahead:.3f} s ahead, by its steps; its gain error is not told",
    )
    energy = {"measured": True, "quick": found["quick"]}
    energy |= analyse(Trace.of_power(time_s - ahead, watts), windows, about, rate)
    return found | {"energy": energy}


def load(path: Path) -> dict[str, Any]:
    """Read a profile.

    Raises
    ------
    UsageError
        If it is none, or of a newer version.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["schema"] > SCHEMA or "throughput" not in found:
            raise UsageError(f"{path} is not a profile that this edge-vpr reads: make it again")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"cannot read a profile from {path}: {error}") from error
    return dict(found)


def _load(
    args: argparse.Namespace,
) -> tuple[ReferenceMap, Iterable[Events], Pair | None, Sequence[str]]:
    """Give the map, the events, and both drives where they are at hand."""
    if args.map is not None:
        from edge_vpr_tools.reading import open_from

        reference = ReferenceMap.load(args.map)
        recording = open_from(args, args.recording)
        events = list(cleaned(recording, reference.settings))
        return reference, events, None, [args.map, args.recording]
    from edge_vpr.settings import PRESETS
    from edge_vpr.simulate import simulate_pair

    pair = simulate_pair(args.seed, length_m=_STREET_M)
    for drive in pair:
        drive.keep()
    reference = map_traverse(pair[0], PRESETS["paper"])
    return reference, list(cleaned(pair[1], reference.settings)), pair, []


def _against_all(reference: ReferenceMap, pair: Pair) -> dict[str, float]:
    """Time a query's distances to the same map at the selected pixels, and at all (paper, IV)."""
    from edge_vpr.baselines import map_all_pixels

    found: dict[str, float] = {}
    for name, mapped in (
        ("sparse", reference),
        ("all", map_all_pixels(pair[0], reference.settings, reference.hot)),
    ):
        queries = describe(pair[1], mapped.pixel_map, mapped.settings, mapped.full_scale)
        match_descriptors(mapped.places, queries, mapped.settings)  # compiled and in the cache
        took = []
        for _ in range(5):
            start = time.perf_counter()
            matches = match_descriptors(mapped.places, queries, mapped.settings)
            took.append(time.perf_counter() - start)
        found[f"{name}_us_per_match"] = 1e6 * float(np.median(took)) / len(matches)
        found[f"{name}_pixels"] = len(mapped.pixel_map)
    found["times_faster"] = found["all_us_per_match"] / found["sparse_us_per_match"]
    return found


def _throughput(workload: Workload, plan: Plan) -> dict[str, float]:
    """Run at full speed for one window; what is compiled and cached was so before."""
    workload.reset()
    cpu, start = time.process_time(), time.perf_counter()
    workload.run(plan.window_s)
    elapsed, cpu = time.perf_counter() - start, time.process_time() - cpu
    if workload.matches == 0:
        raise UsageError(f"no match within {plan.window_s} s: take longer windows (--window-s)")
    rate = workload.events / elapsed
    p50, p99 = np.quantile(workload.latencies_s, [0.5, 0.99])
    return {
        "seconds": elapsed,
        "events_per_s": rate,
        "matches_per_s": workload.matches / elapsed,
        "times_real_time": rate * workload.recorded_s / workload.events_a_round,
        "latency_p50_s": float(p50),
        "latency_p99_s": float(p99),
        "calls_with_a_match": len(workload.latencies_s),
        "cpu_s_per_match": cpu / workload.matches,
        "cpu_share": cpu / elapsed,
        # Linux tells KiB
        "peak_memory_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }


def _choose(
    found: tuple[list[Sensor], list[Missing]], name: str | None
) -> tuple[Sensor | None, list[Missing]]:
    sensors, missing = found
    if name is None:
        return (sensors[0] if sensors else None), missing
    for sensor in sensors:
        if sensor.about.name == name:
            return sensor, missing
    known = ", ".join(sensor.about.name for sensor in sensors) or "none"
    raise UsageError(f"there is no power sensor {name!r}: this machine has {known}")


def _not_measured(missing: Sequence[Missing]) -> dict[str, Any]:
    return {
        "measured": False,
        "resolved": False,
        "not_measured_because": [str(one) for one in missing],
    }
