"""Results: folders that are written whole or not at all, records in JSON, provenance."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import platform
import types
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from edge_vpr.errors import EdgeVprError, UsageError, printable
from edge_vpr.files import (
    check_new_file,
    open_input,
    read_json,
    replacing,
    replacing_folder,
)
from edge_vpr.run_log import command_line, warnings_so_far

# Folders of results, which are written whole or not at all.


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


# Conversion of frozen dataclasses to and from JSON, with all checks of such files.
#
# The names of the fields are the names in the file. Fields that the class does not have are
# ignored, so that a file of a newer version with the same schema can be read.
#
# msgspec reads most of these records equally, and faster. It refuses a union of two dataclasses and
# has named tuples as lists, both of which profiles need; it cannot leave out fields of dataclasses
# that are None, so that writing would stay as it is; and its errors do not contain the value.


T = TypeVar("T")

#: metadata of a field that is not written while it is None
LEFT_OUT: Mapping[str, bool] = {"left_out": True}
_NUMBERS = {float: "a number", int: "an integer", str: "text", bool: "true or false"}


class RecordError(EdgeVprError):
    """Values from a file do not fit the expected record."""


def read_record(kind: type[T], path: Path, what: str, remedy: str) -> T:
    """Read a record from a JSON file; see `from_json` and `edge_vpr.files.read_json`.

    Raises
    ------
    UsageError
        If the file cannot be read, or a field of it is missing or of a wrong type.
    """
    try:
        return from_json(kind, read_json(path, what, remedy))
    except RecordError as error:
        raise UsageError(
            f"cannot read {what} from {path}: {printable(error, 200)}: {remedy}"
        ) from error


def read_run(folder: Path) -> RunRecord:
    """Read the record of the run that wrote a folder of results."""
    return read_record(RunRecord, folder / RUN, "the run", "match again")


def to_json(value: Any) -> Any:
    """Return a record as values that JSON can hold.

    Parameters
    ----------
    value : object
        A dataclass, a named tuple, or a sequence or mapping of them.

    Returns
    -------
    object
        Dictionaries, lists and plain values; None for a number that is not finite.
    """
    if is_dataclass(value) and not isinstance(value, type):
        named = ((each, getattr(value, each.name)) for each in fields(value))
        return {
            each.name: to_json(one)
            for each, one in named if one is not None or not each.metadata.get("left_out")
        }  # fmt: skip
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: to_json(one) for name, one in value._asdict().items()}
    if isinstance(value, Mapping):
        return {name: to_json(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(value: Any, indent: int | None = None) -> str:
    """Return a record as the text of a JSON file; numbers that are not finite are null."""
    return json.dumps(to_json(value), indent=indent, allow_nan=False)


def from_json(kind: type[T], value: object, where: str = "") -> T:
    """Build a record from values of JSON.

    Parameters
    ----------
    kind : type
        A dataclass or a named tuple of plain values, tuples, mappings by name, and records.
    value : object
        As read, and not trusted.
    where : str
        Names of the fields that lead to it, for the message.

    Raises
    ------
    RecordError
        If a field is missing, or is not of its type.
    """
    values = _names(value, where)
    record: Any = kind
    by_field = {}
    for name, hint in _hints(record).items():
        if name in values:
            by_field[name] = _value(hint, values[name], f"{where}.{name}" if where else name)
        elif name not in _defaults(record):
            raise RecordError(f"{where or 'the file'} lacks {name}")
    return kind(**by_field)


@cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind)


@cache
def _defaults(kind: Any) -> frozenset[str]:
    if not is_dataclass(kind):
        return frozenset(kind._field_defaults)
    return frozenset(
        field.name for field in fields(kind)
        if field.default is not MISSING or field.default_factory is not MISSING
    )  # fmt: skip


def _value(hint: Any, value: object, where: str) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _any_of(arguments, value, where)
    if origin is Literal:
        if value not in arguments:
            raise RecordError(f"{where} is {value!r}: expected one of {', '.join(arguments)}")
        return value
    if origin is tuple:
        return _sequence(arguments, value, where)
    if origin is not None and issubclass(origin, Mapping):
        return {
            name: _value(arguments[1], one, f"{where}.{name}")
            for name, one in _names(value, where).items()
        }
    if hint is Any:
        return value
    if hint in _NUMBERS:
        # some programs write 1.0 as 1; true and false are not numbers
        fits = isinstance(value, int | float if hint is float else hint)
        if not fits or (isinstance(value, bool) and hint is not bool):
            raise RecordError(f"{where} is {value!r}: expected {_NUMBERS[hint]}")
        try:
            return hint(value)
        except OverflowError:
            raise RecordError(f"{where} is {value!r}: expected a smaller number") from None
    return value if isinstance(value, hint) else from_json(hint, value, where)


def _any_of(kinds: tuple[Any, ...], value: object, where: str) -> Any:
    """Return the value as the first kind that it fits; the error is that of the last one."""
    if value is None and types.NoneType in kinds:
        return None
    *others, last = (kind for kind in kinds if kind is not types.NoneType)
    for kind in others:
        try:
            return _value(kind, value, where)
        except RecordError:
            continue
    return _value(last, value, where)


def _sequence(kinds: tuple[Any, ...], value: object, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise RecordError(f"{where} is {value!r}: expected a list")
    if kinds[1:] == (...,):
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise RecordError(f"{where} has {len(value)} values: expected {len(kinds)}")
    return tuple(
        _value(kind, one, f"{where}[{i}]")
        for i, (kind, one) in enumerate(zip(kinds, value, strict=True))
    )


def _names(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RecordError(
            f"{where or 'the file'} holds a {type(value).__name__}: expected names and values"
        )
    return value


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


def write_json(path: Path, values: object) -> None:
    """Write a record, or values by name, as indented JSON, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(json_text(values, indent=2) + "\n", encoding="utf-8")


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def hash_input(path: Path) -> InputFile:
    """Return the size and hash of a file."""
    size = path.stat().st_size
    with open_input(path) as file:
        digest = hashlib.sha256(file.read(_HASHED_BYTES)).hexdigest()
    covers = "file" if size <= _HASHED_BYTES else f"first {_HASHED_BYTES} bytes"
    return InputFile(str(path), size, digest, covers)
