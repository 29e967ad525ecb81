"""How an estimate is shown: tables on the terminal, and plain values for programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from edge_vpr_tools.estimate.counts import block_memories, large_and_small_blocks, sizes
from edge_vpr_tools.estimate.fit import Budget, Fit, broken_by, memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission, cost, firmware
from edge_vpr_tools.estimate.model import work as work_of
from edge_vpr_tools.estimate.targets import Constant, Spread, Target
from edge_vpr_tools.report.quantities import quantity
from firmware_model.design import Design

UNKNOWN = "unknown"
if TYPE_CHECKING:
    from edge_vpr_tools.estimate.pareto import Candidate

_WIDTH = 118
#: rows of a table of designs
_SHOWN = 12


def matching(of: Design) -> str:
    """Say how a design matches."""
    if not of.filters:
        return f"sequences of {of.length}"
    kept = "kept" if of.keep_distances else "computed twice"
    return f"place filter of {len(of.steps) + len(of.back)} steps (distances {kept})"


def design(of: Design, mission: Mission, places_per_metre: float) -> None:
    """Print the design, its sizes, and the mission that the rates are for."""
    size = sizes(of)
    route_m = of.places / places_per_metre
    say(
        f"{of.pixels} of {of.width} x {of.height} pixels, {of.slots} counters, codes of "
        f"{of.code_bits} bits ({of.code}), {of.places:,} places, {matching(of)}"
    )
    say(
        f"{size.place_bytes} bytes a place, {size_text(1e3 * places_per_metre * size.place_bytes)} "
        f"a km at {places_per_metre:g} places a metre ({route_m / 1000:g} km); all memories "
        f"{size_text(size.packed_bytes)} packed; firmware in C, a byte a code: flash "
        f"{size_text(size.flash_bytes)} of tables, RAM {size_text(size.ram_bytes)}"
    )
    say(
        f"at {mission.events_per_s:,.0f} events a second, {mission.selected_share:.3%} of them at "
        f"selected pixels, and {mission.matches_per_s:g} matches a second"
    )


def work(of: Design, mission: Mission) -> None:
    """Print the exact counts."""
    units, rates = work_of(of), mission.rates
    header = ["exact counts", *units, "per second"]
    rows = []
    for name in next(iter(units.values())).operations:
        each = [unit.operations[name] for unit in units.values()]
        total = sum(n * rate for n, rate in zip(each, rates.values(), strict=True))
        rows.append([name, *(f"{n:,}" for n in each), f"{total:,.0f}"])
    for name, of_unit in (("bytes read", "bytes_read"), ("bytes written", "bytes_written")):
        sums = [getattr(unit, of_unit) for unit in units.values()]
        total = sum(n * rate for n, rate in zip(sums, rates.values(), strict=True))
        rows.append([name, *(f"{n:,.6g}" for n in sums), f"{total:,.0f}"])
        memories = sorted({memory for unit in units.values() for memory in unit.traffic})
        for memory in memories:
            parts = [unit.traffic.get(memory) for unit in units.values()]
            each_bytes = [0.0 if part is None else getattr(part, of_unit) for part in parts]
            if any(each_bytes):
                total = sum(n * r for n, r in zip(each_bytes, rates.values(), strict=True))
                rows.append([f"  {memory}", *(f"{n:,.6g}" for n in each_bytes), f"{total:,.0f}"])
    table(header, rows)


def costs(
    of: Design, targets: Sequence[Target], mission: Mission, measured: Constant | None
) -> None:
    """Print what each target takes: instructions, time, and modelled energy."""
    rows = []
    for target in targets:
        found = cost(of, target, mission, measured)
        told = found.instructions
        rows.append(
            [
                target.name,
                _instructions(told, "selected event", found),
                _instructions(told, "match", found),
                quantity(found.seconds["match"].central, "s"),
                busy(found.load),
                _energy(found, "match"),
                _watts(found.marginal_w),
                _watts(found.idle_w),
                _fits_in(of, target),
            ]
        )
    table(
        ["target", "event", "match", "time of a match", "busy", "energy of a match (modelled)",
         "added power (modelled)", "power at rest", "memory"],
        rows,
    )  # fmt: skip
    say("event and match: i are instructions, c are clock cycles")


def units(of: Design, target: Target, mission: Mission, measured: Constant | None) -> None:
    """Print what each unit of work takes on one target, and a second of the mission."""
    found = cost(of, target, mission, measured)
    rows = []
    for unit in found.cycles:
        told = "-" if found.instructions is None else f"{found.instructions[unit]:,.0f}"
        rows.append(
            [unit, told, count(found.cycles[unit]), spread(found.seconds[unit], "s"),
             UNKNOWN if found.energy_j is None else spread(found.energy_j[unit], "J")]
        )  # fmt: skip
    told = "-"
    if found.instructions is not None:
        each = found.instructions
        told = f"{sum(each[unit] * rate for unit, rate in mission.rates.items()):,.0f}"
    every_second = _sum(found.cycles, mission)
    rows.append(
        ["a second of the mission", told, count(every_second), spread(found.load, "s"),
         UNKNOWN if found.marginal_w is None else spread(found.marginal_w, "J")]
    )  # fmt: skip
    table([target.name, "instructions", "cycles", "time", "energy (modelled)"], rows)


def _sum(of_unit: Mapping[str, Spread], mission: Mission) -> Spread:
    total = Spread(0.0, 0.0, 0.0)
    for unit, rate in mission.rates.items():
        total = total + of_unit[unit] * rate
    return total


def fits(found: Sequence[Fit], of: Design, target: Target, budgets: Sequence[Budget]) -> None:
    """Print the largest designs within the budgets."""
    limits = " and ".join(budget.text for budget in budgets)
    rows = [
        ["-" if fit.parameter == "code_bits" else f"{fit.code_bits} bit{'s' * (fit.code_bits > 1)}",
         fit.parameter.replace("code_bits", "bits a code"),
         f"{fit.value:,}" if fit.value else "none", fit.limited_by]
        for fit in found
    ]  # fmt: skip
    say(
        f"within {limits} on {target.name}: the largest J with K = {of.places:,}; the largest K "
        f"with J = {of.pixels}; the most bits with both"
    )
    table(["code", "parameter", "largest", "limited by"], rows)
    if target.kind == "processor":
        say("the firmware in C keeps a byte a code, so that fewer bits save it no memory")
    if any(b.quantity == "watts" for b in budgets) and not target.idle_power:
        say("the budget of power is held against what the work adds: power at rest is unknown")
    say("how well such a design recognises places is not estimated: --accuracy-on tries it")


def candidates(found: Sequence[Candidate]) -> None:
    """Print evaluated designs by accuracy: the best ones, and the best that fits."""
    fitting = [one for one in found if not one.limited_by]
    shown = found if len(found) <= _SHOWN else [*found[:_SHOWN]]
    if fitting and fitting[0] not in shown:
        shown = [*shown, fitting[0]]
    rows = [
        [one.name, f"{one.accuracy:.3f}", f"{one.design.pixels}", f"{one.design.code_bits}",
         f"{one.design.places:,}", size_text(one.memory_bytes), joules(one.cost.per_match_j),
         one.limited_by or "fits"]
        for one in shown
    ]  # fmt: skip
    table(
        ["evaluated", "P@100R", "J", "bits", "K", "memory", "energy a match (modelled)",
         "limited by"],
        rows,
    )  # fmt: skip
    if len(shown) < len(found):
        say(f"and {len(found) - len(shown)} more, less often right (all of them by --json)")


def basis(
    of: Design, targets: Sequence[Target], mission: Mission, measured: Constant | None
) -> None:
    """Print what is assumed, what is modelled from which source, and what is unknown."""
    cited: dict[Constant, None] = {}
    for target in targets:
        if target.kind == "processor":
            told = firmware()[target.core]
            say(
                f"{target.name}: instructions of the reference firmware ({told.compiler}, "
                f"{target.core}); cycles an instruction {_three(target.cpi)}: {target.cpi_source}"
            )
        if target.note:
            say(f"{target.name}: {target.note}")
        if target.unknown and measured is None:
            remedy = "; --calibrate takes a profile of your board"
            say(f"{target.name}: {target.unknown}" + remedy * (target.kind == "processor"))
        cited |= dict.fromkeys(cost(of, target, mission, measured).basis)
    for constant in cited:
        say(
            f"modelled, {constant.name}: {_three(asdict(constant.value).values())} "
            f"{constant.unit} (year {constant.year}, {constant.node}): {constant.source}; "
            f"{constant.uncertainty}"
        )


def as_dict(
    of: Design,
    targets: Sequence[Target],
    mission: Mission,
    found: Sequence[Fit],
    measured: Constant | None,
) -> dict[str, Any]:
    """Everything as plain values."""
    return {
        "schema": 1,
        "design": of.to_dict(),
        "mission": asdict(mission),
        "sizes": asdict(sizes(of)),
        "counts": {name: asdict(unit) for name, unit in work_of(of).items()},
        "targets": {t.name: {"energy_is": "modelled"} | asdict(cost(of, t, mission, measured))
                    for t in targets},
        "fit": [asdict(fit) for fit in found],
    }  # fmt: skip


def _fits_in(of: Design, target: Target) -> str:
    if target.kind == "processor":
        limit = broken_by(of, target, Mission(0.0, 0.0, 1.0), ())
        return size_text(memory_bytes(of, target)) + (f": over {limit}" if limit else "")
    if not target.blocks:
        return size_text(sizes(of).packed_bytes)
    needed = block_memories(of, target.block_shapes)
    if needed <= target.blocks:
        return f"{needed} of {target.blocks} blocks"
    if target.large_blocks:
        large, rest = large_and_small_blocks(of, target.large_block_shapes, target.block_shapes)
        return f"{rest} of {target.blocks} blocks, {large} of {target.large_blocks} large" + (
            "" if rest <= target.blocks and large <= target.large_blocks else ": too many"
        )
    return f"{needed} of {target.blocks} blocks: too many"


def _instructions(told: dict[str, float] | None, unit: str, found: Cost) -> str:
    if told is not None:
        return f"{told[unit]:,.0f} i"
    return f"{found.cycles[unit].central:,.0f} c"


def busy(load: Spread) -> str:
    """Tell the share of the time that a target is busy, and where it cannot keep up."""
    if load.low >= 1:
        return "overloaded"
    return f"{load.central:.3%}" if load.high < 1 else f"{load.central:.0%}: may be overloaded"


def _energy(found: Cost, unit: str) -> str:
    return UNKNOWN if found.energy_j is None else spread(found.energy_j[unit], "J")


def joules(value: Spread | None) -> str:
    """Tell an energy, or that it is unknown."""
    return UNKNOWN if value is None else spread(value, "J")


def _watts(value: Spread | None) -> str:
    return UNKNOWN if value is None else spread(value, "W")


def spread(value: Spread, unit: str) -> str:
    """Central, and low to high, in one unit that suits the central value."""
    return quantity(value.central, unit, value.low, value.high)


def _three(values: Iterable[float]) -> str:
    low, central, high = values
    return f"{central:g} ({low:g} to {high:g})"


def times(theirs: float, ours: float) -> str:
    """Tell how many times ours theirs is."""
    return f"{theirs / ours:,.3g}" if ours else "-"


def size_text(number: float) -> str:
    """Tell bytes, in KiB where they are many."""
    return f"{number:,.0f} B" if number < 10_240 else f"{number / 1024:,.1f} KiB"


def say(text: str) -> None:
    """Print a line."""
    _console().print(text, highlight=False, markup=False)


def count(value: Spread) -> str:
    """Tell cycles: central, and low to high."""
    if value.low == value.high:
        return f"{value.central:,.0f}"
    return f"{value.central:,.0f} ({value.low:,.0f} to {value.high:,.0f})"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table."""
    shown = Table()
    for i, title in enumerate(header):
        shown.add_column(title, justify="left" if i == 0 else "right")
    for row in rows:
        shown.add_row(*row)
    _console().print(shown)


def _console() -> Console:
    return Console() if Console().is_terminal else Console(width=_WIDTH)
