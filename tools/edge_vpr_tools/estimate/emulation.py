"""Instructions of the reference firmware on each processor, as a function of the design.

``python -m edge_vpr_tools.estimate.emulation`` runs the firmware on emulated processors for a few
designs, solves for the coefficients, and writes the table that `predict` reads. No figure of it is
typed in; what does not change with the design (an event, code, stack) is read from the table that
stands beside the C sources.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from firmware_model import Design, Memories
from firmware_model.build import EMULATED, Target, build
from firmware_model.image import image, ram_bytes, stride

SCALING = Path(__file__).parent / "scaling.csv"

# addresses are not needed inside: the structures are opaque here
_STRUCT_BYTES = 512
_WINDOW = ("window_call", "window_per_slot")
_MATCH = (
    "match_call",
    "match_per_place",
    "match_per_16_bytes",
    "match_per_16_bytes_left_over",
    "match_per_sum",
    "match_per_sum_of_several",
    "match_per_term",
)

#: sizes that change apart from one another, so that no coefficient hides behind another
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
        # few complete sequences, so that they are told apart from places
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


@dataclass(frozen=True)
class Counted:
    """Instructions of one call of ``vpr_window_end`` and of ``vpr_match_places``."""

    window: int
    match: int


def count(target: Target, elf: Path, design: Design, seed: int = 0) -> Counted:
    """Run the firmware on an emulated processor until L windows are seen, and count the last.

    Parameters
    ----------
    target : Target
    elf : path
        What `firmware_model.build.build` made for it.
    design : Design
    seed : int
        Of the places and counts.

    Returns
    -------
    Counted

    Raises
    ------
    ToolError
        If the emulator is not installed.
    """
    from firmware_model.emulator import Emulator

    emulator = Emulator(target, elf)
    rng = np.random.default_rng(seed)
    places = rng.integers(0, design.code_max + 1, (design.places, design.slots)).tolist()
    flat = rng.choice(design.width * design.height, design.pixels, replace=False).tolist()
    pixels = [(at % design.width, at // design.width) for at in flat]
    flash = image(Memories(design, pixels, places))
    at_image = emulator.put(flash)
    at_design, at_state, at_found = (emulator.put(bytes(_STRUCT_BYTES)) for _ in range(3))
    at_ram = emulator.put(bytes(ram_bytes(design)))
    if not emulator.call("vpr_open", at_design, at_image, len(flash)) & 1:
        raise AssertionError("the firmware refuses its own design")
    emulator.call("vpr_reset", at_design, at_state, at_ram, 0)
    for _ in range(design.length - 1):
        emulator.call("vpr_window_end", at_design, at_state)
        emulator.call("vpr_match_places", at_design, at_state, at_found)
    emulator.call("vpr_window_end", at_design, at_state, count=True)
    window = emulator.instructions
    emulator.call("vpr_match_places", at_design, at_state, at_found, count=True)
    return Counted(window, emulator.instructions)


def fit(designs: Sequence[Design], counted: Sequence[Counted]) -> dict[str, float]:
    """Solve for the coefficients by least squares of the relative errors."""
    window = _solve([_window_terms(d) for d in designs], [c.window for c in counted])
    match = _solve([_match_terms(d) for d in designs], [c.match for c in counted])
    return dict(zip(_WINDOW + _MATCH, [*window, *match], strict=True))


@cache
def scaling() -> Mapping[str, Mapping[str, float]]:
    """Read the fitted coefficients of each processor."""
    with SCALING.open(encoding="ascii", newline="") as file:
        return {
            row["target"]: {name: float(row[name]) for name in _WINDOW + _MATCH}
            for row in csv.DictReader(file)
        }


def predict(design: Design, core: str) -> Counted:
    """Instructions of a window's end and of a match on a processor.

    Parameters
    ----------
    design : Design
    core : str
        A row of the table, for example ``cortex-m4``.

    Returns
    -------
    Counted
        Rounded.
    """
    found = scaling()[core]
    window = sum(found[n] * x for n, x in zip(_WINDOW, _window_terms(design), strict=True))
    match = sum(found[n] * x for n, x in zip(_MATCH, _match_terms(design), strict=True))
    return Counted(round(window), round(match))


def _window_terms(design: Design) -> tuple[int, ...]:
    return 1, design.slots


def _match_terms(design: Design) -> tuple[int, ...]:
    sums = design.places - design.length + 1
    rows = stride(design) // 16
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


def _solve(terms: Sequence[Sequence[int]], counted: Sequence[int]) -> list[float]:
    weight = 1.0 / np.array(counted, dtype=np.float64)
    weighted = np.array(terms) * weight[:, None]
    found: list[float] = np.linalg.lstsq(weighted, np.ones(len(counted)), rcond=None)[0].tolist()
    return found


def main() -> None:
    """Emulate, solve, and write the table."""
    from firmware_model.instructions import compiler

    lines = [",".join(("target", "compiler", *_WINDOW, *_MATCH))]
    with tempfile.TemporaryDirectory() as folder:
        for target in EMULATED:
            elf = build(target, folder)
            found = fit(FITTED_ON, [count(target, elf, design) for design in FITTED_ON])
            values = (f"{value:.3f}" for value in found.values())
            lines.append(",".join((target.name, compiler(), *values)))
    SCALING.write_text("\n".join(lines) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
