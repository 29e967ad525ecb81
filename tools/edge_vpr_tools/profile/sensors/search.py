"""Search this machine for power and energy sensors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edge_vpr.errors import UsageError
from edge_vpr_tools.profile.sensors import hwmon, pmic, powercap
from edge_vpr_tools.profile.sensors.sensor import ROOT, Missing, Sensor

Finder = Callable[[Path], tuple[list[Sensor], list[Missing]]]


def find_sensors(root: Path = ROOT) -> tuple[list[Sensor], list[Missing]]:
    """Find all sensors of this machine, and which kinds are missing.

    Returns
    -------
    sensors : list of Sensor
        The best one first: sensors of the whole board precede those of parts of it.
    """
    finders: tuple[Finder, ...] = (hwmon.find, pmic.find, powercap.find)
    sensors, missing = [], []
    for finder in finders:
        of_kind, absent = finder(root)
        sensors += of_kind
        missing += absent
    return sensors, missing


def choose_sensor(
    root: Path, *, name: str | None, shunt_mohm: float | None
) -> tuple[Sensor | None, list[Missing]]:
    """Open the sensor of a name, else the best sensor of the machine.

    Returns
    -------
    sensor : Sensor or None
        Must be closed by the caller.
    """
    sensors, missing = find_sensors(root)
    if name is not None:
        names = ", ".join(sensor.about.name for sensor in sensors) or "none"
        sensors = [sensor for sensor in sensors if sensor.about.name == name]
        if not sensors:
            raise UsageError(f"there is no power sensor {name!r}: this machine has {names}")
    for unused in sensors[1:]:
        unused.close()
    if not sensors:
        if shunt_mohm is not None:
            raise UsageError(f"--shunt-mohm {shunt_mohm:g}: no power monitor was found")
        return None, missing
    chosen = sensors[0]
    if shunt_mohm is not None:
        chosen = hwmon.with_shunt(chosen, shunt_mohm)
    return chosen, missing
