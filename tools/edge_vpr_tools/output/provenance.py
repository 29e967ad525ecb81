"""What a run was: command, settings, versions, machine, and the files it read."""

from __future__ import annotations

import datetime
import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from edge_vpr.archive import damaged, replacing
from edge_vpr.errors import MapError

#: longer files are told by their size and beginning: hashing 3 GB takes longer than mapping them
_HASHED_BYTES = 64 << 20


def run_record(settings: Mapping[str, Any], inputs: Iterable[str | Path]) -> dict[str, Any]:
    """Describe this run, for `run.json`.

    Parameters
    ----------
    settings : mapping
    inputs : iterable of path
        Files or folders that were read.

    Returns
    -------
    dict
        Values that JSON can hold.
    """
    return {
        "schema": 1,
        "command": sys.argv,
        "finished_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "settings": dict(settings),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("edge-vpr", "numpy", "numba")},
        },
        "machine": {"system": platform.platform(), "processor": processor_name()},
        "inputs": [_file_record(file) for path in inputs for file in _files(Path(path))],
    }


def processor_name() -> str:
    """Name the processor as the system does."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition(":")
            # "Model" is how a Raspberry Pi names its board
            if key.strip() in ("model name", "Model"):
                return value.strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as indented JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")


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


def _file_record(path: Path) -> dict[str, Any]:
    size = path.stat().st_size
    with path.open("rb") as file:
        digest = hashlib.sha256(file.read(_HASHED_BYTES)).hexdigest()
    covers = "file" if size <= _HASHED_BYTES else f"first {_HASHED_BYTES} bytes"
    return {"path": str(path), "bytes": size, "sha256": digest, "sha256_of": covers}
