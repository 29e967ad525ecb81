"""An estimate on the terminal: its tables, and how designs and quantities are written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from edge_vpr_tools.console import is_verbose, say, table
from edge_vpr_tools.estimate import core_area
from edge_vpr_tools.estimate.estimation import Answers, Comparison, Costs, Estimation, Question
from edge_vpr_tools.estimate.model import Cost, EveryPixel, Mission, firmware, per_second, sizes
from edge_vpr_tools.estimate.search import Candidate, DesignOnTarget, Fit, blocks_of, memory_bytes
from edge_vpr_tools.estimate.targets import Constant, Spread, Target
from edge_vpr_tools.report.page import quantity
from firmware_model.design import Design
from firmware_model.image import kept_bytes

# Designs and quantities in words: in suitable units, with low and high.


UNKNOWN = "unknown"


def matching(of: Design) -> str:
    """Return how a design matches."""
    if not of.filters:
        return f"sequences of {of.length}"
    if not of.steps:
        return "place filter" + ", places at half windows" * (of.places_per_window == 2)
    return f"place filter with fixed costs of {len(of.steps) + len(of.back)} steps"


def short_text(of: Design) -> str:
    """Return pixels, codes, places and matching of a design for a cell of a table."""
    by = f"sequences of {of.length}"
    if of.filters:
        by = "filter" + ", places at half windows" * (of.places_per_window == 2)
        by += "" if of.keep_distances else ", distances computed twice"
    return (
        f"{of.pixels:,} px, {of.code_bits} bit{'s' * (of.code_bits > 1)} {of.code}, "
        f"{of.places:,} places, {by}"
    )


def design_text(of: Design) -> str:
    """Return pixels, codes, places, and how a design matches."""
    kept = ""
    if of.filters:
        kept = ", distances computed twice"
        if of.keep_distances:
            kept = f", distances kept ({size_text(kept_bytes(of))} of a processor's RAM)"
    return (
        f"{of.pixels:,} pixels, {of.code_bits} bit{'s' * (of.code_bits > 1)} ({of.code}), "
        f"{of.places:,} places, {matching(of)}{kept}"
    )


def busy(load: Spread) -> str:
    """Return the share of the time that a target is busy, or that it cannot keep up."""
    if load.low >= 1:
        return "overloaded"
    return f"{load.central:.3%}" if load.high < 1 else f"{load.central:.0%}: may be overloaded"


def per_joule(value: Spread | None) -> str:
    """Return the matches per joule of the work, or that they are unknown."""
    if value is None:
        return UNKNOWN
    low, central, high = (
        f"{one:,.0f}" if one >= 100 else f"{one:.3g}"
        for one in (value.low, value.central, value.high)
    )
    return f"{central} ({low} to {high})"


def spread(value: Spread | None, unit: str) -> str:
    """Return a value with low and high, in a unit that suits the central one, or "unknown"."""
    return UNKNOWN if value is None else quantity(value.central, unit, value.low, value.high)


def three(value: Spread) -> str:
    """Return the central value with its bounds."""
    return f"{value.central:g} ({value.low:g} to {value.high:g})"


def times(theirs: float, ours: float) -> str:
    """Return how many times ours theirs is."""
    return f"{theirs / ours:,.3g}" if ours else "-"


def size_text(number: float) -> str:
    """Return bytes, in KiB where they are many."""
    return f"{number:,.0f} B" if number < 10_240 else f"{number / 1024:,.1f} KiB"


def count(value: Spread) -> str:
    """Return cycles with low and high."""
    if value.low == value.high:
        return f"{value.central:,.0f}"
    return f"{value.central:,.0f} ({value.low:,.0f} to {value.high:,.0f})"


# The answer of an estimate: one table of designs on targets, and one sentence.


_HEADER = ["target", "design", "memory", "power (modelled)"]


def _answer(found: Estimation) -> None:
    """Print a table of designs on targets, the sentence that goes with it, and what is unknown."""
    asked, answers = found.question, found.answers
    shown = [target for target in asked.targets if _has_power(target, asked)]
    hidden = [target.name for target in asked.targets if target not in shown]
    if answers is None:
        rows = [
            [*_row(target, of), per_joule(of.cost.matches_per_joule), of.limited_by or "-"]
            for target in shown
            for of in _designs(found, target)
        ]
        header = [*_HEADER, "matches per joule (modelled)", "over"]
        lines = ["accuracy is not estimated: --accuracy-on tries designs on two drives"]
    else:
        rows = [_recommended(target, answers, asked) for target in shown]
        header = [*_HEADER, "correct", "limited by"]
        lines = [_sentence(asked, answers)]
    if hidden:
        lines.append(
            f"power {UNKNOWN}: {', '.join(hidden)} (--target shows one; --calibrate takes a "
            "profile of your board)"
        )
    table(header, rows)
    for line in lines:
        say(line)


def _has_power(target: Target, asked: Question) -> bool:
    """Return whether a part of the power of a target is known, or no other is asked for."""
    return asked.alone is not None or not target.unknown or bool(target.idle_power)


def _designs(found: Estimation, target: Target) -> Iterable[DesignOnTarget]:
    yield found.on[target.name]
    if target.name in found.beside:
        yield found.beside[target.name]


def _recommended(target: Target, answers: Answers, asked: Question) -> list[str]:
    chosen = answers.recommended[target.name]
    if chosen.design is None:
        tried = len(answers.candidates[target.name])
        return [target.name, f"none of {tried} fits", "-", "-", "-", chosen.limit]
    correct = f"{chosen.design.accuracy:.1%} ± {chosen.design.error:.1%}"
    return [*_row(target, chosen.design), correct, chosen.limit or "-"]


def _sentence(asked: Question, answers: Answers) -> str:
    """Return what `correct` is, and how the designs were chosen."""
    assert asked.tried is not None
    tried, some = asked.tried, [one for found in answers.candidates.values() for one in found]
    within = " and ".join(budget.text for budget in asked.budgets)
    chosen = "the smallest design" + f" within {within}" * bool(within)
    on = (
        f"of the queries of {tried.drives}, each run on its own, as evaluated (a smoothed run sees "
        "later windows too, which a device does not)"
    )
    if tried.same_queries:
        on = f"of the {some[0].queries if some else 0} queries on {tried.drives}, the same for all"
        on += f" {len(tried.designs)} designs"
    return (
        f"{chosen} whose share of correct matches is within a standard error of the best that "
        f"fits; correct is the share {on}, and a longer route has more places that look alike"
    )


def _row(target: Target, of: DesignOnTarget) -> list[str]:
    return [
        target.name, short_text(of.design), _memory_text(of, target), _power_text(of.cost)
    ]  # fmt: skip


def _power_text(of: Cost) -> str:
    """Return the power of a device at the mission's rates, as far as it is known."""
    if of.whole_w is not None:
        return spread(of.whole_w, "W")
    if of.marginal_w is not None:
        return f"{spread(of.marginal_w, 'W')} of the work"
    return UNKNOWN if of.idle_w is None else f"{spread(of.idle_w, 'W')} at rest"


def _memory_text(of: DesignOnTarget, target: Target) -> str:
    """Return the memory that a design takes on a target, and its blocks and cells on an FPGA."""
    if target.kind == "processor":
        return size_text(of.memory_bytes)
    text = size_text(sizes(of.design).packed_bytes)
    if target.blocks:
        text += f": {blocks_of(of.design, target)[0]}"
    if of.cost.logic_cells is not None:
        text += f"; {of.cost.logic_cells:,} of {target.logic_cells:,} logic cells"
    return text


# Two designs side by side on the terminal.


def show_comparison(found: Comparison, name: str) -> None:
    """Print both, and how many times the other one takes."""
    rows = [
        [key, f"{ours:,.6g}", f"{theirs:,.6g}", times(theirs, ours)]
        for key, (ours, theirs) in found.counts.items()
    ]
    table(["exact counts", "this design", name, "times"], rows)
    for kind, unit in (("processor", "instructions"), ("fpga", "cycles"), ("datapath", "cycles")):
        those = [one for one in found.costs if one.target.kind == kind]
        if those:
            _modelled(found, name, those, unit)
    if isinstance(found.theirs.design, EveryPixel):
        say(
            "all pixels: no firmware or device of this kind holds as many counters; its "
            "instructions are extrapolated from those of the emulated designs, with a look-up for "
            "each event that its memories do not count"
        )


def _modelled(found: Comparison, name: str, costs: Sequence[Costs], unit: str) -> None:
    rows = []
    for target, a, b in costs:
        taken = [_taken(one, "search") for one in (a, b)]
        memory = [memory_bytes(side.design, target) for side in (found.ours, found.theirs)]
        lines = [
            (f"{unit} of a search", *(f"{n:,.0f}" for n in taken), times(taken[1], taken[0])),
            ("time of a search", *(spread(c.seconds["search"], "s") for c in (a, b)),
             times(b.seconds["search"].central, a.seconds["search"].central)),
            ("busy", *(busy(c.load) for c in (a, b)), times(b.load.central, a.load.central)),
            ("memory", *map(size_text, memory), times(memory[1], memory[0])),
        ]  # fmt: skip
        if a.per_match_j and b.per_match_j and a.marginal_w and b.marginal_w:
            for what, x, y, sign in (
                ("energy of a match, modelled", a.per_match_j, b.per_match_j, "J"),
                ("added power, modelled", a.marginal_w, b.marginal_w, "W"),
            ):
                lines.append((what, spread(x, sign), spread(y, sign), times(y.central, x.central)))
        else:
            lines.append(("energy", UNKNOWN, UNKNOWN, "-"))
        rows += [[target.name if i == 0 else "", *line] for i, line in enumerate(lines)]
    table(["target", "", "this design", name, "times"], rows)


def _taken(found: Cost, unit: str) -> float:
    """Return the instructions of a unit of work, or its cycles where there is no program."""
    if found.instructions is None:
        return found.cycles[unit].central
    return found.instructions[unit]


# Assumptions, sources and unknown values of an estimate.


def sources(found: Estimation) -> list[str]:
    """Return a sentence for each assumption, and for each cited constant."""
    said = []
    cited: dict[Constant, None] = {}
    for target in found.question.targets:
        if target.kind == "processor":
            compiler, cpi = firmware()[target.core].compiler, three(Spread(*target.cpi))
            said.append(
                f"{target.name}: instructions of the reference firmware ({compiler}, "
                f"{target.core}); cycles per instruction {cpi}: {target.cpi_source}"
            )
        if target.logic_cells:
            furthest = max(map(abs, core_area.errors().values()))
            said.append(
                f"{target.name}: logic cells are predicted from {len(core_area.FITTED_ON)} "
                f"netlists of the hardware core; of {len(core_area.CHECKED_ON)} others they were "
                f"{furthest:.1%} off at most"
            )
        if target.note:
            said.append(f"{target.name}: {target.note}")
        if target.unknown and found.question.measured is None:
            remedy = "; --calibrate takes a profile of your board"
            said.append(f"{target.name}: {target.unknown}" + remedy * (target.kind == "processor"))
        cited |= dict.fromkeys(found.on[target.name].cost.basis)
    said += [
        f"modelled, {constant.name}: {three(constant.value)} "
        f"{constant.unit} (year {constant.year}, {constant.node}): {constant.source}; "
        f"{constant.uncertainty}"
        for constant in cited
    ]
    return said


#: designs shown of each kind of matching
_SHOWN = 6


def show(found: Estimation, *, with_sources: bool = False) -> None:
    """Print an estimate: first the answer, then what it takes, and what that rests on.

    Exact counts, and the costs of each unit of work on one target, are printed only if verbose.
    """
    asked = found.question
    _answer(found)
    if found.fit and asked.alone is not None:
        _fits(found.fit, asked, asked.alone)
    if found.answers is not None:
        if asked.alone is None:
            say("--target shows the designs and costs of one target")
            return
        _candidates(found.answers.candidates[asked.alone.name], found.on[asked.alone.name])
    _design(found)
    if is_verbose():
        _work(found)
    _costs(found)
    if is_verbose() and asked.alone is not None:
        _units(found.on[asked.alone.name].cost, asked.alone, found.mission)
    if found.comparison is not None and asked.other is not None:
        show_comparison(found.comparison, asked.other.name)
    if not with_sources:
        counts = "" if is_verbose() else "; -v prints the exact counts"
        say(f"instructions are emulated, energy is modelled: --sources says from what{counts}")
        return
    for line in sources(found):
        say(line)


def _design(found: Estimation) -> None:
    """Print the design, its sizes, and the mission that the rates are for."""
    asked, size = found.question, found.sizes
    of, mission = found.design, found.mission
    density = asked.places_per_metre * of.places_per_window
    say(f"{design_text(of)}: {of.slots} counters, of {of.width} x {of.height} pixels")
    say(
        f"{size.place_bytes} bytes per place, {size_text(1e3 * density * size.place_bytes)} "
        f"per km at {density:.4g} places per metre ({of.places / density / 1000:.4g} km); all "
        f"memories {size_text(size.packed_bytes)} packed; firmware in C, a byte per code: flash "
        f"{size_text(size.flash_bytes)} of tables, RAM {size_text(size.ram_bytes)}"
    )
    if of.filters:
        say(
            "a device has no misfit: it accepts matches by trust alone, where a host's "
            "probabilities depend on both"
        )
    matches = "match" if mission.matches_per_s == 1 else "matches"
    say(
        f"at {mission.events_per_s:,.0f} events per second, {mission.selected_share:.3%} of them "
        f"at selected pixels, and {mission.matches_per_s:g} {matches} per second"
    )


def _work(found: Estimation) -> None:
    """Print the exact counts."""
    units, rates = found.counts, found.mission.rates
    header = ["exact counts", *units, "per second"]
    rows = []

    def add(name: str, each: Sequence[float], form: str) -> None:
        total = sum(n * rate for n, rate in zip(each, rates.values(), strict=True))
        rows.append([name, *(format(n, form) for n in each), f"{total:,.0f}"])

    for name in next(iter(units.values())).operations:
        add(name, [unit.operations[name] for unit in units.values()], ",")
    memories = sorted({memory for unit in units.values() for memory in unit.traffic})
    for name, of_unit in (("bytes read", "bytes_read"), ("bytes written", "bytes_written")):
        add(name, [getattr(unit, of_unit) for unit in units.values()], ",.6g")
        for memory in memories:
            parts = [unit.traffic.get(memory) for unit in units.values()]
            each = [0.0 if part is None else getattr(part, of_unit) for part in parts]
            if any(each):
                add(f"  {memory}", each, ",.6g")
    table(header, rows)


def _costs(found: Estimation) -> None:
    """Print what each target takes: instructions, time, and modelled energy."""
    rows = []
    for target in found.question.targets:
        cost = found.on[target.name].cost
        kind = "c" if cost.instructions is None else "i"
        units = ("selected event", "window", "search")
        rows.append(
            [
                target.name,
                *(f"{_taken(cost, unit):,.0f} {kind}" for unit in units),
                quantity(cost.seconds["search"].central, "s"),
                busy(cost.load),
                spread(cost.per_match_j, "J"),
                spread(cost.marginal_w, "W"),
                spread(cost.idle_w, "W"),
            ]
        )
    table(
        ["target", "event", "window", "search", "time of a search", "busy",
         "energy of a match (modelled)", "added power (modelled)", "power at rest"],
        rows,
    )  # fmt: skip
    say(
        "i are instructions, c are clock cycles; a match takes its events, the end of its window "
        "and the search"
    )


def _units(found: Cost, target: Target, mission: Mission) -> None:
    """Print what each unit of work takes on one target, and a second of the mission."""
    rows = []
    for unit in found.cycles:
        energy = None if found.energy_j is None else found.energy_j[unit]
        taken = "-" if found.instructions is None else f"{found.instructions[unit]:,.0f}"
        rows.append(
            [unit, taken, count(found.cycles[unit]), spread(found.seconds[unit], "s"),
             spread(energy, "J")]
        )  # fmt: skip
    taken = "-"
    if found.instructions is not None:
        each = found.instructions
        taken = f"{sum(each[unit] * rate for unit, rate in mission.rates.items()):,.0f}"
    every_second = per_second(found.cycles, mission)
    rows.append(
        ["a second of the mission", taken, count(every_second), spread(found.load, "s"),
         spread(found.marginal_w, "J")]
    )  # fmt: skip
    table([target.name, "instructions", "cycles", "time", "energy (modelled)"], rows)


def _fits(found: Sequence[Fit], asked: Question, target: Target) -> None:
    """Print the largest designs within the budgets."""
    limits = " and ".join(budget.text for budget in asked.budgets)
    rows = [
        ["place filter" if fit.matching == "filter" else "sequences",
         "-" if fit.parameter == "code_bits" else f"{fit.code_bits} bit{'s' * (fit.code_bits > 1)}",
         fit.parameter.replace("code_bits", "bits per code"),
         f"{fit.value:,}" if fit.value else "none", fit.limited_by]
        for fit in found
    ]  # fmt: skip
    say(
        f"within {limits} on {target.name}: the largest J with K = {asked.design.places:,}; the "
        f"largest K with J = {asked.design.pixels}; the most bits with both"
    )
    table(["matching", "code", "parameter", "largest", "limited by"], rows)
    if target.kind == "processor":
        say("the firmware in C keeps a byte per code, so fewer bits save it no memory")
    if any(b.quantity == "watts" for b in asked.budgets) and not target.idle_power:
        say(
            "the power budget is compared with what the work adds, because power at rest is unknown"
        )


def _candidates(found: Sequence[Candidate], recommended: DesignOnTarget) -> None:
    """Print evaluated designs by accuracy, the best ones of each kind of matching."""
    shown = [
        one
        for kind in ("filter", "sequence")
        for one in [of for of in found if of.design.matching == kind][:_SHOWN]
    ]
    if isinstance(recommended, Candidate) and recommended not in shown:
        shown.append(recommended)
    rows = [
        ["> " * (one is recommended) + one.name, f"{one.accuracy:.3f} ± {one.error:.3f}",
         f"{one.design.places:,}", size_text(one.memory_bytes), spread(one.cost.per_match_j, "J"),
         one.limited_by or "fits"]
        for one in shown
    ]  # fmt: skip
    table(
        ["evaluated", "correct", "K", "memory", "energy of a match (modelled)", "limited by"], rows
    )
    if len(shown) < len(found):
        say(f"and {len(found) - len(shown)} more, less often correct (all of them by --json)")
