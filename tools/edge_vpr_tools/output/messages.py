"""Notes on standard error and summaries on standard output, depending on ``-q`` and ``-v``."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum

from edge_vpr.errors import escaped, printable


class Verbosity(IntEnum):
    """How much a command prints while it runs."""

    QUIET = -1
    NORMAL = 0
    VERBOSE = 1


_now = [Verbosity.NORMAL]


@contextmanager
def verbosity(level: Verbosity) -> Iterator[None]:
    """Print as much as `level` allows within the block."""
    _now.append(level)
    try:
        yield
    finally:
        _now.pop()


def is_quiet() -> bool:
    """Return whether progress, notes and summaries are off."""
    return _now[-1] <= Verbosity.QUIET


def summary(text: str) -> None:
    """Print a line of the summary on standard output; not if quiet."""
    if not is_quiet():
        answer(text)


def answer(text: str) -> None:
    """Print a line of a command's result on standard output, even if quiet."""
    print(escaped(text), flush=True)


def note(text: str) -> None:
    """Print a line on standard error; not if quiet."""
    if not is_quiet():
        error_line(text)


def detail(text: str) -> None:
    """Print a line on standard error if verbose."""
    if _now[-1] >= Verbosity.VERBOSE:
        error_line(text)


def detail_settings(settings: Mapping[str, object]) -> None:
    """Print each setting in effect if verbose."""
    for name, value in settings.items():
        detail(f"setting {name} = {value}")


def warning(text: str) -> None:
    """Print a warning on standard error, even if quiet."""
    error_line(f"warning: {text}")


def error_line(text: str) -> None:
    """Print a line on standard error."""
    print("edge-vpr:", printable(text), file=sys.stderr, flush=True)
