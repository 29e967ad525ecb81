"""Measurement of energy by alternating idle and load periods: samples, intervals, record."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr.errors import UsageError
from edge_vpr_tools.console import note
from edge_vpr_tools.profile.sensors.sensor import About, Sensor, SensorError

# Samples of power over time, and the energy between two times.


Floats = npt.NDArray[np.float64]


class Window(NamedTuple):
    """Period of one kind of load, on the monotonic clock."""

    load: bool
    start_s: float
    end_s: float
    matches: int = 0
    #: watts, middle_watts: mean power of the window, and of its middle half; None: not measured.
    watts: float | None = None
    middle_watts: float | None = None


class Readings(NamedTuple):
    """What a meter read from the beginning of the first window to the end of the last."""

    samples: int
    lowest_w: float
    highest_w: float
    at_highest: int  #: Readings that are the highest: many, where its range ends.
    longest_gap_s: float  #: Between two readings.


@dataclass(frozen=True, eq=False)
class Trace:
    """Cumulated energy, at increasing times."""

    time_s: Floats  #: Shape (n,): times of the readings.
    energy_j: Floats  #: Shape (n,): energy since the first sample.
    watts: Floats | None = None  #: Shape (n,): the readings, of a meter of power.

    @classmethod
    def of_energy(cls, time_s: Floats, joules: Floats) -> Trace:
        """Make a trace from an energy counter's readings."""
        return cls(time_s, joules - joules[0])

    @classmethod
    def of_power(cls, time_s: Floats, watts: Floats) -> Trace:
        """Integrate power by trapezoids; repeated readings do not change the integral's mean."""
        steps = np.diff(time_s) * (watts[1:] + watts[:-1]) / 2
        return cls(time_s, np.concatenate([[0.0], np.cumsum(steps)]), watts)

    def readings(self, start_s: float, end_s: float) -> Readings:
        """Return facts of the readings between two times; of a counter, of the power between."""
        time_s, watts = self.time_s, self.watts
        if watts is None:
            time_s, watts = time_s[:-1], np.diff(self.energy_j) / np.diff(time_s)
        inside = (start_s <= time_s) & (time_s <= end_s)
        most = float(watts[inside].max())
        return Readings(
            int(np.count_nonzero(inside)), float(watts[inside].min()), most,
            int(np.count_nonzero(watts[inside] == most)), float(np.diff(time_s[inside]).max()),
        )  # fmt: skip

    def power(self, start_s: float, end_s: float) -> float:
        """Return the mean watts between two times, see `energy`."""
        return self.energy(start_s, end_s) / (end_s - start_s)

    def energy(self, start_s: float, end_s: float) -> float:
        """Return the joules between two times, with linear interpolation between samples.

        Raises
        ------
        SensorError
            If the trace does not cover both times.
        """
        if not self.time_s[0] <= start_s < end_s <= self.time_s[-1]:
            raise SensorError(
                f"the power trace covers {self.time_s[0]:g} to {self.time_s[-1]:g} s and not "
                f"{start_s:g} to {end_s:g} s: let the meter run longer"
            )
        before, after = np.interp([start_s, end_s], self.time_s, self.energy_j)
        return float(after - before)


@dataclass
class Sampler:
    """Reads a sensor at its period, in a thread of its own."""

    sensor: Sensor
    error: SensorError | None = None  #: Reason why sampling stopped early.
    _times: list[float] = field(default_factory=list)
    _values: list[float] = field(default_factory=list)
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def __enter__(self) -> Sampler:
        self._take()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *unused: object) -> None:
        self._stop.set()
        assert self._thread is not None
        self._thread.join()
        if self.error is None:
            try:
                self._take()
            except SensorError as error:
                self.error = error

    def trace(self) -> Trace:
        """Return the samples.

        Raises
        ------
        SensorError
            If the sensor failed during sampling.
        """
        if self.error is not None:
            raise self.error
        times, values = np.array(self._times), np.array(self._values)
        if self.sensor.about.kind == "energy":
            return Trace.of_energy(times, values)
        return Trace.of_power(times, values)

    def _take(self) -> None:
        when, value = self.sensor.sample()
        if self._times and when <= self._times[-1]:
            return  # the sensor was read before it had a new value
        self._times.append(when)
        self._values.append(value)

    def _run(self) -> None:
        try:
            while not self._stop.wait(self.sensor.about.period_s):
                self._take()
        except SensorError as error:
            self.error = error


# Statistics of pairs of idle and load periods: median, interval, and whether it is resolved.


LEAST_PAIRS = 5
_RESAMPLES = 2_000


@dataclass(frozen=True)
class Estimate:
    """Median of paired differences."""

    value: float
    #: low, high: 95 % interval by block bootstrap.
    low: float
    high: float
    pairs: int  #: Number of differences.

    @property
    def resolved(self) -> bool:
        """Whether the whole interval is above zero."""
        return self.low > 0

    def pairs_needed(self) -> int | None:
        """Return the number of pairs that would resolve the median; None if it is not above 0.

        The spread is assumed to stay the same; an interval narrows with the square root of the
        number.
        """
        if self.value <= 0:
            return None
        half = (self.high - self.low) / 2
        return max(self.pairs + 1, int(np.ceil(self.pairs * (1.2 * half / self.value) ** 2)))


def powered(trace: Trace, window: Window) -> Window:
    """Return a window with its mean power."""
    quarter_s = (window.end_s - window.start_s) / 4
    return window._replace(
        watts=trace.power(window.start_s, window.end_s),
        middle_watts=trace.power(window.start_s + quarter_s, window.end_s - quarter_s),
    )


def interval(differences: Floats) -> Estimate:
    """Return the median of paired differences, and its interval by a circular block bootstrap.

    Neighbouring pairs share slow changes of the board's temperature. Blocks of neighbours are
    therefore drawn together: two pairs from 27 pairs on, and three from 126 on; with fewer pairs,
    each is drawn by itself. The unit is always a pair of windows and never a sample, so that
    duplicates of samples do not narrow the interval.
    """
    n = differences.size
    if n < LEAST_PAIRS:
        raise UsageError(f"{n} pairs of windows: an interval needs {LEAST_PAIRS} or more")
    block = max(1, int(n ** (1 / 3) / 2 + 0.5))
    rng = np.random.default_rng(0)
    starts = rng.integers(0, n, (_RESAMPLES, -(-n // block)))
    at = (starts[:, :, None] + np.arange(block)) % n
    medians = np.median(differences[at.reshape(_RESAMPLES, -1)[:, :n]], axis=1)
    low, high = np.quantile(medians, [0.025, 0.975]).tolist()
    value, wider = float(np.median(differences)), _small_sample(n)
    return Estimate(value, value + wider * (low - value), value + wider * (high - value), n)


def _small_sample(n: int) -> float:
    """Return the factor by which to widen a bootstrap interval of few values (Hesterberg, 2015).

    The bootstrap resamples with the variance of n instead of n - 1, and has quantiles of a normal
    instead of Student's distribution, whose quantile is expanded here (Abramowitz and Stegun,
    26.7.5).
    """
    z, degrees = 1.959964, n - 1
    student = z + (z**3 + z) / (4 * degrees) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * degrees**2)
    return float(student / z * np.sqrt(n / degrees))


# Energy of a match: measured, void because of throttling, or not measured.


Bounds = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures on the energy of a match, from idle and load periods."""

    pairs: int  #: Number of pairs of an idle and a load window.
    window_s: float  #: Median length of a window.
    #: Joules under load minus joules at rest; None if the difference is not resolved.
    marginal_j_per_match: float | None
    #: 95 % interval, like all intervals here; without the gain error of the meter.
    marginal_j_per_match_interval: Bounds
    #: Number of pairs that would resolve the difference if the spread stays the same; None if it is
    #: resolved, or if no number would resolve it.
    pairs_needed: int | None
    matches_per_joule: float | None  #: Computed from the marginal energy.
    matches_per_joule_interval: Bounds | None
    #: idle_w, load_w: power at rest and under load, in watts.
    idle_w: float
    idle_w_interval: Bounds
    load_w: float


class PowerTrace(NamedTuple):
    """Power over time, with few points for a figure; seconds since the first window, and watts."""

    time_s: tuple[float, ...]
    watts: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Energy:
    """Energy of a match, as far as it was measured."""

    figures: Figures | None = None  #: None if not measured, or void because of throttling.
    #: sensor, trace: kept even if the figures are void.
    sensor: About | None = None
    trace: PowerTrace | None = None
    readings: Readings | None = None
    began_unix_s: float | None = None  #: When the first window began, since 1970.
    #: Of idle and load; without a sensor, those that were run for an external meter.
    windows: tuple[Window, ...] = ()
    not_measured_because: tuple[str, ...] = ()


# Measurement of the energy of a match by alternating idle and load periods.


#: function that runs the load for some seconds and returns the number of matches
RunLoad = Callable[[float], int]

#: least duration and native samples of a window, for a figure that can be published
LEAST_S, LEAST_SAMPLES = 10.0, 100
_LEAST_QUICK_S = 0.1
#: the same for a quick one, and for the trace of an external meter
_LEAST_QUICK_SAMPLES, _LEAST_TRACE_SAMPLES = 10, 8


@dataclass(frozen=True)
class Plan:
    """Number and length of the periods of a measurement."""

    pairs: int = LEAST_PAIRS  #: Number of pairs of an idle and a load window.
    window_s: float = LEAST_S  #: Duration of each window in seconds.
    #: Whether windows are too short for a figure that can be published; figures are then labelled.
    quick: bool = False

    @classmethod
    def checked(cls, pairs: int, window_s: float | None, quick: bool) -> Plan:
        """Build a plan whose figures can be published, or a quick one.

        Parameters
        ----------
        window_s : float, optional
            10 s by default, or 1 s if `quick`.
        """
        least_s = _LEAST_QUICK_S if quick else LEAST_S
        if window_s is None:
            window_s = 1.0 if quick else LEAST_S
        if not (window_s >= least_s and pairs >= LEAST_PAIRS):
            raise UsageError(
                f"--pairs {pairs} of {window_s:g} s: give {LEAST_PAIRS} pairs or more, of "
                f"{least_s:g} s or more{'' if quick else ' (shorter: --quick)'}"
            )
        return cls(pairs, window_s, quick)

    def for_period(self, period_s: float) -> Plan:
        """Lengthen the windows so that each holds a hundred native samples; ten if quick."""
        least = _LEAST_QUICK_SAMPLES if self.quick else LEAST_SAMPLES
        return replace(self, window_s=max(self.window_s, least * period_s))


def take_turns(plan: Plan, load: RunLoad) -> list[Window]:
    """Alternate idle and load windows, with alternating order within pairs.

    A steady drift of the board's power cancels over two pairs: idle, load, load, idle. In idle
    windows, this process sleeps.

    Parameters
    ----------
    load : callable
        Must be warm: compiled, and in the caches.
    """
    windows = []
    for pair in range(plan.pairs):
        left_s = 2 * plan.window_s * (plan.pairs - pair)
        note(f"idle and load, pair {pair + 1} of {plan.pairs}: {left_s:.0f} s left")
        for loaded in (False, True) if pair % 2 == 0 else (True, False):
            start, matches = time.monotonic(), 0
            if loaded:
                matches = load(plan.window_s)
            else:
                time.sleep(plan.window_s)
            windows.append(Window(loaded, start, time.monotonic(), matches))
    return windows


def measure(sensor: Sensor, plan: Plan, load: RunLoad) -> Energy:
    """Measure the energy of a match.

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
    with Sampler(sensor) as sampler:
        time.sleep(3 * sensor.about.period_s)
        windows = take_turns(plan, load)
        time.sleep(3 * sensor.about.period_s)
    return analyse(sampler.trace(), windows, sensor.about)


def analyse(trace: Trace, windows: Sequence[Window], about: About) -> Energy:
    """Return the energy that a match adds to that of the machine at rest, with intervals.

    The power of a window is that of its middle half: a meter averages and answers late, so that its
    readings near the beginning and the end may be of the window beside it.

    Raises
    ------
    SensorError
        If the meter reads too seldom for the windows.
    """
    window_s = float(np.median([window.end_s - window.start_s for window in windows]))
    if round(window_s / about.period_s) < _LEAST_TRACE_SAMPLES:
        raise SensorError(
            f"the meter reads every {about.period_s:g} s, and windows are of {window_s:g} s: take "
            f"windows of {_LEAST_QUICK_SAMPLES * about.period_s:g} s or more (--window-s)"
        )
    # each two consecutive windows are a pair, in either order
    windows = [powered(trace, window) for window in windows]
    loads = [window for window in windows if window.load]
    idle_w = np.array([window.middle_watts for window in windows if not window.load])
    load_w = np.array([window.middle_watts for window in loads])
    # divided by the matches of the same period, so that a slow period does not seem cheap
    a_match_s = np.array([(w.end_s - w.start_s) / max(w.matches, 1) for w in loads])
    marginal = interval((load_w - idle_w) * a_match_s)
    idle = interval(idle_w)
    resolved, value = marginal.resolved, marginal.value
    start = windows[0].start_s
    return Energy(
        figures=Figures(
            pairs=marginal.pairs,
            window_s=window_s,
            marginal_j_per_match=value if resolved else None,
            marginal_j_per_match_interval=(marginal.low, marginal.high),
            pairs_needed=None if resolved else marginal.pairs_needed(),
            matches_per_joule=1 / value if resolved else None,
            matches_per_joule_interval=(1 / marginal.high, 1 / marginal.low) if resolved else None,
            idle_w=idle.value,
            idle_w_interval=(idle.low, idle.high),
            load_w=float(np.median(load_w)),
        ),
        sensor=about,
        trace=_thinned(trace, start),
        readings=trace.readings(start, windows[-1].end_s),
        windows=tuple(
            w._replace(start_s=w.start_s - start, end_s=w.end_s - start) for w in windows
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
