"""Plan of a sweep: the file ``sweep.toml``."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.plain_values import read_toml
from edge_vpr.settings import SETTING_FIELDS, Settings, resolve_settings
from edge_vpr_tools.output.json_records import RecordError, from_json
from edge_vpr_tools.sweep.trial import PairOfDrives, Trial

_REMEDY = "write it as docs/sweep.md shows"
_TABLES = ("seeds", "settings", "grid", "variants", "drives")
_MOST_TRIALS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class NamedTrial:
    """Trial with its names in the plan."""

    variant: str
    drives: str
    seed: int
    trial: Trial


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All combinations of variants, drives and seeds."""

    variants: Mapping[str, Settings]
    drives: Mapping[str, PairOfDrives]
    seeds: tuple[int, ...]

    def trials(self) -> Iterator[NamedTrial]:
        """Hash every input once, and yield all trials.

        Raises
        ------
        UsageError
            If an input cannot be read.
        """
        files = {file for drives in self.drives.values() for file in drives.files}
        hashes = {file: content_hash(Path(file)) for file in sorted(files)}
        for (drive, drives), (name, settings), seed in itertools.product(
            self.drives.items(), self.variants.items(), self.seeds
        ):
            trial = Trial(
                settings=replace(settings, seed=seed).to_dict(),
                drives=drives,
                inputs=tuple(hashes[file] for file in drives.files),
            )
            yield NamedTrial(variant=name, drives=drive, seed=seed, trial=trial)


def read_plan(path: Path) -> Plan:
    """Read a plan; paths in it are relative to its folder.

    Parameters
    ----------
    path : Path
        TOML: ``seeds`` (a number, or a list); ``[settings]`` of all variants; ``[grid]`` with a
        list of values for each setting, every combination of which is a variant;
        ``[variants.NAME]`` with additional variants; ``[drives.NAME]`` with the fields of
        `PairOfDrives`.

    Raises
    ------
    UsageError
        If the file cannot be read, or a name or value in it is wrong.
    """
    values = read_toml(path, "a sweep", _REMEDY)
    _check_names(values, _TABLES, str(path))
    tables = {name: _table(values, name, path) for name in _TABLES[1:]}
    drives = {
        name: _drives(one, f"{path}: drives.{name}", path.parent)
        for name, one in tables["drives"].items()
    }
    if not drives:
        raise UsageError(f"{path} names no drives: {_REMEDY}")
    variants = dict(_variants(tables, path))
    seeds = _seeds(values.get("seeds", 1), path)
    if len(variants) * len(drives) * len(seeds) > _MOST_TRIALS:
        raise UsageError(f"{path} asks for more than {_MOST_TRIALS:,} trials: split it")
    return Plan(variants=variants, drives=drives, seeds=seeds)


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of all files of a folder.

    Raises
    ------
    UsageError
        If a file cannot be read.
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        whole = hashlib.sha256()
        for inner in sorted(file for file in path.rglob("*") if file.is_file()):
            whole.update(f"{inner.relative_to(path)}\0{content_hash(inner)}\n".encode())
        return whole.hexdigest()
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}): check the path") from error


def _variants(tables: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Settings]]:
    common, grid = tables["settings"], tables["grid"]
    for name, choices in grid.items():
        if not isinstance(choices, list) or not choices:
            raise UsageError(f"{path}: grid.{name} is {choices!r}: give a list of values")
    if len(list(itertools.islice(itertools.product(*grid.values()), _MOST_TRIALS + 1))) > (
        _MOST_TRIALS
    ):
        raise UsageError(f"{path}: the grid has more than {_MOST_TRIALS:,} variants: split it")
    # without a grid and without variants, the settings are the only variant
    if grid or not tables["variants"]:
        for values in itertools.product(*grid.values()):
            changes = dict(zip(grid, values, strict=True))
            name = " ".join(f"{key}={_word(value)}" for key, value in changes.items())
            yield name or "settings", _resolved(common, changes, f"{path}: grid")
    for name, changes in tables["variants"].items():
        if not isinstance(changes, Mapping):
            raise UsageError(f"{path}: variants.{name} is {changes!r}: give settings")
        yield name, _resolved(common, changes, f"{path}: variants.{name}")


def _resolved(common: Mapping[str, Any], own: Mapping[str, Any], where: str) -> Settings:
    values = {**common, **own}
    preset = values.pop("preset", "default")
    if "seed" in values:
        raise UsageError(f"{where} sets seed: name the seeds of all variants as seeds = [...]")
    known = {field.key for field in SETTING_FIELDS.values()} | set(SETTING_FIELDS)
    _check_names(values, tuple(sorted(known)), where)
    try:
        return resolve_settings(preset, None, values)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def _drives(values: object, where: str, folder: Path) -> PairOfDrives:
    if not isinstance(values, Mapping):
        raise UsageError(f"{where} is {values!r}: give reference, query and ground_truth")
    _check_names(values, tuple(field.name for field in fields(PairOfDrives)), where)
    given = dict(values)
    for name in ("start", "end", "start_offset"):
        if isinstance(given.get(name), list):
            given[name] = [str(value) for value in given[name]]
    if isinstance(given.get("ground_truth"), str):
        given["ground_truth"] = [given["ground_truth"]]
    try:
        drives = from_json(PairOfDrives, given)
    except RecordError as error:
        raise UsageError(f"{where}: {error}: {_REMEDY}") from None
    return replace(
        drives,
        reference=str(folder / drives.reference),
        query=str(folder / drives.query),
        ground_truth=tuple(str(folder / file) for file in drives.ground_truth),
    )


def _seeds(given: object, path: Path) -> tuple[int, ...]:
    seeds = list(range(given)) if type(given) is int and 0 < given <= _MOST_TRIALS else given
    if (
        not isinstance(seeds, list)
        or not seeds
        or not all(type(seed) is int and 0 <= seed < 1 << 32 for seed in seeds)
        or len(set(seeds)) < len(seeds)
    ):
        raise UsageError(
            f"{path}: seeds is {given!r}: give how many, or a list of different whole numbers"
        )
    return tuple(seeds)


def _table(values: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise UsageError(f"{path}: {name} is {table!r}: {_REMEDY}")
    return table


def _check_names(values: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for name in values:
        if name not in known:
            raise UsageError(
                f"{where} has the unknown name {name!r}{did_you_mean(name, known)} (known: "
                f"{', '.join(known)})"
            )


def _word(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
