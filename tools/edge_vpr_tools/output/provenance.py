"""The record of a run: command, settings, versions, machine, and the files it read."""

from __future__ import annotations

import datetime
import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from edge_vpr.archive import damaged, replacing
from edge_vpr.errors import MapError
from edge_vpr_tools.output.json_records import LEFT_OUT, to_json

#: longer files are identified by size and beginning: hashing 3 GB takes longer than mapping them
_HASHED_BYTES = 64 << 20


@dataclass(frozen=True)
class Machine:
    """The operating system, and the processor as the system names it."""

    system: str
    processor: str


@dataclass(frozen=True)
class InputFile:
    """A file that was read, with its hash.

    Attributes
    ----------
    path : str
    bytes : int
    sha256 : str
        Of what `sha256_of` says: ``file``, or its first bytes.
    sha256_of : str
    """

    path: str
    bytes: int
    sha256: str
    sha256_of: str


@dataclass(frozen=True)
class RemovedEvents:
    """Numbers of events that cleaning removed from a recording."""

    events_read: int
    burst_events: int
    burst_share: float
    hot_pixels: int


@dataclass(frozen=True)
class RunRecord:
    """The record of a run, stored as `run.json`.

    Attributes
    ----------
    schema : int
    command : tuple of str
    finished_utc : str
        ISO 8601.
    settings : mapping
        Plain values by name.
    versions : mapping of str to str
        Of Python and the libraries that compute.
    machine : Machine
    inputs : tuple of InputFile
    removed : RemovedEvents or None
        None where the run cleaned no recording.
    """

    schema: int
    command: tuple[str, ...]
    finished_utc: str
    settings: Mapping[str, Any]
    versions: dict[str, str]
    machine: Machine
    inputs: tuple[InputFile, ...]
    removed: RemovedEvents | None = field(default=None, metadata=LEFT_OUT)


def run_record(
    settings: Mapping[str, Any], inputs: Iterable[str | Path], removed: RemovedEvents | None = None
) -> RunRecord:
    """Describe this run, for `run.json`.

    Parameters
    ----------
    settings : mapping
    inputs : iterable of path
        Files or folders that were read.
    removed : RemovedEvents, optional
        By cleaning.
    """
    versions = {"python": platform.python_version()}
    versions |= {name: version(name) for name in ("edge-vpr", "numpy", "numba")}
    return RunRecord(
        schema=1,
        command=tuple(sys.argv),
        finished_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        settings=dict(settings),
        versions=versions,
        machine=Machine(platform.platform(), processor_name()),
        inputs=tuple(_input_file(file) for path in inputs for file in _files(Path(path))),
        removed=removed,
    )


def processor_name() -> str:
    """Return the name of the processor from the system."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            # "Model" is the name of the board on a Raspberry Pi
            if key.strip() in ("model name", "Model"):
                return value.strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def write_json(path: Path, values: object) -> None:
    """Write a record, or values by name, as indented JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(to_json(values), indent=2) + "\n", encoding="utf-8")


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """Read values that `write_json` wrote.

    Raises
    ------
    MapError
        If the file is missing, or does not hold an object of JSON.
    """
    with damaged(path, remedy):
        values = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(values, dict):
            raise MapError(f"it holds a {type(values).__name__}: expected names and values")
        return values


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def _input_file(path: Path) -> InputFile:
    size = path.stat().st_size
    with path.open("rb") as file:
        digest = hashlib.sha256(file.read(_HASHED_BYTES)).hexdigest()
    covers = "file" if size <= _HASHED_BYTES else f"first {_HASHED_BYTES} bytes"
    return InputFile(str(path), size, digest, covers)
