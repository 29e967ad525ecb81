"""Systems that the paper compares with, and others, behind one interface.

A name is one of `baseline_names`; or of a kind that takes an argument: ``strategy:NAME`` for the
paper's method with pixels of another strategy, ``lens:FILE`` and ``model:FILE`` with weights of the
user.
``NAME@1,2,4`` is the ensemble of a baseline over windows of these lengths, and ``NAME+NAME`` is the
ensemble of two baselines.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from edge_vpr_tools.console import warning

from edge_vpr.errors import UsageError, did_you_mean, kind_of
from edge_vpr.plugins import Registry
from lab.baselines.baseline import (
    Baseline,
    Compared,
    VectorBaseline,
    compare,
    filter_distances,
    match_distances,
)
from lab.baselines.dense import Ensemble, Member
from lab.baselines.selected_pixels import map_all_pixels

__all__ = [
    "GROUP",
    "Baseline",
    "Compared",
    "Ensemble",
    "Member",
    "VectorBaseline",
    "baseline_names",
    "compare",
    "filter_distances",
    "map_all_pixels",
    "match_distances",
    "open_baseline",
]

#: entry points of this group name a callable that takes a seed and returns a `Baseline`; a second
#: parameter takes the text behind a colon
GROUP = "edge_vpr.baselines"
_WINDOWS = re.compile(r"@(\d{1,3}(?:,\d{1,3})*)$")


_PACKAGE = "lab.baselines"
_BASELINES = Registry(
    GROUP,
    {
        "paper": f"{_PACKAGE}.selected_pixels:paper",
        "seed-code": f"{_PACKAGE}.selected_pixels:released_code",
        "all-pixels": f"{_PACKAGE}.dense:AbsoluteDifferences",
        "patch-normalised": f"{_PACKAGE}.dense:PatchNormalised",
        "active-pixels": f"{_PACKAGE}.selected_pixels:ActivePixels",
        "hog": f"{_PACKAGE}.dense:OrientedGradients",
        "strategy": f"{_PACKAGE}.selected_pixels:by_strategy",
        "lens": f"{_PACKAGE}.networks:lens",
        "model": f"{_PACKAGE}.networks:model",
    },
)


class _Factory(NamedTuple):
    """Maker of a baseline, and what it takes besides a seed: such as ``FILE``, or nothing."""

    make: Callable[..., Baseline]
    argument: str | None


def _factory(name: str) -> _Factory | None:
    make = _BASELINES.load(name)
    if make is None:
        return None
    try:
        _, *more = inspect.signature(make).parameters
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"baseline {name!r} is {kind_of(make)}: expected a callable that takes a seed, so "
            "correct its entry point"
        ) from error
    return _Factory(make, more[0].upper() if more else None)


def _arguments() -> dict[str, str | None]:
    """Return the argument of each baseline; those that fail are left out with a warning."""
    parameters = {}
    for name in _BASELINES.names():
        try:
            factory = _factory(name)
        except UsageError as error:
            _leave_out(str(error))
            continue
        if factory is not None:
            parameters[name] = factory.argument
    return parameters


@cache  # warns once
def _leave_out(error: str) -> None:
    warning(f"baseline left out: {error}")


def baseline_names() -> list[str]:
    """Return the names of all baselines that need no argument, those of other packages last.

    Those whose import fails are left out with a warning.
    """
    return [name for name, argument in _arguments().items() if argument is None]


def open_baseline(name: str, seed: int = 0) -> Baseline:
    """Make a baseline by its name.

    Parameters
    ----------
    name : str
        See `baseline_names`; or ``strategy:NAME``, ``lens:FILE``, ``model:FILE``,
        ``NAME@1,2,4``, ``NAME+NAME``.
    seed : int
        Seed of its random numbers.

    Raises
    ------
    MissingLibraryError
        If a library that it needs is not installed.
    WeightsError
        If the weights of its file cannot be read.

    Examples
    --------
    >>> open_baseline("patch-normalised@1,2+all-pixels").title
    'patch-normalised 32 x 32, SAD, windows 1, 2 + all-pixels, SAD'
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
    kind, _, argument = name.partition(":")
    factory = _factory(kind)
    if factory is None or (argument and factory.argument is None):
        parameters = [
            one if takes is None else f"{one}:{takes}" for one, takes in _arguments().items()
        ]
        raise UsageError(
            f"baseline {name!r} is unknown{did_you_mean(name, baseline_names())}: choose one of "
            f"{', '.join(parameters)}"
        )
    if factory.argument is None:
        return factory.make(seed)
    if not argument:
        raise UsageError(
            f"baseline {kind!r} needs a {factory.argument.lower()}: write {kind}:{factory.argument}"
        )
    return factory.make(seed, argument)
