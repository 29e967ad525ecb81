"""An estimate as a value: the question, its answers, and the comparison of two designs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr.results import to_json
from edge_vpr_tools.estimate.model import Cost, EveryPixel, Mission, Sizes, Work, cost, sizes, work
from edge_vpr_tools.estimate.search import (
    Budget,
    Candidate,
    DesignOnTarget,
    Evaluated,
    Fit,
    Limits,
    Recommendation,
    candidates,
    fit,
    on_target,
    recommend,
)
from edge_vpr_tools.estimate.targets import Constant, Target
from firmware_model.design import Design

# Two designs side by side in every layer: counts, bytes, instructions, time, modelled energy.


class Side(NamedTuple):
    """A design, and what it has to keep up with."""

    design: Design
    mission: Mission


class Costs(NamedTuple):
    """Costs of this design on a target, and of the other one."""

    target: Target
    ours: Cost
    theirs: Cost


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two designs in every layer."""

    ours: Side
    theirs: Side
    counts: dict[str, tuple[float, float]]  #: Exact counts of ours and of theirs, by name.
    costs: tuple[Costs, ...]  #: On each target.

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold: ``[this design, the other]``."""
        return {
            "counts": to_json(self.counts),
            "targets": {
                target.name: [to_json(one) | {"energy_is": "modelled"} for one in (ours, theirs)]
                for target, ours, theirs in self.costs
            },
        }


def compare(
    ours: Side, theirs: Side, targets: Iterable[Target], measured: Constant | None = None
) -> Comparison:
    """Count and model two designs."""
    a, b = counted(*ours), counted(*theirs)
    return Comparison(
        ours,
        theirs,
        {name: (a.get(name, 0), value) for name, value in b.items()},
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
    search = units["search"]
    found: dict[str, float] = {"counters": design.slots}
    found |= {f"{name} per search": n for name, n in search.operations.items() if n}
    found |= {
        "bytes read per search": search.bytes_read,
        "bytes written per search": search.bytes_written,
    }
    found |= {"bytes read and written per end of a window": _bytes(units["window"])}
    for name in search.operations:
        total = sum(units[unit].operations[name] * rate for unit, rate in rates.items())
        if total:
            found[f"{name} per second"] = total
    found["bytes read and written per second"] = sum(
        _bytes(units[unit]) * rate for unit, rate in rates.items()
    )
    return found | {
        "bytes per place": size.place_bytes,
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
    """Evaluated designs, the drives that they were tried on, and whether on the same queries."""

    drives: str
    designs: Sequence[Evaluated]
    same_queries: bool


class Other(NamedTuple):
    """A design to compare with, by the name that the user gave it; None for all pixels."""

    name: str
    design: Design | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """What is asked of an estimate."""

    design: Design
    #: One of the same size that matches by sequences, to show beside it.
    beside: Design | None = None
    choose_distances: bool = False  #: See `search.Limits`.
    mission: Mission
    places_per_metre: float  #: Density of the route, of places at whole windows.
    targets: tuple[Target, ...]
    #: Held against the design on a single target, and against those of `tried`.
    budgets: tuple[Budget, ...] = ()
    measured: Constant | None = None  #: Energy of a cycle of the user's own board.
    other: Other | None = None  #: A design to compare with.
    #: Evaluated designs, of which the most accurate one that fits is wanted.
    tried: Tried | None = None
    #: Places of the route that `tried` designs are for, at one per window; None for those of their
    #: own maps.
    route_places: int | None = None
    #: events_per_s, matches_per_s: rates of `tried` designs; None for those of their own drives.
    events_per_s: float | None = None
    matches_per_s: float | None = None

    @property
    def alone(self) -> Target | None:
        """The target, if there is one only."""
        return self.targets[0] if len(self.targets) == 1 else None


@dataclass(frozen=True)
class Answers:
    """The designs that are recommended, by the name of the target."""

    recommended: dict[str, Recommendation]  #: Best design of each target, by its name.
    candidates: dict[str, list[Candidate]]  #: Best first.
    unknown: dict[str, str]  #: Why a target cannot be held against a budget of power.

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        return {
            "recommended": {
                name: {"limit": found.limit, "design": _modelled(found.design)}
                for name, found in self.recommended.items()
            },
            "candidates": {
                name: [_modelled(one) for one in found] for name, found in self.candidates.items()
            },
            "unknown": self.unknown,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimation:
    """What a design needs."""

    question: Question
    #: That the counts and sizes are of: with a single target the recommended one, if designs were
    #: tried and one fits; else the question's.
    design: Design
    mission: Mission  #: Of that design.
    sizes: Sizes
    counts: Mapping[str, Work]  #: Of an event, a window's end and a search.
    on: dict[str, DesignOnTarget]  #: That design, by the name of the target.
    beside: dict[str, DesignOnTarget]  #: The design that matches by sequences.
    #: The largest designs within the budgets of a single target, if none were tried.
    fit: tuple[Fit, ...] = ()
    comparison: Comparison | None = None
    answers: Answers | None = None

    def to_json(self) -> dict[str, Any]:
        """Return values that JSON can hold."""
        values = {
            "schema": 2,
            "design": to_json(self.design),
            "mission": to_json(self.mission),
            "sizes": to_json(self.sizes),
            "counts": to_json(self.counts),
            "targets": {name: _on_target(found) for name, found in self.on.items()},
            "beside": {name: _on_target(found) for name, found in self.beside.items()},
            "fit": to_json(self.fit),
        }
        if self.comparison is not None:
            values["vs"] = to_json(self.comparison)
        if self.answers is not None:
            values["answers"] = to_json(self.answers)
        return values


def _modelled(found: Candidate | None) -> dict[str, Any] | None:
    return None if found is None else to_json(found) | {"energy_is": "modelled"}


def _on_target(found: DesignOnTarget) -> dict[str, Any]:
    more = {"memory_bytes": found.memory_bytes, "limited_by": found.limited_by}
    return {"energy_is": "modelled", "design": to_json(found.design), **more} | to_json(found.cost)


def estimate(question: Question) -> Estimation:
    """Count, model, and hold against budgets what a question asks for.

    Raises
    ------
    UsageError
        If a budget cannot be held against the only target.
    """
    measured, alone = question.measured, question.alone
    answers = None if question.tried is None else _answers(question, question.tried)
    budgets = question.budgets if alone is not None else ()
    limits = {
        target.name: Limits(target, budgets, measured, question.choose_distances)
        for target in question.targets
    }

    def on(design: Design, mission: Mission) -> dict[str, DesignOnTarget]:
        return {name: on_target(design, mission, of) for name, of in limits.items()}

    fits: list[Fit] = []
    if budgets and alone is not None and answers is None:
        for one in filter(None, (question.design, question.beside)):
            fits += fit(one, question.mission, limits[alone.name])
    recommended = None
    if answers is not None and alone is not None:
        recommended = answers.recommended[alone.name].design
    found = on(question.design, question.mission)
    if recommended is not None and alone is not None:
        found = {alone.name: recommended}
    described = next(iter(found.values()))
    design, mission = described.design, described.mission
    return Estimation(
        question=question,
        design=design,
        mission=mission,
        sizes=sizes(design),
        counts=work(design),
        on=found,
        beside={} if question.beside is None else on(question.beside, question.mission),
        fit=tuple(fits),
        comparison=None if question.other is None
        else compare(
            Side(design, mission),
            _other_side(question.other, design, mission),
            question.targets,
            measured,
        ),
        answers=answers,
    )  # fmt: skip


def _other_side(other: Other, design: Design, mission: Mission) -> Side:
    """Return the design to compare with, and its mission, which has its own share of events."""
    if other.design is None:
        return Side(EveryPixel.beside(design), replace(mission, selected_share=1.0))
    share = min(1.0, mission.selected_share * other.design.pixels / design.pixels)
    return Side(other.design, replace(mission, selected_share=share))


def _answers(question: Question, tried: Tried) -> Answers:
    recommended, every, unknown = {}, {}, {}
    for target in question.targets:
        limits = Limits(target, question.budgets, question.measured, choose_distances=True)
        try:
            found = candidates(
                tried.designs,
                limits,
                places=question.route_places,
                matches_per_s=question.matches_per_s,
                events_per_s=question.events_per_s,
            )
        except UsageError as error:
            if question.alone is not None:
                raise
            unknown[target.name] = str(error)
            continue
        recommended[target.name] = recommend(found)
        every[target.name] = found
    return Answers(recommended, every, unknown)
