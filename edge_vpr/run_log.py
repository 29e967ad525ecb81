"""The command of a run, its warnings, and reports that kernels are compiled.

Commands that need no kernel import this, and not the compiler.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

COMPILING = "compiling kernels, once on each machine for each kind of work"
DAMAGED = "compiled kernels are damaged or of an older version: all are deleted and compiled again"

_commands: list[tuple[str, ...]] = []
_warnings: list[list[str]] = [[]]
_reports: list[Callable[[str], object]] = []


@contextmanager
def logged_run(command: Sequence[str] = ()) -> Iterator[None]:
    """Keep a list of warnings of its own within the block.

    Parameters
    ----------
    command : sequence of str, optional
        Words of the command that runs in the block; by default those of the process.
    """
    _commands.append((sys.argv[0], *command) if command else tuple(sys.argv))
    _warnings.append([])
    try:
        yield
    finally:
        _commands.pop()
        _warnings.pop()


def log_warning(text: str) -> None:
    """Keep a warning for the record of the run."""
    _warnings[-1].append(text)


def command_line() -> tuple[str, ...]:
    """Return the program and the words of the command that is running."""
    return _commands[-1] if _commands else tuple(sys.argv)


def warnings_so_far() -> tuple[str, ...]:
    """Return the warnings that the running command has printed."""
    return tuple(_warnings[-1])


@contextmanager
def compiling_reported(report: Callable[[str], object]) -> Iterator[None]:
    """Report once when a kernel is compiled within the block, and once when code was damaged.

    Parameters
    ----------
    report : callable
        Takes the text.
    """
    reported: set[str] = set()

    def once(text: str) -> None:
        if text not in reported:
            reported.add(text)
            report(text)

    _reports.append(once)
    try:
        yield
    finally:
        _reports.remove(once)


def tell(text: str) -> None:
    """Report a text in the blocks of `compiling_reported`; `edge_vpr.compiling` calls this."""
    for report in _reports:
        report(text)
