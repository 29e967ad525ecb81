"""Checks of this machine: libraries, kernels, processor, clock, ports, sensors."""

from __future__ import annotations

import getpass
import grp
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from textwrap import wrap
from typing import Literal, NamedTuple

from packaging.requirements import Requirement
from serial.tools import list_ports

from edge_vpr import __version__
from edge_vpr.errors import install_command, printable
from edge_vpr.online.kernels import process_events
from edge_vpr.results import processor_name
from edge_vpr_tools.profile.conditions import Conditions
from edge_vpr_tools.profile.sensors.search import find_sensors
from edge_vpr_tools.profile.sensors.sensor import ROOT

#: "absent": an extra or a device is missing; "wrong": something will fail or mislead
State = Literal["good", "absent", "wrong"]


class Found(NamedTuple):
    """Finding of a check."""

    state: State
    text: str
    remedy: str = ""  #: Remedy for the user; empty if none is needed.


@dataclass(frozen=True)
class Finding:
    """A finding, and the topic of its check."""

    topic: str
    state: State
    text: str
    remedy: str


# Check where compiled kernels are stored.


def _cache_folder() -> Path | None:
    """Return the folder in which the main kernel of live runs is kept; None if there is none."""
    path = process_events.stats.cache_path
    return None if path is None else Path(path)


def check_kernels() -> Iterator[Found]:
    """Find out whether compiled kernels can be stored, and whether a live run has stored some."""
    folder = _cache_folder()
    if folder is None:
        remedy = "set NUMBA_CACHE_DIR to a folder that this user may write"
        yield Found("wrong", "there is no folder where they may be kept", remedy)
    elif any(folder.glob(f"kernels.{process_events.__name__}-*.nbi")):
        yield Found("good", f"kept in {folder}")
    else:
        yield Found("absent", f"none in {folder} yet: the first run takes longer")


# Check this machine: processor, memory, clock, serial ports, power sensors.


#: a live run needs about 180 MB (`tools/bench/soak.py`), and mapping any recording not more
_NEEDED_BYTES = 256 << 20
#: `map` stores the images of all windows in a temporary file of at most 2 GiB, or reads twice
_TEMPORARY_BYTES = 2 << 30


def check_processor(root: Path = ROOT) -> Iterator[Found]:
    """Check for conditions that may slow the processor down."""
    conditions = Conditions.now(root)
    what = f"{processor_name()}, {os.cpu_count()} cores, {conditions}"
    if conditions.faults:
        remedy = "give the board a better supply or more cooling"
        yield Found("wrong", f"{what}: {', '.join(conditions.faults)}", remedy)
    elif conditions.governor not in (None, "performance"):
        remedy = "before edge-vpr profile: sudo cpupower frequency-set -g performance"
        yield Found("good", what, remedy)
    else:
        yield Found("good", what)


def check_memory(root: Path = ROOT) -> Iterator[Found]:
    """Check free memory."""
    free = _available_bytes(root)
    if free is not None and free < _NEEDED_BYTES:
        text = f"{free >> 20} MiB are free, a live run takes up to {_NEEDED_BYTES >> 20} MiB"
        yield Found("wrong", text, "end other programs, or add swap")
    elif free is not None:
        yield Found("good", f"{free >> 20:,} MiB free")


def check_temporary_files() -> Iterator[Found]:
    """Check free space for temporary files."""
    folder = tempfile.gettempdir()
    space = shutil.disk_usage(folder).free
    text = f"{folder}: {space >> 20:,} MiB free"
    if space < _TEMPORARY_BYTES:
        text = f"{text}; maps of long drives then read their recording twice"
        yield Found("absent", text, "set TMPDIR to a folder with 2 GiB")
    else:
        yield Found("good", text)


def check_clock() -> Iterator[Found]:
    """Check whether the clock follows a time server, which ground truth by GPS needs."""
    command = shutil.which("timedatectl")
    if command is None:
        yield Found("absent", "timedatectl is not here, so nobody knows if it is right")
        return
    try:
        said = subprocess.run(
            [command, "show", "--property=NTPSynchronized", "--value"],
            capture_output=True, text=True, timeout=10, check=False,
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        said = ""
    if said == "yes":
        yield Found("good", "follows a time server")
    else:
        yield Found(
            "absent",
            "does not follow a time server: a recording and a GPS log of this machine may be apart",
            "sudo timedatectl set-ntp true, or give evaluate an --offset",
        )


def check_ports() -> Iterator[Found]:
    """Check whether this user may open each serial port."""
    ports = sorted(list_ports.comports())
    for port in ports:
        name = printable(port.device)
        if os.access(port.device, os.R_OK | os.W_OK):
            yield Found("good", f"{name}: may be opened")
        else:
            yield Found(
                # a port of the board itself is not necessarily that of the camera
                "absent" if port.vid is None else "wrong",
                f"{name}: {getpass.getuser()} may not open it",
                f"sudo usermod -aG {_group_of(port.device)} {getpass.getuser()}, then log in again",
            )
    if not ports:
        yield Found("absent", "none", "edge-vpr bridge RECORDING makes a virtual one")


def check_sensors(root: Path = ROOT) -> Iterator[Found]:
    """Search for power sensors, with which `profile` measures joules."""
    sensors, _ = find_sensors(root)
    for sensor in sensors:
        yield Found("good", printable(str(sensor)))
        sensor.close()
    if not sensors:
        remedy = "edge-vpr profile says what to connect; profile trace adds the CSV of any meter"
        yield Found("absent", "none", remedy)


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


# Check Python, the required libraries, and the optional ones.


#: extras for users
EXTRAS = {
    "aedat4": "AEDAT 4 recordings",
    "parquet": "Parquet recordings",
    "hdf5": "HDF5 recordings",
    "hdf5-filters": "HDF5 recordings compressed by Blosc (DSEC)",
    "ros": "ROS bags",
    "tonic": "data sets by tonic",
    "firmware": "compiling and emulating the reference firmware",
    "pandas": "tables of matches (Matches.to_frame)",
    "dask": "sweep --scheduler",
    "hardware": "placing the hardware core on an ECP5, and its bench in Python",
}
#: extras for work on edge-vpr, and those that only gather others
NOT_CHECKED = ("formats", "docs", "test", "bench", "lab", "torch")
#: extras that cannot be installed on a processor, and why
NO_WHEELS = {
    ("tonic", "aarch64"): "tonic needs expelliarmus, which has no wheel for aarch64; "
    "lab.datasets reads the same files without it",
}


def check_versions() -> Iterator[Found]:
    """Compare the versions of Python and the libraries with the requirements of edge-vpr."""
    unfit = [requirement for requirement in _needed() if not _is_fit(requirement)]
    for one in unfit:
        text = f"{one.name} is {_installed(one.name) or 'missing'}, needed is {one}"
        yield Found("wrong", text, f"{sys.executable} -m pip install '{one}'")
    fast = ", ".join(f"{name} {_installed(name)}" for name in ("numba", "numpy"))
    text = f"edge-vpr {__version__}, Python {platform.python_version()}, {fast}"
    yield Found("good", text if unfit else f"{text}, and all else that is required")


def check_extras() -> Iterator[Found]:
    """Check for the libraries of the extras for users."""
    here, old, missing = [], [], []
    for extra, what in EXTRAS.items():
        unfit = [one for one in _needed(extra) if not _is_fit(one)]
        reason = NO_WHEELS.get((extra, platform.machine()))
        if not unfit:
            here.append(extra)
        elif reason is not None:
            yield Found("absent", f"{what}: {reason}")
        else:
            missing.append(extra)
            old += [
                f"{one.name} is {_installed(one.name)}, needed is {one.specifier}"
                for one in unfit
                if _installed(one.name)
            ]
    if here:
        yield Found("good", f"installed: {', '.join(here)}")
    if missing:
        what = ", ".join(f"{extra} ({EXTRAS[extra]})" for extra in missing)
        text = "; ".join([f"not installed: {what}", *old])
        yield Found("absent", text, install_command(",".join(missing)))


def _needed(extra: str = "") -> list[Requirement]:
    """Return what edge-vpr requires, or what an extra adds to it."""
    every = [Requirement(text) for text in distribution("edge-vpr").requires or ()]
    return [one for one in every if _applies(one, extra) and not (extra and _applies(one, ""))]


def _applies(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


def _is_fit(requirement: Requirement) -> bool:
    """Return whether a library is installed in a version that the requirement allows."""
    installed = _installed(requirement.name)
    return installed is not None and requirement.specifier.contains(installed, prereleases=True)


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


# Run all checks, and format their findings.


_MARKS = {"good": "ok", "absent": "--", "wrong": "!!"}
#: Of a line.
_WIDTH = 110


#: checks by their topic
CHECKS: Mapping[str, Callable[[], Iterable[Found]]] = {
    "versions": check_versions,
    "extras": check_extras,
    "compiled kernels": check_kernels,
    "processor": check_processor,
    "memory": check_memory,
    "temporary files": check_temporary_files,
    "clock": check_clock,
    "serial ports": check_ports,
    "power sensors": check_sensors,
}


def examine(checks: Mapping[str, Callable[[], Iterable[Found]]] | None = None) -> list[Finding]:
    """Run every check on this machine; one that fails is a finding, and the others go on."""
    findings = []
    for topic, check in (CHECKS if checks is None else checks).items():
        try:
            # those that were found before a failure stay
            for found in check():
                findings.append(Finding(topic, *found))
        except Exception as error:
            text = f"the check fails: {type(error).__name__}: {printable(str(error), 200)}"
            remedy = "please report it, with edge-vpr doctor --json"
            findings.append(Finding(topic, "wrong", text, remedy))
    return findings


def as_text(findings: Sequence[Finding]) -> str:
    """Format findings as lines: a mark, the topic, what was found, and the remedy."""
    width = max((len(finding.topic) for finding in findings), default=0)
    lines = []
    for finding in findings:
        head = f"{_MARKS[finding.state]}  {finding.topic:<{width}}  "
        under = " " * len(head)
        for text in filter(None, (finding.text, finding.remedy)):
            # paths and commands stay whole, so that they can be copied
            lines += wrap(
                text, _WIDTH, initial_indent=head, subsequent_indent=under,
                break_long_words=False, break_on_hyphens=False,
            )  # fmt: skip
            head = under
    return "\n".join(lines)
