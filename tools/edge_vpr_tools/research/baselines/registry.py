"""Baselines by name.

A name is one of `baseline_names`, ``strategy:NAME`` for the paper's method with pixels of another
strategy, or ``lens:FILE`` or ``model:FILE`` with weights of the user.
``NAME@1,2,4`` is the ensemble of a baseline over windows of these lengths, and ``NAME+NAME`` is the
ensemble of two baselines.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.plugins import Registry
from edge_vpr_tools.console import warning
from edge_vpr_tools.research.baselines.baseline import Baseline
from edge_vpr_tools.research.baselines.dense import Ensemble, Member

#: entry points of this group name a callable that takes a seed and returns a `Baseline`
GROUP = "edge_vpr.baselines"
_WINDOWS = re.compile(r"@(\d{1,3}(?:,\d{1,3})*)$")


_PACKAGE = "edge_vpr_tools.research.baselines"
_BASELINES = Registry(
    GROUP,
    {
        "paper": f"{_PACKAGE}.selected_pixels:paper",
        "seed-code": f"{_PACKAGE}.selected_pixels:released_code",
        "all-pixels": f"{_PACKAGE}.dense:all_pixels",
        "patch-normalised": f"{_PACKAGE}.dense:patch_normalised",
        "active-pixels": f"{_PACKAGE}.selected_pixels:active_pixels",
        "active-overlap": f"{_PACKAGE}.selected_pixels:active_overlap",
        "hog": f"{_PACKAGE}.dense:hog",
        "ensemble-windows": f"{_PACKAGE}.dense:windows_ensemble",
        "ensemble-descriptors": f"{_PACKAGE}.dense:descriptors_ensemble",
    },
)
#: baselines with weights of the user; their factories also take the file
_WITH_FILE = Registry(
    f"{GROUP}.files", {"lens": f"{_PACKAGE}.networks:lens", "model": f"{_PACKAGE}.networks:model"}
)
#: baselines that select pixels by a strategy, which is named behind a colon
_BY_STRATEGY = Registry(
    f"{GROUP}.strategies", {"strategy": f"{_PACKAGE}.selected_pixels:by_strategy"}
)


def baseline_names() -> list[str]:
    """Return the names of all baselines that need no file, those of other packages last.

    Those whose import fails are left out with a warning.
    """
    names = _BASELINES.names()
    return [name for name in names if name in _BASELINES or _can_be_imported(name)]


@cache  # warns once
def _can_be_imported(name: str) -> bool:
    try:
        _BASELINES.load(name)
    except UsageError as error:
        warning(f"baseline left out: {error}")
        return False
    return True


def open_baseline(name: str, seed: int = 0) -> Baseline:
    """Make a baseline by its name.

    Parameters
    ----------
    name : str
        See `baseline_names`; or ``strategy:NAME``, ``lens:FILE``, ``model:FILE``, ``NAME@1,2,4``,
        ``NAME+NAME``.
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
    with_file: Callable[[int, Path], Baseline] | None = _WITH_FILE.load(kind)
    if with_file is not None:
        if not file:
            raise UsageError(f"baseline {kind!r} needs a file: write {kind}:FILE")
        return with_file(seed, Path(file))
    with_strategy: Callable[[int, str], Baseline] | None = _BY_STRATEGY.load(kind)
    if with_strategy is not None and file:
        return with_strategy(seed, file)
    factory: Callable[[int], Baseline] | None = _BASELINES.load(name)
    if factory is None:
        raise UsageError(
            f"baseline {name!r} is unknown{did_you_mean(name, baseline_names())}: choose one of "
            f"{', '.join(baseline_names())}, strategy:NAME, lens:FILE, model:FILE"
        )
    return factory(seed)
