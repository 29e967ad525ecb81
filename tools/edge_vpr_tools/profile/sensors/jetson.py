"""INA3221 on Jetson boards of older JetPack, by its iio files; newer versions use hwmon."""

from __future__ import annotations

from pathlib import Path

from edge_vpr_tools.profile.sensors.hwmon import CHIPS, SHUNT_TOLERANCE, WHOLE_BOARD, PowerFiles
from edge_vpr_tools.profile.sensors.sensor import About, Missing, Sensor, SensorError, read_text

_RESOLUTION_W, _PERIOD_S = 0.04, 0.01


def find(root: Path) -> tuple[list[Sensor], list[Missing]]:
    """Find the rails; the first is that of the whole board, which contains the others."""
    sensors: list[Sensor] = []
    refused = []
    pattern = "sys/bus/i2c/drivers/ina3221x/*/iio[:_]device*/rail_name_*"
    for label in sorted(root.glob(pattern)):
        number, rail = label.name.removeprefix("rail_name_"), read_text(label)
        about = About(
            name=f"ina3221x/{rail}",
            kind="power",
            scope="whole board" if rail in WHOLE_BOARD else f"rail {rail} only",
            period_s=_PERIOD_S,
            resolution=_RESOLUTION_W,
            gain_error=CHIPS["ina3221"].gain_error + SHUNT_TOLERANCE,
            detail=f"the board's own shunts; {CHIPS['ina3221'].source}",
        )
        sensor = PowerFiles(about, label.with_name(f"in_power{number}_input"), unit=1e-3)
        try:
            sensor.read()
        except SensorError as error:
            refused.append(str(error))
        else:
            sensors.append(sensor)
    sensors.sort(key=lambda s: s.about.scope != "whole board")
    return sensors, [Missing("Jetson", text, "read as root") for text in refused]
