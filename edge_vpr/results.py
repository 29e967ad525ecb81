"""Folders of results, which are written whole or not at all, and the record of their run."""

from __future__ import annotations

import datetime
import hashlib
import platform
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError
from edge_vpr.files import check_new_file, open_input, replacing_folder
from edge_vpr.records import LEFT_OUT, read_record
from edge_vpr.run_log import command_line, warnings_so_far

MAP, MATCHES, MATCHES_CSV, QUERIES = "map.npz", "matches.npz", "matches.csv", "queries.npz"
QUERIES_KIND = "set of query descriptors"
#: windows of a drive that was matched event by event, for its report alone
WINDOWS = "windows.npz"
_SUFFIXES = (".npz", ".csv", ".json", ".md", ".tex", ".png", ".pdf", ".svg", ".html")
RUN, METRICS, REPORT = "run.json", "metrics.json", "report.html"


def check_output_folder(
    path: Path, overwrite: bool, inputs: Iterable[str | Path | None] = ()
) -> None:
    """Check that a folder can be written, before any work is done.

    Parameters
    ----------
    overwrite : bool
        Whether an existing folder may be replaced.
    inputs : iterable of path or None
        What the run reads, see `check_output`; None is not given.

    Raises
    ------
    UsageError
        If it exists and may not be replaced, does not look like one of ours, or an input would be
        lost.
    """
    check_new_file(path, inputs, overwrite)
    if not path.exists():
        return
    ours = path.is_dir() and (not any(path.iterdir()) or (path / RUN).is_file())
    if not ours:
        raise UsageError(
            f"output {path} is not a folder of edge-vpr's results (no {RUN} in it), so that it is "
            "not replaced: name another one"
        )
    foreign = sorted(
        file.name for file in path.iterdir() if not (file.is_file() and file.suffix in _SUFFIXES)
    )
    if foreign:
        raise UsageError(
            f"output {path} also holds {foreign[0]!r}, which is not ours to delete: move it away, "
            "or name another folder"
        )


@contextmanager
def results_folder(
    path: Path, overwrite: bool, inputs: Iterable[str | Path | None] = ()
) -> Iterator[Path]:
    """Yield an empty folder that becomes `path` if the block succeeds, see `replacing_folder`."""
    check_output_folder(path, overwrite, inputs)
    with replacing_folder(path, overwrite) as folder:
        yield folder


# The record of a run: command, settings, versions, machine, and the files it read.


#: longer files are identified by size and beginning: hashing 3 GB takes longer than mapping them
_HASHED_BYTES = 64 << 20


@dataclass(frozen=True)
class Machine:
    """The operating system, and the processor as the system names it."""

    system: str
    processor: str


@dataclass(frozen=True)
class InputFile:
    """A file that was read, with its hash."""

    path: str
    bytes: int
    sha256: str  #: Of what `sha256_of` says: ``file``, or its first bytes.
    sha256_of: str  #: ``file``, or the number of its first bytes that were hashed.


@dataclass(frozen=True)
class RemovedEvents:
    """Numbers of events that cleaning removed from a recording."""

    events_read: int
    burst_events: int
    burst_share: float
    hot_pixels: int


@dataclass(frozen=True)
class RunRecord:
    """The record of a run, stored as `run.json`."""

    schema: int
    command: tuple[str, ...]
    finished_utc: str  #: ISO 8601.
    settings: Mapping[str, Any]  #: Plain values by name.
    versions: dict[str, str]  #: Of Python and the libraries that compute.
    machine: Machine
    inputs: tuple[InputFile, ...]
    #: None where the run cleaned no recording.
    removed: RemovedEvents | None = field(default=None, metadata=LEFT_OUT)
    #: Printed before the record was written; None if there were none.
    warnings: tuple[str, ...] | None = field(default=None, metadata=LEFT_OUT)
    #: Where the part that was read (--start) begins in the recording, in microseconds; None if 0.
    start_us: int | None = field(default=None, metadata=LEFT_OUT)
    #: Start of the recording, where its clock counts from 1970, in microseconds; None if not.
    clock_us: int | None = field(default=None, metadata=LEFT_OUT)


def run_record(
    settings: Mapping[str, Any],
    inputs: Iterable[str | Path],
    removed: RemovedEvents | None = None,
    start_us: int = 0,
    clock_us: int = 0,
) -> RunRecord:
    """Describe this run, for `run.json`.

    Parameters
    ----------
    settings : mapping
        Plain values by name.
    inputs : iterable of path
        Files or folders that were read.
    removed : RemovedEvents, optional
        By cleaning.
    start_us : int
        Where the part that was read begins in the recording.
    clock_us : int
        Start of the recording, where its clock counts from 1970; else 0.
    """
    versions = {"python": platform.python_version()}
    versions |= {name: version(name) for name in ("edge-vpr", "numpy", "numba")}
    return RunRecord(
        schema=1,
        command=command_line(),
        finished_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        settings=dict(settings),
        versions=versions,
        machine=Machine(platform.platform(), processor_name()),
        inputs=tuple(hash_input(file) for path in inputs for file in _files(Path(path))),
        removed=removed,
        warnings=warnings_so_far() or None,
        start_us=start_us or None,
        clock_us=clock_us or None,
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


def read_run(folder: Path) -> RunRecord:
    """Read the record of the run that wrote a folder of results."""
    return read_record(RunRecord, folder / RUN, "the run", "match again")


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def hash_input(path: Path) -> InputFile:
    """Return the size and hash of a file."""
    size = path.stat().st_size
    with open_input(path) as file:
        digest = hashlib.sha256(file.read(_HASHED_BYTES)).hexdigest()
    covers = "file" if size <= _HASHED_BYTES else f"first {_HASHED_BYTES} bytes"
    return InputFile(str(path), size, digest, covers)
