"""Print a profile, or two side by side, on the terminal."""

from __future__ import annotations

import math
from pathlib import Path

from edge_vpr.plain_values import understood
from edge_vpr_tools.energy.profile_record import Profile
from edge_vpr_tools.energy.profile_text import DESIGNS, designs, notes, rows
from edge_vpr_tools.energy.profile_values import NOT_MEASURED, Number, numbers
from edge_vpr_tools.output.spreadsheets import write_spreadsheet
from edge_vpr_tools.output.tables import say, table

_WIDTH = 110


def show(found: Profile) -> None:
    """Print a profile."""
    table(("measured", ""), rows(found), title=found.run.machine.processor, width=_WIDTH)
    if found.designs:
        table(DESIGNS, designs(found), width=_WIDTH)
    for line in notes(found):
        say(line, width=_WIDTH)


def compare(first: Path, second: Path, spreadsheet: Path | None = None) -> None:
    """Print two profiles side by side, with the ratio if both have a number.

    Parameters
    ----------
    first, second : path
        Paths of the two ``profile.json`` files.
    spreadsheet : path, optional
        File to which the comparison is also written.

    Raises
    ------
    UsageError
        If a profile cannot be read.
    """
    found = [Profile.load_file(path) for path in (first, second)]
    for path, one in zip((first, second), found, strict=True):
        check_shown(one, path)
    sides = [{number.name: number for number in numbers(one)} for one in found]
    told, cells = [], []
    for name in dict.fromkeys(name for side in sides for name in side):
        a, b = (side.get(name, Number(name, None, why=NOT_MEASURED)) for side in sides)
        ratio = b.value / a.value if a.value and b.value is not None else None
        cells.append((name, a.value, b.value, ratio))
        told.append((name, _cell(a), _cell(b), "-" if ratio is None else f"{ratio:.3g}"))
    table(("", str(first), str(second), "times"), told, width=_WIDTH)
    for path, one in zip((first, second), found, strict=True):
        for line in notes(one):
            say(f"{path}: {line}", width=_WIDTH)
    if spreadsheet is not None:
        write_spreadsheet(spreadsheet, ("quantity", str(first), str(second), "times"), cells)


def check_shown(found: Profile, path: Path) -> None:
    """Raise `UsageError` unless all shown parts of a profile are valid."""
    with understood(path, "a profile", "make it again with edge-vpr profile"):
        _ = rows(found), designs(found), notes(found)
        for number in numbers(found):
            for value in number[1:4]:
                if value is not None and not math.isfinite(value):
                    raise ValueError(f"{number.name} is {value}")


def _cell(of: Number) -> str:
    return of.why if of.value is None else f"{of.value:,.6g}"
