"""Baselines by name.

A name is one of `baseline_names`, or ``lens:FILE`` or ``model:FILE`` with weights of the user.
``NAME@1,2,4`` is the ensemble of a baseline over windows of these lengths, and ``NAME+NAME`` is the
ensemble of two baselines.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.plugins import load_plugin, names_with_plugins
from edge_vpr_tools.research.baselines.baseline import Baseline
from edge_vpr_tools.research.baselines.dense import Ensemble, Member

#: entry points of this group name a callable that takes a seed and returns a `Baseline`
GROUP = "edge_vpr.baselines"
_WINDOWS = re.compile(r"@(\d{1,3}(?:,\d{1,3})*)$")


@dataclass(frozen=True)
class Entry:
    """Baseline of this package, which is imported when it is first used."""

    name: str
    module: str
    factory: str


BASELINES: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        Entry("paper", "selected_pixels", "paper"),
        Entry("seed-code", "selected_pixels", "released_code"),
        Entry("all-pixels", "dense", "all_pixels"),
        Entry("patch-normalised", "dense", "patch_normalised"),
        Entry("active-pixels", "selected_pixels", "active_pixels"),
        Entry("active-overlap", "selected_pixels", "active_overlap"),
        Entry("hog", "dense", "hog"),
        Entry("ensemble-windows", "dense", "windows_ensemble"),
        Entry("ensemble-descriptors", "dense", "descriptors_ensemble"),
    )
}
#: baselines with weights of the user; their factories also take the file
WITH_FILE: dict[str, Entry] = {
    entry.name: entry
    for entry in (Entry("lens", "networks", "lens"), Entry("model", "networks", "model"))
}


def baseline_names() -> list[str]:
    """Return the names of all baselines that need no file, those of other packages last."""
    return names_with_plugins(BASELINES, GROUP)


def open_baseline(name: str, seed: int = 0) -> Baseline:
    """Make a baseline by its name.

    Parameters
    ----------
    name : str
        See `baseline_names`; or ``lens:FILE``, ``model:FILE``, ``NAME@1,2,4``, ``NAME+NAME``.
    seed : int
        Seed of its random numbers.

    Raises
    ------
    UsageError
        If there is no baseline of this name.
    MissingLibraryError
        If a library that it needs is not installed.
    WeightsError
        If the weights of its file cannot be read.

    Examples
    --------
    >>> open_baseline("patch-normalised@1,2+all-pixels").title
    'patch-normalised 32 x 32, SAD, windows 1, 2 + all pixels, SAD'
    """
    members, titles = [], []
    for part in name.split("+"):
        lengths = _WINDOWS.search(part)
        one = part[: lengths.start()] if lengths else part
        windows = [int(text) for text in lengths[1].split(",")] if lengths else [1]
        baselines = [_open(one, seed) for _ in windows]
        members += [Member(*pair) for pair in zip(baselines, windows, strict=True)]
        shown = f", windows {', '.join(map(str, windows))}" if lengths else ""
        titles.append(baselines[0].title + shown)
    if len(members) == 1 and members[0].windows == 1:
        return members[0].baseline
    return Ensemble(" + ".join(titles), members)


def _open(name: str, seed: int) -> Baseline:
    kind, _, file = name.partition(":")
    if kind in WITH_FILE:
        if not file:
            raise UsageError(f"baseline {kind!r} needs a file: write {kind}:FILE")
        entry = WITH_FILE[kind]
        with_file: Callable[[int, Path], Baseline] = _factory(entry)
        return with_file(seed, Path(file))
    factory: Callable[[int], Baseline] | None = (
        _factory(BASELINES[name]) if name in BASELINES else load_plugin(name, GROUP)
    )
    if factory is None:
        raise UsageError(
            f"baseline {name!r} is unknown{did_you_mean(name, baseline_names())}: choose one of "
            f"{', '.join(baseline_names())}, lens:FILE, model:FILE"
        )
    return factory(seed)


def _factory(entry: Entry) -> Callable[..., Baseline]:
    found: Callable[..., Baseline] = getattr(
        import_module(f"edge_vpr_tools.research.baselines.{entry.module}"), entry.factory
    )
    return found
