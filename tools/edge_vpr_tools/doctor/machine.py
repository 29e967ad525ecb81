"""Check this machine: processor, memory, clock, serial ports, power sensors."""

from __future__ import annotations

import getpass
import grp
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from serial.tools import list_ports

from edge_vpr.errors import printable
from edge_vpr_tools.doctor.finding import Finding
from edge_vpr_tools.energy.conditions import Conditions
from edge_vpr_tools.energy.sensors.search import find_sensors
from edge_vpr_tools.energy.sensors.sensor import ROOT
from edge_vpr_tools.output.provenance import processor_name

#: a live run needs about 180 MB (`tools/bench/soak.py`), and so does a map of any recording
_NEEDED_BYTES = 256 << 20
#: `map` stores the images of all windows in a temporary file of at most 2 GiB, or reads twice
_TEMPORARY_BYTES = 2 << 30


def check_processor(root: Path = ROOT) -> Iterator[Finding]:
    """Check for conditions that may slow the processor down."""
    conditions = Conditions.now(root)
    what = f"{processor_name()}, {os.cpu_count()} cores, {conditions}"
    if conditions.faults:
        remedy = "give the board a better supply or more cooling"
        yield Finding("processor", "wrong", f"{what}: {', '.join(conditions.faults)}", remedy)
    elif conditions.governor not in (None, "performance"):
        remedy = "before edge-vpr profile: sudo cpupower frequency-set -g performance"
        yield Finding("processor", "good", what, remedy)
    else:
        yield Finding("processor", "good", what)


def check_memory(root: Path = ROOT) -> Iterator[Finding]:
    """Check free memory, and free space for temporary files."""
    free = _available_bytes(root)
    if free is not None and free < _NEEDED_BYTES:
        yield Finding(
            "memory",
            "wrong",
            f"{free >> 20} MiB are free, a live run takes up to {_NEEDED_BYTES >> 20} MiB",
            "end other programs, or add swap",
        )
    elif free is not None:
        yield Finding("memory", "good", f"{free >> 20:,} MiB free")
    folder = tempfile.gettempdir()
    space = shutil.disk_usage(folder).free
    text = f"{folder}: {space >> 20:,} MiB free"
    if space < _TEMPORARY_BYTES:
        yield Finding(
            "temporary files",
            "absent",
            f"{text}; maps of long drives then read their recording twice",
            "set TMPDIR to a folder with 2 GiB",
        )
    else:
        yield Finding("temporary files", "good", text)


def check_clock() -> Iterator[Finding]:
    """Check whether the clock follows a time server, which ground truth by GPS needs."""
    command = shutil.which("timedatectl")
    if command is None:
        yield Finding("clock", "absent", "timedatectl is not here, so nobody knows if it is right")
        return
    try:
        said = subprocess.run(
            [command, "show", "--property=NTPSynchronized", "--value"],
            capture_output=True, text=True, timeout=10, check=False,
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        said = ""
    if said == "yes":
        yield Finding("clock", "good", "follows a time server")
    else:
        yield Finding(
            "clock",
            "absent",
            "does not follow a time server: a recording and a GPS log of this machine may be apart",
            "sudo timedatectl set-ntp true, or give evaluate an --offset",
        )


def check_ports() -> Iterator[Finding]:
    """Check whether this user may open each serial port."""
    ports = sorted(list_ports.comports())
    for port in ports:
        name = printable(port.device)
        if os.access(port.device, os.R_OK | os.W_OK):
            yield Finding("serial ports", "good", f"{name}: may be opened")
        else:
            yield Finding(
                "serial ports",
                # a port of the board itself is not necessarily that of the camera
                "absent" if port.vid is None else "wrong",
                f"{name}: {getpass.getuser()} may not open it",
                f"sudo usermod -aG {_group_of(port.device)} {getpass.getuser()}, then log in again",
            )
    if not ports:
        remedy = "edge-vpr bridge RECORDING makes a virtual one"
        yield Finding("serial ports", "absent", "none", remedy)


def check_sensors(root: Path = ROOT) -> Iterator[Finding]:
    """Search for power sensors, with which `profile` measures joules."""
    sensors, missing = find_sensors(root)
    for sensor in sensors:
        yield Finding("power sensors", "good", printable(str(sensor)))
        sensor.close()
    for absent in missing:
        yield Finding("power sensors", "absent", printable(str(absent)))
    if not sensors:
        remedy = "give profile a --meter-port, or add a meter's trace with profile trace"
        yield Finding("power sensors", "absent", "none", remedy)


def _available_bytes(root: Path) -> int | None:
    try:
        for line in (root / "proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None


def _group_of(device: str) -> str:
    try:
        return grp.getgrgid(Path(device).stat().st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"
