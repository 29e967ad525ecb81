"""A profile: load, conditions, speed and, with a sensor or a meter's trace, energy.

`profile` measures it, `profile.json` holds it, and `numbers` names its figures.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr.records import from_json, parse_errors, read_json
from edge_vpr.results import RunRecord, run_record
from edge_vpr_tools.console import note
from edge_vpr_tools.profile.conditions import Conditions, void_because
from edge_vpr_tools.profile.measurement import Energy, Plan, Trace, analyse, measure, take_turns
from edge_vpr_tools.profile.meter_trace import Stated, ahead_s, check_turns, read_meter
from edge_vpr_tools.profile.sensors.sensor import (
    ROOT,
    About,
    Missing,
    Sensor,
    SensorError,
    read_text,
)
from edge_vpr_tools.profile.workload import Throughput, Workload, measure_throughput

# The record: what `profile.json` holds.


PROFILE = "profile.json"
SCHEMA = 5


@dataclass(frozen=True)
class Moments:
    """Conditions of the machine before, during and after the load."""

    before: Conditions
    loaded: Conditions
    after: Conditions
    void_because: str  #: Reason why the figures are void; empty if none is known.

    def named(self) -> dict[str, Conditions]:
        """Return the three conditions in their order, by name."""
        return {"before": self.before, "loaded": self.loaded, "after": self.after}


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Load measured on a machine."""

    schema: int = SCHEMA
    quick: bool  #: Whether windows were too short for a figure that can be published.
    recording: str  #: Whose events are the load; each window gives a match.
    throughput: Throughput
    energy: Energy
    conditions: Moments
    board: str | None  #: Name of the board, or of the product; None if not known.
    kernel: str
    run: RunRecord

    @property
    def drive_events_per_s(self) -> float:
        """Events per second of the recording, as it was driven."""
        return self.throughput.events_per_s / self.throughput.times_real_time

    @property
    def void(self) -> bool:
        """Whether the figures are void because the machine was throttled."""
        return bool(self.conditions.void_because)

    @classmethod
    def load_file(cls, path: Path) -> Profile:
        """Read a profile, by its file or the folder that holds it.

        Raises
        ------
        UsageError
            If the file is not a profile, or is of another version.
        """
        what, remedy = "a profile", "make one by edge-vpr profile"
        path = path / PROFILE if path.is_dir() else path
        values = read_json(path, what, remedy)
        if values.get("schema") != SCHEMA or "throughput" not in values:
            raise UsageError(f"{path} is not a profile that this edge-vpr reads: make it again")
        with parse_errors(path, what, remedy):
            return from_json(cls, values)


# Measuring: everything on this machine, or the energy from the trace of a meter.


def profile(
    workload: Workload,
    plan: Plan,
    sensor: Sensor | None = None,
    missing: Sequence[Missing] = (),
    *,
    meter: bool = False,
    root: Path = ROOT,
) -> Profile:
    """Measure a load on this machine.

    Parameters
    ----------
    sensor : Sensor, optional
        Sensor of power or energy; it is not closed.
    meter : bool
        Whether to alternate idle and load for an external meter.

    Raises
    ------
    UsageError
        If the load gives no match within a window.
    """
    if sensor is not None:
        longer = plan.for_period(sensor.about.period_s)
        note(f"measuring energy takes about {_duration(longer.pairs * 2 * longer.window_s)}")
    before = Conditions.now(root)
    note(f"speed: {_duration(plan.window_s)}")
    throughput = measure_throughput(workload, plan.window_s)
    # read at once, because a governor lowers the clock of an idle processor
    loaded = Conditions.now(root)
    because = tuple(str(one) for one in missing)
    energy = Energy(not_measured_because=because)
    if sensor is not None:
        try:
            energy = measure(sensor, plan, workload.run)
        except SensorError as error:
            energy = Energy(not_measured_because=(f"{sensor.about.name}: {error}",))
    elif meter:
        windows = tuple(take_turns(plan, workload.run))
        began_s = time.time() - (time.monotonic() - windows[0].start_s)
        energy = replace(energy, windows=windows, began_unix_s=began_s)
    after = Conditions.now(root)
    void = void_because(before, loaded, after)
    if void:
        energy = replace(energy, figures=None)
    run = run_record(workload.reference.settings.to_dict(), workload.files)
    return Profile(
        quick=plan.quick,
        recording=workload.name,
        throughput=throughput,
        energy=energy,
        conditions=Moments(before, loaded, after, void),
        board=_board(root),
        kernel=platform.release(),
        run=run,
    )


def with_meter(path: Path, meter: Path, stated: Stated) -> Profile:
    """Give a profile that was made for an external meter the energy of that meter's trace.

    Parameters
    ----------
    stated : Stated
        See `read_meter`.

    Raises
    ------
    UsageError
        If the profile has no windows for a meter, or the trace does not contain them.
    """
    profile = Profile.load_file(path)
    energy = profile.energy
    windows = energy.windows  # an earlier trace leaves them, to be computed again
    if not windows:
        raise UsageError(f"{path} took no turns for a meter: make it with --meter")
    with parse_errors(path, "the turns of a profile", "make it again with edge-vpr profile"):
        check_turns(windows)
    trace = read_meter(meter, stated)
    time_s = trace.time_s - ahead_s(trace, windows, energy.began_unix_s)
    by = "by its time zone" if stated.first_load is None else f"at {stated.first_load} as stated"
    left_out = f"; {trace.no_reading:,} samples say no reading, and are left out"
    about = About(
        name=meter.name,
        kind="power",
        scope="what the external meter feeds",
        period_s=float(np.median(np.diff(time_s))),
        detail=f"from {trace.read_from}; the first load begins {by}; its gain error is not known"
        f"{left_out if trace.no_reading else ''}",
    )
    try:
        measured = analyse(Trace.of_power(time_s, trace.watts), windows, about)
    except SensorError as error:
        raise UsageError(f"{meter}: {error}") from None
    if energy.sensor is not None:
        note(f"replacing the energy that {energy.sensor.name} measured")
    return replace(
        profile,
        energy=replace(
            measured,
            figures=None if profile.void else measured.figures,
            began_unix_s=energy.began_unix_s,
        ),
    )


def _board(root: Path) -> str | None:
    """Return the name of the board or of the product."""
    board = read_text(root / "proc/device-tree/model").rstrip("\0")
    return board or read_text(root / "sys/class/dmi/id/product_name") or None


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


# Numbers of a profile by name, with their intervals.


NOT_MEASURED, NOT_RESOLVED, VOID = "not measured", "not resolved", "void: throttled"


class Number(NamedTuple):
    """Figure of a profile; if `value` is None, `why` states the reason."""

    name: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""


#: figures of an `Energy` that have an interval
BOUNDED = ("marginal_j_per_match", "matches_per_joule", "idle_w")


def numbers(profile: Profile) -> Iterator[Number]:
    """Yield the numbers of a profile, in the same order and with the same names for each."""
    for name, value in asdict(profile.throughput).items():
        yield Number(name, value)
    figures = profile.energy.figures
    for name in BOUNDED:
        if profile.void or figures is None:
            yield Number(name, None, why=VOID if profile.void else NOT_MEASURED)
        elif getattr(figures, name) is None:
            yield Number(name, None, why=NOT_RESOLVED)
        else:
            interval = getattr(figures, f"{name}_interval") or ()
            yield Number(name, getattr(figures, name), *interval)
