"""One profile: the load, the conditions, the speed, and the joules where there is a sensor."""

from __future__ import annotations

import argparse
import json
import platform
import resource
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr_tools.arguments.schedule import parse_every
from edge_vpr_tools.energy.conditions import Conditions, void_because
from edge_vpr_tools.energy.designs import PIXELS, compare
from edge_vpr_tools.energy.drives import Load, load_of
from edge_vpr_tools.energy.measurement import Plan, analyse, measure, take_turns
from edge_vpr_tools.energy.sampling import Trace, Window, align, read_csv
from edge_vpr_tools.energy.sensors.hwmon import with_shunt
from edge_vpr_tools.energy.sensors.search import find_sensors
from edge_vpr_tools.energy.sensors.sensor import (
    About,
    Missing,
    Sensor,
    SensorError,
    read_text,
)
from edge_vpr_tools.energy.sensors.um_meter import UmMeter
from edge_vpr_tools.energy.speed import sparse_against_all
from edge_vpr_tools.energy.workload import Workload
from edge_vpr_tools.output.messages import note
from edge_vpr_tools.output.provenance import run_record

PROFILE = "profile.json"
SCHEMA = 3


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
    sensor, missing = _choose(args, root)
    try:
        load = load_of(args)
        found = _measured(args, plan, load, sensor, missing, root)
    finally:
        if sensor is not None:
            sensor.close()
    return found | {
        "load": {
            "recording": load.name,
            "every": args.every,
            "packet": args.packet,
        },
        "provenance": _provenance(root, found),
        "run": run_record(load.reference.settings.to_dict(), load.inputs),
    }


def _measured(
    args: argparse.Namespace,
    plan: Plan,
    load: Load,
    sensor: Sensor | None,
    missing: Sequence[Missing],
    root: Path,
) -> dict[str, Any]:

    reference = load.reference
    every = parse_every(args.every, reference)
    workload = Workload(reference, load.events, every, args.packet)
    designs = load.truth_of is not None and not args.no_designs
    if sensor is not None:
        _say_how_long(plan.for_period(sensor.about.period_s), designs)
    before = Conditions.now(root)
    note(f"speed: {_duration(plan.window_s)}")
    throughput = _throughput(workload, plan)
    # at once: a governor lowers the clock of a processor that rests
    loaded = Conditions.now(root)
    energy = _not_measured([str(one) for one in missing])
    if sensor is not None:
        try:
            energy = {"measured": True} | measure(sensor, plan, workload.run, args.mission_rate)
        except SensorError as error:
            energy = _not_measured([f"{sensor.about.name}: {error}"])
            sensor = None
    elif args.meter:
        energy["windows"] = [window._asdict() for window in take_turns(plan, workload.run)]
    compared = []
    if designs:
        assert load.truth_of is not None
        known = (reference, energy)
        compared = compare(
            load.designs, load.query, load.events, load.truth_of, sensor, plan, args.mission_rate,
            known,
        )  # fmt: skip
    after = Conditions.now(root)
    note("few pixels against all: some 10 s")
    # last: all pixels take memory that the method does not
    everything = np.concatenate(load.events)
    sparse = sparse_against_all(everything, reference.pixel_map, len(reference))
    void = void_because(before, loaded, after)
    if void:
        for one in [energy, *(design["energy"] for design in compared)]:
            _make_void(one)
    return {
        "schema": SCHEMA,
        "quick": plan.quick,
        "throughput": throughput | {"events_a_round": workload.events_a_round},
        "map": {
            "places": len(reference),
            "pixels": len(reference.pixel_map),
            "bytes_per_place": reference.packed_bytes_per_place,
            "sequence_length": reference.settings.sequence_length,
        },
        "energy": energy,
        "designs": compared,
        "conditions": {
            "before": asdict(before),
            "loaded": asdict(loaded),
            "after": asdict(after),
            "void_because": void,
        },
        "sparse_against_all": sparse,
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
        if found["schema"] != SCHEMA or "throughput" not in found:
            raise UsageError(f"{path} is not a profile that this edge-vpr reads: make it again")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"cannot read a profile from {path}: {error}") from error
    return dict(found)


def _provenance(root: Path, found: dict[str, Any]) -> dict[str, Any]:
    """Tell board, kernel, clock, sensor, shunt and versions; None is not known."""
    board = read_text(root / "proc/device-tree/model").rstrip("\0")
    loaded, sensor = found["conditions"]["loaded"], found["energy"].get("sensor", {})
    run = run_record({}, ())
    return {
        "board": board or read_text(root / "sys/class/dmi/id/product_name") or None,
        "processor": run["machine"]["processor"],
        "kernel": platform.release(),
        "clock_hz": loaded["frequency_hz"],
        "governor": loaded["governor"],
        "sensor": sensor.get("name"),
        "shunt_mohm": sensor.get("shunt_mohm"),
        "versions": run["versions"],
    }


def _say_how_long(plan: Plan, designs: bool) -> None:
    one = plan.pairs * 2 * plan.window_s
    note(
        f"measuring energy takes about {_duration(one)}"
        + f", and {_duration(one * (len(PIXELS) + 1))} more for other designs (--no-designs: none)"
        * designs
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


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


def _choose(args: argparse.Namespace, root: Path) -> tuple[Sensor | None, list[Missing]]:
    """Take the meter that was named, else the sensor, else the best there is."""
    sensors, missing = find_sensors(root)
    if args.meter_port is not None:
        for unused in sensors:
            unused.close()
        sensors = [UmMeter(args.meter_port)]
    if args.sensor_name is not None:
        known = ", ".join(sensor.about.name for sensor in sensors) or "none"
        sensors = [sensor for sensor in sensors if sensor.about.name == args.sensor_name]
        if not sensors:
            raise UsageError(
                f"there is no power sensor {args.sensor_name!r}: this machine has {known}"
            )
    for unused in sensors[1:]:
        unused.close()
    if not sensors:
        if args.shunt_mohm is not None:
            raise UsageError(f"--shunt-mohm {args.shunt_mohm:g}: no power monitor was found")
        return None, missing
    chosen = sensors[0]
    if args.shunt_mohm is not None:
        chosen = with_shunt(chosen, args.shunt_mohm)
    return chosen, missing


def _not_measured(reasons: list[str]) -> dict[str, Any]:
    return {"measured": False, "resolved": False, "not_measured_because": reasons}


def _make_void(energy: dict[str, Any] | None) -> None:
    """Take every figure away that a throttled machine gave; what was read stays."""
    for name in energy or ():
        if "_j_" in name or name.startswith(("matches_per_joule", "idle_w", "load_w", "pairs_")):
            energy[name] = None  # type: ignore[index]
    if energy and "resolved" in energy:
        energy["resolved"] = False
