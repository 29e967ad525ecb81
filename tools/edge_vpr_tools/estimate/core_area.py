"""Logic cells of the hardware core on an FPGA, as a function of the design.

``python -m edge_vpr_tools.estimate.core_area`` synthesizes and packs the board designs of
`FITTED_ON` and `CHECKED_ON` by yosys and nextpnr, and writes the table of their cells beside this
file. `cells` fits the first at its first call; the others say how far it errs.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from firmware_model.design import Design
from firmware_model.hardware.parameters import ICEBREAKER
from firmware_model.hardware.report import packed_cells

TABLE = Path(__file__).parent / "core_area.csv"

_SEQUENCES = Design(width=346, height=260, pixels=150, places=860, length=5, lanes=8, code_bits=4)
_SINGLE = replace(_SEQUENCES, length=1)
_FILTER = replace(_SINGLE, matching="filter")
_CONTRAST = replace(_SINGLE, code="contrast")
_DEFAULT = replace(_CONTRAST, matching="filter")
#: sizes that vary independently
FITTED_ON = {
    "sequences, 2 lanes": replace(_SEQUENCES, lanes=2),
    "sequences, 8 lanes": _SEQUENCES,
    "sequences, 16 lanes": replace(_SEQUENCES, lanes=16),
    "sequences, codes of 6 bits": replace(_SEQUENCES, code_bits=6),
    "single windows, 8 lanes": _SINGLE,
    "place filter, 4 lanes": replace(_FILTER, lanes=4),
    "place filter, 16 lanes": replace(_FILTER, lanes=16),
    "single windows, contrast codes, 4 lanes": replace(_CONTRAST, lanes=4),
    "place filter, contrast codes, 8 lanes": _DEFAULT,
    "place filter at half windows, contrast codes, 8 lanes": replace(_DEFAULT, places_per_window=2),
    "seven gains at half windows, 8 lanes": replace(_DEFAULT, places_per_window=2, gains=7),
}
#: designs that the fit is checked with
CHECKED_ON = {
    "place filter, 8 lanes": _FILTER,
    "sequences, 100 pixels, 400 places, 5 lanes": replace(
        _SEQUENCES, pixels=100, places=400, lanes=5
    ),
    "place filter, contrast codes, 60 pixels, 1,500 places, 4 lanes": replace(
        _DEFAULT, pixels=60, places=1500, lanes=4
    ),
    "place filter at half windows, contrast codes, 60 pixels, 1,500 places, 4 lanes": replace(
        _DEFAULT, places_per_window=2, pixels=60, places=1500, lanes=4
    ),
    "seven gains at half windows, 60 pixels, 1,500 places, 4 lanes": replace(
        _DEFAULT, places_per_window=2, pixels=60, places=1500, lanes=4, gains=7
    ),
}


#: columns of the table: cells of the packed design, and of the FPGA
HEADER = ("design", "cells", "available")


def read(table: Path = TABLE) -> dict[str, int]:
    """Read the cells of the measured netlists by the name of the design."""
    with table.open(encoding="ascii", newline="") as file:
        return {row["design"]: int(row["cells"]) for row in csv.DictReader(file)}


def cells(design: Design) -> int:
    """Predict the logic cells of the core and its SPI slave on an iCE40UP5K."""
    return round(float(np.dot(_fitted(), _terms(design))))


def errors() -> dict[str, float]:
    """Return the relative error of each netlist that was not fitted; positive: too many cells."""
    measured = read()
    return {name: cells(of) / measured[name] - 1 for name, of in CHECKED_ON.items()}


@cache
def _fitted() -> tuple[float, ...]:
    """Solve for the cells of each term, by least squares of relative errors."""
    measured = read()
    counted = np.array([measured[name] for name in FITTED_ON], dtype=np.float64)
    terms = np.array([_terms(design) for design in FITTED_ON.values()], dtype=np.float64)
    solved = np.linalg.lstsq(terms / counted[:, None], np.ones(len(counted)), rcond=None)[0]
    return tuple(solved.tolist())


def _terms(design: Design) -> tuple[int, ...]:
    """Return what each term of the fit counts, in this order.

    The core, bits of a word, the place filter, places at half windows, contrast codes, sums of
    several windows, and several gains.
    """
    several = not design.filters and design.length > 1
    word = design.lanes * design.code_bits
    half = design.places_per_window == 2
    return 1, word, design.filters, half, design.contrast, several, design.gains > 1


def main() -> None:
    """Synthesize and pack all designs, and write their table."""
    rows = []
    for name, design in (FITTED_ON | CHECKED_ON).items():
        rows.append((name, *packed_cells(design, ICEBREAKER)["logic cells"]))
        print(f"{name}: {rows[-1][1]} cells", file=sys.stderr, flush=True)
    with TABLE.open("w", encoding="ascii", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])
    _fitted.cache_clear()
    for name, error in errors().items():
        print(f"{name}: {error:+.1%}")


if __name__ == "__main__":
    main()
