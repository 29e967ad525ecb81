"""Accuracy of evaluated runs against what they would cost on a target."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure

from edge_vpr.errors import UsageError
from edge_vpr.reference_map import ReferenceMap
from edge_vpr_tools import results
from edge_vpr_tools.estimate.fit import Budget, broken_by, memory_bytes
from edge_vpr_tools.estimate.model import Cost, Mission, cost
from edge_vpr_tools.estimate.of_map import design_of, event_rates
from edge_vpr_tools.estimate.targets import Constant, Target
from edge_vpr_tools.report.style import BLUE, ORANGE, figure
from firmware_model.design import Design
from firmware_model.errors import DesignError


@dataclass(frozen=True)
class Candidate:
    """One evaluated run, as a device.

    Attributes
    ----------
    name : str
        Of its folder.
    accuracy : float
        P@100R on its own drives.
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
    own_places: int
    design: Design
    cost: Cost
    memory_bytes: int
    limited_by: str


def candidates(
    folder: Path,
    target: Target,
    budgets: Sequence[Budget],
    places: int | None = None,
    matches_per_s: float | None = None,
    cycle_energy: Constant | None = None,
) -> list[Candidate]:
    """Take every evaluated run below a folder, best accuracy first.

    Parameters
    ----------
    folder : path
    target : Target
    budgets : sequence of Budget
    places : int, optional
        K of the mission's route, in place of each map's.
    matches_per_s : float, optional
        By default one a window.
    cycle_energy : Constant, optional
        See `cost`.

    Returns
    -------
    list of Candidate

    Raises
    ------
    UsageError
        If no run was evaluated.
    """
    found = []
    for metrics in sorted(folder.rglob(results.METRICS)):
        told = json.loads(metrics.read_text(encoding="utf-8")).get("evaluation")
        if told is None or not (metrics.parent / results.MAP).is_file():
            continue
        reference = ReferenceMap.load(metrics.parent / results.MAP)
        rate, share = event_rates(reference)
        try:
            design = design_of(reference)
            if places is not None:
                design = replace(design, places=places)
        except DesignError as error:
            raise UsageError(f"{metrics.parent}: {error}") from error
        a_window = int((reference.places.end_us - reference.places.start_us).sum()) / 1e6
        mission = Mission(rate, share, matches_per_s or len(reference) / max(a_window, 1e-6))
        limit = broken_by(design, target, mission, budgets, cycle_energy)
        found.append(
            Candidate(
                name=str(metrics.parent),
                accuracy=told["precision_at_100_recall"],
                own_places=len(reference),
                design=design,
                cost=cost(design, target, mission, cycle_energy),
                memory_bytes=memory_bytes(design, target),
                limited_by=limit,
            )
        )
    if not found:
        raise UsageError(f"no evaluated run in {folder}: edge-vpr match, then edge-vpr evaluate")
    return sorted(found, key=lambda one: (-one.accuracy, one.memory_bytes))


def frontier(found: Sequence[Candidate]) -> list[Candidate]:
    """Those that no other one beats: as accurate or more, and smaller."""
    best: list[Candidate] = []
    for one in sorted(found, key=lambda c: (c.memory_bytes, -c.accuracy)):
        if not best or one.accuracy > best[-1].accuracy:
            best.append(one)
    return best


def draw(found: Sequence[Candidate], target: Target) -> Figure:
    """Draw accuracy against memory, and against energy where it is known."""
    kept = frontier(found)
    with figure(8.0, 4.8) as (drawing, axes):
        for one in found:
            energy = one.cost.per_match_j
            label = Path(one.name).name
            if energy is not None:
                label += f", {energy.central * 1e6:.3g} uJ"
            axes.plot(
                one.memory_bytes, one.accuracy, "x" if one.limited_by else "o",
                color=ORANGE if one.limited_by else BLUE,
            )  # fmt: skip
            axes.annotate(
                label, (one.memory_bytes, one.accuracy), xytext=(5, 4), textcoords="offset points",
                fontsize=8,
            )  # fmt: skip
        axes.step(
            [one.memory_bytes for one in kept], [one.accuracy for one in kept], where="post",
            color=BLUE, lw=1, alpha=0.6,
        )  # fmt: skip
        axes.set_xscale("log")
        axes.set(
            title=f"Accuracy against memory on {target.name}; energy of a match is modelled",
            xlabel="memory (bytes); crosses: over a budget",
            ylabel="P@100R",
        )
    return drawing
