"""Tables of results as CSV files, which a spreadsheet opens."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from edge_vpr.errors import printable
from edge_vpr.files import replacing

#: a spreadsheet takes a cell that begins like this as a formula, which can run programs
_OF_FORMULAS = ("=", "+", "-", "@")


def write_spreadsheet(
    path: Path, header: Sequence[str], lines: Iterable[Sequence[str | float | None]]
) -> None:
    """Write a CSV file, atomically.

    Parameters
    ----------
    lines : iterable of sequence of str, float or None
        None is an empty cell, which was not measured. Text that a spreadsheet would compute has an
        apostrophe before it.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(map(spreadsheet_cell, header))
        writer.writerows(map(spreadsheet_cell, line) for line in lines)


def spreadsheet_cell(value: str | float | None) -> str | float:
    """Return the cell of a spreadsheet, see `write_spreadsheet`."""
    if not isinstance(value, str):
        return "" if value is None else value
    text = printable(value)
    return f"'{text}" if text.startswith(_OF_FORMULAS) else text
