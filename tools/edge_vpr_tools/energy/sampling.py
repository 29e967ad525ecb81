"""Samples of power over time, and the energy between two times."""

from __future__ import annotations

import resource
import threading
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edge_vpr_tools.energy.sensors.sensor import Sensor, SensorError

Floats = npt.NDArray[np.float64]


class Window(NamedTuple):
    """Period of one kind of load, on the monotonic clock."""

    load: bool
    start_s: float
    end_s: float
    matches: int = 0


@dataclass(frozen=True, eq=False)
class Trace:
    """Cumulated energy, at increasing times.

    Attributes
    ----------
    time_s : ndarray of float64, shape (n,)
    energy_j : ndarray of float64, shape (n,)
        Energy since the first sample.
    fresh : ndarray of bool, shape (n,)
        Whether the reading differs from the previous one. A meter that is read more often than it
        measures repeats its readings.
    """

    time_s: Floats
    energy_j: Floats
    fresh: npt.NDArray[np.bool_]

    @classmethod
    def of_energy(cls, time_s: Floats, joules: Floats) -> Trace:
        """Make a trace from an energy counter's readings."""
        return cls(time_s, joules - joules[0], _fresh(joules))

    @classmethod
    def of_power(cls, time_s: Floats, watts: Floats) -> Trace:
        """Integrate power by trapezoids; repeated readings do not change the integral's mean."""
        steps = np.diff(time_s) * (watts[1:] + watts[:-1]) / 2
        return cls(time_s, np.concatenate([[0.0], np.cumsum(steps)]), _fresh(watts))

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

    def native_samples(self, start_s: float, end_s: float) -> int:
        """Count the readings between two times that differ from the previous one."""
        inside = (self.time_s >= start_s) & (self.time_s <= end_s)
        return int(np.count_nonzero(inside & self.fresh))


def _fresh(readings: Floats) -> npt.NDArray[np.bool_]:
    return np.concatenate([[True], np.diff(readings) != 0])


@dataclass
class Sampler:
    """Reads a sensor at its period, in a thread of its own.

    Attributes
    ----------
    cpu_s, commands_s : float
        Processor time of the thread, and of the commands that ran during sampling; it is part of
        idle and load alike.
    error : SensorError, optional
        Reason why sampling stopped early.
    """

    sensor: Sensor
    cpu_s: float = 0.0
    commands_s: float = 0.0
    error: SensorError | None = None
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
        period, before = self.sensor.about.period_s, _commands_s()
        try:
            while not self._stop.wait(period):
                self._take()
        except SensorError as error:
            self.error = error
        self.cpu_s, self.commands_s = time.thread_time(), _commands_s() - before


def _commands_s() -> float:
    """Return the processor time of all commands that this process has run."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
