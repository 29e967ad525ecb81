"""Power monitors as the kernel shows them, by umockdev, to the command as it is."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest
from edge_vpr_tools.cli import main

from tests.tools.test_commands import drive  # noqa: F401

UMOCKDEV = shutil.which("umockdev-run")
pytestmark = pytest.mark.skipif(
    UMOCKDEV is None, reason="umockdev-run is not installed (Debian's package umockdev)"
)

#: an INA226 behind a Raspberry Pi's 5 V line, and a Jetson's INA3221, whose third channel is off
DEVICES = r"""P: /devices/platform/soc/fe804000.i2c/i2c-1/1-0040/hwmon/hwmon5
E: SUBSYSTEM=hwmon
A: name=ina226\n
A: power1_input=2500000\n
A: in1_input=5000\n
A: curr1_input=500\n
A: shunt_resistor=10000\n
A: update_interval=36\n

P: /devices/platform/c240000.i2c/i2c-1/1-0041/hwmon/hwmon6
E: SUBSYSTEM=hwmon
A: name=ina3221\n
A: in1_label=VDD_CPU_GPU_CV\n
A: in1_enable=1\n
A: in1_input=5000\n
A: curr1_input=300\n
A: shunt1_resistor=5000\n
A: in2_label=VDD_IN\n
A: in2_enable=1\n
A: in2_input=5000\n
A: curr2_input=800\n
A: shunt2_resistor=5000\n
A: in3_label=VDD_SOC\n
A: in3_enable=0\n
A: in3_input=0\n
A: curr3_input=0\n
A: update_interval=100\n
"""


@pytest.mark.parametrize(
    ("flags", "name", "scope", "watts"),
    [
        ([], "ina3221@hwmon6/VDD_IN", "whole board", 4.0),
        (["--sensor-name", "ina226@hwmon5"], "ina226@hwmon5", "what its shunt is wired to", 2.5),
        (
            ["--sensor-name", "ina226@hwmon5", "--shunt-mohm", "100"],
            "ina226@hwmon5", "what its shunt is wired to", 0.25,
        ),
    ],
    ids=["the whole board first", "by name", "by name, shunt confirmed"],
)  # fmt: skip
def test_the_command_finds_and_reads_a_power_monitor(drive, tmp_path, flags, name, scope, watts):  # noqa: F811
    """Steady power: the board at rest is measured, and the load's energy is not resolved."""
    devices = tmp_path / "monitors.umockdev"
    devices.write_text(DEVICES)
    assert UMOCKDEV is not None
    load = ["--map", str(drive / "map.npz"), "--recording", str(drive / "query.npz")]
    done = subprocess.run(
        [UMOCKDEV, "-d", devices, "--", sys.executable, "-m", "edge_vpr_tools.cli", "profile",
         "--quick", "--window-s", "0.1", *load, *flags, "-o", tmp_path / "out"],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    energy = json.loads((tmp_path / "out/profile.json").read_text())["energy"]
    assert (energy["sensor"]["name"], energy["sensor"]["scope"]) == (name, scope)
    figures = energy["figures"]
    assert figures["idle_w"] == pytest.approx(watts) and figures["load_w"] == pytest.approx(watts)
    assert figures["marginal_j_per_match"] is None
    assert name in done.stdout


def test_without_it_this_machine_has_no_such_monitor(drive, tmp_path):  # noqa: F811
    """What the other test finds is umockdev's."""
    load = ["--map", str(drive / "map.npz"), "--recording", str(drive / "query.npz")]
    flags = ["--quick", "--window-s", "0.1", "--sensor-name", "ina226@hwmon5"]
    assert main(["profile", *load, *flags, "-o", str(tmp_path / "out")]) == 2
