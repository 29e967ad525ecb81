"""Accuracy of evaluated designs against their cost on a target, and the best one that fits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge_vpr.errors import UsageError
from edge_vpr.plain_values import read_json, understood
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools.estimate.fit import Budget, broken_by, memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission, cost
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.show import UNKNOWN, matching, size_text, spread
from edge_vpr_tools.estimate.targets import Constant, Target
from edge_vpr_tools.output import results
from edge_vpr_tools.report.style import BLUE, ORANGE, figure, quantity_axis
from firmware_model.design import Design
from firmware_model.errors import DesignError


@dataclass(frozen=True, eq=False)
class Evaluated:
    """How right a map was on two drives.

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
    """What a candidate has to keep: a target, budgets, and the mission.

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
    UsageError
        If the file cannot be read, or holds something else.
    """
    what, remedy = "metrics", "evaluate the run again"
    told = read_json(metrics, what, remedy).get("evaluation")
    if told is None:
        return None
    with understood(metrics, what, remedy):
        right, queries = told["precision_at_100_recall"], told["queries"]
        if not 0.0 <= right <= 1.0 or type(queries) is not int or queries < 1:
            raise ValueError(f"P@100R is {right!r} of {queries!r} queries")
    return float(right), queries


def evaluated_runs(folder: Path) -> list[Evaluated]:
    """Find every evaluated run below a folder.

    Raises
    ------
    UsageError
        If there is none.
    """
    found = []
    for metrics in sorted(folder.rglob(results.METRICS)):
        told = evaluation_of(metrics)
        if told is not None and (metrics.parent / results.MAP).is_file():
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
    """Say in a sentence what one can have, how right it is, and what limits it."""
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


def frontier(found: Sequence[Candidate], cost_of: Callable[[Candidate], float]) -> list[Candidate]:
    """Those that no other one beats: as accurate or more, at a lower cost."""
    best: list[Candidate] = []
    for one in sorted(found, key=lambda c: (cost_of(c), -c.accuracy)):
        if not best or one.accuracy > best[-1].accuracy:
            best.append(one)
    return best


def draw(found: Sequence[Candidate], target: Target) -> Figure:
    """Draw accuracy against energy a match and memory; what no other beats has its name."""
    with figure(12.0, 5.2) as (drawing, only):
        only.remove()
        left, right = drawing.subplots(1, 2, sharey=True)
        known = [one for one in found if one.cost.per_match_j is not None]
        if known:
            _panel(left, known, _joules, "J", "energy added by the work of a match: modelled")
        else:
            left.text(
                0.5, 0.5, f"energy on {target.name}: unknown", transform=left.transAxes, ha="center"
            )
            left.set_xticks([])
        _panel(right, found, lambda one: one.memory_bytes, "B", "memory (1 kB is 1,000 bytes)")
        left.set_ylabel("P@100R")
        handles, labels = right.get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=3)
        drawing.suptitle(f"Accuracy against energy and bytes on {target.name}")
    return drawing


def _joules(one: Candidate) -> float:
    assert one.cost.per_match_j is not None
    return one.cost.per_match_j.central


def _panel(
    axes: Axes,
    found: Sequence[Candidate],
    cost_of: Callable[[Candidate], float],
    unit: str,
    label: str,
) -> None:
    for limited, marker, colour, name in (
        (False, "o", BLUE, "fits"), (True, "x", ORANGE, "over a budget")
    ):  # fmt: skip
        those = [one for one in found if bool(one.limited_by) == limited]
        if those:
            axes.plot(
                [cost_of(one) for one in those], [one.accuracy for one in those],
                marker, color=colour, label=name,
            )  # fmt: skip
    kept = frontier(found, cost_of)
    axes.step(
        [cost_of(one) for one in kept], [one.accuracy for one in kept], where="post",
        color=BLUE, lw=1, alpha=0.6, label="no other is better and cheaper",
    )  # fmt: skip
    for before, one in zip([None, *kept], kept, strict=False):
        # to the left of the steps is room, but for what is hardly above the step before
        beside = before is not None and one.accuracy - before.accuracy < 0.02
        axes.annotate(
            Path(one.name).name, (cost_of(one), one.accuracy), fontsize=7,
            ha="left" if beside else "right", xytext=(5 if beside else -5, 3),
            textcoords="offset points",
        )  # fmt: skip
    quantity_axis(axes.xaxis, unit)
    axes.margins(x=0.3)
    axes.set_xlabel(label)
