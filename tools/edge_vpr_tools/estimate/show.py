"""An estimate on the terminal: one table, one sentence, and the sources on request."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from edge_vpr_tools.console import say, table
from edge_vpr_tools.estimate import core_area
from edge_vpr_tools.estimate.model import Cost, Mission, firmware, search_work, sizes
from edge_vpr_tools.estimate.search import (
    Budget,
    DesignOnTarget,
    Recommendation,
    blocks_of,
    tried_designs,
)
from edge_vpr_tools.estimate.targets import Constant, Spread, Target
from edge_vpr_tools.report.page import quantity
from firmware_model.design import Design

#: of tables and paragraphs, in columns
WIDTH = 80
UNKNOWN = "unknown"
#: what every figure of matches per joule includes
WORK = "the work alone, without the camera and the board at rest"


def size_text(number: float) -> str:
    """Return bytes, in KiB where they are many."""
    return f"{number:,.0f} B" if number < 10_240 else f"{number / 1024:,.3g} KiB"


def three(value: Spread) -> str:
    """Return the central value with its bounds."""
    return f"{value.central:g} ({value.low:g} to {value.high:g})"


def per_joule(of: Cost) -> str:
    """Return the matches per joule of the work for a cell of a table."""
    if of.load.low >= 1:
        return "too slow"
    if of.matches_per_joule is None:
        return "-"
    value = of.matches_per_joule.central
    return f"{float(f'{value:.3g}'):,.{0 if value >= 100 else 1}f}"


def _time(of: DesignOnTarget) -> str:
    if of.cost.load.low >= 1:
        return "too slow"
    return quantity(of.cost.load.central / of.mission.matches_per_s, "s")


def _energy(of: Cost) -> str:
    return UNKNOWN if of.per_match_j is None else quantity(of.per_match_j.central, "J")


def show_design(
    found: Mapping[Target, DesignOnTarget],
    at_rates: Mapping[Target, Mapping[float, Cost]],
    rate_is: str,
    budgets: Sequence[Budget] = (),
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
        [target.name, size_text(of.memory_bytes), _time(of), _energy(of.cost),
         *(per_joule(at_rates[target][rate]) for rate in rates)]
        for target, of in found.items()
    ]  # fmt: skip
    powers = [f"10^{len(str(round(rate))) - 1}/s" for rate in rates]
    title = "a match; on the right, matches per joule by events/s (modelled)"
    table(["target", "memory", "time", "energy", *powers], rows, title=title, width=WIDTH)
    of = next(iter(found.values()))
    *operations, moved = search_work(of.design)
    match_s = 1 / of.mission.matches_per_s
    over = [f"{target.name} ({of.limited_by})" for target, of in found.items() if of.limited_by]
    text = (
        f"{design_text(of.design)}. The search takes {sum(operations):,} operations, "
        f"{of.design.places * of.design.slots:,} of them differences of codes, and moves "
        f"{size_text(moved)}. Matches per joule are of {WORK}, by the events per second of the "
        "whole sensor; time and energy of a match, with its events, are at "
        f"{of.mission.events_per_s:,.0f} events/s ({rate_is}), one match each {match_s:.3g} s"
        f"{_within(found.values())}."
    )
    if over:
        text += f" Over its limits: {', '.join(over)}."
    elif budgets:
        text += f" Within the limits.{_not_at_rest(found, budgets)}"
    if len(found) == 1:
        text += _of_one(next(iter(found)), of)
    say(text, width=WIDTH)


def _within(found: Iterable[DesignOnTarget]) -> str:
    """Return how far the energies may be off by the spread of their constants."""
    known = [of.cost.per_match_j for of in found if of.cost.per_match_j is not None]
    if not known:
        return ""
    low = min(value.low / value.central for value in known)
    high = max(value.high / value.central for value in known)
    return f"; energies may be {low:.2g} to {high:.2g} times these (--sources)"


def _not_at_rest(found: Mapping[Target, DesignOnTarget], budgets: Sequence[Budget]) -> str:
    """Return which devices keep a limit of power by their work alone."""
    power = [budget.text for budget in budgets if budget.quantity == "watts"]
    names = [target.name for target, of in found.items() if of.cost.idle_w is None]
    if not power or not names:
        return ""
    return f" Power at rest is unknown, and not held against {power[0]}: {', '.join(names)}."


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
    return (
        f"{of.pixels:,} of {of.width} x {of.height} pixels, {of.code_bits} "
        f"bit{'s' * (of.code_bits > 1)} ({of.code}), {sizes(of).place_bytes} bytes per place "
        f"packed, {of.places:,} places, {by}"
    )


def show_recommended(
    found: Mapping[Target, Recommendation],
    budgets: Sequence[Budget],
    mission: Mission,
) -> None:
    """Print the design that is recommended for each target within the budgets."""
    rows: list[list[str]] = []
    limits: list[str] = []
    none: list[str] = []
    larger: list[str] = []
    for target, one in found.items():
        if one.limit:
            exceeded = f"{target.name} ({one.limit})"
            (none if one.best is None else limits).append(exceeded)
        if one.best is None:
            rows.append([target.name, "none", "-", "-", "-", "-", "-"])
            continue
        size, device = one.best
        rows.append(
            [target.name, str(size.pixels), str(size.code_bits),
             f"{device.design.places:,}, {size.places_per_window}",
             size_text(device.memory_bytes), _energy(device.cost), f"{size.accuracy:.3f}"]
        )  # fmt: skip
        if one.most_correct is not None and one.most_correct != one.best:
            size, device = one.most_correct
            larger.append(
                f"{target.name} {size.pixels} pixels, {size.code_bits} bits, "
                f"{size.places_per_window} per window, {size_text(device.memory_bytes)} "
                f"({size.accuracy:.3f})"
            )
    not_fitting = f"No design fits: {', '.join(none)}." if none else ""
    if len(none) == len(found):
        _say(not_fitting)
        return
    header = ["target", "pixels", "bits", "places,\nper window", "memory", "energy", "correct"]
    table(header, rows, width=WIDTH)
    text = (
        f"The smallest of {len(tried_designs())} designs within "
        f"{' and '.join(budget.text for budget in budgets)} whose share of correct matches on "
        "three simulated streets is within a standard error of the best that fits; a longer route "
        "has more places that look alike. Energy of a match is modelled, of "
        f"{WORK}, at {mission.events_per_s:,.0f} events/s."
    )
    if larger:
        text += f" Most correct of those that fit: {'; '.join(larger)}."
    if limits:
        text += f" A better one exceeds: {', '.join(limits)}."
    text += _not_at_rest({of: one.best.device for of, one in found.items() if one.best}, budgets)
    _say(f"{text} {not_fitting}")


def show_sources(targets: Sequence[Target], costs: Mapping[Target, Cost]) -> None:
    """Print a sentence for each assumption, and for each cited constant."""
    cited: dict[Constant, None] = {}
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
        if target in costs:
            cited |= dict.fromkeys(costs[target].basis)
    for constant in cited:
        _say(
            f"modelled, {constant.name}: {three(constant.value)} {constant.unit} (year "
            f"{constant.year}, {constant.node}): {constant.source}; {constant.uncertainty}"
        )


def _say(text: str) -> None:
    say(text, width=WIDTH)
