"""The search for a design: evaluated designs, and those that fit a budget."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from edge_vpr import results
from edge_vpr.archive import archive_errors
from edge_vpr.errors import MapError, UsageError
from edge_vpr.files import read_json
from edge_vpr.reference_map import ReferenceMap
from edge_vpr.results import from_json
from edge_vpr_tools.estimate.model import (
    Cost,
    Mission,
    block_memories,
    cost,
    firmware,
    large_and_small_blocks,
    sizes,
)
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.targets import Constant, Target
from firmware_model.design import Design
from firmware_model.errors import DesignError
from firmware_model.image import check_limits

# The largest design that stays within budgets of memory and power, and what limits it.


_UNITS = {
    "b": ("bytes", 1.0), "kb": ("bytes", 1e3), "mb": ("bytes", 1e6),
    "kib": ("bytes", 1024.0), "mib": ("bytes", 1024.0**2),
    "uw": ("watts", 1e-6), "µw": ("watts", 1e-6), "mw": ("watts", 1e-3), "w": ("watts", 1.0),
}  # fmt: skip
FIRMWARE_LIMITS = "the firmware's widths"
BLOCKS, LOGIC_CELLS, SPEED = "its block memories", "its logic cells", "its speed"
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
        form = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Zµ]+)\s*", text)
        if form and form[2].lower() in _UNITS and float(form[1]) > 0:
            quantity, factor = _UNITS[form[2].lower()]
            return cls(text, quantity, float(form[1]) * factor)
        raise UsageError(f"budget {text!r}: expected memory or power, such as 64KiB or 10mW")


@dataclass(frozen=True)
class Fit:
    """The largest value of one parameter, the others as given."""

    matching: str  #: How the design matches.
    parameter: str  #: {"pixels", "places", "code_bits"}: which one is largest.
    code_bits: int  #: Bits of a counter code.
    value: int  #: 0 if not even one fits.
    limited_by: str  #: The budget, or the range of the parameter.


@dataclass(frozen=True)
class DesignOnTarget:
    """A design on a target, with what it takes there."""

    design: Design
    mission: Mission
    cost: Cost
    memory_bytes: int
    limited_by: str  #: What keeps it from fitting; empty if it fits.


@dataclass(frozen=True)
class Limits:
    """A target, and the budgets that a design must keep there."""

    target: Target
    budgets: Sequence[Budget] = ()
    cycle_energy: Constant | None = None  #: See `cost`.
    #: Keep the distances of the place filter where the memory allows it, which takes less time and
    #: energy than to compute them twice; else do as the design says.
    choose_distances: bool = False

    def variants(self, design: Design) -> tuple[Design, ...]:
        """Return a design as it may be built, the preferred one first."""
        if not (self.choose_distances and design.filters):
            return (design,)
        return tuple(replace(design, keep_distances=kept) for kept in (True, False))


def memory_bytes(design: Design, target: Target) -> int:
    """Return the memory that a budget is held against.

    On a processor it is what the reference firmware in C takes, flash and RAM with code and stack;
    on others it is all memories, packed.
    """
    if target.kind != "processor":
        return sizes(design).packed_bytes
    program, size = firmware()[target.core], sizes(design)
    return size.flash_bytes + size.ram_bytes + program.code_bytes + program.stack_bytes


def fit(design: Design, mission: Mission, limits: Limits) -> list[Fit]:
    """Find the largest J, and the largest K, for some numbers of bits per code; and the most bits.

    Parameters
    ----------
    mission : Mission
        Its share of selected events grows with J.
    """

    def broken(candidate: Design) -> str:
        share = min(1.0, mission.selected_share * candidate.pixels / design.pixels)
        scaled = replace(mission, selected_share=share)
        return _best_variant(candidate, scaled, limits)[1]

    # the firmware in C keeps a byte a code, so that fewer bits save a processor nothing
    packed = limits.target.kind != "processor"
    most_pixels, found = min(design.width * design.height, 1 << 15), []
    for bits in _BITS if packed else (design.code_bits,):
        found.append(_largest(design, bits, "pixels", 1, most_pixels, broken))
        found.append(_largest(design, bits, "places", design.length, 1 << 20, broken))
    widest = _largest(design, design.code_bits, "code_bits", 1, MOST_BITS, broken)
    return [*found, replace(widest, code_bits=widest.value or design.code_bits)]


def on_target(design: Design, mission: Mission, limits: Limits) -> DesignOnTarget:
    """Take a design to a target, and see whether it fits."""
    chosen, limit = _best_variant(design, mission, limits)
    of = cost(chosen, limits.target, mission, limits.cycle_energy)
    return DesignOnTarget(chosen, mission, of, memory_bytes(chosen, limits.target), limit)


def _best_variant(design: Design, mission: Mission, limits: Limits) -> tuple[Design, str]:
    """Return the first variant that fits, or else the last one, and what it exceeds."""
    for chosen in limits.variants(design):
        limit = broken_by(chosen, mission, limits)
        if not limit:
            break
    return chosen, limit


def broken_by(design: Design, mission: Mission, limits: Limits) -> str:
    """Return which budget or limit of the target a design exceeds; empty if none.

    Raises
    ------
    UsageError
        If a budget of power is given and the target's is unknown.
    """
    target = limits.target
    if target.kind == "processor":
        try:
            check_limits(design)
        except DesignError:
            return FIRMWARE_LIMITS
    elif target.blocks and not blocks_of(design, target)[1]:
        return BLOCKS
    of = cost(design, target, mission, limits.cycle_energy)
    if of.logic_cells is not None and of.logic_cells > target.logic_cells:
        return LOGIC_CELLS
    if of.load.low >= 1:
        return SPEED
    for budget in limits.budgets:
        if budget.quantity == "bytes":
            used: float = memory_bytes(design, target)
        else:
            # a board that takes more at rest needs no figure for its work
            at_rest = of.whole_w is None and of.idle_w is not None and of.idle_w.low > budget.limit
            used = budget.limit + 1 if at_rest else _watts(of, target)
        if used > budget.limit:
            return budget.text
    return ""


def blocks_of(of: Design, target: Target) -> tuple[str, bool]:
    """Return the block memories that a design takes, and whether there are as many."""
    needed = block_memories(of, target.block_shapes)
    if needed <= target.blocks or not target.large_blocks:
        return f"{needed} of {target.blocks} blocks", needed <= target.blocks
    large, rest = large_and_small_blocks(of, target.large_block_shapes, target.block_shapes)
    enough = rest <= target.blocks and large <= target.large_blocks
    return f"{rest} of {target.blocks} blocks, {large} of {target.large_blocks} large", enough


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
            return Fit(design.matching, parameter, bits, 0, limit)
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
    return Fit(design.matching, parameter, bits, low, limit)


# Evaluated designs as devices of a mission, and the most accurate one that fits.


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Accuracy of a map on two drives."""

    name: str  #: Of its folder, or its size.
    accuracy: float  #: Share of the queries that are correct when every one is matched (P@100R).
    queries: int  #: That were evaluated.
    reference: ReferenceMap


class Accuracy(NamedTuple):
    """The part of the result of `edge-vpr evaluate` that is needed here."""

    precision_at_100_recall: float
    queries: int


class Metrics(NamedTuple):
    """The part of `metrics.json` that has the accuracy; None before an evaluation."""

    evaluation: Accuracy | None = None


@dataclass(frozen=True)
class Candidate(DesignOnTarget):
    """One evaluated map, as a device.

    Its design has as many places as the mission's route, if that is given; or twice as many, with
    two per window.
    """

    #: name, accuracy, queries: see `Evaluated`.
    name: str
    accuracy: float
    queries: int
    own_places: int  #: Of its map, among which it was that accurate.

    @property
    def error(self) -> float:
        """Standard error of the accuracy, as if the queries were independent of one another.

        By the rule of succession, so that it is not 0 where all queries are correct.
        """
        share = (self.accuracy * self.queries + 1) / (self.queries + 2)
        return math.sqrt(share * (1 - share) / (self.queries + 3))


class Recommendation(NamedTuple):
    """The design that is recommended for a target, and what keeps it from being better."""

    design: Candidate | None  #: None where no design fits.
    #: The budget or limit that a design breaks which is more accurate by a standard error, or that
    #: the smallest one breaks where none fits; empty where there is none.
    limit: str


def evaluation_of(metrics: Path) -> tuple[float, int] | None:
    """Read P@100R and the number of queries of a run; None if it was not evaluated.

    Raises
    ------
    MapError
        If the file is damaged.
    """
    remedy = "match and evaluate again"
    values = read_json(metrics, "metrics", remedy)
    with archive_errors(metrics, remedy):
        evaluation = from_json(Metrics, values).evaluation
        if evaluation is None:
            return None
        precision, queries = evaluation.precision_at_100_recall, evaluation.queries
        if not 0 <= precision <= 1 or queries < 1:
            raise MapError(f"P@100R is {precision} of {queries} queries")
    return precision, queries


def evaluated_runs(folder: Path) -> list[Evaluated]:
    """Find every evaluated run below a folder.

    Raises
    ------
    UsageError
        If there is none.
    MapError
        If the metrics of one are damaged.
    """
    found = []
    for metrics in sorted(folder.rglob(results.METRICS)):
        if not (metrics.parent / results.MAP).is_file():
            continue
        evaluation = evaluation_of(metrics)
        if evaluation is not None:
            reference = ReferenceMap.load(metrics.parent / results.MAP)
            found.append(Evaluated(str(metrics.parent), *evaluation, reference))
    if not found:
        raise UsageError(f"no evaluated run in {folder}: edge-vpr match, then edge-vpr evaluate")
    return found


def candidates(
    evaluated: Iterable[Evaluated],
    limits: Limits,
    *,
    places: int | None = None,
    matches_per_s: float | None = None,
    events_per_s: float | None = None,
) -> list[Candidate]:
    """Take evaluated maps as devices of a mission, best accuracy first, then the smallest.

    Parameters
    ----------
    places : int, optional
        Of the mission's route at one per window, instead of each map's.
    matches_per_s, events_per_s : float, optional
        By default one a window, and those of the reference drive.

    Raises
    ------
    UsageError
        If no device of this kind could be, or a budget of power cannot be held against this target.
    """
    found = []
    for one in evaluated:
        reference = one.reference
        rate, share = event_rates(reference)
        try:
            design = design_of(reference)
            if places is not None:
                design = replace(design, places=places * reference.settings.window_parts)
        except DesignError as error:
            raise UsageError(f"{one.name}: {error}") from error
        windows_s = int((reference.places.end_us - reference.places.start_us).sum()) / 1e6
        a_second = matches_per_s or len(reference) / max(windows_s, 1e-6)
        device = on_target(design, Mission(events_per_s or rate, share, a_second), limits)
        found.append(
            Candidate(
                **vars(device),
                name=one.name,
                accuracy=one.accuracy,
                queries=one.queries,
                own_places=len(reference),
            )
        )
    return sorted(found, key=lambda one: (-one.accuracy, one.memory_bytes))


def recommend(found: Sequence[Candidate]) -> Recommendation:
    """Return the smallest design that fits and is as accurate as the most accurate one that fits.

    A difference below the standard error of the most accurate one does not count. Among designs of
    the same size it is the more accurate one.
    """
    fitting = [one for one in found if not one.limited_by]
    if not fitting:
        return Recommendation(None, min(found, key=lambda one: one.memory_bytes).limited_by)
    best = max(fitting, key=lambda one: one.accuracy)
    least = best.accuracy - best.error
    as_good = [one for one in fitting if one.accuracy >= least]
    chosen = min(as_good, key=lambda one: (one.memory_bytes, -one.accuracy))
    better = [one for one in found if one.accuracy > best.accuracy + best.error]
    # what keeps the smallest of the better ones from fitting
    limit = min(better, key=lambda one: one.memory_bytes).limited_by if better else ""
    return Recommendation(chosen, limit)
