"""Tables and lines on the terminal, with a fixed width if the output is a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from edge_vpr.errors import escaped

#: width of a table in a file, in characters
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
    """Print a paragraph, see `table`; use `markup` only for texts without words from a file."""
    _console(width, quiet).print(text if markup else _plain(text), highlight=False)


def _plain(text: str) -> Text:
    """Return text without the mark-up and escapes that names of files and devices can contain."""
    return Text("\n".join(map(escaped, text.split("\n"))))


def _console(width: int, quiet: bool) -> Console:
    return Console(width=None if Console().is_terminal else width, quiet=quiet)
