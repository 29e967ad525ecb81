"""Markdown tables of pages, from the CSV files of results.

In a file with a row per trial, the columns before ``seed`` name what was tried, those after it were
measured. Trials that differ in their seed alone are one row of a page, with the mean and the sample
standard deviation of each measurement. A file without the column ``seed`` is shown as it is.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path

import numpy as np

from edge_vpr.errors import UsageError, did_you_mean
from edge_vpr.files import open_input

SEED = "seed"
#: cell of a page where nothing was measured
NOTHING = "-"

#: cells by column; an empty cell was not measured
Row = Mapping[str, str]
_MARKER = re.compile(r"^(<!-- table: (\S+?)(?: (.*?))? -->)\n(?:\n(?:\|.*\n)+)?", re.MULTILINE)


@dataclass(frozen=True)
class TableView:
    """Part of a table that a page shows."""

    #: Rows that have these values, in this order; several are separated by `` | ``. A column of
    #: one value is left out.
    only: Mapping[str, str]
    columns: Sequence[str] = ()  #: Columns, in this order; by default all.
    #: Column whose values become columns, for each measured column; those without a value are left
    #: out.
    across: str | None = None
    titles: Sequence[str] = ()  #: Header of the table, instead of the names of its columns.

    @classmethod
    def parse(cls, text: str) -> TableView:
        """Read ``key = value`` pairs, separated by semicolons.

        Examples
        --------
        >>> TableView.parse("drives = Brisbane; columns = method, P@100R")
        TableView(only={'drives': 'Brisbane'}, columns=('method', 'P@100R'), across=None, titles=())
        """
        pairs = (part.partition("=") for part in text.split(";") if part.strip())
        only = {key.strip(): value.strip() for key, _, value in pairs}
        lists = (only.pop(name, "").split(",") for name in ("columns", "titles"))
        columns, titles = (tuple(filter(None, map(str.strip, one))) for one in lists)
        return cls(only, columns, only.pop("across", None), titles)


def with_tables(page: str, folder: Path) -> str:
    """Return a page of Markdown with the tables that its markers name.

    A marker is a line ``<!-- table: FILE VIEW -->``; FILE is a CSV file, and VIEW, which may be
    absent, a `TableView`. The table behind it is replaced.

    Raises
    ------
    UsageError
        If a file cannot be read, or does not have what the view names.
    """

    def replaced(marked: re.Match[str]) -> str:
        marker, file, view = marked.groups()
        try:
            table = table_of(read_rows(folder / file), TableView.parse(view or ""))
        except UsageError as error:
            raise UsageError(f"{marker}: {error}") from None
        # without the empty line, some readers of Markdown take the table for a part of the comment
        return f"{marker}\n\n{table}\n"

    return _MARKER.sub(replaced, page)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Read a CSV file with a header.

    Raises
    ------
    UsageError
        If it is missing or has no rows.
    """
    try:
        with TextIOWrapper(open_input(path), newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}): check the path") from error
    if not rows:
        raise UsageError(f"{path} has no rows: run the experiment that writes it")
    return rows


def table_of(rows: Sequence[Row], view: TableView | None = None) -> str:
    """Return a Markdown table with the trials of each row joined.

    Examples
    --------
    >>> two = [{"pixels": "25", "seed": "0", "P": "0.5"}, {"pixels": "25", "seed": "1", "P": "0.7"}]
    >>> print(table_of(two))
    | pixels | P |
    | --- | --- |
    | 25 | 0.600 ± 0.141 |
    """
    view = view or TableView({})
    header = list(rows[0])
    for name in (*view.only, *view.columns, view.across):
        if name is not None and name not in header:
            raise UsageError(
                f"no column {name!r}{did_you_mean(name, header)} (there are {', '.join(header)})"
            )
    only = {name: value.split(" | ") for name, value in view.only.items()}
    rows = [row for row in rows if all(row[name] in values for name, values in only.items())]
    if not rows:
        raise UsageError(f"no row has {dict(view.only)}")
    # in the order of the values that the view names
    rows.sort(key=lambda row: [values.index(row[name]) for name, values in only.items()])
    names = header[: header.index(SEED)] if SEED in header else header
    single = [name for name, values in only.items() if len(values) == 1]
    shown = [name for name in view.columns or header if name not in (SEED, view.across, *single)]
    named = [name for name in shown if name in names]
    measured = [name for name in shown if name not in names]
    across = view.across
    # of each row of the page: trials by the value across it
    joined: dict[tuple[str, ...], dict[str, list[Row]]] = {}
    for row in rows:
        group = joined.setdefault(tuple(row[name] for name in named), {})
        group.setdefault(row[across] if across else "", []).append(row)
    values = list(dict.fromkeys(row[across] for row in rows)) if across else [""]
    body = [
        [
            *(name or NOTHING for name in key),
            *(
                mean_and_deviation([trial[name] for trial in group.get(value, ())])
                for value in values
                for name in measured
            ),
        ]
        for key, group in joined.items()
    ]
    titles = [*named, *measured]
    if across is not None:
        single_one = len(measured) == 1
        titles = named + [v if single_one else f"{v}, {m}" for v in values for m in measured]
        kept = [i for i in range(len(titles)) if any(row[i] != NOTHING for row in body)]
        titles, body = [titles[i] for i in kept], [[row[i] for i in kept] for row in body]
    if view.titles and len(view.titles) != len(titles):
        raise UsageError(f"{len(view.titles)} titles for {len(titles)} columns: {titles}")
    return markdown_table(view.titles or titles, body)


def mean_and_deviation(cells: Sequence[str]) -> str:
    """Return the mean of some cells, with the sample standard deviation of several that differ.

    Examples
    --------
    >>> [mean_and_deviation(cells) for cells in (["1234"], ["0.5", ""], ["1", "2"])]
    ['1,234', '0.500', '1.500 ± 0.707']
    """
    filled = [cell for cell in cells if cell]
    if not filled:
        return NOTHING
    try:
        numbers = [float(cell) for cell in filled]
    except ValueError:  # text, which is the same in all trials
        return " / ".join(dict.fromkeys(filled))
    if len(set(filled)) == 1 and filled[0].removeprefix("-").isdigit():
        return f"{int(filled[0]):,}"
    mean = float(np.mean(numbers))
    decimals = 3 if abs(mean) < 10 else 1 if abs(mean) < 100 else 0
    if len(numbers) == 1:
        return f"{mean:,.{decimals}f}"
    # of the sample of trials, and not of their mean
    return f"{mean:,.{decimals}f} ± {np.std(numbers, ddof=1):,.{decimals}f}"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
