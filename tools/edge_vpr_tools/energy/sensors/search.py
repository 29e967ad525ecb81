"""Search this machine for power and energy sensors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edge_vpr_tools.energy.sensors import hwmon, jetson, pmic, powercap
from edge_vpr_tools.energy.sensors.sensor import ROOT, Missing, Sensor

Finder = Callable[[Path], tuple[list[Sensor], list[Missing]]]


def find_sensors(root: Path = ROOT) -> tuple[list[Sensor], list[Missing]]:
    """Look for every sensor that this machine has.

    Parameters
    ----------
    root : path
        Where the file system begins; another one for tests.

    Returns
    -------
    sensors : list of Sensor
        The best one first: whole board before parts of it.
    missing : list of Missing
    """
    finders: tuple[Finder, ...] = (hwmon.find, jetson.find, pmic.find, powercap.find)
    sensors, missing = [], []
    for finder in finders:
        found, absent = finder(root)
        sensors += found
        missing += absent
    return sensors, missing
