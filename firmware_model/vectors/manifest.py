"""The manifest of golden vectors, and the folder that holds them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from firmware_model.design import Design, read_file
from firmware_model.errors import VectorError

SCHEMA = 1
MANIFEST = "manifest.json"
README = "README.md"
RTL_FOLDER = "rtl"


#: of what the files hold; docs/specification.md defines each
UNITS = {
    "t, start, tau_us": "microseconds, modulo 2^timestamp_bits",
    "activity of a case, mean_activity": "1/256 event at selected pixels in a window",
    "place_activity, activity of a window": "1/16 octave: floor(16 log2(1 + events)), less the "
    "mean number's; in place_activity.mem two's complement of 8 bits",
    "weight": "1/8 of the evidence",
    "gain": "1/16 octave",
    "speed": "1/256 octave",
    "place_bias": "units of code",
    "levels, means, window_mean": "1/256 octave: round(256 log2(1 + count))",
    "restart": "whole units of cost; a device holds it times 4 (2 fraction bits)",
    "sum, second_sum": "units of code; of the filter metrics, 1/4 unit of cost (2 fraction bits)",
    "margin": "that of sum",
    "trust, support, kept": "1/16 of a metric, 1/64 unit of cost",
    "worst_residual": "that of a metric",
    "reciprocal": "1/65536 per unit of code",
    "spread": "units of code",
}


#: what every case begins with, and what is read before what
POWER_ON = (
    "each case by itself: counters, events counted and numbers of windows 0; the first window "
    "opens at start; the mean number is activity, the running means are means; the filter has "
    "seen no window and no place, and trust and residuals are 0. Memories that are written before "
    "they are read may hold anything"
)
ORDER = (
    "memories, start and activity; then events, one a line, each with its line of "
    "expected_events; a window that an event ends comes before that event by time, and behind it "
    "by count; its match comes behind the window. expected.bin has all of them in this order"
)


class FieldPlace(NamedTuple):
    """Position of a field in a packed word."""

    field: str
    lowest_bit: int
    bits: int


@dataclass(frozen=True)
class FileEntry:
    """A file of a case."""

    bytes: int
    sha256: str
    # of a memory's image: number of words, and bits of each
    words: int | None = None
    bits: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold, without those that are None."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class CaseEntry:
    """A case: its design, its contents, and its files."""

    name: str
    number: int  #: Number that stands for the case in binary results.
    start: int  #: Time at which the first window starts.
    activity: int  #: Mean activity at which the device starts.
    events: int
    windows: int
    matches: int
    design: Design
    widths: dict[str, int]  #: Bits of the device's values.
    reference_firmware: str  #: Whether the firmware in C takes the case.
    words: dict[str, tuple[FieldPlace, ...]]  #: Fields of a word of each memory's image.
    coverage: dict[str, int]  #: How often each corner is reached.
    files: dict[str, FileEntry]

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        return vars(self) | {
            "design": self.design.to_dict(),
            "words": {
                name: [place._asdict() for place in places] for name, places in self.words.items()
            },
            "files": {name: entry.to_json() for name, entry in self.files.items()},
        }


@dataclass(frozen=True)
class SuiteEntry:
    """A suite: how often its cases reach each corner, and the cases."""

    name: str
    coverage: dict[str, int]
    cases: tuple[CaseEntry, ...]


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Contents of a folder of vectors."""

    versions: dict[str, str]  #: Versions of the software that made them.
    seed: int
    corners: dict[str, str]  #: Description of each corner.
    design: Design
    rtl: tuple[str, ...]  #: Source files of the hardware core.
    suites: tuple[SuiteEntry, ...]

    def cases(self) -> Iterator[tuple[str, CaseEntry]]:
        """Yield each case with its name as ``suite/name``."""
        for suite in self.suites:
            for case in suite.cases:
                yield f"{suite.name}/{case.name}", case

    def files(self) -> list[str]:
        """Return all files of the folder as relative paths, including the manifest."""
        sources = [f"{RTL_FOLDER}/{name}" for name in self.rtl]
        return [MANIFEST, README, "design.toml", *sources] + [
            f"{place}/{name}" for place, case in self.cases() for name in case.files
        ]

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        return {
            "schema": SCHEMA,
            "kind": "golden vectors",
            "versions": self.versions,
            "seed": self.seed,
            "byte_order": "little",
            "packing": "the first field, and lane 0, in the least significant bits",
            "none": "0xFFFFFFFF in records, -1 in CSV and arrays",
            "units": UNITS,
            "power_on": POWER_ON,
            "order": ORDER,
            "corners": self.corners,
            "design": self.design.to_dict(),
            "rtl": list(self.rtl),
            "suites": [
                vars(suite) | {"cases": [case.to_json() for case in suite.cases]}
                for suite in self.suites
            ],
        }


# What a file says, read back.


def _manifest(values: Mapping[str, Any]) -> Manifest:
    return Manifest(
        versions=values["versions"],
        seed=values["seed"],
        corners=values["corners"],
        design=Design.from_dict(values["design"], "the manifest"),
        rtl=tuple(values["rtl"]),
        suites=tuple(
            SuiteEntry(**{**suite, "cases": tuple(map(_case, suite["cases"]))})
            for suite in values["suites"]
        ),
    )


def _case(values: Mapping[str, Any]) -> CaseEntry:
    words, files = values["words"].items(), values["files"].items()
    read = {
        "design": Design.from_dict(values["design"], f"case {values['name']}"),
        "words": {table: tuple(FieldPlace(**one) for one in places) for table, places in words},
        "files": {name: FileEntry(**entry) for name, entry in files},
    }
    return CaseEntry(**{**values, **read})


# A folder of golden vectors: its manifest, and its files, which are checked by their hashes.


def load_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a folder.

    Raises
    ------
    VectorError
        If the manifest is missing, of another schema, or damaged.
    """
    path = Path(folder) / MANIFEST
    try:
        values = json.loads(read_file(path))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or error
        raise VectorError(f"cannot read {path}: {reason}: name a folder of vectors") from error
    try:
        schema = values["schema"]
        manifest = _manifest(values) if schema == SCHEMA else None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise VectorError(f"{path} is damaged ({error}): make the vectors again") from error
    if manifest is None:
        raise VectorError(
            f"{path} has schema {schema!r} and this version reads {SCHEMA}: make the vectors again"
        )
    return manifest


def read_case_file(folder: Path, place: str, case: CaseEntry, name: str) -> bytes:
    """Read a file of a case, and check its hash.

    Parameters
    ----------
    folder : path
        Folder of the vectors.
    place : str
        Name of the case, as ``suite/name``.

    Raises
    ------
    VectorError
        If the file is missing or was changed.
    """
    path = folder / place / name
    try:
        data = read_file(path)
    except OSError as error:
        raise VectorError(
            f"cannot read {path}: {error.strerror}: make the vectors again"
        ) from error
    if hashlib.sha256(data).hexdigest() != case.files[name].sha256:
        raise VectorError(f"{path} was changed since it was made: make the vectors again")
    return data


def check_files(folder: str | Path) -> int:
    """Check the hash of every file of the vectors, and return the number of files.

    Raises
    ------
    VectorError
        If a file is missing or was changed.
    """
    number = 0
    for place, case in load_manifest(folder).cases():
        for name in case.files:
            read_case_file(Path(folder), place, case, name)
            number += 1
    return number
