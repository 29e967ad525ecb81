"""Facts of this machine: libraries, kernels, processor, memory, clock, serial ports, sensors."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

from packaging.requirements import Requirement
from serial.tools import list_ports

from edge_vpr import __version__
from edge_vpr.errors import printable
from edge_vpr.online.kernels import process_events
from edge_vpr.results import processor_name
from edge_vpr_tools.profile.conditions import Conditions
from edge_vpr_tools.profile.sensors.search import find_sensors

#: what a live run takes at most (`tools/bench/soak.py`), and `map` of a long drive in one pass
LIVE_MIB, TEMPORARY_MIB = 256, 2_048


def versions() -> str:
    """Return the versions of edge-vpr and Python, and which requirements are not met."""
    unmet = list(map(str, _unmet()))
    needs = f"needs {', '.join(unmet)}" if unmet else "has all that it requires"
    fast = ", ".join(f"{name} {version(name)}" for name in ("numba", "numpy"))
    return f"edge-vpr {__version__} {needs}; Python {platform.python_version()}, {fast}"


def extras() -> str:
    """Return which extras are installed, and which are not."""
    named = sorted(distribution("edge-vpr").metadata.get_all("Provides-Extra") or ())
    absent = [extra for extra in named if any(_unmet(extra))]
    here = [extra for extra in named if extra not in absent]
    return f"{', '.join(here) or 'none'}; not installed: {', '.join(absent) or 'none'}"


def _unmet(extra: str = "") -> Iterable[Requirement]:
    """Yield the requirements, of edge-vpr or of an extra, that no installed library meets."""
    for requirement in map(Requirement, distribution("edge-vpr").requires or ()):
        marker = requirement.marker
        if extra != "" if marker is None else not marker.evaluate({"extra": extra}):
            continue
        if requirement.name == "edge-vpr":  # an extra that gathers others
            for gathered in requirement.extras:
                yield from _unmet(gathered)
        elif not _is_met(requirement):
            yield requirement


def _is_met(requirement: Requirement) -> bool:
    try:
        return requirement.specifier.contains(version(requirement.name), prereleases=True)
    except PackageNotFoundError:
        return False


def kernels() -> str:
    """Return where compiled kernels are kept."""
    stats = getattr(process_events, "stats", None)  # none where NUMBA_DISABLE_JIT is set
    folder = None if stats is None else stats.cache_path
    if folder is None:
        return "compiled at each start: set NUMBA_CACHE_DIR to a folder that this user may write"
    return f"kept in {folder} and beside it"


def processor() -> str:
    """Return the processor, its conditions, and what slows it down."""
    conditions = Conditions.now()
    what = [f"{processor_name()}, {os.cpu_count()} cores", str(conditions), *conditions.faults]
    return ", ".join(what)


def memory() -> str:
    """Return the memory and the space for temporary files that are free."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    free_kib = int(dict(line.split(":") for line in lines)["MemAvailable"].split()[0])
    folder = tempfile.gettempdir()
    space_mib = shutil.disk_usage(folder).free >> 20
    return (
        f"{free_kib >> 10:,} MiB are free, of which a live run takes up to {LIVE_MIB}; "
        f"{space_mib:,} MiB in {folder}, of which a map of a long drive takes up to "
        f"{TEMPORARY_MIB:,}"
    )


def clock() -> str:
    """Return whether the clock follows a time server, which ground truth by GPS needs."""
    command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return "timedatectl does not answer, so nobody knows if it is right"
    follows = "follows" if done.stdout.strip() == "yes" else "does not follow"
    return f"{follows} a time server"


def ports() -> str:
    """Return the serial ports, and whether this user may open them."""
    names = [
        printable(port.device)
        + ("" if os.access(port.device, os.R_OK | os.W_OK) else " (not open to this user)")
        for port in sorted(list_ports.comports())
    ]
    return ", ".join(names) or "none"


def sensors() -> str:
    """Return the power sensors with which `edge-vpr profile` measures joules."""
    names = []
    for sensor in find_sensors()[0]:
        names.append(printable(str(sensor)))
        sensor.close()
    return ", ".join(names) or "none"


#: by topic
CHECKS: dict[str, Callable[[], str]] = {
    "versions": versions,
    "extras": extras,
    "kernels": kernels,
    "processor": processor,
    "memory": memory,
    "clock": clock,
    "serial ports": ports,
    "power sensors": sensors,
}


def facts() -> dict[str, str]:
    """Return what is so on this machine, by topic; a check that fails leaves the others."""
    told = {}
    for topic, check in CHECKS.items():
        try:
            told[topic] = check()
        except Exception as error:
            told[topic] = f"the check fails: {type(error).__name__}: {printable(str(error), 200)}"
    return told
