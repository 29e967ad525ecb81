"""The command that runs, and the warnings that it has printed, for the record of a run."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

_commands: list[tuple[str, ...]] = []
_warnings: list[list[str]] = [[]]


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
