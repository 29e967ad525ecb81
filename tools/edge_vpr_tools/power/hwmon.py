"""INA2xx and INA3221 power monitors, by the Linux hwmon files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from edge_vpr_tools.power.sensor import (
    About,
    Missing,
    Sensor,
    SensorError,
    plausible,
    read_number,
    read_text,
)

#: largest gain error of the chip by its data sheet; the shunt's tolerance comes on top
CHIPS = {
    "ina219": 0.01, "ina226": 0.001, "ina228": 0.0005, "ina230": 0.005, "ina231": 0.005,
    "ina237": 0.003, "ina238": 0.001, "ina260": 0.005, "ina3221": 0.0025,
}  # fmt: skip
#: of a usual shunt resistor, an assumption; INA260 has its own inside
SHUNT_TOLERANCE = 0.01
#: channels of INA3221 that hold the whole board, on Jetson boards
WHOLE_BOARD = ("VDD_IN", "POM_5V_IN", "VIN_SYS_5V0", "VIN")
_PERIOD_MS = 10.0


class EnergyFile(Sensor):
    """A file that counts microjoules."""

    def __init__(self, about: About, path: Path) -> None:
        self.about, self._path = about, path

    def read(self) -> float:
        """Joules since the driver was loaded."""
        return read_number(self._path) * 1e-6


class PowerFile(Sensor):
    """A file that tells power; `unit` is that of its numbers, in watts."""

    def __init__(self, about: About, path: Path, unit: float = 1e-6) -> None:
        self.about, self._path, self._unit = about, path, unit

    def read(self) -> float:
        """Watts now."""
        return plausible(read_number(self._path) * self._unit, self.about.name)


class VoltsTimesAmperes(Sensor):
    """Two files, of millivolts and milliamperes."""

    def __init__(self, about: About, volts: Path, amperes: Path) -> None:
        self.about, self._volts, self._amperes = about, volts, amperes

    def read(self) -> float:
        """Watts now; the two are read one after the other."""
        watts = read_number(self._volts) * read_number(self._amperes) * 1e-6
        return plausible(watts, self.about.name)


@dataclass(frozen=True)
class _Channel:
    folder: Path
    chip: str
    number: int
    label: str
    shunt: str

    @property
    def name(self) -> str:
        where = f"/{self.label}" if self.label else ""
        return f"{self.chip}@{self.folder.name}{where}"


def find(root: Path) -> tuple[list[Sensor], list[Missing]]:
    """Find power monitors, by the chip's name and not by its number."""
    sensors: list[Sensor] = []
    refused = []
    for folder in sorted((root / "sys/class/hwmon").glob("hwmon*")):
        chip = read_text(folder / "name").lower()
        if chip not in CHIPS:
            continue
        for channel in _channels(folder, chip):
            sensor = _sensor(channel)
            if sensor is None:
                refused.append(f"{folder} has no power, energy, or volts and amperes")
                continue
            try:
                sensor.read()
            except SensorError as error:
                refused.append(str(error))
            else:
                sensors.append(sensor)
    sensors.sort(key=lambda s: s.about.scope != "whole board")
    if sensors:
        return sensors, []
    reason = "; ".join(refused) or "no INA219, 226, 228, 260 or 3221 among the hwmon devices"
    remedy = "wire one in the 5 V line, and load its driver (dtoverlay=i2c-sensor,ina219)"
    return [], [Missing("power monitor", reason, remedy)]


def _channels(folder: Path, chip: str) -> list[_Channel]:
    if chip != "ina3221":
        return [_Channel(folder, chip, 1, "", _shunt(folder / "shunt_resistor", chip))]
    return [
        _Channel(
            folder, chip, i, read_text(folder / f"in{i}_label") or f"channel {i}",
            _shunt(folder / f"shunt{i}_resistor", chip),
        )
        for i in (1, 2, 3)
        if (folder / f"curr{i}_input").exists() and read_text(folder / f"in{i}_enable") != "0"
    ]  # fmt: skip


def _shunt(path: Path, chip: str) -> str:
    if chip == "ina260":
        return "shunt of 2 mOhm inside"
    micro = read_text(path)
    if not micro.isdigit():
        return "shunt unknown: confirm that the driver has your board's"
    return (
        f"the driver takes a shunt of {int(micro) / 1000:g} mOhm: confirm that it is your board's"
    )


def _sensor(channel: _Channel) -> Sensor | None:
    folder, n = channel.folder, channel.number
    interval = read_text(folder / "update_interval")
    period_ms = float(interval) if interval.replace(".", "", 1).isdigit() else _PERIOD_MS
    whole = channel.label in WHOLE_BOARD
    scope = "what its shunt is wired to"
    if channel.label:
        scope = "whole board" if whole else f"rail {channel.label} only"
    energy, power = folder / f"energy{n}_input", folder / f"power{n}_input"
    gain = CHIPS[channel.chip] + (0.0 if channel.chip == "ina260" else SHUNT_TOLERANCE)

    def about(kind: str, resolution: float = 0.0) -> About:
        return About(
            name=channel.name,
            kind="energy" if kind == "energy" else "power",
            scope=scope,
            period_s=max(period_ms, 1.0) / 1e3,
            resolution=resolution,
            gain_error=gain,
            detail=channel.shunt,
        )

    if energy.exists():
        return EnergyFile(about("energy", 1e-6), energy)
    if power.exists():
        return PowerFile(about("power"), power)
    volts, amperes = folder / f"in{n}_input", folder / f"curr{n}_input"
    if volts.exists() and amperes.exists():
        # at 5 V, by steps of 8 mA: INA3221's 40 uV over 5 mOhm
        return VoltsTimesAmperes(about("power", 0.04 * (channel.chip == "ina3221")), volts, amperes)
    return None
