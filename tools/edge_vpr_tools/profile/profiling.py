"""A profile: load, conditions, speed and, with a sensor or a meter's trace, energy."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr.files import understood
from edge_vpr.online.state import MatchSchedule
from edge_vpr.results import run_record
from edge_vpr_tools.console import note
from edge_vpr_tools.profile.conditions import Conditions, void_because
from edge_vpr_tools.profile.measurement import (
    Floats,
    NotMeasured,
    Outcome,
    Plan,
    Trace,
    Window,
    analyse,
    measure,
    take_turns,
)
from edge_vpr_tools.profile.record import LoadRecord, MapSize, Moments, Profile, Provenance
from edge_vpr_tools.profile.sensors.sensor import ROOT, About, Missing, Sensor, SensorError
from edge_vpr_tools.profile.speed import sparse_against_all
from edge_vpr_tools.profile.workload import PIXELS, Load, Workload, compare, measure_throughput

# Trace of an external meter, aligned with the windows of a profile by the steps of the load.


#: Thresholds for a trace that follows the load: its correlation with the load in standard errors of
#: the readings, and the mean difference of the pairs in standard errors of the differences. Of 450
#: traces of noise, of random walks and of other steps, none passed; with 3 in place of 6, one in
#: five did.
_FOLLOWING, _PAIRS_HIGHER = 5.0, 6.0
#: most windows of a profile, and most seconds between its first and last one
_MOST_WINDOWS, _MOST_S = 100_000, 1e6


def read_csv(path: Path) -> tuple[Floats, Floats]:
    """Read the times and watts that an external meter wrote.

    Parameters
    ----------
    path : path
        CSV with a header: a column of time in seconds (``time``, ``time_s``, ``timestamp``), and
        either one of power in watts (``power``, ``power_w``) or those of volts and amperes
        (``voltage``, ``current``, with or without ``_v`` and ``_a``).

    Returns
    -------
    time_s, watts : ndarray of float64, shape (n,)

    Raises
    ------
    UsageError
        If columns are missing, a cell is not a number, or time does not increase.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = [row for row in csv.reader(file) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise UsageError(
            f"cannot read a power trace from {path}: {error}: name a CSV with a header of time "
            "and power"
        ) from error
    names = [name.strip().lower() for name in header]
    values = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        try:
            values[i] = [float(cell) for cell, _ in zip(row, names, strict=True)]
        except ValueError:
            raise UsageError(
                f"cannot read a power trace from {path}, sample {i + 1}, {','.join(row)!r}: "
                f"expected {len(names)} numbers with commas between them, time in seconds"
            ) from None

    def column(*choices: str) -> Floats | None:
        found = next((names.index(name) for name in choices if name in names), None)
        return None if found is None else values[:, found]

    if len(values) < 2:
        raise UsageError(f"{path}: a power trace needs two samples or more")
    when, watts = column("time", "time_s", "timestamp"), column("power", "power_w")
    if watts is None:
        volts, amperes = column("voltage", "voltage_v"), column("current", "current_a")
        watts = None if volts is None or amperes is None else volts * amperes
    if when is None or watts is None:
        raise UsageError(
            f"{path} has the columns {', '.join(names)}: expected time_s, and power_w or both "
            "voltage_v and current_a"
        )
    if not (np.diff(when) > 0).all() or not np.isfinite(values).all():
        raise UsageError(f"{path}: time does not increase from row to row, or a cell is no number")
    return when, watts


def check_turns(windows: Sequence[Window]) -> None:
    """Raise ValueError unless the windows are consecutive pairs of idle and load.

    Parameters
    ----------
    windows : sequence of Window
        For example from a file.
    """
    if len(windows) % 2 or len(windows) > _MOST_WINDOWS:
        raise ValueError(f"{len(windows)} windows are no pairs")
    end = -math.inf
    for window in windows:
        times = type(window.load) is bool and type(window.matches) is int and window.matches >= 0
        if not times or not end <= window.start_s < window.end_s <= _MOST_S:
            raise ValueError(f"{window} is no span after {end:g} s")
        end = window.end_s
    if any(a.load == b.load for a, b in zip(windows[::2], windows[1::2], strict=True)):
        raise ValueError("a pair has two idle or two load windows")


def align(windows: Sequence[Window], time_s: Floats, watts: Floats) -> float:
    """Return by how much a meter's clock is ahead, from the steps of the load in its trace.

    Parameters
    ----------
    windows : sequence of Window
    time_s, watts : ndarray of float64, shape (n,)

    Returns
    -------
    float
        Seconds to be subtracted from `time_s`.

    Raises
    ------
    UsageError
        If the trace is shorter than the windows, or does not follow the load at any time.
    """
    start, end = windows[0].start_s, windows[-1].end_s
    span = end - start
    room = time_s[-1] - time_s[0] - span
    if room < 0:
        raise UsageError(
            f"the meter's trace of {time_s[-1] - time_s[0]:g} s is shorter than the measurement of "
            f"{span:g} s: let it run before and after"
        )
    step = min(0.05, span / 2_000)
    grid = np.arange(0.0, span, step)
    edges = np.array([window.start_s - start for window in windows])
    which = np.searchsorted(edges, grid, side="right") - 1
    loaded = np.array([window.load for window in windows], dtype=np.float64)[which]
    pattern = loaded - loaded.mean()
    fine = np.interp(np.arange(0.0, room + span, step), time_s - time_s[0], watts)
    scores = np.correlate(fine - fine.mean(), pattern, mode="valid")
    best = int(np.argmax(scores))
    part = fine[best : best + grid.size]
    if not _follows(part, pattern, which, span / float(np.median(np.diff(time_s)))):
        raise UsageError(
            "the meter's trace does not rise and fall with the load of the profile, at any time: "
            "is it of the same run, and of the board that ran it? If it is, take longer windows"
        )
    return float(time_s[0] + best * step - start)


def _follows(watts: Floats, pattern: Floats, window: npt.NDArray[np.intp], samples: float) -> bool:
    """Return whether power is higher in load windows by more than chance.

    Parameters
    ----------
    watts, pattern : ndarray of float64, shape (n,)
        Power, and the load minus its mean, at the same times.
    window : ndarray of int, shape (n,)
        Number of the window at each time.
    samples : float
        Number of the meter's readings in that time, from which `watts` was interpolated.
    """
    spread = float(watts.std() * pattern.std())
    if spread == 0 or float(np.mean(watts * pattern)) / spread * np.sqrt(samples) < _FOLLOWING:
        return False
    means = np.bincount(window, watts) / np.bincount(window)
    loaded = np.bincount(window, pattern) > 0
    # each two consecutive windows are a pair, in either order
    differences = np.where(loaded, means, -means).reshape(-1, 2).sum(axis=1)
    error = differences.std(ddof=1) / np.sqrt(differences.size) if differences.size > 1 else 0.0
    return bool(differences.mean() > _PAIRS_HIGHER * error)


# Measure a profile: load, conditions, speed and, with a sensor, energy.


@dataclass(frozen=True, kw_only=True)
class Request:
    """What to measure with a load.

    Attributes
    ----------
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
        If the rate is not positive.
    """

    every: str = "window"
    packet: int = 512
    mission_rate: float = 1.0
    designs: bool = True
    meter: bool = False
    root: Path = ROOT

    def __post_init__(self) -> None:
        if not self.mission_rate > 0:
            raise UsageError(
                f"a mission of {self.mission_rate:g} matches a second: expected a positive rate"
            )


def profile(
    load: Load,
    request: Request,
    plan: Plan,
    sensor: Sensor | None = None,
    missing: Sequence[Missing] = (),
) -> Profile:
    """Measure a load on this machine.

    Parameters
    ----------
    load : Load
    request : Request
    plan : Plan
    sensor : Sensor, optional
        Sensor of power or energy; it is not closed.
    missing : sequence of Missing
        Reasons why there is no sensor.

    Raises
    ------
    UsageError
        If the load gives no match within a window.
    """
    reference = load.reference
    every = MatchSchedule.parse(request.every, reference.settings)
    workload = Workload(reference, load.events, every, request.packet)
    designs = load.truth_of is not None and request.designs
    if sensor is not None:
        _say_how_long(plan.for_period(sensor.about.period_s), designs)
    before = Conditions.now(request.root)
    note(f"speed: {_duration(plan.window_s)}")
    throughput = measure_throughput(workload, plan.window_s)
    # read at once, because a governor lowers the clock of an idle processor
    loaded = Conditions.now(request.root)
    because = tuple(str(one) for one in missing)
    energy: Outcome = NotMeasured(because)
    if sensor is not None:
        try:
            energy = measure(sensor, plan, workload.run, request.mission_rate)
        except SensorError as error:
            energy = NotMeasured((f"{sensor.about.name}: {error}",))
            sensor = None
    elif request.meter:
        energy = NotMeasured(because, tuple(take_turns(plan, workload.run)))
    compared = []
    if designs:
        assert load.truth_of is not None
        compared = compare(
            load.designs, load.query, load.events, load.truth_of, sensor, plan,
            request.mission_rate, (reference, energy),
        )  # fmt: skip
    after = Conditions.now(request.root)
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
        load=LoadRecord(load.name, request.every, request.packet),
        provenance=Provenance.of(request.root, loaded, energy, run),
        run=run,
    )  # fmt: skip


def with_meter(path: Path, meter: Path, rate: float) -> Profile:
    """Add the energy from an external meter's trace to a profile that was made for it.

    Raises
    ------
    UsageError
        If the profile has no windows for a meter, or the trace does not contain them.
    """
    found = Profile.load_file(path)
    windows = found.energy.windows if isinstance(found.energy, NotMeasured) else ()
    if not windows:
        raise UsageError(f"{path} took no turns for a meter: make it with --meter")
    with understood(path, "the turns of a profile", "make it again with edge-vpr profile"):
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
