"""Running average power limit (RAPL) of Intel and AMD, read from the powercap files."""

from __future__ import annotations

from pathlib import Path

from edge_vpr_tools.profile.sensors.sensor import (
    About,
    Missing,
    NumberFile,
    Sensor,
    SensorError,
    read_text,
)


class Package(Sensor):
    """Energy of a processor package; wraps of the counter are removed.

    It must be read more often than the counter wraps, which takes minutes.
    """

    def __init__(self, about: About, folder: Path) -> None:
        self.about, self._path = about, folder / "energy_uj"
        self._counter = NumberFile(self._path)
        span = NumberFile(folder / "max_energy_range_uj")
        self._range = span.read()
        span.close()
        self._last = self._counter.read()
        self._total = 0.0

    def read(self) -> float:
        """Return the joules since the sensor was opened."""
        now = self._counter.read()
        step = now - self._last
        if step < 0:
            step += self._range + 1
        if not 0 <= now <= self._range or step < 0:
            raise SensorError(
                f"{self._path} reads {now:g} uJ of at most {self._range:g}: it cannot be trusted"
            )
        self._last = now
        self._total += step
        return self._total * 1e-6

    def close(self) -> None:
        """See `Sensor.close`."""
        self._counter.close()


def find(root: Path) -> tuple[list[Sensor], list[Missing]]:
    """Find the packages; their energy includes that of their parts."""
    sensors: list[Sensor] = []
    refused = []
    # a zone within another zone has two colons
    for folder in sorted((root / "sys/class/powercap").glob("*-rapl:*")):
        if folder.name.count(":") != 1:
            continue
        name = read_text(folder / "name") or folder.name
        about = About(
            name=f"rapl/{name}",
            kind="energy",
            scope="platform" if name == "psys" else "processor package only, no board around it",
            period_s=1e-3,
            resolution=61e-6,
            # on some generations, this is a model of the processor itself without a published bound
            gain_error=0.05,
            detail="5 % of gain error is an assumption: none is published",
        )
        try:
            sensors.append(Package(about, folder))
        except SensorError as error:
            refused.append(str(error))
    if sensors:
        return sensors, []
    if refused:
        return [], [Missing("RAPL", refused[0], "its energy is for root only: run with sudo")]
    return [], [
        Missing("RAPL", "no powercap zone", "Intel and AMD have one, virtual machines none")
    ]
