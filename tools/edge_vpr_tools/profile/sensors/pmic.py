"""Power management chip of Raspberry Pi 5, read by the command vcgencmd."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

from edge_vpr_tools.profile.sensors.sensor import (
    ROOT,
    About,
    Missing,
    Sensor,
    SensorError,
    read_text,
)

_LINE = re.compile(r"^\s*(\w+)_([AV]) (?:current|volt)\(\d+\)=([\d.]+)[AV]\s*$")
_BOARD = "proc/device-tree/model"
#: includes Raspberry Pi 500
_WITH_CHIP = ("Raspberry Pi 5", "Raspberry Pi Compute Module 5")


class Pmic(Sensor):
    """Sum of all rails that have both voltage and current."""

    about = About(
        name="pmic",
        kind="power",
        scope="rails behind the power chip: not USB, HATs and NVMe, which the 5 V input feeds",
        # faster sampling would slow down the load that is measured
        period_s=0.1,
        gain_error=0.05,
        detail="5 % of gain error is an assumption: none is published",
    )

    def __init__(self, command: str) -> None:
        self._command = command

    def read(self) -> float:
        """Return the present watts."""
        try:
            done = subprocess.run(
                [self._command, "pmic_read_adc"],
                capture_output=True, text=True, check=True, timeout=5,
            )  # fmt: skip
        except (OSError, subprocess.SubprocessError) as error:
            raise SensorError(f"vcgencmd pmic_read_adc fails ({error}): run it by hand") from error
        return parse(done.stdout)


def parse(text: str) -> float:
    """Return the watts in the output of ``vcgencmd pmic_read_adc``.

    Raises
    ------
    SensorError
        If no rail has both a voltage and a current.
    """
    by_rail: dict[str, dict[str, float]] = {}
    for line in text.splitlines():
        form = _LINE.match(line)
        if form:
            by_rail.setdefault(form[1], {})[form[2]] = float(form[3])
    rails = [rail["A"] * rail["V"] for rail in by_rail.values() if len(rail) == 2]
    if not rails:
        raise SensorError("vcgencmd pmic_read_adc tells no rail's voltage and current")
    return sum(rails)


def vcgencmd(root: Path) -> str | None:
    """Return the path of the command; None if it is absent."""
    if root == ROOT:
        return shutil.which("vcgencmd")
    command = root / "usr/bin/vcgencmd"
    return str(command) if command.exists() else None


def find(root: Path) -> tuple[list[Sensor], list[Missing]]:
    """Find the chip; earlier boards do not measure current."""
    board = read_text(root / _BOARD).rstrip("\0")
    has_chip = any(name in board for name in _WITH_CHIP)
    if "Raspberry Pi" in board and not has_chip:
        remedy = "wire an INA226 in the 5 V line, or a meter that exports CSV (profile trace)"
        return [], [Missing("PMIC", f"{board} measures no current", remedy)]
    command = vcgencmd(root)
    if command is None:
        return [], [Missing("PMIC", "there is no vcgencmd", "only Raspberry Pi 5 has this chip")]
    sensor = Pmic(command)
    try:
        sensor.read()
    except SensorError as error:
        remedy = "only Raspberry Pi 5 has this chip"
        if has_chip:
            remedy = "run with sudo, or join the group video"
        return [], [Missing("PMIC", str(error), remedy)]
    return [sensor], []
