"""Comparison of a device's results with the vectors, up to the first difference."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_model.design import read_file
from firmware_model.errors import VectorError
from firmware_model.specification import MatchResult
from firmware_model.vectors.case import KINDS, NONE, Record, from_binary
from firmware_model.vectors.manifest import load_manifest, read_case_file

COMPARED = ("event", "window", "match")
_FIELDS = {
    "event": ("number", "slot", "count"),
    "window": ("number", "events"),
    "match": MatchResult._fields,
}


@dataclass(frozen=True)
class Verdict:
    """Result of a comparison."""

    differences: list[str]  #: The first difference of each case that has one.
    compared: dict[str, int]  #: Number of equal records, by kind.
    cases: int  #: Number of cases that were returned.
    total: int  #: Number of cases of the vectors.
    missing: tuple[str, ...] = ()  #: Cases of the vectors that were not returned.


def read_results(path: str | Path) -> list[Record]:
    """Read a device's results.

    A CSV file has one record a line: ``case,corners/tie_of_two`` first, then ``event,0,3,1`` and so
    on, with the values as in ``expected_*.csv``. Any other suffix means binary: 32-bit
    little-endian words. A binary record consists of its kind (0 case, 1 event, 2 window, 3 match),
    the number of its values, and the values; the value of a case is its number in the manifest.

    Raises
    ------
    VectorError
        If the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() in (".json", ".jsonl"):
        raise VectorError(
            f"{path}: results are lines of CSV or binary records: name a .csv or .bin file"
        )
    try:
        if path.suffix.lower() != ".csv":
            return list(from_binary(read_file(path), str(path)))
        text = read_file(path).decode("ascii")
    except UnicodeDecodeError as error:
        raise VectorError(
            f"{path} holds the byte {error.object[error.start]:#x}, and results are ASCII: save "
            "them as UTF-8 without a byte order mark (in PowerShell by Out-File -Encoding ascii)"
        ) from None
    except OSError as error:
        reason = error.strerror or error
        raise VectorError(f"cannot read results from {path}: {reason}: name a file") from error
    return [
        _from_line(line, f"{path}, line {number}")
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip()
    ]


def _from_line(line: str, where: str) -> Record:
    kind, *values = (part.strip() for part in line.split(","))
    if kind not in KINDS:
        raise _no_record(line, where)
    if kind == "case":
        return f"case {','.join(values)}", ()
    try:
        if "_" not in line:
            return kind, tuple(NONE if value == "-1" else int(value) for value in values)
    except ValueError:
        pass
    raise _no_record(line, where)


def _no_record(line: str, where: str) -> VectorError:
    return VectorError(
        f"{where}: {line[:60]!r} is no record: begin each line with its kind, one of "
        f"{', '.join(KINDS)}, and then the values in integers, as in match,0,3,... (the lines of "
        "expected_*.csv lack the kind)"
    )


def verify(
    folder: str | Path,
    results: Iterable[Record],
    *,
    case: str | None = None,
    kinds: Sequence[str] = COMPARED,
) -> Verdict:
    """Compare a device's results with the vectors.

    Parameters
    ----------
    folder : path
        Folder of the vectors; the hashes of the files that are read are checked.
    case : str, optional
        Case, as ``suite/name``, of the records before the first one that names a case.
    kinds : sequence of {"event", "window", "match"}
        Kinds of records that the device returns; other kinds are neither expected nor compared.

    Raises
    ------
    VectorError
        If a record belongs to no case, or no case was returned.
    """
    folder = Path(folder)
    cases = dict(load_manifest(folder).cases())
    if not cases:
        raise VectorError(f"{folder} holds no case: write the vectors again")
    returned = _by_case(results, {one.number: name for name, one in cases.items()}, case)
    compared = dict.fromkeys(kinds, 0)
    differences = []
    for name, records in returned.items():
        if name not in cases:
            raise VectorError(
                f"results of a case {name!r}, which the vectors have not: they have for example "
                f"{next(iter(cases))!r}"
            )
        entry = cases[name]
        expected = list(from_binary(read_case_file(folder, name, entry, "expected.bin")))
        pixels = _pixels(read_case_file(folder, name, entry, "pixels.csv"))
        difference = _compare(expected, records, kinds, pixels, compared)
        if difference:
            differences.append(f"{name}: {difference}")
    if not returned:
        raise VectorError("the results are empty: expected at least one case")
    missing = tuple(name for name in cases if name not in returned)
    return Verdict(differences, compared, len(returned), len(cases), missing)


def _by_case(
    results: Iterable[Record], names: dict[int, str], case: str | None
) -> dict[str, list[Record]]:
    by_case: dict[str, list[Record]] = {} if case is None else {case: []}
    for kind, values in results:
        if kind.startswith("case"):
            if kind == "case" and (not values or values[0] not in names):
                raise VectorError(f"results of case number {list(values)}: the vectors have not")
            case = names[values[0]] if kind == "case" else kind.removeprefix("case ")
            by_case.setdefault(case, [])
        elif case is None:
            raise VectorError(
                "the first record names no case: begin with one, or pass --case SUITE/NAME"
            )
        else:
            by_case[case].append((kind, values))
    return by_case


def _compare(
    expected: Sequence[Record],
    records: Sequence[Record],
    kinds: Sequence[str],
    pixels: Sequence[str],
    compared: dict[str, int],
) -> str:
    """Describe the first difference in the order of the stream; empty if there is none."""
    left: dict[str, Iterator[tuple[int, ...]]] = {
        kind: iter([values for k, values in records if k == kind]) for kind in kinds
    }
    taken = 0
    for kind, wanted in expected:
        if kind == "event":
            taken = wanted[0]
        if kind not in kinds:
            continue
        got = next(left[kind], None)
        if got != wanted:
            return _describe(kind, wanted, got, pixels, taken)
        compared[kind] += 1
    for kind, rest in left.items():
        extra = next(rest, None)
        if extra is not None:
            return f"{kind} {extra[0] if extra else ''} was returned beyond the last one expected"
    return ""


def _describe(
    kind: str,
    wanted: tuple[int, ...],
    got: tuple[int, ...] | None,
    pixels: Sequence[str],
    taken: int,
) -> str:
    where = f"{kind if kind != 'match' else 'match of window'} {wanted[0]}"
    if kind == "event" and wanted[1] != NONE:
        where += f" at pixel {pixels[wanted[1] % len(pixels)]}"
    elif kind != "event":
        where += f" (after event {taken})"
    if got is None:
        return f"{where}: nothing was returned for it"
    if len(got) != len(wanted):
        return f"{where}: expected {len(wanted)} values, got {len(got)}"
    at = next(i for i, (a, b) in enumerate(zip(wanted, got, strict=True)) if a != b)
    names = _FIELDS[kind]
    if at < len(names):
        what = names[at]
    else:
        slot = at - len(names)
        what = f"code of slot {slot}, pixel {pixels[slot % len(pixels)]}"
    return f"{where}: {what}: expected {_said(wanted[at])}, got {_said(got[at])}"


def _said(value: int) -> str:
    return "none" if value == NONE else str(value)


def _pixels(data: bytes) -> list[str]:
    lines = data.decode("ascii").splitlines()[1:]
    return ["({}, {})".format(*line.split(",")) for line in lines]
