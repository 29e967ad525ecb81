"""An estimate as a value: the question, its answers, comparison and calibration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr.files import understood
from edge_vpr.results import to_json
from edge_vpr_tools.estimate.model import (
    Cost,
    Mission,
    Sizes,
    Work,
    block_memories,
    cost,
    large_and_small_blocks,
    sizes,
    work,
)
from edge_vpr_tools.estimate.search import (
    Asked,
    Budget,
    Candidate,
    Evaluated,
    Fit,
    answer,
    broken_by,
    candidates,
    fit,
    memory_bytes,
)
from edge_vpr_tools.estimate.targets import (
    UNKNOWN,
    Constant,
    Spread,
    Target,
    busy,
    matching,
    size_text,
    spread,
)
from edge_vpr_tools.profile.measurement import Energy
from edge_vpr_tools.profile.record import Profile
from firmware_model.model.design import Design

# Two designs side by side in every layer: counts, bytes, instructions, time, modelled energy.


class Side(NamedTuple):
    """A design, and what it has to keep up with."""

    design: Design
    mission: Mission


class Pair(NamedTuple):
    """A number of this design, and of the other one."""

    ours: float
    theirs: float


class Costs(NamedTuple):
    """Costs of this design on a target, and of the other one."""

    target: Target
    ours: Cost
    theirs: Cost


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two designs in every layer.

    Attributes
    ----------
    ours, theirs : Side
    counts : dict of str to Pair
        Exact counts, by name.
    costs : tuple of Costs
        On each target.
    """

    ours: Side
    theirs: Side
    counts: dict[str, Pair]
    costs: tuple[Costs, ...]

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold: ``[this design, the other]``."""
        return {
            "counts": {name: list(pair) for name, pair in self.counts.items()},
            "targets": {
                target.name: [to_json(one) | {"energy_is": "modelled"} for one in (ours, theirs)]
                for target, ours, theirs in self.costs
            },
        }


def compare(
    ours: Side, theirs: Side, targets: Iterable[Target], measured: Constant | None = None
) -> Comparison:
    """Count and model two designs.

    Parameters
    ----------
    ours, theirs : Side
    targets : iterable of Target
    measured : Constant, optional
        See `cost`.
    """
    a, b = counted(*ours), counted(*theirs)
    return Comparison(
        ours,
        theirs,
        {name: Pair(a.get(name, 0), value) for name, value in b.items()},
        tuple(
            Costs(
                target,
                *(cost(side.design, target, side.mission, measured) for side in (ours, theirs)),
            )
            for target in targets
        ),
    )


def counted(design: Design, mission: Mission) -> dict[str, float]:
    """Return operations and bytes of a match and of a second, and memory."""
    units, rates, size = work(design), mission.rates, sizes(design)
    match = units["match"]
    found: dict[str, float] = {"counters": design.slots}
    found |= {f"{name}, a match": n for name, n in match.operations.items() if n}
    found |= {
        "bytes read, a match": match.bytes_read,
        "bytes written, a match": match.bytes_written,
    }
    found |= {"bytes read and written, a window's end": _bytes(units["window"])}
    for name in match.operations:
        total = sum(units[unit].operations[name] * rate for unit, rate in rates.items())
        if total:
            found[f"{name}, a second"] = total
    found["bytes read and written, a second"] = sum(
        _bytes(units[unit]) * rate for unit, rate in rates.items()
    )
    return found | {
        "bytes a place": size.place_bytes,
        "bytes of all places": design.places * size.place_bytes,
        "bytes of all memories, packed": size.packed_bytes,
        "flash of the firmware in C": size.flash_bytes,
        "RAM of the firmware in C": size.ram_bytes,
    }


def _bytes(unit: Work) -> float:
    return unit.bytes_read + unit.bytes_written


# An estimate as a value: a question about a design, and everything that is counted and modelled.
#
# `estimate` answers a `Question`; the modules beside it print the answer.


class Tried(NamedTuple):
    """Evaluated designs, and the name of the drives that they were evaluated on."""

    drives: str
    designs: Sequence[Evaluated]


class Other(NamedTuple):
    """A design to compare with, by the name that the user gave it."""

    name: str
    side: Side


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """What is asked of an estimate.

    Attributes
    ----------
    design : Design
    mission : Mission
    places_per_metre : float
        Density of the route.
    targets : tuple of Target
    budgets : tuple of Budget
        Held against the design on a single target, and against those of `tried`.
    measured : Constant or None
        Energy of a cycle of the user's own board.
    other : Other or None
        A design to compare with.
    tried : Tried or None
        Evaluated designs, of which the most accurate one that fits is wanted.
    route_places : int or None
        Places of the route that `tried` designs are for; None for those of their own maps.
    events_per_s, matches_per_s : float or None
        Rates of `tried` designs; None for those of their own drives.
    """

    design: Design
    mission: Mission
    places_per_metre: float = 0.1
    targets: tuple[Target, ...]
    budgets: tuple[Budget, ...] = ()
    measured: Constant | None = None
    other: Other | None = None
    tried: Tried | None = None
    route_places: int | None = None
    events_per_s: float | None = None
    matches_per_s: float | None = None

    @property
    def alone(self) -> Target | None:
        """The target, if there is one only."""
        return self.targets[0] if len(self.targets) == 1 else None


@dataclass(frozen=True)
class Answers:
    """The most accurate designs that fit, by the name of the target.

    Attributes
    ----------
    text : dict of str to str
        A sentence a target.
    candidates : dict of str to list of Candidate
        Best first; none of a target that cannot be answered.
    """

    text: dict[str, str]
    candidates: dict[str, list[Candidate]]

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        told = {
            name: [to_json(one) | {"energy_is": "modelled"} for one in found]
            for name, found in self.candidates.items()
        }
        return {"text": self.text, "candidates": told}


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimation:
    """What a design needs.

    Attributes
    ----------
    question : Question
    sizes : Sizes
    counts : mapping of str to Work
        Of an event, a window and a match.
    costs : dict of str to Cost
        By the name of the target.
    fit : tuple of Fit
        The largest designs within the budgets of a single target.
    comparison : Comparison or None
    answers : Answers or None
    """

    question: Question
    sizes: Sizes
    counts: Mapping[str, Work]
    costs: dict[str, Cost]
    fit: tuple[Fit, ...] = ()
    comparison: Comparison | None = None
    answers: Answers | None = None

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        values = {
            "schema": 1,
            "design": to_json(self.question.design),
            "mission": to_json(self.question.mission),
            "sizes": to_json(self.sizes),
            "counts": to_json(self.counts),
            "targets": {
                name: {"energy_is": "modelled"} | to_json(found)
                for name, found in self.costs.items()
            },
            "fit": to_json(self.fit),
        }
        if self.comparison is not None:
            values["vs"] = to_json(self.comparison)
        if self.answers is not None:
            values["answers"] = to_json(self.answers)
        return values


def estimate(question: Question) -> Estimation:
    """Count, model, and hold against budgets what a question asks for.

    Raises
    ------
    UsageError
        If a budget cannot be held against the only target.
    """
    design, mission, measured = question.design, question.mission, question.measured
    fits: tuple[Fit, ...] = ()
    if question.budgets and question.alone is not None:
        fits = tuple(fit(design, question.alone, mission, question.budgets, measured))
    other = question.other
    return Estimation(
        question=question,
        sizes=sizes(design),
        counts=work(design),
        costs={one.name: cost(design, one, mission, measured) for one in question.targets},
        fit=fits,
        comparison=None if other is None
        else compare(Side(design, mission), other.side, question.targets, measured),
        answers=None if question.tried is None else _answers(question, question.tried),
    )  # fmt: skip


def _answers(question: Question, tried: Tried) -> Answers:
    said, told = {}, {}
    for target in question.targets:
        asked = Asked(
            target, question.budgets, question.route_places, question.matches_per_s,
            question.events_per_s, question.measured,
        )  # fmt: skip
        try:
            found = candidates(tried.designs, asked)
        except UsageError as error:
            if question.alone is not None:
                raise
            said[target.name] = str(error)
            continue
        said[target.name] = answer(found, asked, tried.drives)
        told[target.name] = found
    return Answers(said, told)


# The answer of an estimate in sentences: what fits, memory, time, power and accuracy.


def answer_lines(found: Estimation) -> list[str]:
    """Return the answer: a sentence for each target, and one on the accuracy."""
    asked = found.question
    if found.answers is not None:
        return [
            *found.answers.text.values(),
            "an accuracy is of those drives: a longer route has more places to be mistaken for "
            "one another",
        ]
    of = asked.design
    head = (
        f"{of.pixels} pixels, codes of {of.code_bits} bits ({of.code}), {of.places:,} places, "
        f"{matching(of)}:"
    )
    lines = [
        f"{target.name}: {_verdict(asked, target, found.costs[target.name])}"
        for target in asked.targets
    ]
    return [head, *lines, "accuracy is not estimated: --accuracy-on tries designs on two drives"]


def _verdict(asked: Question, target: Target, cost: Cost) -> str:
    """Return whether a design fits, and what it takes."""
    of = asked.design
    budgets = asked.budgets if asked.alone is not None else ()
    over = broken_by(of, target, asked.mission, budgets, asked.measured)
    problems = [f"over {over}"] if over else []
    memory = size_text(memory_bytes(of, target))
    if target.blocks:
        blocks, enough = _blocks(of, target)
        memory += f" in {blocks}"
        if not enough:
            problems.append("too few block memories")
    if cost.logic_cells is not None:
        memory += f"; {cells_text(cost.logic_cells, target)} (predicted)"
        if cost.logic_cells > target.logic_cells:
            problems.append("too few logic cells")
    if cost.load.low >= 1:
        problems.append("too slow for the mission")
    fits = f"does not fit ({', '.join(problems)})" if problems else "fits"
    energy = f"energy {UNKNOWN}"
    if cost.energy_j is not None:
        energy = f"{spread(cost.energy_j['match'], 'J')} modelled"
    known = ((cost.marginal_w, "added by the work"), (cost.idle_w, "at rest"))
    power = [f"{spread(value, 'W')} {what}" for value, what in known if value is not None]
    return (
        f"{fits}; memory {memory}; a match takes {spread(cost.seconds['match'], 's')}, {energy}; "
        f"busy {busy(cost.load)}; power {', '.join(power) or UNKNOWN}"
    )


def memory_text(of: Design, target: Target) -> str:
    """Return the memory that a design takes on a target, and whether that is too much."""
    if target.kind == "processor":
        limit = broken_by(of, target, Mission(0.0, 0.0, 1.0), ())
        return size_text(memory_bytes(of, target)) + (f": over {limit}" if limit else "")
    if not target.blocks:
        return size_text(sizes(of).packed_bytes)
    blocks, enough = _blocks(of, target)
    return blocks if enough else f"{blocks}: too many"


def cells_text(taken: int, target: Target) -> str:
    """Return the logic cells that the core takes, and those that there are."""
    return f"{taken:,} of {target.logic_cells:,} logic cells"


def _blocks(of: Design, target: Target) -> tuple[str, bool]:
    """Return the block memories that a design takes, and whether there are as many."""
    needed = block_memories(of, target.block_shapes)
    if needed <= target.blocks or not target.large_blocks:
        return f"{needed} of {target.blocks} blocks", needed <= target.blocks
    large, rest = large_and_small_blocks(of, target.large_block_shapes, target.block_shapes)
    enough = rest <= target.blocks and large <= target.large_blocks
    return f"{rest} of {target.blocks} blocks, {large} of {target.large_blocks} large", enough


# Energy of a processor's clock cycle, from the profile of a board with a power sensor.


def calibrated(path: Path) -> Constant:
    """Return the energy of a cycle that a profile measured.

    It is a single point: marginal joules per second of processor time, divided by the clock.

    Parameters
    ----------
    path : path
        Of a ``profile.json``.

    Returns
    -------
    Constant
        In picojoules a cycle.

    Raises
    ------
    UsageError
        If the file is no profile, or its energy was not measured or not resolved.
    """
    profile = Profile.load_file(path)
    energy, clock = profile.energy, profile.conditions.loaded.frequency_hz
    figures = energy.figures if isinstance(energy, Energy) else None
    marginal = None if figures is None else figures.marginal_j_per_match
    if not isinstance(energy, Energy) or figures is None or marginal is None or not clock:
        raise UsageError(
            f"{path}: energy was not measured or not resolved, or the clock is not known: "
            "profile a board with a power sensor, for longer"
        )
    # periods of an external meter have no processor time, which is taken from the throughput
    seconds = energy.cpu_s_per_match or profile.throughput.cpu_s_per_match
    low, high = figures.marginal_j_per_match_interval
    with understood(path, "energy and clock", "profile the board again"):
        picojoules = [1e12 * joules / (seconds * clock) for joules in (low, marginal, high)]
        if not all(map(math.isfinite, picojoules)) or picojoules != sorted(picojoules):
            raise ValueError(f"{picojoules} pJ a cycle are no interval")
        year = int(profile.run.finished_utc[:4])
    return Constant(
        "a cycle of this board",
        "pJ/cycle",
        Spread(*picojoules),
        year,
        profile.run.machine.processor,
        f"calibrated on the profile {path}",
        "interval of the measurement; one point: another load may cost another energy a cycle",
    )
