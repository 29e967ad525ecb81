"""One profile: the load, the conditions, the speed, and the joules where there is a sensor."""

from __future__ import annotations

import platform
import resource
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import read_json, understood
from edge_vpr_tools.arguments.schedule import parse_every
from edge_vpr_tools.energy.conditions import Conditions, void_because
from edge_vpr_tools.energy.designs import PIXELS, compare
from edge_vpr_tools.energy.drives import Load
from edge_vpr_tools.energy.measurement import Plan, analyse, measure, take_turns
from edge_vpr_tools.energy.meter_trace import align, check_turns, read_csv
from edge_vpr_tools.energy.sampling import Trace, Window
from edge_vpr_tools.energy.sensors.sensor import (
    ROOT,
    About,
    Missing,
    Sensor,
    SensorError,
    read_text,
)
from edge_vpr_tools.energy.speed import sparse_against_all
from edge_vpr_tools.energy.workload import Workload
from edge_vpr_tools.output.messages import note
from edge_vpr_tools.output.provenance import run_record

PROFILE = "profile.json"
SCHEMA = 3
_REMEDY = "make it again with edge-vpr profile"


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is measured of a load.

    Attributes
    ----------
    every : str
        When to match, see `parse_every`.
    packet : int
        Events a call.
    mission_rate : float
        Matches a second of the mission.
    designs : bool
        Compare other designs, if the truth is known.
    meter : bool
        Alternate idle and load for an external meter.
    root : path
        Where the file system begins; another one for tests.
    """

    every: str = "window"
    packet: int = 512
    mission_rate: float = 1.0
    designs: bool = True
    meter: bool = False
    root: Path = ROOT


def profile(
    load: Load,
    request: Request,
    plan: Plan,
    sensor: Sensor | None = None,
    missing: Sequence[Missing] = (),
) -> dict[str, Any]:
    """Measure a load on this machine.

    Parameters
    ----------
    load : Load
    request : Request
    plan : Plan
    sensor : Sensor, optional
        Of power or energy; left open.
    missing : sequence of Missing
        Why there is no sensor.

    Returns
    -------
    dict
        Plain values; ``energy`` says "not measured" and why where there is no sensor.

    Raises
    ------
    UsageError
        If the load gives no match within a window.
    """
    found = _measured(load, request, plan, sensor, missing)
    return found | {
        "load": {
            "recording": load.name,
            "every": request.every,
            "packet": request.packet,
        },
        "provenance": _provenance(request.root, found),
        "run": run_record(load.reference.settings.to_dict(), load.inputs),
    }


def _measured(
    load: Load,
    request: Request,
    plan: Plan,
    sensor: Sensor | None,
    missing: Sequence[Missing],
) -> dict[str, Any]:
    reference = load.reference
    every = parse_every(request.every, reference)
    workload = Workload(reference, load.events, every, request.packet)
    designs = load.truth_of is not None and request.designs
    if sensor is not None:
        _say_how_long(plan.for_period(sensor.about.period_s), designs)
    before = Conditions.now(request.root)
    note(f"speed: {_duration(plan.window_s)}")
    throughput = _throughput(workload, plan)
    # at once: a governor lowers the clock of a processor that rests
    loaded = Conditions.now(request.root)
    energy = _not_measured([str(one) for one in missing])
    if sensor is not None:
        try:
            energy = {"measured": True} | measure(sensor, plan, workload.run, request.mission_rate)
        except SensorError as error:
            energy = _not_measured([f"{sensor.about.name}: {error}"])
            sensor = None
    elif request.meter:
        energy["windows"] = [window._asdict() for window in take_turns(plan, workload.run)]
    compared = []
    if designs:
        assert load.truth_of is not None
        known = (reference, energy)
        compared = compare(
            load.designs, load.query, load.events, load.truth_of, sensor, plan,
            request.mission_rate, known,
        )  # fmt: skip
    after = Conditions.now(request.root)
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
    with understood(path, "the turns of a profile", _REMEDY):
        windows = [Window(**window) for window in told]
        check_turns(windows)
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
    found = read_json(path, "a profile", _REMEDY)
    if found.get("schema") != SCHEMA or "throughput" not in found:
        raise UsageError(f"{path} is not a profile that this edge-vpr reads: {_REMEDY}")
    with understood(path, "a profile", _REMEDY):
        _ = found["energy"]["measured"], found["quick"]
    return found


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


def _not_measured(reasons: list[str]) -> dict[str, Any]:
    return {"measured": False, "resolved": False, "not_measured_because": reasons}


def _make_void(energy: dict[str, Any] | None) -> None:
    """Take every figure away that a throttled machine gave; what was read stays."""
    for name in energy or ():
        if "_j_" in name or name.startswith(("matches_per_joule", "idle_w", "load_w", "pairs_")):
            energy[name] = None  # type: ignore[index]
    if energy and "resolved" in energy:
        energy["resolved"] = False
