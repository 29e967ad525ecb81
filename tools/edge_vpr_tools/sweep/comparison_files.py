"""Files of a comparison, for papers and programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edge_vpr.archive import replacing
from edge_vpr.errors import printable
from edge_vpr_tools.output.provenance import run_record, write_json
from edge_vpr_tools.output.results import RUN
from edge_vpr_tools.output.spreadsheets import write_spreadsheet
from edge_vpr_tools.report.style import save
from edge_vpr_tools.sweep.comparison import MEASURES, Row, draw, spreadsheet_of, table_of

NAME = "compare"


def markdown(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    head, lines = table_of(rows)
    # names come from files: a bar would end a cell, and an escape sequence would reach the terminal
    cells = [[printable(cell, 200).replace("|", "\\|") for cell in line] for line in [head, *lines]]
    cells.insert(1, ["---"] * len(head))
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def write_comparison(
    folder: Path, rows: Sequence[Row], formats: Sequence[str], measure: str
) -> None:
    """Write ``compare.csv``, ``.json``, ``.md``, and the figure in each format.

    Parameters
    ----------
    folder : Path
    rows : sequence of Row
    formats : sequence of str
        Names from `report.formats.FORMATS`.
    measure : str
        Measure of the figure, one of `MEASURES`.
    """
    head, lines = spreadsheet_of(rows)
    write_spreadsheet(folder / f"{NAME}.csv", head, lines)
    with replacing(folder / f"{NAME}.md") as temporary:
        temporary.write_text(markdown(rows), encoding="utf-8")
    write_json(folder / f"{NAME}.json", {"schema": 1, "measures": MEASURES, "rows": list(rows)})
    write_json(folder / RUN, run_record({}, []))
    save(draw(rows, measure), *(folder / f"{NAME}.{kind}" for kind in formats))
