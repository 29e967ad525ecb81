"""The largest design that stays within budgets of memory and power, and what limits it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from edge_vpr.errors import UsageError
from edge_vpr_tools.estimate.counts import sizes
from edge_vpr_tools.estimate.model import Cost, Mission, cost, firmware
from edge_vpr_tools.estimate.targets import Constant, Target
from firmware_model.design import Design
from firmware_model.errors import DesignError
from firmware_model.image import check_limits

_UNITS = {
    "b": ("bytes", 1.0), "kb": ("bytes", 1e3), "mb": ("bytes", 1e6),
    "kib": ("bytes", 1024.0), "mib": ("bytes", 1024.0**2),
    "uw": ("watts", 1e-6), "mw": ("watts", 1e-3), "w": ("watts", 1.0),
}  # fmt: skip
FIRMWARE_LIMITS = "the firmware's widths"
#: bits of a code, for which J and K are searched; and the most that a code has
_BITS = (8, 6, 4, 3, 2, 1)
MOST_BITS = 8


@dataclass(frozen=True)
class Budget:
    """An upper limit in bytes of memory, or in watts."""

    text: str
    quantity: str
    limit: float

    @classmethod
    def parse(cls, text: str) -> Budget:
        """Read ``64KiB`` or ``10mW``.

        Raises
        ------
        UsageError
            If it is neither.
        """
        form = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Z]+)\s*", text)
        if form and form[2].lower() in _UNITS and float(form[1]) > 0:
            quantity, factor = _UNITS[form[2].lower()]
            return cls(text, quantity, float(form[1]) * factor)
        raise UsageError(f"budget {text!r}: expected memory or power, such as 64KiB or 10mW")


@dataclass(frozen=True)
class Fit:
    """The largest value of one parameter, the others as given.

    Attributes
    ----------
    parameter : {"pixels", "places", "code_bits"}
    code_bits : int
    value : int
        0 if not even one fits.
    limited_by : str
        The budget, or the range of the parameter.
    """

    parameter: str
    code_bits: int
    value: int
    limited_by: str


def memory_bytes(design: Design, target: Target) -> int:
    """Memory that a budget is held against.

    On a processor what the reference firmware in C takes, flash and RAM with code and stack; on
    others all memories, packed.
    """
    if target.kind != "processor":
        return sizes(design).packed_bytes
    told, size = firmware()[target.core], sizes(design)
    return size.flash_bytes + size.ram_bytes + told.code_bytes + told.stack_bytes


def fit(
    design: Design,
    target: Target,
    mission: Mission,
    budgets: Sequence[Budget],
    cycle_energy: Constant | None = None,
) -> list[Fit]:
    """Find the largest J, and the largest K, for some numbers of bits a code; and the most bits.

    Parameters
    ----------
    design : Design
        The parameters that are not searched.
    target : Target
    mission : Mission
        Its share of selected events grows with J.
    budgets : sequence of Budget
        All must hold.
    cycle_energy : Constant, optional
        See `cost`.

    Raises
    ------
    UsageError
        If a budget of power is given and the target's is unknown.
    """

    def broken(candidate: Design) -> str:
        share = min(1.0, mission.selected_share * candidate.pixels / design.pixels)
        scaled = replace(mission, selected_share=share)
        return broken_by(candidate, target, scaled, budgets, cycle_energy)

    # the firmware in C keeps a byte a code, so that fewer bits save a processor nothing
    packed = target.kind != "processor"
    most_pixels, found = min(design.width * design.height, 1 << 15), []
    for bits in _BITS if packed else (design.code_bits,):
        found.append(_largest(design, bits, "pixels", 1, most_pixels, broken))
        found.append(_largest(design, bits, "places", design.length, 1 << 20, broken))
    widest = _largest(design, design.code_bits, "code_bits", 1, MOST_BITS, broken)
    return [*found, replace(widest, code_bits=widest.value or design.code_bits)]


def broken_by(
    design: Design,
    target: Target,
    mission: Mission,
    budgets: Sequence[Budget],
    cycle_energy: Constant | None = None,
) -> str:
    """Return which budget or limit of the firmware a design exceeds; empty if none.

    Raises
    ------
    UsageError
        If a budget of power is given and the target's is unknown.
    """
    if target.kind == "processor":
        try:
            check_limits(design)
        except DesignError:
            return FIRMWARE_LIMITS
    for budget in budgets:
        if budget.quantity == "bytes":
            used: float = memory_bytes(design, target)
        else:
            of = cost(design, target, mission, cycle_energy)
            # a board that takes more at rest needs no figure for its work
            at_rest = of.whole_w is None and of.idle_w is not None and of.idle_w.low > budget.limit
            used = budget.limit + 1 if at_rest else _watts(of, target)
        if used > budget.limit:
            return budget.text
    return ""


def _watts(of: Cost, target: Target) -> float:
    total = of.whole_w or of.marginal_w
    if total is None:
        remedy = "take another target, or name no budget of power"
        if target.kind == "processor":
            remedy = "calibrate with a profile of your board (--calibrate)"
        raise UsageError(
            f"the power of {target.name} is unknown, so that no budget of it can be met: {remedy}"
        )
    return total.central


def _changed(design: Design, bits: int, name: str, value: int) -> Design:
    values = design.to_dict() | {"code_bits": bits, "lookup_depth": 0, name: value}
    if design.code == "linear":
        values["full_scales"] = [0]
    return Design.from_dict(values)


def _largest(
    design: Design,
    bits: int,
    parameter: str,
    least: int,
    most: int,
    broken: Callable[[Design], str],
) -> Fit:
    """Bisect: memory and power grow with J and with K."""
    try:
        limit = broken(_changed(design, bits, parameter, least))
        if limit:
            return Fit(parameter, bits, 0, limit)
        low, high = least, most + 1
        limit = f"range up to {most}"
        while high - low > 1:
            middle = (low + high) // 2
            why = broken(_changed(design, bits, parameter, middle))
            if why:
                high, limit = middle, why
            else:
                low = middle
    except DesignError as error:
        raise UsageError(str(error)) from error
    return Fit(parameter, bits, low, limit)
