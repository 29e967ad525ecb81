"""Designs on targets: their cost, the limits that they meet, and the recommended one."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr_tools.estimate.model import (
    Cost,
    Mission,
    block_memories,
    cost,
    firmware,
    large_and_small_blocks,
    sizes,
)
from edge_vpr_tools.estimate.targets import Target
from firmware_model.design import Design
from firmware_model.errors import DesignError
from firmware_model.image import STRUCT_BYTES, check_limits

# Limits of memory and of a target, and a design that is held against them.


_UNITS = {"b": 1.0, "kb": 1e3, "mb": 1e6, "kib": 1024.0, "mib": 1024.0**2}
FIRMWARE_LIMITS = "the firmware's widths"


@dataclass(frozen=True)
class Budget:
    """An upper limit in bytes of flash, of RAM or of both together."""

    text: str
    quantity: str  #: {"flash", "ram", "bytes"}
    limit: float

    @classmethod
    def parse(cls, text: str) -> Budget:
        """Read ``flash=256KiB``, ``ram=32KiB``, or ``64KiB`` for both together."""
        form = re.fullmatch(
            r"\s*(?:(flash|ram)=)?(\d+(?:\.\d*)?|\.\d+)\s*([a-z]+)\s*", text.lower()
        )
        if form and form[3] in _UNITS and float(form[2]) > 0:
            return cls(text, form[1] or "bytes", float(form[2]) * _UNITS[form[3]])
        raise UsageError(f"{text!r}: expected memory, such as 64KiB or ram=8KiB")


class DeviceMemory(NamedTuple):
    """Memory that a design takes on a target."""

    flash_bytes: int  #: Image and program of the reference firmware; 0 on an FPGA.
    #: Arrays, structures and stack of the firmware; on an FPGA all memories, packed.
    ram_bytes: int
    program_bytes: int  #: Of the flash, functions and constants of the firmware.

    @property
    def total(self) -> int:
        """Flash and RAM."""
        return self.flash_bytes + self.ram_bytes


@dataclass(frozen=True)
class DesignOnTarget:
    """A design on a target, with its cost there."""

    design: Design
    mission: Mission
    cost: Cost
    memory: DeviceMemory
    limited_by: str  #: The exceeded limit; empty if it fits.


def memory_on(design: Design, target: Target) -> DeviceMemory:
    """Return the memory that a budget is held against."""
    size = sizes(design)
    if target.kind != "processor":
        return DeviceMemory(0, size.packed_bytes, 0)
    code, stack = firmware()[target.core].code_bytes, firmware()[target.core].stack_bytes
    ram = size.state_bytes + STRUCT_BYTES + stack
    return DeviceMemory(size.image_bytes + code, ram, code)


def on_target(
    design: Design, mission: Mission, target: Target, budgets: Sequence[Budget] = ()
) -> DesignOnTarget:
    """Estimate a design on a target, and check whether it fits there and in the budgets."""
    of, used = cost(design, target, mission), memory_on(design, target)
    limited_by = _broken_by(design, mission, of, target) or _over(budgets, used)
    return DesignOnTarget(design, mission, of, used, limited_by)


def _broken_by(design: Design, mission: Mission, of: Cost, target: Target) -> str:
    """Return which limit of the target a design exceeds; empty if none."""
    if target.kind == "processor":
        try:
            check_limits(design)
        except DesignError:
            return FIRMWARE_LIMITS
    elif target.blocks:
        needed, enough = blocks_of(design, target)
        if not enough:
            return needed
    if of.logic_cells is not None and of.logic_cells > target.logic_cells:
        return f"{of.logic_cells:,} of {target.logic_cells:,} logic cells"
    return of.too_slow(mission.events_per_s)


def _over(budgets: Sequence[Budget], used: DeviceMemory) -> str:
    """Return which budgets the memory of a design exceeds; empty if none."""
    taken = {"flash": used.flash_bytes, "ram": used.ram_bytes, "bytes": used.total}
    over = (
        f"{budget.text}: {taken[budget.quantity]:,} bytes"
        for budget in budgets
        if taken[budget.quantity] > budget.limit
    )
    return " and ".join(over)


def blocks_of(of: Design, target: Target) -> tuple[str, bool]:
    """Return the block memories that a design takes, and whether there are as many."""
    needed = block_memories(of, target.block_shapes)
    if needed <= target.blocks or not target.large_blocks:
        return f"{needed} of {target.blocks} block memories", needed <= target.blocks
    large, rest = large_and_small_blocks(of, target.large_block_shapes, target.block_shapes)
    enough = rest <= target.blocks and large <= target.large_blocks
    return (
        f"{rest} of {target.blocks} block memories, {large} of {target.large_blocks} large ones",
        enough,
    )


# The recommended design: of those whose accuracy was tried, the smallest that is as good as any.


class Tried(NamedTuple):
    """A size of the default design, and its share of correct matches on simulated streets."""

    pixels: int
    code_bits: int
    places_per_window: int
    accuracy: float  #: Mean over the streets.
    #: Standard error of the accuracy: by the spread over the streets, or by the number of windows
    #: as if they were independent of one another, whichever is larger.
    error: float


class Candidate(NamedTuple):
    """A tried size, as a device of a mission."""

    tried: Tried
    device: DesignOnTarget


class Recommendation(NamedTuple):
    """The design that is recommended for a target, and what keeps it from being better."""

    best: Candidate | None  #: None where no design fits.
    #: What the smallest more accurate design exceeds, or where none fits the smallest of all; empty
    #: where there is none.
    limit: str
    #: Of the designs that fit, the one with most correct matches.
    most_correct: Candidate | None = None


#: installed beside this module; in a checkout it is among the results
_TABLES = (
    Path(__file__).with_name("designs.csv"),
    Path(__file__).parents[3] / "docs" / "results" / "designs.csv",
)


@cache
def tried_designs() -> tuple[Tried, ...]:
    """Read the accuracy by pixels, bits and places per window (`python -m lab designs`)."""
    shares: dict[tuple[int, int, int], list[tuple[float, int]]] = {}
    table = next(path for path in _TABLES if path.is_file())
    with table.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            size = int(row["pixels"]), int(row["bits"]), int(row["places per window"])
            shares.setdefault(size, []).append((float(row["P@100R"]), int(row["windows"])))
    return tuple(Tried(*size, *_mean_and_error(of)) for size, of in shares.items())


def _mean_and_error(streets: Sequence[tuple[float, int]]) -> tuple[float, float]:
    """Return the mean share of correct matches, and its standard error.

    The error by the number of windows is that of the rule of succession, so that it is not 0 where
    all matches are correct.
    """
    number, windows = len(streets), sum(n for _, n in streets)
    mean = sum(share for share, _ in streets) / number
    spread = sum((share - mean) ** 2 for share, _ in streets) / max(number - 1, 1) / number
    smoothed = (mean * windows + 1) / (windows + 2)
    return mean, math.sqrt(max(spread, smoothed * (1 - smoothed) / (windows + 3)))


def recommend(
    design: Design, mission: Mission, target: Target, budgets: Sequence[Budget] = ()
) -> Recommendation:
    """Return the smallest tried size that fits and is as accurate as the best one that fits.

    A difference below the standard error of the best one does not count. Among designs of the same
    size it is the more accurate one.

    Parameters
    ----------
    design : Design
        All but pixels, bits, and places per window is taken from it.
    """
    candidates = []
    whole = math.ceil(design.places / design.places_per_window)
    exclusion = design.exclusion // design.places_per_window
    for size in tried_designs():
        number = size.places_per_window
        changed = replace(
            design, pixels=size.pixels, code_bits=size.code_bits, places=whole * number,
            places_per_window=number, exclusion=exclusion * number, lookup_depth=0,
        )  # fmt: skip
        share = min(1.0, mission.selected_share * size.pixels / design.pixels)
        device = on_target(changed, replace(mission, selected_share=share), target, budgets)
        candidates.append(Candidate(size, device))
    fitting = [one for one in candidates if not one.device.limited_by]
    if not fitting:
        smallest = min(candidates, key=lambda one: one.device.memory.total)
        return Recommendation(None, smallest.device.limited_by)
    most_correct = max(fitting, key=lambda one: one.tried.accuracy)
    best = most_correct.tried
    as_good = [one for one in fitting if one.tried.accuracy >= best.accuracy - best.error]
    chosen = min(as_good, key=lambda one: (one.device.memory.total, -one.tried.accuracy))
    better = [one for one in candidates if one.tried.accuracy > best.accuracy]
    limit = ""
    if better:
        limit = min(better, key=lambda one: one.device.memory.total).device.limited_by
    return Recommendation(chosen, limit, most_correct)
