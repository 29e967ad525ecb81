"""An estimate on the terminal: one table, one sentence, and the sources on request."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from edge_vpr_tools.console import number_of, say, table
from edge_vpr_tools.estimate import core_area
from edge_vpr_tools.estimate.fitting import (
    Budget,
    DesignOnTarget,
    Recommendation,
    blocks_of,
    tried_designs,
)
from edge_vpr_tools.estimate.model import Cost, Mission, firmware, search_work, sizes
from edge_vpr_tools.estimate.targets import Constant, Spread, Target, constants
from edge_vpr_tools.report.page import quantity
from firmware_model.design import Design

#: of tables and paragraphs, in columns
WIDTH = 80
#: cells of what is not known, or does not exist, and of a target that does not keep up
UNKNOWN, SLOW = "-", "slow"
#: what every figure of matches per joule includes
MEMORY, ENERGY = ["flash\nKiB", "RAM\nKiB"], "energy\nµJ"
WORK = "the work alone, without the camera and the board at rest"


def size_text(number: float) -> str:
    """Return bytes, in KiB where they are many."""
    return f"{number:,.0f} B" if number < 10_240 else f"{float(f'{number / 1024:.3g}'):,g} KiB"


def short(value: float) -> str:
    """Return three significant digits, below 0.1 two, in few characters for a narrow table.

    Examples
    --------
    >>> short(0.0505), short(24.97), short(5_562.0), short(181_072.0)
    ('0.051', '25', '5,560', '181k')
    """
    value = float(f"{value:.{2 if value < 0.1 else 3}g}")
    for factor, prefix in ((1e6, "M"), (1e3, "k")):
        if value >= 10 * factor:
            return f"{value / factor:,.4g}{prefix}"
    return f"{value:,g}"


def three(value: Spread) -> str:
    """Return the central value with its bounds."""
    return f"{value.central:g} ({value.low:g} to {value.high:g})"


def _memory(of: DesignOnTarget) -> list[str]:
    return [short(of.memory.flash_bytes / 1024) if of.memory.flash_bytes else UNKNOWN,
            short(of.memory.ram_bytes / 1024)]  # fmt: skip


def _time(of: DesignOnTarget) -> str:
    return short(1e3 * of.cost.load.central / of.mission.matches_per_s)


def _energy(of: Cost) -> str:
    return UNKNOWN if of.per_match_j is None else short(1e6 * of.per_match_j.central)


def _per_joule(of: Cost, events_per_s: float) -> str:
    if of.too_slow(events_per_s):
        return SLOW
    return UNKNOWN if of.matches_per_joule is None else short(of.matches_per_joule.central)


def show_design(
    estimates: Mapping[Target, DesignOnTarget],
    at_rates: Mapping[Target, Mapping[float, Cost]],
    rate_is: str,
    budgets: Sequence[Budget],
) -> None:
    """Print what a match of a design takes on each target, against the rate of events.

    Parameters
    ----------
    at_rates : mapping
        Costs on each target by the events per second.
    rate_is : str
        Whose rate the columns of time and energy are for.
    budgets : sequence of Budget
        Limits that were given.
    """
    rates = list(next(iter(at_rates.values())))
    rows = [
        [target.name, f"{of.cost.clock_hz / 1e6:.4g}", *_memory(of), _time(of), _energy(of.cost),
         *(_per_joule(at_rates[target][rate], rate) for rate in rates)]
        for target, of in estimates.items()
    ]  # fmt: skip
    powers = [f"10^{len(str(round(rate))) - 1}\n/s" for rate in rates]
    title = "a match; on the right, matches per joule by events/s (modelled)"
    header = ["target", "MHz", *MEMORY, "time\nms", ENERGY, *powers]
    table(header, rows, title=title, width=WIDTH)
    of = next(iter(estimates.values()))
    *operations, moved = search_work(of.design)
    match_s = 1 / of.mission.matches_per_s
    over = [f"{target.name} ({of.limited_by})" for target, of in estimates.items() if of.limited_by]
    text = (
        f"{design_text(of.design)}. A search of all places takes {sum(operations):,} operations, "
        f"{of.design.places * of.design.slots:,} of them differences of codes, and moves "
        f"{size_text(moved)}. Flash holds the map and the C firmware; all memories of an FPGA are "
        "RAM. Time and energy of a match, with its events, are at "
        f"{of.mission.events_per_s:,.0f} events/s of the whole sensor ({rate_is}), one match every "
        f"{match_s:.3g} s, at an assumed clock. {_energies(estimates.values())}"
    )
    if any(SLOW in row for row in rows):
        text += f" {SLOW}: the device, or the SPI line to an FPGA, may not keep up."
    if over:
        text += f" Over its limits: {', '.join(over)}."
    elif budgets:
        text += " Within the limits."
    if len(estimates) == 1:
        text += _of_one(next(iter(estimates)), of)
    _say(text)


def _energies(estimates: Collection[DesignOnTarget]) -> str:
    """Return what energies include, and how far off they may be by their constants."""
    energies_j = [of.cost.per_match_j for of in estimates if of.cost.per_match_j is not None]
    if not energies_j:
        return "Energy is unknown (--sources)."
    low = min(value.low / value.central for value in energies_j)
    high = max(value.high / value.central for value in energies_j)
    unknown = "; - is unknown" * (len(energies_j) < len(estimates))
    return (
        f"Energy, also in matches per joule, is of {WORK}; it may be {low:.2g} to {high:.2g} times "
        f"this{unknown} (--sources)."
    )


def _of_one(target: Target, of: DesignOnTarget) -> str:
    """Return what a single target shows besides."""
    said = []
    if target.blocks:
        said.append(blocks_of(of.design, target)[0])
    if of.cost.logic_cells is not None:
        said.append(f"{of.cost.logic_cells:,} of {target.logic_cells:,} logic cells (predicted)")
    if of.cost.idle_w is not None:
        said.append(f"{quantity(of.cost.idle_w.central, 'W')} at rest")
    if of.cost.per_match_j is not None:
        value = of.cost.per_match_j
        energy = quantity(value.central, "J", value.low, value.high)
        said.append(f"{energy} per match")
    return f" {target.name}: {', '.join(said)}." if said else ""


def design_text(of: Design) -> str:
    """Return pixels, codes, places, and how a design matches."""
    by = f"sequences of {of.length}"
    if of.filters:
        by = "place filter" + ", places at half windows" * (of.places_per_window == 2)
        by += f", {of.gains} gains" * (of.gains > 1)
    return (
        f"{of.pixels:,} of {of.width} x {of.height} pixels, {number_of(of.code_bits, 'bit')} "
        f"({of.code}), {of.places:,} places of {sizes(of).place_bytes} bytes, packed as on an "
        f"FPGA, {by}"
    )


def show_recommended(
    recommended: Mapping[Target, Recommendation], budgets: Sequence[Budget], mission: Mission
) -> None:
    """Print the design that is recommended for each target within the budgets."""
    rows: list[list[str]] = []
    limits: list[str] = []
    none: list[str] = []
    larger: list[str] = []
    for target, one in recommended.items():
        if one.limit:
            exceeded = f"{target.name} ({one.limit})"
            (none if one.best is None else limits).append(exceeded)
        if one.best is None:
            rows.append([target.name, "none", *["-"] * 6])
            continue
        size, device = one.best
        rows.append(
            [target.name, str(size.pixels), str(size.code_bits),
             f"{device.design.places:,}, {size.places_per_window}",
             *_memory(device), _energy(device.cost),
             f"{size.accuracy:.3f}"]
        )  # fmt: skip
        if one.most_correct is not None and one.most_correct != one.best:
            size, device = one.most_correct
            larger.append(
                f"{target.name} {size.pixels} pixels, {number_of(size.code_bits, 'bit')}, "
                f"{size.places_per_window} per window, {size_text(device.memory.total)} "
                f"({size.accuracy:.3f})"
            )
    not_fitting = f"No design fits: {', '.join(none)}." if none else ""
    if len(none) == len(recommended):
        _say(not_fitting)
        return
    header = ["target", "pixels", "bits", "places,\na window", *MEMORY, ENERGY, "correct"]
    table(header, rows, width=WIDTH)
    text = (
        f"The smallest of {len(tried_designs())} designs within "
        f"{' and '.join(budget.text for budget in budgets)} whose share of correct live matches "
        "(of all, to 10 m, on three simulated streets) is within a standard error of the best that "
        "fits; a longer route has more places that look alike. "
    )
    text += f"Energy of a match is modelled, of {WORK}, at {mission.events_per_s:,.0f} events/s."
    if larger:
        text += f" Most correct of those that fit: {'; '.join(larger)}."
    if limits:
        text += f" A better one exceeds: {', '.join(limits)}."
    _say(f"{text} {not_fitting}")


def show_sources(targets: Sequence[Target]) -> None:
    """Print a sentence for each assumption, and for each cited constant."""
    cited: list[Constant] = []
    for target in targets:
        if target.kind == "processor":
            compiler, cpi = firmware()[target.core].compiler, three(Spread(*target.cpi))
            _say(
                f"{target.name}: instructions of the reference firmware ({compiler}, "
                f"{target.core}) at {target.clock_hz / 1e6:,.0f} MHz; cycles per instruction "
                f"{cpi}: {target.cpi_source}"
            )
        if target.logic_cells:
            furthest = max(map(abs, core_area.errors().values()))
            _say(
                f"{target.name}: logic cells are predicted from {len(core_area.FITTED_ON)} "
                f"netlists of the hardware core; of {len(core_area.CHECKED_ON)} others they were "
                f"{furthest:.1%} off at most"
            )
        if target.note:
            _say(f"{target.name}: {target.note}")
        if target.unknown:
            _say(f"{target.name}: {target.unknown}")
        names = (target.cycle_energy, target.cell_energy, target.idle_power)
        cited += [constants()[name] for name in names if name]
    for constant in dict.fromkeys(cited):
        _say(
            f"modelled, {constant.name}: {three(constant.value)} {constant.unit} (year "
            f"{constant.year}, {constant.node}): {constant.source}; {constant.uncertainty}"
        )


def _say(text: str) -> None:
    say(text, width=WIDTH)
