"""Logic cells of the hardware core on an FPGA, as a function of the design.

``python -m edge_vpr_tools.estimate.core_area`` synthesizes and packs the board design of some
designs by yosys and nextpnr, solves for the coefficients, and writes the table that `cells` reads,
with the largest error on designs that it was not fitted on. No figure of it is typed in.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from firmware_model.design import Design

AREA = Path(__file__).parent / "core_area.csv"

_TERMS = ("core", "per_bit_of_a_word", "filter", "own_mean", "several_windows")
_SEQUENCES = Design(
    width=346, height=260, pixels=150, places=860, length=5, lanes=8, code="log", code_bits=4
)
_SINGLE = replace(_SEQUENCES, length=1)
_FILTER = replace(_SINGLE, matching="filter")
#: sizes that change apart from one another
FITTED_ON = (
    *(replace(_SEQUENCES, lanes=lanes) for lanes in (2, 8, 16)),
    replace(_SINGLE, lanes=8),
    *(replace(_FILTER, lanes=lanes) for lanes in (4, 16)),
    replace(_FILTER, lanes=8, code="own-mean", full_scales=(0,)),
    replace(_SINGLE, lanes=4, code="own-mean", full_scales=(0,)),
)
#: designs that the fit is judged on
JUDGED_ON = (
    _FILTER,
    replace(_SEQUENCES, pixels=100, places=400, lanes=5, code_bits=6),
    replace(_FILTER, pixels=60, places=1500, lanes=12, code="own-mean", full_scales=(0,)),
)


@cache
def areas() -> Mapping[str, Mapping[str, float]]:
    """Read the fitted coefficients of each FPGA, and the cells that it has."""
    with AREA.open(encoding="ascii", newline="") as file:
        return {
            row["fpga"]: {
                name: float(row[name]) for name in (*_TERMS, "available", "largest_error")
            }
            for row in csv.DictReader(file)
        }


def cells(design: Design, fpga: str) -> int | None:
    """Predict the logic cells of the core with its SPI slave.

    Parameters
    ----------
    design : Design
    fpga : str
        A row of the table, for example ``iCE40UP5K``.

    Returns
    -------
    int or None
        Rounded; None of an FPGA that the table does not have.
    """
    if fpga not in areas():
        return None
    found = areas()[fpga]
    return round(sum(found[n] * x for n, x in zip(_TERMS, _terms(design), strict=True)))


def _terms(design: Design) -> tuple[int, ...]:
    several = not design.filters and design.length > 1
    return 1, design.lanes * design.code_bits, design.filters, design.own_mean, several


def main() -> None:
    """Synthesize, solve, and write the table."""
    from firmware_model.hardware.boards import ICEBREAKER
    from firmware_model.hardware.netlist import packed_cells
    from firmware_model.hardware.report import version

    board = ICEBREAKER

    available = 0

    def measured(design: Design) -> int:
        nonlocal available
        taken, available = packed_cells(design, board)["logic cells"]
        print(f"{taken} logic cells: {design}", flush=True)
        return taken

    counted = [measured(design) for design in FITTED_ON]
    terms = np.array([_terms(design) for design in FITTED_ON], dtype=np.float64)
    weight = 1.0 / np.array(counted, dtype=np.float64)
    solved = np.linalg.lstsq(terms * weight[:, None], np.ones(len(counted)), rcond=None)[0]
    errors = [
        abs(float(np.dot(solved, _terms(design))) / measured(design) - 1) for design in JUDGED_ON
    ]
    tools = f"{version('yosys', '-V')}; {version(board.placer, '--version')}"
    lines = [
        ",".join(("fpga", "tools", "available", "largest_error", *_TERMS)),
        ",".join(
            (board.fpga, tools, str(available), f"{max(errors):.4f}")
            + tuple(f"{value:.2f}" for value in solved)
        ),
    ]
    AREA.write_text("\n".join(lines) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
