"""INA2xx and INA3221 power monitors, read from the hwmon files of Linux."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from edge_vpr.errors import UsageError
from edge_vpr_tools.profile.sensors.sensor import (
    About,
    Missing,
    NumberFile,
    Sensor,
    SensorError,
    read_text,
)


@dataclass(frozen=True)
class Chip:
    """Data of a power monitor from its data sheet."""

    #: current_gain, voltage_gain: largest relative errors at 25 degrees Celsius.
    current_gain: float
    voltage_gain: float
    source: str  #: Source of the two errors; errors that it does not state are labelled as assumed.
    #: Step of the power register in watts, times the shunt in micro-ohms; 0 if not known. The
    #: scaling is that of Linux, drivers/hwmon/ina2xx.c.
    power_step: float = 0.0

    @property
    def gain_error(self) -> float:
        """Gain error of a power without the shunt; at worst, both errors have the same sign."""
        return self.current_gain + self.voltage_gain


#: from Texas Instruments' data sheets
CHIPS = {
    "ina219": Chip(0.005, 0.005, "SBOS448F, current and bus voltage, grade A", 200.0),
    "ina220": Chip(0.005, 0.005, "assumed as of INA219", 200.0),
    "ina226": Chip(0.001, 0.001, "SBOS547B, shunt and bus voltage gain error", 62.5),
    "ina228": Chip(0.0005, 0.0005, "SLYS021A, shunt and bus voltage gain error"),
    "ina230": Chip(0.005, 0.005, "SBOS601, shunt and bus voltage gain error", 62.5),
    "ina231": Chip(0.005, 0.005, "SBOS644, shunt; of the bus voltage assumed the same", 62.5),
    "ina237": Chip(0.003, 0.003, "SBOSA27A, shunt; of the bus voltage assumed the same"),
    "ina238": Chip(0.001, 0.001, "INA238-Q1, SLYS026A, shunt and bus voltage gain error"),
    "ina260": Chip(0.0015, 0.001, "SBOS656C, current with its own shunt, and bus voltage"),
    "ina3221": Chip(0.0025, 0.0025, "SBOS576A, shunt and bus voltage gain error"),
}
#: assumed tolerance of a common shunt resistor; INA260 has an internal one
SHUNT_TOLERANCE = 0.01
#: tolerance of INA228's clock, with which it integrates energy (SLYS021A)
_OSCILLATOR = 0.005
_INA260_STEP_W, _INA3221_STEP_V = 0.01, 40e-6
#: channels of INA3221 that measure the whole board, on Jetson boards
WHOLE_BOARD = ("VDD_IN", "POM_5V_IN", "VIN_SYS_5V0", "VIN")
_PERIOD_MS = 10.0


class Files(Sensor):
    """File with the power or the energy, or files with volts and amperes, which are multiplied.

    Parameters
    ----------
    unit : float
        Unit of the product in watts or joules.
    """

    def __init__(self, about: About, *paths: Path, unit: float = 1.0) -> None:
        self.about, self.unit, self.paths = about, unit, paths
        self._files = [NumberFile(path) for path in paths]

    def read(self) -> float:
        """See `Sensor.read`; two files are read one after the other."""
        value = self.unit
        for file in self._files:
            value *= file.read()
        return value

    def close(self) -> None:
        """See `Sensor.close`."""
        for file in self._files:
            file.close()


@dataclass(frozen=True)
class _Channel:
    folder: Path
    chip: str
    number: int
    label: str
    shunt: Path

    @property
    def name(self) -> str:
        where = f"/{self.label}" if self.label else ""
        return f"{self.chip}@{self.folder.name}{where}"


def find(root: Path) -> tuple[list[Sensor], list[Missing]]:
    """Find power monitors by the chip's name, not by its number."""
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
                sensor.close()
                refused.append(str(error))
            else:
                sensors.append(sensor)
    sensors.sort(key=lambda s: s.about.scope != "whole board")
    if sensors:
        return sensors, []
    if refused:
        return [], [Missing("power monitor", "; ".join(refused), "check its wiring and driver")]
    reason = f"no {', '.join(CHIPS).upper()} among the hwmon devices"
    remedy = (
        "wire one in the 5 V line, and tell the kernel (for an INA226 on bus 1: "
        "echo ina226 0x40 | sudo tee /sys/bus/i2c/devices/i2c-1/new_device)"
    )
    return [], [Missing("power monitor", reason, remedy)]


def _channels(folder: Path, chip: str) -> list[_Channel]:
    if chip != "ina3221":
        return [_Channel(folder, chip, 1, "", folder / "shunt_resistor")]
    return [
        _Channel(
            folder, chip, i, read_text(folder / f"in{i}_label") or f"channel {i}",
            folder / f"shunt{i}_resistor",
        )
        for i in (1, 2, 3)
        if (folder / f"curr{i}_input").exists() and read_text(folder / f"in{i}_enable") != "0"
    ]  # fmt: skip


def with_shunt(sensor: Sensor, mohm: float) -> Sensor:
    """Correct a power monitor for its real shunt, if its driver assumes another one."""
    about = sensor.about
    if not isinstance(sensor, Files) or about.shunt_mohm is None or not mohm > 0:
        raise UsageError(
            f"--shunt-mohm {mohm:g}: {about.name} does not report the shunt that it assumes: "
            "give its driver the right one (shunt-resistor in the device tree)"
        )
    factor = about.shunt_mohm / mohm
    about = replace(
        about,
        resolution=None if about.resolution is None else about.resolution * factor,
        shunt_mohm=mohm,
        detail=f"{about.detail.partition('; shunt')[0]}; shunt of {mohm:g} mOhm as confirmed, the "
        f"driver's is {about.shunt_mohm:g}: its readings are multiplied by {factor:g}",
    )
    return Files(about, *sensor.paths, unit=sensor.unit * factor)


def _sensor(channel: _Channel) -> Sensor | None:
    folder, n, chip = channel.folder, channel.number, CHIPS[channel.chip]
    interval = read_text(folder / "update_interval")
    period_ms = float(interval) if interval.replace(".", "", 1).isdigit() else _PERIOD_MS
    scope = "what its shunt is wired to"
    if channel.label:
        whole = channel.label in WHOLE_BOARD
        scope = "whole board" if whole else f"rail {channel.label} only"
    energy, power = folder / f"energy{n}_input", folder / f"power{n}_input"
    volts, amperes = folder / f"in{n}_input", folder / f"curr{n}_input"
    inside = channel.chip == "ina260"
    micro = read_text(channel.shunt)
    # an absurd shunt is ignored, since a division by it would give no reading
    micro_ohms = int(micro) if not inside and micro.isdigit() and int(micro) > 0 else None
    shunt = "shunt of 2 mOhm inside" if inside else "shunt unknown: confirm the driver's"
    if micro_ohms is not None:
        shunt = (
            f"shunt of {micro_ohms / 1e3:g} mOhm taken by the driver: confirm that it is your "
            "board's (--shunt-mohm)"
        )

    def about(kind: Literal["energy", "power"], step: float) -> About:
        counted = _OSCILLATOR if kind == "energy" else 0.0
        return About(
            name=channel.name,
            kind=kind,
            scope=scope,
            period_s=max(period_ms, 1.0) / 1e3,
            resolution=step,
            gain_error=chip.gain_error + counted + (0.0 if inside else SHUNT_TOLERANCE),
            detail=f"gain error after {chip.source}"
            + ("" if inside else f" and {SHUNT_TOLERANCE:.0%} of the shunt, assumed")
            + f"; {shunt}",
            shunt_mohm=None if micro_ohms is None else micro_ohms / 1e3,
        )

    if energy.exists():
        return Files(about("energy", 1e-6), energy, unit=1e-6)
    if power.exists():
        step = _INA260_STEP_W if inside else chip.power_step / (micro_ohms or math.inf)
        return Files(about("power", step), power, unit=1e-6)
    if volts.exists() and amperes.exists():
        step = 0.0
        if channel.chip == "ina3221" and micro_ohms is not None:
            step = 5.0 * _INA3221_STEP_V / (micro_ohms * 1e-6)  # at 5 V
        return Files(about("power", step), volts, amperes, unit=1e-6)
    return None
