"""An estimate as a value: a question about a design, and everything that is counted and modelled.

`estimate` answers a `Question`; the modules beside it print the answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from edge_vpr.errors import UsageError
from edge_vpr_tools.estimate.candidates import Asked, Candidate, Evaluated, answer, candidates
from edge_vpr_tools.estimate.comparison import Comparison, Side, compare
from edge_vpr_tools.estimate.counts import Sizes, Work, sizes
from edge_vpr_tools.estimate.fit import Budget, Fit, fit
from edge_vpr_tools.estimate.model import Cost, Mission, cost, work
from edge_vpr_tools.estimate.targets import Constant, Target
from edge_vpr_tools.output.json_records import to_json
from firmware_model.design import Design


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
