"""Logic cells of each unit of the core: ``python -m firmware_model.hardware.unit_cells``.

The board designs of the documented kinds are synthesized by yosys and packed by nextpnr-ice40. Each
cell belongs to the unit with which its name begins. Units are flattened first, so that a cell that
serves two units is counted for one of them. Cells at the start or end of carry chains belong to no
unit.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from firmware_model.design import Design
from firmware_model.errors import ToolError
from firmware_model.hardware.parameters import ICEBREAKER
from firmware_model.hardware.report import KINDS, packed_cells
from firmware_model.vectors.formats import csv_text

#: names for cells of the top itself, and for cells of carry chains without a unit
TOP, CARRIES = "window's number, busy, board", "ends of carries"
_SKIPPED = re.compile(r"^(?:device\.)?(?:core\.)?|\bg_\w+(?:\[\d+\])?\.|\bgenblk\d+\.")


def unit_of(cell: str) -> str:
    """Return the unit of a packed cell by its name, without generate blocks and inner units."""
    if cell.startswith("$"):
        return CARRIES
    first, *inner = _SKIPPED.sub("", cell).split(".")
    if not inner:
        return TOP
    return f"{first}: {inner[0]}" if first in ("events", "place_filter") and inner[1:] else first


def unit_cells(design: Design) -> Counter[str]:
    """Count the logic cells of each unit of a board design.

    Returns
    -------
    Counter of str
        Number of cells by the unit's name in ``vpr_core.sv``, or by that of a unit within it.

    Raises
    ------
    ToolError
        If a tool is missing, or refuses the design.
    """
    with tempfile.TemporaryDirectory() as name:
        written = Path(name) / "packed.json"
        packed_cells(design, ICEBREAKER, written)
        (packed,) = json.loads(written.read_text(encoding="utf-8"))["modules"].values()
    return Counter(
        unit_of(cell) for cell, found in packed["cells"].items() if found["type"] == "ICESTORM_LC"
    )


def to_csv(found: Mapping[str, Counter[str]]) -> str:
    """Return the cells of units as CSV, largest first, with a column for each design."""
    total: Counter[str] = Counter()
    for cells in found.values():
        total += cells
    rows = [
        [unit, *(cells[unit] or "" for cells in found.values())] for unit, _ in total.most_common()
    ]
    sums = [f"{sum(cells.values()):,}" for cells in found.values()]
    return csv_text(["unit", *found], [*rows, ["all", *sums]])


def main(words: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if a tool fails."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args(words)
    try:
        print(to_csv({kind: unit_cells(design) for kind, design in KINDS.items()}), end="")
    except ToolError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
