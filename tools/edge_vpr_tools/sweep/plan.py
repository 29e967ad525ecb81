"""The plan of a sweep (``sweep.toml``): variants, drives and seeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.records import RecordError, from_json, read_toml
from edge_vpr.settings import SETTING_FIELDS, Settings, resolve_settings
from edge_vpr_tools.sweep.trial import PairOfDrives, Trial

_REMEDY = "write it as docs/laboratory.md shows"
_TABLES = ("seeds", "settings", "grid", "variants", "drives")
_MOST_TRIALS = 100_000


def read_plan(path: Path) -> list[Trial]:
    """Read the trials of a plan; paths in it are relative to its folder.

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
    seeds = _seeds(values.get("seeds", 1), path)
    for name, choices in tables["grid"].items():
        if not isinstance(choices, list) or not choices:
            raise UsageError(f"{path}: grid.{name} is {choices!r}: give a list of values")
    combined = math.prod(map(len, tables["grid"].values())) + len(tables["variants"])
    if combined * len(drives) * len(seeds) > _MOST_TRIALS:
        raise UsageError(f"{path} asks for more than {_MOST_TRIALS:,} trials: split it")
    variants = list(_variants(tables, path))
    return [
        Trial(name, drive, replace(settings, seed=seed), pair)
        for drive, pair in drives.items()
        for name, settings in variants
        for seed in seeds
    ]


def _variants(tables: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Settings]]:
    common, grid = tables["settings"], tables["grid"]
    # without a grid and without variants, the settings are the only variant
    if grid or not tables["variants"]:
        for values in itertools.product(*grid.values()):
            changes = dict(zip(grid, values, strict=True))
            name = " ".join(f"{key}={_word(value)}" for key, value in changes.items())
            yield name or "settings", _resolved({**common, **changes}, f"{path}: grid")
    for name, changes in tables["variants"].items():
        if not isinstance(changes, Mapping):
            raise UsageError(f"{path}: variants.{name} is {changes!r}: give settings")
        yield name, _resolved({**common, **changes}, f"{path}: variants.{name}")


def _resolved(values: dict[str, Any], where: str) -> Settings:
    preset = values.pop("preset", "default")
    if "seed" in values:
        raise UsageError(f"{where} sets seed: name the seeds of all variants as seeds = [...]")
    names = {one.key for one in SETTING_FIELDS.values()} | set(SETTING_FIELDS)
    _check_names(values, ("preset", *sorted(names)), where)
    try:
        return resolve_settings(preset, None, values)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def _drives(values: object, where: str, folder: Path) -> PairOfDrives:
    if not isinstance(values, Mapping):
        raise UsageError(f"{where} is {values!r}: give reference, query and ground_truth")
    _check_names(values, tuple(one.name for one in fields(PairOfDrives)), where)
    options = dict(values)
    for name in ("start", "end", "start_offset"):
        if isinstance(options.get(name), list):
            options[name] = [str(value) for value in options[name]]
    if isinstance(options.get("ground_truth"), str):
        options["ground_truth"] = [options["ground_truth"]]
    if isinstance(options.get("tolerance"), int | float):
        options["tolerance"] = [options["tolerance"]]
    try:
        drives = from_json(PairOfDrives, options)
    except RecordError as error:
        raise UsageError(f"{where}: {error}: {_REMEDY}") from None
    return replace(
        drives,
        reference=str(folder / drives.reference),
        query=str(folder / drives.query),
        ground_truth=tuple(str(folder / file) for file in drives.ground_truth),
    )


def _seeds(value: object, path: Path) -> tuple[int, ...]:
    if type(value) is int and value > _MOST_TRIALS:
        raise UsageError(f"{path} asks for more than {_MOST_TRIALS:,} trials: split it")
    seeds = list(range(value)) if type(value) is int and value > 0 else value
    if (
        not isinstance(seeds, list)
        or not seeds
        or not all(type(seed) is int and 0 <= seed < 1 << 32 for seed in seeds)
        or len(set(seeds)) < len(seeds)
    ):
        raise UsageError(
            f"{path}: seeds is {value!r}: give how many, or a list of different whole numbers"
        )
    return tuple(seeds)


def _table(values: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise UsageError(f"{path}: {name} is {table!r}: {_REMEDY}")
    return table


def _check_names(values: Mapping[str, Any], names: tuple[str, ...], where: str) -> None:
    for name in values:
        if name not in names:
            raise UsageError(
                f"{where} has the unknown name {name!r}{did_you_mean(name, names)} (known: "
                f"{', '.join(names)})"
            )


def _word(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
