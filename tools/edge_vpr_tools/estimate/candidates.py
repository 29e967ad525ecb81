"""Evaluated designs as devices of a mission, and the most accurate one that fits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from edge_vpr.archive import damaged
from edge_vpr.errors import MapError, UsageError
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.estimate.fit import Budget, broken_by, memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission, cost
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.targets import Constant, Target
from edge_vpr_tools.estimate.wording import UNKNOWN, matching, size_text, spread
from edge_vpr_tools.output import results
from edge_vpr_tools.output.json_records import from_json
from edge_vpr_tools.output.provenance import read_json
from firmware_model.design import Design
from firmware_model.errors import DesignError


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Accuracy of a map on two drives.

    Attributes
    ----------
    name : str
        Of its folder, or its size.
    accuracy : float
        P@100R.
    queries : int
        That were evaluated.
    reference : ReferenceMap
    """

    name: str
    accuracy: float
    queries: int
    reference: ReferenceMap


class Accuracy(NamedTuple):
    """The part of the result of `edge-vpr evaluate` that is needed here."""

    precision_at_100_recall: float
    queries: int


class Metrics(NamedTuple):
    """The part of `metrics.json` that tells the accuracy; None before an evaluation."""

    evaluation: Accuracy | None = None


@dataclass(frozen=True)
class Candidate:
    """One evaluated map, as a device.

    Attributes
    ----------
    name, accuracy, queries
        See `Evaluated`.
    own_places : int
        Of its map, among which it was that accurate.
    design : Design
        Of its map; with as many places as the mission's route, if that is given.
    cost : Cost
    memory_bytes : int
    limited_by : str
        What keeps it from fitting; empty if it fits.
    """

    name: str
    accuracy: float
    queries: int
    own_places: int
    design: Design
    cost: Cost
    memory_bytes: int
    limited_by: str


@dataclass(frozen=True)
class Asked:
    """Requirements for a candidate: a target, budgets, and the mission.

    Attributes
    ----------
    target : Target
    budgets : sequence of Budget
    places : int, optional
        K of the mission's route, in place of each map's.
    matches_per_s : float, optional
        By default one a window.
    events_per_s : float, optional
        By default those of the reference drive.
    cycle_energy : Constant, optional
        See `cost`.
    """

    target: Target
    budgets: Sequence[Budget] = ()
    places: int | None = None
    matches_per_s: float | None = None
    events_per_s: float | None = None
    cycle_energy: Constant | None = None

    def candidate(self, one: Evaluated) -> Candidate:
        """Take a map as a device with the mission's number of places.

        Raises
        ------
        UsageError
            If no device of this kind could be, or a budget of power cannot be held against this
            target.
        """
        reference = one.reference
        rate, share = event_rates(reference)
        try:
            design = design_of(reference)
            if self.places is not None:
                design = replace(design, places=self.places)
        except DesignError as error:
            raise UsageError(f"{one.name}: {error}") from error
        windows_s = int((reference.places.end_us - reference.places.start_us).sum()) / 1e6
        a_second = self.matches_per_s or len(reference) / max(windows_s, 1e-6)
        mission = Mission(self.events_per_s or rate, share, a_second)
        return Candidate(
            name=one.name,
            accuracy=one.accuracy,
            queries=one.queries,
            own_places=len(reference),
            design=design,
            cost=cost(design, self.target, mission, self.cycle_energy),
            memory_bytes=memory_bytes(design, self.target),
            limited_by=broken_by(design, self.target, mission, self.budgets, self.cycle_energy),
        )


def evaluation_of(metrics: Path) -> tuple[float, int] | None:
    """Read P@100R and the number of queries of a run; None if it was not evaluated.

    Raises
    ------
    MapError
        If the file is damaged.
    """
    remedy = "match and evaluate again"
    values = read_json(metrics, remedy)
    with damaged(metrics, remedy):
        told = from_json(Metrics, values).evaluation
        if told is None:
            return None
        right, queries = told.precision_at_100_recall, told.queries
        if not 0 <= right <= 1 or queries < 1:
            raise MapError(f"P@100R is {right} of {queries} queries")
    return right, queries


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
        told = evaluation_of(metrics)
        if told is not None:
            reference = ReferenceMap.load(metrics.parent / results.MAP)
            found.append(Evaluated(str(metrics.parent), *told, reference))
    if not found:
        raise UsageError(f"no evaluated run in {folder}: edge-vpr match, then edge-vpr evaluate")
    return found


def candidates(evaluated: Iterable[Evaluated], asked: Asked) -> list[Candidate]:
    """Take evaluated designs for a mission, best accuracy first, then the smallest."""
    found = [asked.candidate(one) for one in evaluated]
    return sorted(found, key=lambda one: (-one.accuracy, one.memory_bytes))


def answer(found: Sequence[Candidate], asked: Asked, on: str) -> str:
    """Return a sentence on the best design that fits, its accuracy, and what limits it."""
    within = " and ".join(budget.text for budget in asked.budgets) or "no budget"
    head = f"{asked.target.name}, within {within}: "
    fitting = [one for one in found if not one.limited_by]
    if not fitting:
        least = min(found, key=lambda one: one.memory_bytes)
        return (
            f"{head}none of the {len(found)} designs fits; the smallest, {_told(least)}, is over "
            f"{least.limited_by}"
        )
    best = fitting[0]
    # of a share, taken as if the queries had nothing to do with one another
    error = math.sqrt(best.accuracy * (1 - best.accuracy) / max(best.queries, 1))
    said = (
        f"{head}{_told(best)}, {best.accuracy:.1%} right on {on}, among its own {best.own_places} "
        f"places (standard error {error:.1%} of {best.queries} queries)"
    )
    better = [one for one in found if one.accuracy > best.accuracy + error]
    if not better:
        return f"{said}. Nothing limits it: no design is more often right by a standard error"
    # the one that asks for least more
    nearest = min(better, key=lambda one: one.memory_bytes)
    return (
        f"{said}. What limits it: {nearest.limited_by}; {nearest.accuracy:.1%} right would take "
        f"{_told(nearest)}"
    )


def _told(one: Candidate) -> str:
    design, power = one.design, one.cost.whole_w or one.cost.marginal_w
    watts = f"power {UNKNOWN}"
    if power is None and one.cost.idle_w is not None:
        watts = spread(one.cost.idle_w, "W") + " at rest alone, modelled"
    elif power is not None:
        watts = spread(power, "W")
        watts += " modelled" if one.cost.whole_w else " added by the work, modelled (rest unknown)"
    return (
        f"{design.pixels} pixels, {design.code_bits} bit{'s' * (design.code_bits > 1)} "
        f"({design.code}), {design.places:,} places, {matching(design)}: "
        f"{size_text(one.memory_bytes)}, {watts}"
    )
