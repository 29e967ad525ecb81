"""Instructions of the reference firmware on each processor, as a function of the design.

``python -m edge_vpr_tools.estimate.emulation`` runs the firmware on emulated processors for a few
designs, solves for the coefficients, and writes the table that `predict` reads. With ``--check`` it
counts random designs instead, and writes how far off the predictions are. No figure is typed by
hand; what does not depend on the design (an event, code, stack) is read from the table beside the C
sources.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from firmware_model import Design, Memories
from firmware_model.emulation.build import COUNTED, Target, build, compiler
from firmware_model.emulation.emulator import Emulator
from firmware_model.emulation.instructions import FirmwareRun
from firmware_model.errors import DesignError
from firmware_model.image import check_limits, stride
from fixedpoint.activity import SUMS

SCALING = Path(__file__).parent / "scaling.csv"

_WINDOW = ("window_call", "window_per_slot")
_CONTRAST_WINDOW = ("contrast_call", "contrast_per_slot")
_MATCH = (
    "match_call",
    "match_per_place",
    "match_per_16_bytes",
    "match_per_16_bytes_left_over",
    "match_per_sum",
    "match_per_sum_of_several",
    "match_per_term",
)
_FILTER = (
    "filter_call",
    "filter_per_place",
    "filter_per_16_bytes",
    "filter_per_16_bytes_left_over",
    "filter_per_half_place",
)
#: with seven gains, which compare sums of windows too
_GAINS_WINDOW = ("gains_window_call", "gains_window_per_slot")
_GAINS = tuple(name.replace("filter", "gains") for name in _FILTER)
_WINDOWS = (_WINDOW, _CONTRAST_WINDOW, _GAINS_WINDOW)
_GROUPS = (*_WINDOWS, _MATCH, _FILTER, _GAINS)

#: sizes that vary independently, so that each coefficient can be determined
FITTED_ON = tuple(
    Design(width=64, height=64, pixels=pixels, places=places, length=length, code_bits=4)
    for places, length, sizes in (
        (12, 1, (16, 150)),
        (40, 1, (16, 40, 64, 150, 256)),
        (40, 2, (16, 100)),
        (40, 5, (16, 48, 128, 150)),
        (100, 10, (25, 64, 208)),
        (100, 20, (33, 150)),
        (200, 5, (150,)),
        # few complete sequences, so that they differ from places
        (20, 12, (100,)),
        (24, 14, (16, 150)),
        (26, 15, (250,)),
        (30, 8, (64,)),
        (40, 6, (16, 150)),
        (40, 7, (100,)),
        (60, 3, (100,)),
        (60, 4, (40,)),
    )
    for pixels in sizes
)


#: the same for the filter: gains, sizes, and places per window
_FILTERS = tuple(
    Design(
        width=64, height=64, pixels=pixels, places=places, code_bits=4, matching="filter",
        code="contrast", places_per_window=per_window, gains=gains,
    )
    for gains in (1, 7)
    for pixels, places, per_window in (
        (16, 20, 1), (150, 20, 1), (40, 60, 1), (64, 90, 1), (100, 30, 1), (208, 24, 1),
        (250, 40, 1), (16, 24, 2), (25, 60, 2), (150, 40, 2), (64, 30, 2), (208, 30, 2),
    )
)  # fmt: skip


@dataclass(frozen=True)
class Counted:
    """Instructions of one call of ``vpr_window_end`` and of ``vpr_match_places``."""

    window: int
    match: int


def count(target: Target, elf: Path, design: Design, seed: int = 0) -> Counted:
    """Run the firmware on an emulated processor until L windows are seen, and count the last.

    Of the filter, until the third, since the first takes longer, or until the longest sum is of
    windows that were seen. No window pauses.

    Raises
    ------
    ToolError
        If the emulator is not installed.
    """
    rng = np.random.default_rng(seed)
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots)).tolist()
    flat = rng.choice(design.width * design.height, design.pixels, replace=False).tolist()
    pixels = [(at % design.width, at // design.width) for at in flat]
    run = FirmwareRun(Emulator(target, elf), Memories(design, pixels, places))
    windows = max(3, 1 + SUMS[design.sums - 1]) if design.filters else design.length
    return Counted(*run.match(windows))


def fit(designs: Sequence[Design], counted: Sequence[Counted]) -> dict[str, float]:
    """Solve for the coefficients by least squares of the relative errors."""
    coefficients: dict[str, float] = {}
    for group in _GROUPS:
        window = group in _WINDOWS
        pairs = [
            (_window_terms(d) if window else _match_terms(d), c.window if window else c.match)
            for d, c in zip(designs, counted, strict=True)
            if group in _groups(d)
        ]
        solved = _solve([terms for terms, _ in pairs], [count for _, count in pairs])
        coefficients |= dict(zip(group, solved, strict=True))
    return coefficients


@cache
def scaling() -> Mapping[str, Mapping[str, float]]:
    """Read the fitted coefficients of each processor."""
    with SCALING.open(encoding="ascii", newline="") as file:
        return {
            row["target"]: {name: float(row[name]) for group in _GROUPS for name in group}
            for row in csv.DictReader(file)
        }


def predict(design: Design, core: str) -> Counted:
    """Predict the instructions of a window's end and of a match on a processor."""
    coefficients = scaling()[core]
    of_window, of_match = _groups(design)
    window = sum(coefficients[n] * x for n, x in zip(of_window, _window_terms(design), strict=True))
    match = sum(coefficients[n] * x for n, x in zip(of_match, _match_terms(design), strict=True))
    return Counted(round(window), round(match))


def _groups(design: Design) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name the coefficients of the design's windows and matches."""
    if design.gains > 1:
        return _GAINS_WINDOW, _GAINS
    window = _CONTRAST_WINDOW if design.contrast else _WINDOW
    return window, _FILTER if design.filters else _MATCH


def _window_terms(design: Design) -> tuple[int, ...]:
    return 1, design.slots


def _match_terms(design: Design) -> tuple[int, ...]:
    rows = stride(design) // 16
    if design.filters:
        return _filter_terms(design, rows)
    sums = design.places - design.length + 1
    return (
        1,
        design.places,
        design.places * rows,
        # compilers take four rows at a time, and the rest one by one
        design.places * (rows % 4),
        sums,
        sums * (design.length > 1),
        sums * (design.length - 1),
    )


def _filter_terms(design: Design, rows: int) -> tuple[int, ...]:
    places = design.places
    return (
        1,
        places,
        places * rows,
        places * (rows % 4),
        # four steps are unrolled; seven take a loop
        places * (design.places_per_window == 2),
    )


def _solve(terms: Sequence[Sequence[int]], counted: Sequence[int]) -> list[float]:
    weight = 1.0 / np.array(counted, dtype=np.float64)
    weighted = np.array(terms) * weight[:, None]
    solved: list[float] = np.linalg.lstsq(weighted, np.ones(len(counted)), rcond=None)[0].tolist()
    return solved


def random_designs(number: int, seed: int) -> list[Design]:
    """Draw designs of both profiles that the firmware holds, with 20 places or more."""
    rng, designs = np.random.default_rng(seed), list[Design]()
    while len(designs) < number:
        by_filter = rng.random() < 0.7
        matching: dict[str, Any] = {"length": int(rng.integers(1, 20))}
        if by_filter:
            matching = {
                "code": "contrast", "matching": "filter",
                "places_per_window": int(rng.integers(1, 3)), "gains": int(rng.choice([1, 7])),
            }  # fmt: skip
        with suppress(DesignError):
            design = Design(
                width=64, height=64, pixels=int(rng.integers(5, 700)), lookup_depth=2048,
                places=int(rng.integers(20, 120)), code_bits=int(rng.integers(1, 5)), **matching,
            )  # fmt: skip
            check_limits(design)
            designs.append(design)
    return designs


def error(target: Target, elf: Path, design: Design, seed: int = 0) -> float:
    """Return the relative error of a predicted match; positive: too many instructions."""
    return predict(design, target.name).match / count(target, elf, design, seed).match - 1


def check(number: int = 40, seed: int = 77) -> list[str]:
    """Return a table of the furthest errors on each processor."""
    lines = ["target,designs,too few (%),too many (%)"]
    with tempfile.TemporaryDirectory() as folder:
        for target in COUNTED:
            elf = build(target, folder)
            errors = [error(target, elf, one, seed) for one in random_designs(number, seed)]
            lines.append(f"{target.name},{number},{-100 * min(errors):.1f},{100 * max(errors):.1f}")
            print(lines[-1], file=sys.stderr, flush=True)
    return lines


def main() -> None:
    """Emulate, solve, and write the table; or check it."""
    if sys.argv[1:] == ["--check"]:
        print("\n".join(check()))
        return
    lines = [",".join(("target", "compiler", *chain(*_GROUPS)))]
    with tempfile.TemporaryDirectory() as folder:
        for target in COUNTED:
            elf = build(target, folder)
            designs = FITTED_ON + _FILTERS
            coefficients = fit(designs, [count(target, elf, design) for design in designs])
            values = (f"{value:.3f}" for value in coefficients.values())
            lines.append(",".join((target.name, compiler(target), *values)))
    SCALING.write_text("\n".join(lines) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
