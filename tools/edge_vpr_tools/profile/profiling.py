"""A profile: load, conditions, speed and, with a sensor or a meter's trace, energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.files import parse_errors
from edge_vpr.online.localiser import MatchSchedule
from edge_vpr.results import run_record
from edge_vpr_tools.console import note
from edge_vpr_tools.profile.conditions import Conditions, void_because
from edge_vpr_tools.profile.measurement import (
    NotMeasured,
    Outcome,
    Plan,
    Trace,
    analyse,
    measure,
    take_turns,
)
from edge_vpr_tools.profile.meter_trace import align, check_turns, read_csv
from edge_vpr_tools.profile.record import LoadRecord, MapSize, Moments, Profile, Provenance
from edge_vpr_tools.profile.sensors.sensor import ROOT, About, Missing, Sensor, SensorError
from edge_vpr_tools.profile.speed import sparse_against_all
from edge_vpr_tools.profile.workload import PIXELS, Load, Workload, compare, measure_throughput


def profile(
    load: Load,
    plan: Plan,
    sensor: Sensor | None = None,
    missing: Sequence[Missing] = (),
    *,
    every: str = "window",
    packet: int = 512,
    mission_rate: float = 1.0,
    designs: bool = True,
    meter: bool = False,
    root: Path = ROOT,
) -> Profile:
    """Measure a load on this machine.

    Parameters
    ----------
    sensor : Sensor, optional
        Sensor of power or energy; it is not closed.
    missing : sequence of Missing
        Reasons why there is no sensor.
    every : str
        Schedule of matches; see `MatchSchedule.parse`.
    packet : int
        Number of events in a call.
    mission_rate : float
        Matches per second of the mission.
    designs : bool
        Whether to compare other designs, if the truth is known.
    meter : bool
        Whether to alternate idle and load for an external meter.
    root : path
        Root of the file system; replaced in tests.

    Raises
    ------
    UsageError
        If the load gives no match within a window.
    """
    reference = load.reference
    schedule = MatchSchedule.parse(every, reference.settings)
    workload = Workload(reference, load.events, schedule, packet)
    designs = load.truth_of is not None and designs
    if sensor is not None:
        _say_how_long(plan.for_period(sensor.about.period_s), designs)
    before = Conditions.now(root)
    note(f"speed: {_duration(plan.window_s)}")
    throughput = measure_throughput(workload, plan.window_s)
    # read at once, because a governor lowers the clock of an idle processor
    loaded = Conditions.now(root)
    because = tuple(str(one) for one in missing)
    energy: Outcome = NotMeasured(because)
    if sensor is not None:
        try:
            energy = measure(sensor, plan, workload.run, mission_rate)
        except SensorError as error:
            energy = NotMeasured((f"{sensor.about.name}: {error}",))
            sensor = None
    elif meter:
        energy = NotMeasured(because, tuple(take_turns(plan, workload.run)))
    compared = []
    if designs:
        compared = compare(load, sensor, plan, mission_rate, energy)
    after = Conditions.now(root)
    note("few pixels against all: some 10 s")
    # measured last, since all pixels take memory that the method does not need
    everything = np.concatenate(load.events)
    sparse = sparse_against_all(everything, reference.pixel_map, len(reference))
    void = void_because(before, loaded, after)
    if void:
        energy = energy.void()
        compared = [
            replace(one, energy=None if one.energy is None else one.energy.void())
            for one in compared
        ]
    run = run_record(reference.settings.to_dict(), load.inputs)
    return Profile(
        quick=plan.quick,
        throughput=throughput,
        map=MapSize(
            len(reference), len(reference.pixel_map), reference.packed_bytes_per_place,
            reference.settings.sequence_length,
        ),
        energy=energy,
        designs=tuple(compared),
        conditions=Moments(before, loaded, after, void),
        sparse_against_all=sparse,
        load=LoadRecord(load.name, every, packet),
        provenance=Provenance.of(root, loaded, energy, run),
        run=run,
    )  # fmt: skip


def with_meter(path: Path, meter: Path, rate: float, voltage: float | None = None) -> Profile:
    """Add the energy from an external meter's trace to a profile that was made for it.

    Parameters
    ----------
    path, meter : path
        Of the profile and the trace.
    rate : float
        Matches per second of the mission.
    voltage : float, optional
        Supply in volts, for a trace of current alone.

    Raises
    ------
    UsageError
        If the profile has no windows for a meter, or the trace does not contain them.
    """
    found = Profile.load_file(path)
    windows = found.energy.windows if isinstance(found.energy, NotMeasured) else ()
    if not windows:
        raise UsageError(f"{path} took no turns for a meter: make it with --meter")
    with parse_errors(path, "the turns of a profile", "make it again with edge-vpr profile"):
        check_turns(windows)
    time_s, watts = read_csv(meter, voltage)
    ahead = align(windows, time_s, watts)
    about = About(
        name=meter.name,
        kind="power",
        scope="what the external meter feeds",
        period_s=float(np.median(np.diff(time_s))),
        detail=f"its clock is {ahead:.3f} s ahead, by its steps; its gain error is not known",
    )
    energy = analyse(Trace.of_power(time_s - ahead, watts), windows, about, rate)
    return replace(found, energy=replace(energy, quick=found.quick))


def _say_how_long(plan: Plan, designs: bool) -> None:
    one = plan.pairs * 2 * plan.window_s
    note(
        f"measuring energy takes about {_duration(one)}"
        + f", and {_duration(one * (len(PIXELS) + 1))} more for other designs (--no-designs: none)"
        * designs
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
