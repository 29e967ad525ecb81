"""Measurement of the energy of a match by alternating idle and load periods."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edge_vpr.errors import UsageError
from edge_vpr_tools.energy.energy_record import Energy, Figures, PowerTrace, Readings
from edge_vpr_tools.energy.intervals import LEAST_PAIRS, interval, paired_energy
from edge_vpr_tools.energy.sampling import Sampler, Trace, Window
from edge_vpr_tools.energy.sensors.sensor import About, Sensor
from edge_vpr_tools.output.interrupt import check_interrupted
from edge_vpr_tools.output.messages import note

#: function that runs the load for some seconds and returns the number of matches
Load = Callable[[float], int]

#: least duration and native samples of a window, for a figure that can be published
LEAST_S, LEAST_SAMPLES = 10.0, 100
_LEAST_QUICK_S = 0.1


@dataclass(frozen=True)
class Plan:
    """Number and length of the periods of a measurement.

    Attributes
    ----------
    pairs : int
        Number of pairs of an idle and a load window.
    window_s : float
        Duration of each window in seconds.
    quick : bool
        Whether windows are too short for a figure that can be published; figures are then labelled.
    """

    pairs: int = LEAST_PAIRS
    window_s: float = LEAST_S
    quick: bool = False

    @classmethod
    def checked(cls, pairs: int, window_s: float | None, quick: bool) -> Plan:
        """Build a plan whose figures can be published, or a quick one.

        Parameters
        ----------
        pairs : int
        window_s : float, optional
            10 s by default, or 1 s if `quick`.
        quick : bool

        Raises
        ------
        UsageError
            If there are too few pairs, or windows are too short.
        """
        least_s = _LEAST_QUICK_S if quick else LEAST_S
        if window_s is None:
            window_s = 1.0 if quick else LEAST_S
        if not (window_s >= least_s and pairs >= LEAST_PAIRS):
            raise UsageError(
                f"{pairs} pairs of {window_s:g} s: expected {LEAST_PAIRS} pairs or more, and "
                f"{least_s:g} s or more (shorter: --quick)"
            )
        return cls(pairs, window_s, quick)

    def for_period(self, period_s: float) -> Plan:
        """Lengthen the windows so that each holds a hundred native samples."""
        if self.quick:
            return self
        return Plan(self.pairs, max(self.window_s, LEAST_SAMPLES * period_s))


def take_turns(
    plan: Plan,
    load: Load,
    *,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> list[Window]:
    """Alternate idle and load windows, with alternating order within pairs.

    A steady drift of the board's power cancels over two pairs: idle, load, load, idle. In idle
    windows, this process sleeps.

    Parameters
    ----------
    plan : Plan
    load : callable
        Must be warm: compiled, and in the caches.
    sleep, clock : callable
        Replaced in tests.
    """
    windows = []
    for pair in range(plan.pairs):
        left_s = 2 * plan.window_s * (plan.pairs - pair)
        note(f"idle and load, pair {pair + 1} of {plan.pairs}: {left_s:.0f} s left")
        for loaded in (False, True) if pair % 2 == 0 else (True, False):
            check_interrupted()
            start, matches = clock(), 0
            if loaded:
                matches = load(plan.window_s)
            else:
                sleep(plan.window_s)
            windows.append(Window(loaded, start, clock(), matches))
    return windows


def measure(sensor: Sensor, plan: Plan, load: Load, rate: float) -> Energy:
    """Measure the energy of a match.

    Parameters
    ----------
    sensor : Sensor
    plan : Plan
    load : callable
    rate : float
        Matches per second of the mission.

    Returns
    -------
    Energy
        See `analyse`; includes the cost of sampling.

    Raises
    ------
    SensorError
        If the sensor fails during the measurement.
    """
    plan = plan.for_period(sensor.about.period_s)
    cpu = time.process_time()
    with Sampler(sensor) as sampler:
        time.sleep(3 * sensor.about.period_s)
        windows = take_turns(plan, load)
        time.sleep(3 * sensor.about.period_s)
    cpu = time.process_time() - cpu
    found = analyse(sampler.trace(), windows, sensor.about, rate)
    matches = sum(window.matches for window in windows)
    elapsed = windows[-1].end_s - windows[0].start_s
    return replace(
        found,
        quick=plan.quick,
        cpu_s_per_match=(cpu - sampler.cpu_s) / max(matches, 1),
        sampler_cpu_share=(sampler.cpu_s + sampler.commands_s) / elapsed,
    )


def analyse(trace: Trace, windows: Sequence[Window], about: About, rate: float) -> Energy:
    """Return the energy of a match with intervals: marginal, saturated, and at the mission's rate.

    Parameters
    ----------
    trace : Trace
    windows : sequence of Window
        Pairs of an idle and a load window.
    about : About
        Description of the meter.
    rate : float
        Matches per second of the mission.
    """
    idle_w, load_w = paired_energy(trace, windows)
    loads = [window for window in windows if window.load]
    # divided by the matches of the same period, so that a slow period does not seem cheap
    a_match_s = np.array([(w.end_s - w.start_s) / max(w.matches, 1) for w in loads])
    marginal = interval((load_w - idle_w) * a_match_s)
    saturated = interval(load_w * a_match_s)
    idle = interval(idle_w)
    resolved, value = marginal.resolved, marginal.value
    at_mission = interval(idle_w / rate + (load_w - idle_w) * a_match_s)
    start = windows[0].start_s
    samples = [trace.native_samples(w.start_s, w.end_s) for w in windows]
    return Energy(
        pairs=marginal.pairs,
        window_s=float(np.median([w.end_s - w.start_s for w in windows])),
        native_samples_per_window=int(np.median(samples)),
        saturated_matches_per_s=float(np.median(1 / a_match_s)),
        mission_matches_per_s=rate,
        figures=Figures(
            marginal_j_per_match=value if resolved else None,
            marginal_j_per_match_interval=(marginal.low, marginal.high),
            marginal_j_per_match_interval_with_gain=marginal.with_gain(about.gain_error),
            pairs_needed=None if resolved else marginal.pairs_needed(),
            saturated_j_per_match=saturated.value,
            saturated_j_per_match_interval=(saturated.low, saturated.high),
            mission_j_per_match=at_mission.value,
            mission_j_per_match_interval=(at_mission.low, at_mission.high),
            matches_per_joule=1 / value if resolved else None,
            matches_per_joule_interval=(1 / marginal.high, 1 / marginal.low) if resolved else None,
            idle_w=idle.value,
            idle_w_interval=(idle.low, idle.high),
            load_w=float(np.median(load_w)),
        ),
        readings=Readings(
            sensor=about,
            differences_w=tuple((load_w - idle_w).tolist()),
            windows=tuple(
                Window(w.load, w.start_s - start, w.end_s - start, w.matches) for w in windows
            ),
            trace=_thinned(trace, start),
        ),
    )


def _thinned(trace: Trace, start: float) -> PowerTrace:
    """Return at most a thousand points of power, for a figure."""
    step = 1 + trace.time_s.size // 1_000
    time_s, energy = trace.time_s[::step], trace.energy_j[::step]
    return PowerTrace(
        tuple(((time_s[1:] + time_s[:-1]) / 2 - start).tolist()),
        tuple((np.diff(energy) / np.diff(time_s)).tolist()),
    )
