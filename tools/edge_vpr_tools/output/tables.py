"""Tables and lines on the terminal, in a width of their own where the output is no terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from edge_vpr.errors import escaped

#: columns of a table that goes into a file
WIDTH = 118


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    width: int = WIDTH,
    quiet: bool = False,
) -> None:
    """Print a table: the first column to the left, numbers to the right.

    Parameters
    ----------
    header : sequence of str
    rows : iterable of sequence of str
    title : str, optional
    width : int
        In columns, where the output is no terminal.
    quiet : bool
        Print nothing.
    """
    shown = Table(title=None if title is None else _plain(title))
    for i, name in enumerate(header):
        shown.add_column(_plain(name), justify="left" if i == 0 else "right")
    for row in rows:
        shown.add_row(*map(_plain, row))
    _console(width, quiet).print(shown)


def say(text: str, *, width: int = WIDTH, markup: bool = False, quiet: bool = False) -> None:
    """Print a paragraph, see `table`; `markup` is for texts without a word out of a file."""
    _console(width, quiet).print(text if markup else _plain(text), highlight=False)


def _plain(text: str) -> Text:
    """Return text without mark-up and escapes, which names of files and devices may hold."""
    return Text("\n".join(map(escaped, text.split("\n"))))


def _console(width: int, quiet: bool) -> Console:
    return Console(width=None if Console().is_terminal else width, quiet=quiet)
