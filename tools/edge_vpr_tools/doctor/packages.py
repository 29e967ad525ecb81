"""Check Python, the required libraries, and the optional ones."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution, version

from packaging.requirements import Requirement

from edge_vpr import __version__
from edge_vpr.errors import install_command
from edge_vpr_tools.doctor.finding import Finding

#: extras for users; the others are for work on edge-vpr itself
EXTRAS = {
    "aedat4": "AEDAT 4 recordings",
    "parquet": "Parquet recordings",
    "hdf5": "HDF5 recordings",
    "ros": "ROS bags",
    "es": "event-stream recordings",
    "tonic": "data sets by tonic",
    "firmware": "compiling and emulating the reference firmware",
    "mqtt": "stream --mqtt",
    "rerun": "the viewer of stream --rerun",
}
#: extras that cannot be installed on a processor, and why
NO_WHEELS = {
    ("tonic", "aarch64"): "tonic needs expelliarmus, which has no wheel for aarch64; "
    "edge_vpr.datasets.published_drives reads the same files without it"
}


def check_versions() -> Iterator[Finding]:
    """Compare the versions of Python and the libraries with the requirements of edge-vpr."""
    needed = [Requirement(text) for text in distribution("edge-vpr").requires or ()]
    found = [f"edge-vpr {__version__}", f"Python {platform.python_version()}"]
    for requirement in needed:
        if requirement.marker is not None:  # required by an extra
            continue
        installed = _installed(requirement)
        if installed is None or not requirement.specifier.contains(installed, prereleases=True):
            yield Finding(
                "versions",
                "wrong",
                f"{requirement.name} is {installed or 'missing'}, needed is {requirement}",
                f"{sys.executable} -m pip install '{requirement}'",
            )
        else:
            found.append(f"{requirement.name} {installed}")
    yield Finding("versions", "good", ", ".join(found))


def check_extras() -> Iterator[Finding]:
    """Check for the libraries of each extra for users."""
    needed = [Requirement(text) for text in distribution("edge-vpr").requires or ()]
    for extra, what in EXTRAS.items():
        missing = [
            requirement.name
            for requirement in needed
            if requirement.marker is not None
            and requirement.marker.evaluate({"extra": extra})
            and not requirement.marker.evaluate({"extra": ""})
            and _installed(requirement) is None
        ]
        reason = NO_WHEELS.get((extra, platform.machine()))
        if missing and reason is not None:
            yield Finding("extras", "absent", f"{what}: {reason}")
        elif missing:
            text = f"{what}: {', '.join(missing)} missing"
            yield Finding("extras", "absent", text, install_command(extra))
        else:
            yield Finding("extras", "good", what)


def _installed(requirement: Requirement) -> str | None:
    try:
        return version(requirement.name)
    except PackageNotFoundError:
        return None
